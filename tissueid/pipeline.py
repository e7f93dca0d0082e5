"""The stages in their order: recordings in, an identification out.

No mathematics and no paths here.  Trials come as an iterable; where a ``reload`` is given, samples are
kept only while they fit in a small cache and are read again when needed, so that the memory of a study
does not grow with it.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import PurePath
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.errors import InputError, exit_code
from tissueid.fit.specimen import FitOptions, LogHandle, fit_specimen
from tissueid.fit.window import fitted_log
from tissueid.result import Exit, Identification, Refusal, SpecimenFit
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Axes, Segmentation, Source, Trial

__all__ = [
    "DEFAULT_REQUIRED",
    "REQUIRABLE",
    "IdentifyOptions",
    "arithmetic_refusal",
    "identify",
]

#: Samples kept in memory between the passes [bytes].
CACHE_BYTES = 16 * 2**20
#: Libraries whose version may change a number.
LIBRARIES = ("lmfit", "numba", "numpy", "scipy")
REQUIRABLE = ("viscosity", "static", "stiffness", "relaxation-time")
DEFAULT_REQUIRED = ("viscosity", "static")
_PREFIX = {
    "viscosity": "viscosity",
    "static": "static",
    "stiffness": "stiffness",
    "relaxation-time": "relaxation_time",
}


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """Options of a run.

    Attributes
    ----------
    fit : FitOptions
    segment : SegmentOptions
    required : tuple of str
        What must be identified for exit code 0, of :data:`REQUIRABLE`.
    seed : int
        Seed of everything random; recorded, and without effect where nothing is drawn.
    """

    fit: FitOptions = field(default_factory=FitOptions)
    segment: SegmentOptions = field(default_factory=SegmentOptions)
    required: tuple[str, ...] = DEFAULT_REQUIRED
    seed: int = 0


_Progress = Callable[[str, int, int], None]


class _TrialCache:
    """The most recent trials, up to a number of bytes."""

    def __init__(self, reload: Callable[[Source], Trial] | None) -> None:
        self._reload = reload
        self._trials: OrderedDict[tuple[str, str | None], Trial] = OrderedDict()
        self._bytes = 0

    @property
    def reloads(self) -> bool:
        """True where a trial that was dropped can be read again."""
        return self._reload is not None

    @staticmethod
    def _size(trial: Trial) -> int:
        return trial.time_s.nbytes + trial.displacement_mm.nbytes + trial.force_N.nbytes

    def add(self, key: tuple[str, str | None], trial: Trial) -> None:
        self._trials[key] = trial
        self._bytes += self._size(trial)
        while self._reload is not None and self._bytes > CACHE_BYTES and len(self._trials) > 1:
            _, oldest = self._trials.popitem(last=False)
            self._bytes -= self._size(oldest)

    def get(self, key: tuple[str, str | None], source: Source) -> Trial:
        if key in self._trials:
            self._trials.move_to_end(key)
            return self._trials[key]
        if self._reload is None:
            raise KeyError(key)
        trial = self._reload(source)
        if trial.source.sha256 != source.sha256:
            msg = "the file changed while it was being fitted; run again when it is whole"
            raise InputError(code="unreadable_file", message=msg, path=source.path, sheet=source.sheet)
        self.add(key, trial)
        return trial


def arithmetic_refusal(path: str, sheet: str | None, done: str, error: Exception) -> Refusal:
    """The refusal of a trial whose numbers defeat the arithmetic while it is ``done``."""
    message = (
        f"the samples defeat the arithmetic and could not be {done} ({type(error).__name__}: {error}); are "
        "their units and magnitudes right? `tissueid inspect` shows them"
    )
    return Refusal(path=path, sheet=sheet, code="fit_failed", message=message)


def _mixed_axes(trial: Trial) -> Refusal:
    message = (
        f"its displacement is in {trial.axes.length} and its force in {trial.axes.force}, unlike the other"
        f" recordings of {trial.specimen}: give it a specimen of its own, or declare the same axes"
    )
    return Refusal(path=trial.source.path, sheet=trial.source.sheet, code="mixed_axes", message=message)


def _refusal_for(trial: Trial, segmentation: Segmentation) -> Refusal:
    if segmentation.contact is None:
        code, message = "no_contact", "no contact between tool and tissue was found: there is nothing to fit"
    else:
        code = "too_few_samples"
        message = (
            "fewer than six samples, or samples of one and the same force, lie between contact and "
            "unloading: there is nothing to fit"
        )
    return Refusal(path=trial.source.path, sheet=trial.source.sheet, code=code, message=message)


def _display_names(sources: Sequence[tuple[str, Source]]) -> dict[str, str]:
    """Specimens named after their file get the shortest ending of the path that tells them apart."""
    names: dict[str, str] = {}
    own: dict[str, tuple[str, ...]] = {}
    for specimen, source in sources:
        whole = source.path if source.sheet is None else f"{source.path}::{source.sheet}"
        if specimen == whole:
            path = PurePath(source.path)
            sheet = () if source.sheet is None else (source.sheet,)
            own[specimen] = (*path.parts[:-1], path.stem, *sheet)
        else:
            names[specimen] = specimen
    taken = set(names.values())
    waiting = dict(own)
    for length in range(1, max(map(len, own.values()), default=0) + 1):
        endings = {specimen: "/".join(parts[-length:]) for specimen, parts in own.items()}
        count = Counter(endings.values())
        for specimen in list(waiting):
            if count[endings[specimen]] == 1 and endings[specimen] not in taken:
                names[specimen] = endings[specimen]
                del waiting[specimen]
        taken.update(names.values())
    # files that differ in nothing but their suffix keep their whole path
    return names | {specimen: specimen for specimen in waiting}


def _tip_radius(protocol_radii: Iterable[float | None]) -> float | None:
    radii = set(protocol_radii)
    return radii.pop() if len(radii) == 1 else None


def _reasons(specimens: Sequence[SpecimenFit], required: Sequence[str]) -> list[str]:
    reasons = []
    prefixes = tuple(_PREFIX[name] for name in required)
    for fit in specimens:
        missing = [one.name for one in fit.parameters if not one.identified and one.name.startswith(prefixes)]
        if missing:
            reasons.append(f"{fit.specimen}: not identified: {', '.join(missing)}")
        if any(flag.code == "not_converged" for flag in fit.flags):
            reasons.append(f"{fit.specimen}: Levenberg-Marquardt did not converge")
    return reasons


def _exit(specimens: Sequence[SpecimenFit], refused: Sequence[Refusal], required: Sequence[str]) -> Exit:
    codes: set[int] = {0}
    reasons: list[str] = []
    if refused:
        codes.add(7 if specimens else 3)
        reasons += map(str, refused)
    elif not specimens:
        codes.add(3)
        reasons.append("no recording was found")
    missing = _reasons(specimens, required)
    if missing:
        codes.add(4)
    return Exit(code=exit_code(codes), reasons=tuple(reasons + missing))


@dataclass(slots=True)
class _Collected:
    """Trials by specimen, before anything is fitted."""

    groups: dict[str, list[LogHandle]] = field(default_factory=dict)
    radii: dict[str, list[float | None]] = field(default_factory=dict)
    axes: dict[str, Axes] = field(default_factory=dict)
    sources: list[tuple[str, Source]] = field(default_factory=list)
    inputs: list[dict[str, Any]] = field(default_factory=list)
    left_out: list[Refusal] = field(default_factory=list)

    def add(self, trial: Trial, handle: LogHandle) -> None:
        """Count one trial in."""
        self.axes.setdefault(trial.specimen, trial.axes)
        if trial.specimen not in self.groups:
            self.sources.append((trial.specimen, trial.source))
        self.groups.setdefault(trial.specimen, []).append(handle)
        self.radii.setdefault(trial.specimen, []).append(trial.protocol.tip_radius_mm)
        self.inputs.append(
            {
                "path": trial.source.path,
                "sheet": trial.source.sheet,
                "sha256": trial.source.sha256,
                "recipe": trial.source.recipe,
                "columns": dict(trial.source.columns),
                "specimen": trial.specimen,
                "n_samples": int(trial.time_s.size),
            }
        )


def _collect(
    trials: Iterable[Trial], options: IdentifyOptions, cache: _TrialCache, progress: _Progress
) -> _Collected:
    """Read and segment every trial; its samples stay only in the cache."""
    collected = _Collected()
    for count, trial in enumerate(trials):
        progress(f"reading {trial.name}", count, 0)
        try:
            segmentation = segment(trial, options=options.segment)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            collected.left_out.append(
                arithmetic_refusal(trial.source.path, trial.source.sheet, "segmented", error)
            )
            continue
        if trial.axes != collected.axes.get(trial.specimen, trial.axes):
            collected.left_out.append(_mixed_axes(trial))
            continue
        log = fitted_log(trial, segmentation)
        if log is None:
            collected.left_out.append(_refusal_for(trial, segmentation))
            continue
        key = (trial.source.path, trial.source.sheet) if cache.reloads else (str(count), None)
        cache.add(key, trial)
        handle = LogHandle(
            load=lambda key=key, source=trial.source: cache.get(key, source),  # type: ignore[misc]
            segmentation=segmentation,
            facts=log.without_samples(),
            contact_sd_mm=log.contact_sd_mm,
        )
        collected.add(trial, handle)
    return collected


def _fit_all(
    collected: _Collected, names: Mapping[str, str], options: IdentifyOptions, progress: _Progress
) -> list[SpecimenFit]:
    """Fit every specimen; one whose numbers defeat the arithmetic is refused, and the rest goes on."""
    fits: list[SpecimenFit] = []
    total = len(collected.groups)
    for done, (specimen, handles) in enumerate(collected.groups.items()):
        name = names[specimen]

        def tick(message: str, *, name: str = name, done: int = done) -> None:
            progress(f"{name}: {message}", done, total)

        tick("fitting")
        try:
            fit = fit_specimen(name, handles, options=options.fit, tick=tick)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            collected.left_out += [
                arithmetic_refusal(entry["path"], entry["sheet"], "fitted", error)
                for entry in collected.inputs
                if entry["specimen"] == specimen
            ]
            continue
        radius_mm = _tip_radius(collected.radii[specimen])
        fits.append(replace(fit, tip_radius_mm=radius_mm, axes=collected.axes[specimen]))
    progress("fitted", total, total)
    return fits


def identify(
    trials: Iterable[Trial],
    *,
    options: IdentifyOptions | None = None,
    reload: Callable[[Source], Trial] | None = None,
    refused: Sequence[Refusal] = (),
    provenance: Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Identification:
    """Identify the contact model of every specimen among the trials.

    Parameters
    ----------
    trials : iterable of Trial
        Trials of one specimen are fitted together.
    options : IdentifyOptions, optional
    reload : callable, optional
        Reads a trial again from its source; without it all samples stay in memory.
    refused : sequence of Refusal, optional
        Inputs refused while ``trials`` was read; looked at after the iteration has ended.
    provenance : mapping, optional
        Added to the versions, options and inputs that are recorded anyway.
    progress : callable, optional
        ``progress(message, done, total)``; total is 0 while it is not known.

    Returns
    -------
    Identification
        Its ``exit`` says whether something was left out or not identified.
    """
    options = options or IdentifyOptions()
    progress = progress or (lambda _message, _done, _total: None)
    collected = _collect(trials, options, _TrialCache(reload), progress)
    names = _display_names(collected.sources)
    fits = _fit_all(collected, names, options, progress)
    inputs = [entry | {"specimen": names[entry["specimen"]]} for entry in collected.inputs]
    everything = [*refused, *collected.left_out]
    return Identification(
        specimens=tuple(fits),
        refused=tuple(everything),
        exit=_exit(fits, everything, options.required),
        provenance={
            "tissueid": __version__,
            "versions": {name: version(name) for name in LIBRARIES},
            "options": {
                "branches": options.fit.branches or "auto",
                "stiffness_degree": (
                    "auto" if options.fit.stiffness_degree is None else options.fit.stiffness_degree
                ),
                "static": options.fit.static,
                "compression_sign": options.segment.compression_sign,
                "contact_displacement_mm": options.segment.contact_displacement_mm,
                "required": list(options.required),
                "seed": options.seed,
            },
            "inputs": inputs,
            **(provenance or {}),
        },
    )
