"""The protocol that is checked, and the tissue in the middle: of a recipe, a bundle or recordings.

Recordings give their own measured x(t); a recipe gives its program behind an approach in air, a bundle
without its recordings a ramp-and-hold program within what it was identified on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from tissueid import IdentifyOptions, PosteriorOptions, identify
from tissueid.arrays import FloatArray
from tissueid.collection import display_names
from tissueid.decided import as_decided
from tissueid.documents.identification import NoiseFit
from tissueid.errors import BundleError, InputError, refuse
from tissueid.inference.specimen import FitOptions
from tissueid.inference.window import GUARD_SD
from tissueid.manifest import Study
from tissueid.measured.pushes import usable_until
from tissueid.model.channels import ChannelModel
from tissueid.model.frame import deflection
from tissueid.model.grammar import rebuilt
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import SpecimenFit
from tissueid.segment import segment
from tissueid.selfcheck.records import DRAWS
from tissueid.selfcheck.truth import ProtocolLog
from tissueid.store.bundle import Bundle
from tissueid.store.files import sha256_of
from tissueid.synth.recipe import SECONDS_PER_MINUTE, Hold, Log, Move, Recipe
from tissueid.synth.simulate import crosshead_path
from tissueid.trial import Contact, Segmentation, Source, Trial, contact_frame

#: Scatter of the contact points of a program without any [mm].
CONTACT_SD_MM = 0.01
#: Approach in air before a program: at least so long [s], and so many samples.
AIR_S, AIR_SAMPLES = 1.0, 50
#: Program of a bundle whose recordings are gone: hold [s] at the least and most, in longest relaxation times.
SHORTEST_HOLD_S, LONGEST_HOLD_S, HOLD_TIMES = 5.0, 60.0, 10.0
#: Its sampling interval [s], in shortest relaxation times.
FINEST_STEP_S, COARSEST_STEP_S, STEP_TIMES = 1e-3, 1e-2, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Centre:
    """The tissue that priors are centred on."""

    model: ChannelModel
    theta: FloatArray  # (p,)
    sigma_N: float
    phi: float = 0.0  # correlation of the noise over one reference step; 0 is white
    white_share: float = 0.0  # share of the noise's variance that is white beside a correlated part
    pooling: str = "partial"  # ``scaled``, ``partial`` or ``shared``


@dataclass(frozen=True, slots=True, eq=False)
class Protocol:
    """Logs that are recorded of one specimen."""

    words: str  # its origin, in one sentence
    logs: tuple[ProtocolLog, ...]
    speeds_mm_s: tuple[float, float]  # slowest and fastest loading

    @property
    def depth_mm(self) -> float:
        """Largest depth."""
        return max(float(log.depth_mm.max()) for log in self.logs)

    @property
    def step_s(self) -> float:
        """Finest of the logs' median sampling intervals."""
        steps = [np.diff(log.time_s) for log in self.logs]
        return min(float(np.median(step[step > 0.0])) for step in steps)

    @property
    def duration_s(self) -> float:
        """Longest log, from contact on."""
        return max(float(log.time_s[-1]) for log in self.logs)

    @property
    def samples(self) -> int:
        """Samples in contact."""
        return sum(int((log.depth_mm > 0.0).sum()) for log in self.logs)


def in_air_first(
    name: str, time_s: FloatArray, depth_mm: FloatArray, *, speed_mm_s: float, contact_sd_mm: float
) -> ProtocolLog:
    """A log of a path that starts at contact, behind an approach in air at one speed."""
    step = float(time_s[1] - time_s[0])
    air = step * np.arange(-max(int(np.ceil(AIR_S / step)), AIR_SAMPLES), 0)
    return ProtocolLog(
        name, np.concatenate([air, time_s]), np.concatenate([air * speed_mm_s, depth_mm]), contact_sd_mm
    )


