"""``tissueid calibrate``, of a recipe, a study or recordings, or a bundle; and ``calibrate-frame``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from tissueid.cli.flags import FILE, FOLDER, FROM_0, FROM_1, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.output import checked, made_folder, note, progress_bar, refuse_foreign, tell, write_output
from tissueid.cli.reading import ReadingFlags, read_all, read_options, recorded_options
from tissueid.cli.synth_command import check_rate
from tissueid.documents.folder import Frame
from tissueid.documents.selfcheck import Prior, SelfCheck, Source
from tissueid.errors import InputError, NotIdentifiedError, UsageError, refuse
from tissueid.report.wording import counted
from tissueid.store.files import json_bytes, time_now, write_file

if TYPE_CHECKING:
    from tissueid.collection import Progress
    from tissueid.priors import Priors
    from tissueid.result import Refusal
    from tissueid.selfcheck.protocol import Centre, Protocol
    from tissueid.selfcheck.tissue import TissueCheck
    from tissueid.selfcheck.verdicts import Verdict
    from tissueid.store.bundle import Bundle

#: Below so many simulations even gross errors stay within the bands.
FEWEST = 20
_FILES = ("calibrate.json", "calibrate.html", "calibrate.jsonl")


class _CalibrateFlags(OutputFlags):
    # fmt: off
    source: str = argument(type=PATH)
    out: str = option(
        "Folder for calibrate.json, calibrate.html and calibrate.jsonl; a second call goes on there.",
        "-o", type=FOLDER, default="tissueid-calibration",
    )
    simulations: int = option(
        "How many truths are drawn, recorded and inferred.",
        type=click.IntRange(min=FEWEST), default=200, metavar="N",
    )
    seed: int = option("Seed of everything random.", type=FROM_0, default=0)
    workers: int = option("Processes; results do not depend on them.", type=FROM_1, default=1)
    specimen: str | None = option("Which specimen of a study, where it has several.", metavar="NAME")
    model: str | None = option("Law of the tissue in recordings, as of tissueid fit.", metavar="NAME")
    interval: Literal["statistical", "total"] = option(
        "total draws calibration defects from their priors and checks the intervals that know these.",
        default="statistical",
    )
    noise: Literal["auto", "white", "ar1"] = option(
        "Noise of the recordings; auto takes the recipe's, or that of the fit.", default="auto"
    )
    phi: float | None = option(
        "Correlation of neighbouring samples in the middle of its prior, with --noise ar1.",
        type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True), metavar="PHI",
    )
    rate: float | None = option("Sampling rate of a recipe, where not its own.", metavar="HZ")
    # fmt: on


@subcommand(
    "calibrate",
    "paper-a-30-k1 --rate 100",
    "lab_data/study.toml -o calibration --simulations 500",
    "out/bundle.h5 --interval total --workers 4",
    'lab_data/ --model "power * fung"',
    "my_recipe.toml --noise ar1 --phi 0.95",
)
def command(flags: _CalibrateFlags) -> int:
    """Check whether the intervals hold what they claim, for your own protocol.

    SOURCE is a study.toml or a folder of recordings (their own measured displacement is used), a bundle of
    a fit, or a recipe of tissueid synth. Tissues are drawn from proper priors around the one that was found,
    recorded with noise on the protocol's samples, and inferred again as fit does it; the ranks of the truths
    and the coverage of 50, 80, 90 and 95 % intervals are judged within family-wise 99 % bands. Exit code 4
    where they leave these. A killed run goes on where it was.
    """
    from tissueid.report.selfcheck_page import render_selfcheck
    from tissueid.selfcheck.records import Checkpoint, fingerprint, run_simulations
    from tissueid.selfcheck.tissue import described, tissue_check
    from tissueid.selfcheck.verdicts import check_document

    if flags.phi is not None and flags.noise != "ar1":
        refuse("--phi is the correlation of --noise ar1: give both, or neither")
    with progress_bar(show=not flags.quiet) as progress:
        found = found_source(flags, progress)
        centre, defects = _with_noise(found.centre, flags), flags.interval == "total"
        check = tissue_check(found.protocol, centre, stated=found.stated, defects=defects)
        out = made_folder(flags.out)
        refuse_foreign(out, _FILES[:2], _FILES[2], f"without the {_FILES[2]} they come from")
        digest = fingerprint({"check": described(check), "seed": flags.seed})
        counts = {"simulations": flags.simulations, "seed": flags.seed}
        with Checkpoint(out / _FILES[2], digest) as checkpoint:
            records = run_simulations(check, checkpoint, **counts, workers=flags.workers, progress=progress)
    source = Source(found.kind, flags.source, found.specimen)
    written, verdict = check_document(source, found.protocol, check, records, **counts)
    document, read = checked(written, SelfCheck, where=_FILES[0])
    write_file(out / _FILES[0], json_bytes(document))
    write_file(out / _FILES[1], render_selfcheck(read, created=time_now()).encode("utf-8"))
    tell(flags, document, _lines(check, read.priors, found.protocol, verdict, flags.out))
    for reason in verdict.reasons:
        note(f"not calibrated: {reason}", quiet=flags.quiet)
    return 0 if verdict.calibrated else NotIdentifiedError.exit_status


def _with_noise(centre: Centre, flags: _CalibrateFlags) -> Centre:
    """The noise the user asked for, or that of the source."""
    if flags.noise == "auto":
        return centre
    if flags.noise == "white":
        return replace(centre, phi=0.0, white_share=0.0)
    phi = flags.phi or centre.phi
    if phi == 0.0:
        refuse("--noise ar1 needs its correlation here: add --phi, as --phi 0.9")
    return replace(centre, phi=phi, white_share=0.0)


def _lines(
    check: TissueCheck, priors: Sequence[Prior], protocol: Protocol, verdict: Verdict, out: str
) -> Iterator[str]:
    yield (
        f"{protocol.words}: {counted(len(protocol.logs), 'log')}, "
        f"{protocol.samples:,} samples; {check.noise_model} noise; {verdict.simulations} simulations"
    )
    yield ""
    yield "priors"
    yield from (f"  {one.name}: {one.prior}" for one in priors)
    width = max(len(one.name) for one in verdict.parameters)
    levels = "".join(f"{100 * row.level:>7g} %" for row in verdict.parameters[0].coverage)
    yield ""
    yield f"{'coverage of':<{width}}{levels}   mean z   spread"
    for one in verdict.parameters:
        shares = "".join(f"{100 * row.fraction:>9.1f}" for row in one.coverage)
        mark = "" if one.calibrated else "   outside its band"
        yield f"{one.name:<{width}}{shares}{one.mean_z:>9.2f}{one.spread_ratio:>9.2f}{mark}"
    bands = "".join(f"{100 * row.low:>4.0f}-{100 * row.high:<4.0f}" for row in verdict.parameters[0].coverage)
    yield f"{'band':<{width}}{bands}"
    yield ""
    yield f"{'calibrated' if verdict.calibrated else 'NOT calibrated'}: {out}/{_FILES[1]}"


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Object of a check."""

    kind: Literal["recipe", "study", "bundle"]
    specimen: str
    protocol: Protocol
    centre: Centre
    stated: Priors | None = None  # of a study


