"""Object of ``tissueid calibrate``: a recipe, a study or recordings, or a bundle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.cli.output import note
from tissueid.cli.reading import read_all, read_in_order, recorded_options
from tissueid.errors import UsageError

if TYPE_CHECKING:
    from tissueid.cli.calibrate_command import _CalibrateFlags
    from tissueid.priors import Priors
    from tissueid.result import Refusal
    from tissueid.selfcheck.protocol import Centre, Protocol
    from tissueid.store.bundle import Bundle

_Progress = Callable[[str, int, int], None]
_BUNDLE_SUFFIXES = (".h5", ".hdf5")
#: No test machine logs faster.
HIGHEST_RATE_HZ = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Object of a check."""

    kind: str  # ``recipe``, ``study`` or ``bundle``
    specimen: str
    protocol: Protocol
    centre: Centre
    stated: Priors | None = None  # of a study


def found_source(flags: _CalibrateFlags, progress: _Progress) -> Found:
    """Look at the source the user named.

    Raises UsageError: it is none, or an option does not go with it; InputError, BundleError: it can't be
    used.
    """
    from tissueid.synth import RECIPES

    named: str = flags.source
    recipe = named in RECIPES or _is_recipe(Path(named))
    if flags.model is not None and (recipe or bundle_file(Path(named)) is not None):
        msg = "--model is for recordings: a recipe and a bundle have a law of their own"
        raise UsageError(msg)
    if recipe:
        return _recipe(named, flags)
    if flags.rate is not None:
        msg = "--rate is for recipes: recordings and bundles have their own"
        raise UsageError(msg)
    if not Path(named).exists() and "::" not in named:
        msg = f"{named}: no such file, folder or recipe; recipes are {', '.join(sorted(RECIPES))}"
        raise UsageError(msg)
    bundle = bundle_file(Path(named))
    if bundle is not None:
        return _bundle(bundle, flags, progress)
    return _recordings(named, flags, progress)


def _is_recipe(path: Path) -> bool:
    """A TOML file that speaks of logs, and not of a study."""
    import tomllib

    if path.suffix != ".toml" or not path.is_file():
        return False
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        # the reader of studies says what is wrong with it
        return False
    return "logs" in table and "schema" not in table


def _recipe(named: str, flags: _CalibrateFlags) -> Found:
    from tissueid.selfcheck.protocol import of_recipe
    from tissueid.synth import RECIPES, load_recipe, recipe

    rate = flags.rate
    if rate is not None and not 0.0 < rate <= HIGHEST_RATE_HZ:
        msg = f"--rate is {rate}, must be above 0 and at most {HIGHEST_RATE_HZ:g} Hz"
        raise UsageError(msg)
    plan = recipe(named) if named in RECIPES else load_recipe(named)
    protocol, centre = of_recipe(plan, rate_Hz=rate)
    return Found("recipe", plan.specimen, protocol, centre)


def bundle_file(path: Path) -> Path | None:
    """The bundle a path means: itself, or the only one of an output folder."""
    if path.is_file():
        return path if path.suffix in _BUNDLE_SUFFIXES else None
    if not (path / "identification.json").is_file():
        return None
    only = path / "bundle.h5"
    if only.is_file():
        return only
    names = ", ".join(str(one) for one in sorted(path.glob("bundle*.h5")))
    msg = f"{path} is the output of a fit of several specimens: name one bundle ({names or 'none there'})"
    raise UsageError(msg)


def _bundle(path: Path, flags: _CalibrateFlags, progress: _Progress) -> Found:
    from dataclasses import replace

    from tissueid.selfcheck.protocol import of_bundle, pooled
    from tissueid.selfcheck.recorded import inputs_there
    from tissueid.store.bundle import load_bundle

    bundle = load_bundle(path)
    program, centre = of_bundle(bundle, where=str(path))
    measured = _measured(bundle, progress) if inputs_there(bundle) else None
    if measured is None:
        note(f"note: {program.words}", quiet=flags.quiet)
        return Found("bundle", bundle.specimen, program, centre)
    centre = replace(centre, pooling=pooled(bundle.model.static_pooling, logs=len(measured.logs)))
    return Found("bundle", bundle.specimen, measured, centre)


def _measured(bundle: Bundle, progress: _Progress) -> Protocol | None:
    """The measured x(t) behind a bundle, read as it was read then."""
    from tissueid.errors import InputError
    from tissueid.selfcheck.recorded import inputs_there, of_bundle_inputs
    from tissueid.study.recordings import locate_study

    reading = recorded_options(bundle.provenance.get("reading", {}))
    manifest = bundle.provenance.get("study", {}).get("path")
    paths = tuple(dict.fromkeys(str(entry["path"]) for entry in inputs_there(bundle)))
    try:
        study = locate_study((), named=manifest)[0] if manifest else None
        refused: list[Refusal] = []
        return of_bundle_inputs(
            read_all(read_in_order(paths, reading, study), refused),
            bundle,
            study=study,
            progress=progress,
        )
    except (InputError, UsageError):
        # the study or a file has changed since: a program stands in, and that is said
        return None


def _recordings(named: str, flags: _CalibrateFlags, progress: _Progress) -> Found:
    from tissueid.selfcheck.recorded import Recordings, of_recordings
    from tissueid.study.recordings import locate_study, read_decided_one

    reading = recorded_options({})
    study, paths = locate_study((named,))
    refused: list[Refusal] = []
    given = Recordings(
        read_all(read_in_order(paths, reading, study), refused),
        lambda source: read_decided_one(source.path, source.sheet, reading, study),
        named,
        study,
    )
    specimen, protocol, centre = of_recordings(
        given, specimen=flags.specimen, model=flags.model, progress=progress
    )
    for one in refused:
        note(f"refused ({one.code})  {one}", quiet=flags.quiet)
    return Found("study", specimen, protocol, centre, None if study is None else study.priors)