def of_program(
    logs: Sequence[Log], *, rate_Hz: float, contact_sd_mm: float, rounding_s: float = 0.0, words: str
) -> Protocol:
    """The protocol of moves and holds that start at contact."""
    found: list[ProtocolLog] = []
    speeds = [move.speed_mm_s for log in logs for move in log.moves if isinstance(move, Move)]
    for log in logs:
        path = crosshead_path(log, rounding_s=rounding_s)
        time = np.arange(0.0, path.time_s[-1], 1.0 / rate_Hz)
        depth = path.at(time)
        if (depth >= GUARD_SD * contact_sd_mm).sum() < 2:
            message = f"log {log.name!r} of the program stays within its contact's standard deviation"
            raise InputError(code="recipe", message=message, path=words)
        first = next(move.speed_mm_s for move in log.moves if isinstance(move, Move))
        found += [
            in_air_first(
                f"{log.name}-{repeat + 1}", time, depth, speed_mm_s=first, contact_sd_mm=contact_sd_mm
            )
            for repeat in range(log.repeats)
        ]
    return Protocol(words=words, logs=tuple(found), speeds_mm_s=(min(speeds), max(speeds)))


def of_recipe(recipe: Recipe, *, rate_Hz: float | None = None) -> tuple[Protocol, Centre]:
    """Protocol and tissue of a synthetic recipe."""
    rate = rate_Hz or recipe.rate_Hz
    protocol = of_program(
        recipe.logs,
        rate_Hz=rate,
        contact_sd_mm=recipe.contact_offset_sd_mm or CONTACT_SD_MM,
        rounding_s=recipe.crosshead_rounding_s,
        words=f"the program of {recipe.name} at {rate:g} Hz",
    )
    degree = max((len(branch.stiffness) - 1 for branch in recipe.branches), default=0)
    variance = recipe.sigma_N**2 + recipe.ar1_sigma_N**2
    for wrong, message in (
        (not recipe.branches, "its tissue has no branch: there is no relaxation to infer, add [[branches]]"),
        (recipe.ar1_phi < 0.0, f"ar1_phi is {recipe.ar1_phi}; noise of negative correlation is not offered"),
        (variance == 0.0, "its noise is zero: a posterior needs some, give sigma_N or ar1_sigma_N"),
    ):
        if wrong:
            raise InputError(code="recipe", message=message, path=recipe.name)
    try:
        model = kelvin_voigt(
            branches=len(recipe.branches), stiffness_degree=degree, depth_mm=protocol.depth_mm
        )
    except ValueError as error:
        raise InputError(code="recipe", message=str(error), path=recipe.name) from error
    stiffness = np.array(
        [(*branch.stiffness, *[0.0] * (degree + 1 - len(branch.stiffness))) for branch in recipe.branches]
    )
    tau = np.array([branch.tau_s for branch in recipe.branches])
    correlated = recipe.ar1_sigma_N > 0.0 and recipe.ar1_phi > 0.0
    centre = Centre(
        model=model,
        theta=model.join(np.array(recipe.static), stiffness.reshape(len(recipe.branches), degree + 1), tau),
        sigma_N=float(np.sqrt(variance)),
        phi=recipe.ar1_phi if correlated else 0.0,
        white_share=recipe.sigma_N**2 / variance if correlated else 0.0,
        pooling=pooled("partial", logs=len(protocol.logs)),
    )
    return protocol, centre


def pooled(pooling: str, *, logs: int) -> str:
    """Way in which logs share F_s: one log has nothing to pool; bundles of before may say ``per-log``."""
    return "shared" if logs == 1 else {"per-log": "scaled"}.get(pooling, pooling)


def of_bundle(bundle: Bundle, *, where: str) -> tuple[Protocol, Centre]:
    """Tissue of a bundle, and a ramp-and-hold program within its depth and speeds."""
    model = bundle.contact_model()
    if not bundle.parameters or model.fixed_s.size:
        raise BundleError(
            f"{where}: {bundle.model.key} can't be checked: its times follow the recordings; fit another law"
        )
    tau = model.times(np.asarray(bundle.theta))
    slow, fast = bundle.speeds_mm_s
    slow, fast = (slow, fast) if fast > 0.0 else (1.0, 1.0)
    slow = slow if slow > 0.0 else fast
    longest, shortest = (float(tau.max()), float(tau.min())) if tau.size else (1.0, 1.0)
    hold_s = float(np.clip(HOLD_TIMES * longest, SHORTEST_HOLD_S, LONGEST_HOLD_S))
    step = float(np.clip(STEP_TIMES * shortest, FINEST_STEP_S, COARSEST_STEP_S))
    depth, middle = model.depth_mm, float(np.sqrt(slow * fast))
    ramps = [
        Log(f"ramp-{v:.3g}", (Move(depth, v * SECONDS_PER_MINUTE),)) for v in sorted({slow, middle, fast})
    ]
    holds = [
        Log(
            f"hold-{share * depth:.3g}",
            (Move(share * depth, fast * SECONDS_PER_MINUTE), Hold(hold_s)),
            repeats=2,
        )
        for share in (0.5, 1.0)
    ]
    protocol = of_program(
        [*ramps, *holds],
        rate_Hz=1.0 / step,
        contact_sd_mm=min(CONTACT_SD_MM, 1e-3 * depth),
        words=(
            f"a ramp-and-hold program within the bundle's depth ({depth:.3g} mm) and speeds "
            f"({slow:.3g} to {fast:.3g} mm/s), holds of {hold_s:.3g} s: its recordings are not there"
        ),
    )
    pooling = pooled(bundle.model.static_pooling, logs=len(protocol.logs))
    return protocol, Centre(model, np.asarray(bundle.theta), bundle.sigma_N, pooling=pooling)


