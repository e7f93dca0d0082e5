"""Protocol and tissue of recordings: read, segmented and identified once, to centre the priors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from tissueid import IdentifyOptions, PosteriorOptions, identify
from tissueid.collection import display_names
from tissueid.decided import decided_options, decided_trial, why_excluded
from tissueid.documents.identification import NoiseFit
from tissueid.errors import InputError, UsageError
from tissueid.inference.specimen import FitOptions
from tissueid.manifest import Study
from tissueid.measured.pushes import usable_until
from tissueid.model.frame import deflection
from tissueid.model.grammar import rebuilt
from tissueid.result import SpecimenFit
from tissueid.segment import SegmentOptions, segment
from tissueid.selfcheck.protocol import Centre, Protocol, pooled
from tissueid.selfcheck.ranks import DRAWS
from tissueid.selfcheck.recording import ProtocolLog
from tissueid.store.bundle import Bundle
from tissueid.store.files import sha256_of
from tissueid.trial import Contact, Segmentation, Source, Trial, contact_frame

#: A bundle's contact points were refined by its fit: depths may differ by a little.
DEPTH_TOLERANCE = 0.02
#: A known frame gives under a mean force of so many samples, without most of its noise.
SMOOTHED = 11

_Progress = Callable[[str, int, int], None]
_Reload = Callable[[Source], Trial]


def _in_contact(raw: Trial, study: Study | None) -> tuple[Trial, Segmentation, Contact] | None:
    """A recording as the study decides it, divided; ``None`` where a fit would leave it out."""
    trial, options = raw, SegmentOptions()
    decision = None
    if study is not None:
        decision = study.decision(raw.source.path, raw.source.sheet)
        if study.only_listed and not decision.listed:
            return None
        trial, options = decided_trial(raw, decision, study), decided_options(options, decision)
    if why_excluded(raw, decision, study) is not None:
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
        msg = f"{where} holds {len(names)} specimens: choose one with --specimen: {', '.join(names)}"
        raise UsageError(msg)
    name = specimen or next(iter(names))
    if name not in names:
        msg = f"{where} holds no specimen {name!r}; there are {', '.join(names)}"
        raise UsageError(msg)
    return name, names[name]


@dataclass(frozen=True, slots=True)
class Recordings:
    """Recordings that a check is made of, as they are read."""

    trials: Iterable[Trial]
    reload: _Reload
    where: str  # as the user named them
    study: Study | None = None


def of_recordings(
    given: Recordings, *, specimen: str | None, model: str | None, progress: _Progress
) -> tuple[str, Protocol, Centre]:
    """Name, protocol and identified tissue of one specimen of some recordings.

    ``model``: law of the tissue; that of the study, or the paper's, where it is None.  Raises InputError:
    nothing can be fitted; UsageError: there are several specimens and none, or another, was named; the law
    can't be checked.
    """
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
        msg = f"{fit.model.name or fit.model.key} can't be checked: its times follow the recordings"
        raise UsageError(msg)
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