def found_source(flags: _CalibrateFlags, progress: Progress) -> Found:
    """Look at the source the user named."""
    from tissueid.selfcheck.protocol import of_recipe
    from tissueid.synth import RECIPES, load_recipe, recipe

    named: str = flags.source
    is_recipe = named in RECIPES or _is_recipe(Path(named))
    if flags.model is not None and (is_recipe or bundle_file(Path(named)) is not None):
        refuse("--model is for recordings: a recipe and a bundle have a law of their own")
    if is_recipe:
        if flags.rate is not None:
            check_rate(flags.rate)
        plan = recipe(named) if named in RECIPES else load_recipe(named)
        return Found("recipe", plan.specimen, *of_recipe(plan, rate_Hz=flags.rate))
    if flags.rate is not None:
        refuse("--rate is for recipes: recordings and bundles have their own")
    if not Path(named).exists() and "::" not in named:
        refuse(f"{named}: no such file, folder or recipe; recipes are {', '.join(sorted(RECIPES))}")
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


def bundle_file(path: Path) -> Path | None:
    """The bundle a path means: itself, or the only one of an output folder."""
    if path.is_file():
        return path if path.suffix in {".h5", ".hdf5"} else None
    if not (path / "identification.json").is_file():
        return None
    only = path / "bundle.h5"
    if not only.is_file():
        names = ", ".join(map(str, sorted(path.glob("bundle*.h5")))) or "none there"
        refuse(f"{path} is the output of a fit of several specimens: name one bundle ({names})")
    return only