#: A bundle's contact points were refined by its fit: depths may differ by a little.
DEPTH_TOLERANCE = 0.02
#: A known frame gives under a mean force of so many samples, without most of its noise.
SMOOTHED = 11

_Progress = Callable[[str, int, int], None]


def _in_contact(raw: Trial, study: Study | None) -> tuple[Trial, Segmentation, Contact] | None:
    """A recording as the study decides it, divided; ``None`` where a fit would leave it out."""
    trial, options, excluded = as_decided(raw, None, study)
    unlisted = (
        study is not None
        and study.only_listed
        and not study.decision(raw.source.path, raw.source.sheet).listed
    )
    if unlisted or excluded is not None:
        return None
    try:
        found = segment(trial, options=options)
    except (ArithmeticError, np.linalg.LinAlgError):
        return None
    return None if found.contact is None else (trial, found, found.contact)


def _turns(found: Segmentation, contact: Contact, size: int) -> int:
    """One past the last sample before the tool first turns back, or the tissue breaks."""
    stop = usable_until(found, size)
    for phase in found.phases[found.test :]:
        if phase.kind == "cycle" and phase.peak is not None:
            return min(phase.peak + 1, stop)
        if phase.kind == "retract" and phase.stop > contact.index + 1:
            return min(phase.start + 1, stop)
    return stop


def _log(raw: Trial, study: Study | None) -> tuple[ProtocolLog, list[float]] | None:
    """The measured x(t) of the tip to where it turns back, and the speeds of its ramps."""
    known = _in_contact(raw, study)
    if known is None:
        return None
    trial, found, contact = known
    depth, force = contact_frame(trial, found)
    frame = None if study is None else study.calibration.frame
    if frame is not None:
        depth = depth - deflection(frame, np.maximum(uniform_filter1d(force, SMOOTHED), 0.0))
    ramps = found.of_kind("ramp")
    stop = _turns(found, contact, depth.size)
    kept = slice(found.phases[0].start if found.phases else 0, stop)
    time = trial.time_s - trial.time_s[contact.index]
    log = ProtocolLog(trial.name, time[kept], depth[kept], contact.sd_mm)
    speeds = [one.speed_mm_s for one in ramps if one.stop > contact.index and one.start < stop - 1]
    return log, [speed for speed in speeds if speed > 0.0]


def _protocol(trials: Iterable[Trial], study: Study | None) -> Protocol:
    """The recordings' own measured x(t), without its force."""
    known = [one for one in (_log(raw, study) for raw in trials) if one is not None]
    speeds = [speed for _, own in known for speed in own] or [1.0]
    return Protocol(
        words=f"the measured x(t) of {len(known)} recording{'s' * (len(known) > 1)}",
        logs=tuple(log for log, _ in known),
        speeds_mm_s=(min(speeds), max(speeds)),
    )


def _chosen(
    trials: Iterable[Trial], study: Study | None, specimen: str | None, where: str, progress: _Progress
) -> tuple[str, Sequence[Source]]:
    """Name and recordings of the one specimen that is meant."""
    groups: dict[str, list[Source]] = {}
    for raw in trials:
        progress(f"read {raw.name}", 0, 0)
        known = _in_contact(raw, study)
        if known is not None:
            groups.setdefault(known[0].specimen, []).append(raw.source)
    shown = display_names([(key, sources[0]) for key, sources in groups.items()])
    names = {shown[key]: sources for key, sources in groups.items()}
    if not names:
        message = "holds no recording in which the tool meets a tissue"
        raise InputError(code="no_contact", message=message, path=where)
    if specimen is None and len(names) > 1:
        refuse(f"{where} holds {len(names)} specimens: choose one with --specimen: {', '.join(names)}")
    name = specimen or next(iter(names))
    if name not in names:
        refuse(f"{where} holds no specimen {name!r}; there are {', '.join(names)}")
    return name, names[name]


@dataclass(frozen=True, slots=True)
class Recordings:
    """Recordings that a check is made of, as they are read."""

    trials: Iterable[Trial]
    reload: Callable[[Source], Trial]
    where: str  # as the user named them
    study: Study | None = None


def of_recordings(
    given: Recordings, *, specimen: str | None, model: str | None, progress: _Progress
) -> tuple[str, Protocol, Centre]:
    """Name, protocol and identified tissue of one specimen of some recordings."""
    study, where = given.study, given.where
    name, sources = _chosen(given.trials, study, specimen, where, progress)
    own = [given.reload(source) for source in sources]
    options = IdentifyOptions(fit=FitOptions(model=model), posterior=PosteriorOptions(draws=DRAWS))
    found = identify(own, study=study, options=options, progress=progress)
    if not found.specimens:
        message = f"holds nothing that can be fitted; the first: {found.exit.reasons[0]}"
        raise InputError(code="no_contact", message=message, path=where)
    protocol, fit = _protocol(own, study), found.specimens[0]
    if not fit.parameters or rebuilt(fit.model, fit.depth_mm).fixed_s.size:
        refuse(f"{fit.model.name or fit.model.key} can't be checked: its times follow the recordings")
    return name, protocol, of_fit(fit, logs=len(protocol.logs))


def of_fit(fit: SpecimenFit, *, logs: int) -> Centre:
    """The tissue that was identified, and its noise: white, where no posterior tells of it."""
    noise = NoiseFit("white", fit.sigma_N, 0.0, 1.0) if fit.posterior is None else fit.posterior.noise
    return Centre(
        model=rebuilt(fit.model, fit.depth_mm),
        theta=np.asarray(fit.theta),
        sigma_N=noise.sigma_N,
        phi=0.0 if noise.model == "white" else noise.phi,
        white_share=white_share(noise),
        pooling=pooled(fit.model.static_pooling, logs=logs),
    )


def white_share(noise: NoiseFit) -> float:
    """Share of the variance that is white beside an AR(1), from the moving average that the two make.

    White noise and an AR(1) have a lag-one correlation of ``phi (1 - share)``; theirs as an ARMA(1, 1) is
    ``(phi - theta) (1 - phi theta) / (1 + theta^2 - 2 phi theta)``.
    """
    phi, theta = noise.phi, noise.moving_average
    if noise.model != "white+ar1" or phi <= 0.0:
        return 0.0
    lag_one = (phi - theta) * (1.0 - phi * theta) / (1.0 + theta**2 - 2.0 * phi * theta)
    return float(np.clip(1.0 - lag_one / phi, 0.0, 1.0))


def inputs_there(bundle: Bundle) -> list[dict[str, Any]]:
    """The recordings behind a bundle, where every one is still there and unchanged; empty otherwise."""
    inputs = [dict(entry) for entry in bundle.provenance.get("inputs", ())]
    for entry in inputs:
        path = Path(str(entry.get("path", "")))
        if not path.is_file() or sha256_of(path) != entry.get("sha256"):
            return []
    return inputs


def of_bundle_inputs(
    trials: Iterable[Trial], bundle: Bundle, *, study: Study | None, progress: _Progress
) -> Protocol | None:
    """The measured x(t) behind a bundle; ``None`` where the recordings are no longer those of its fit."""
    wanted = {(entry["path"], entry["sheet"]) for entry in inputs_there(bundle)}

    def own() -> Iterable[Trial]:
        for raw in trials:
            progress(f"read {raw.name}", 0, 0)
            if (raw.source.path, raw.source.sheet) in wanted:
                yield raw

    protocol = _protocol(own(), study)
    if len(protocol.logs) != len(wanted):
        return None
    # the passive set and the curves of the bundle end at its depth: samples beyond are none of its claims
    return protocol if protocol.depth_mm <= bundle.depth_mm * (1.0 + DEPTH_TOLERANCE) else None