def _bundle(path: Path, flags: _CalibrateFlags, progress: Progress) -> Found:
    from tissueid.selfcheck.protocol import inputs_there, of_bundle, pooled
    from tissueid.store.bundle import load_bundle

    bundle = load_bundle(path)
    program, centre = of_bundle(bundle, where=str(path))
    measured = _measured(bundle, progress) if inputs_there(bundle) else None
    if measured is None:
        note(f"note: {program.words}", quiet=flags.quiet)
        return Found("bundle", bundle.specimen, program, centre)
    centre = replace(centre, pooling=pooled(bundle.model.static_pooling, logs=len(measured.logs)))
    return Found("bundle", bundle.specimen, measured, centre)


def _measured(bundle: Bundle, progress: Progress) -> Protocol | None:
    """The measured x(t) behind a bundle, read as it was read then."""
    from tissueid.selfcheck.protocol import inputs_there, of_bundle_inputs
    from tissueid.study.recordings import locate_study

    reading = recorded_options(bundle.provenance.get("reading", {}))
    manifest = bundle.provenance.get("study", {}).get("path")
    paths = tuple(dict.fromkeys(str(entry["path"]) for entry in inputs_there(bundle)))
    try:
        study = locate_study((), named=manifest)[0] if manifest else None
        trials = read_all(paths, reading, study, refused=[])
        return of_bundle_inputs(trials, bundle, study=study, progress=progress)
    except (InputError, UsageError):
        # the study or a file has changed since: a program stands in, and that is said
        return None


def _recordings(named: str, flags: _CalibrateFlags, progress: Progress) -> Found:
    from tissueid.selfcheck.protocol import Recordings, of_recordings
    from tissueid.study.recordings import locate_study, read_decided_one

    reading = recorded_options({})
    study, paths = locate_study((named,))
    refused: list[Refusal] = []
    given = Recordings(
        read_all(paths, reading, study, refused),
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


class _CalibrateFrameFlags(ReadingFlags, OutputFlags):
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    output: str = option("Frame file to write.", "-o", type=FILE, default="frame.json")


@subcommand("calibrate-frame", "rigid.csv", "rigid-1.csv rigid-2.csv -o lab_data/frame.json")
def calibrate_frame(flags: _CalibrateFrameFlags) -> int:
    """Measure how far machine, load cell and fixture give, from recordings of a rigid block.

    Press the tip on steel, several times, to the largest force of the tests. Every loading counts; several
    show how repeatable the frame is. fit takes the deflection off the displacement where study.toml names
    the file, under [calibration]: frame = "frame.json".
    """
    from tissueid.study.calibrate_frame import calibrate_frame as measured_frame

    trials = list(read_all(flags.paths, read_options(flags)))
    written, document = checked(measured_frame(trials), Frame, where=flags.output)
    write_output(flags.output, json_bytes(written))
    tell(flags, written, _frame_lines(document))
    note(f"wrote {flags.output}", quiet=flags.quiet)
    return 0


def _frame_lines(document: Frame) -> Iterator[str]:
    top = document.range_N[1]
    yield f"{counted(document.loadings, 'loading')} to {top:.4g} N"
    yield f"stiffness above {top / 2:.3g} N: {document.stiffness_N_per_mm:.4g} N/mm"
    yield "force [N]   deflection [mm]   sd [mm]"
    for force, give, sd in zip(document.force_N, document.deflection_mm, document.sd_mm, strict=True):
        yield f"{force:9.4g}   {give:15.5f}   {sd:7.5f}"
    if document.repeatability_sd_mm is None:
        yield "one loading: a repeatability of 5 % was assumed; record several to know it"
