"""Specimens with a known truth for the tests of the fit: the segmenter's part is played by the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.fit.candidates import SpecimenSums
from tissueid.fit.logs import LogHandle
from tissueid.fit.window import FittedLog, fitted_log
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.sums import LogData, log_sums
from tissueid.synth import Hold, Log, Move, Recipe, SyntheticLog, as_trials, simulate
from tissueid.trial import Contact, Phase, Segmentation, Trial

#: Standard deviation of a contact point that is known: small against every depth used here.
KNOWN_CONTACT_MM = 1e-4


def log_data(time_s, depth_mm, force_N, *, include=None, fold=None) -> LogData:
    """A log in the contact frame; everything included, one fold, unless said."""
    n = len(time_s)
    return LogData(
        time_s=np.ascontiguousarray(time_s, dtype=float),
        depth_mm=np.ascontiguousarray(depth_mm, dtype=float),
        force_N=np.ascontiguousarray(force_N, dtype=float),
        include=np.ones(n, dtype=bool) if include is None else np.asarray(include, dtype=bool),
        fold=np.zeros(n, dtype=np.int64) if fold is None else np.asarray(fold, dtype=np.int64),
    )


def sums_of(logs: Sequence[LogData], *, degree: int, offset_sd_mm: float = 0.05) -> SpecimenSums:
    """Sums of a specimen from hand-made logs."""
    steps = [np.diff(one.time_s) for one in logs]
    step = min(float(np.median(d[d > 0.0])) for d in steps)
    duration = max(float(one.time_s[-1] - one.time_s[0]) for one in logs)
    basis = kernel_basis(step_s=step, length_s=duration)
    made = [log_sums(one, basis, degree=degree) for one in logs]
    gram = np.concatenate([one.gram for one in made])
    return SpecimenSums(
        gram=gram,
        count=np.concatenate([one.count for one in made]),
        offset_sd_mm=np.full(gram.shape[0], offset_sd_mm),
        basis=basis,
        columns_degree=degree,
        depth_mm=max(float(one.depth_mm.max()) for one in logs),
        step_s=step,
        duration_s=duration,
        single=len(logs) == 1,
        logs=np.arange(gram.shape[0]),
    )


def phases_of(trial: Trial) -> tuple[Phase, ...]:
    """Ramp, and hold where there is one, from the protocol that made the trial."""
    time, n = trial.time_s, trial.time_s.size
    speed, depth = trial.protocol.speed_mm_s, trial.protocol.depth_mm
    corner = min(int(np.searchsorted(time, depth / speed - 1e-9)), n - 1)
    ramp = Phase("ramp", 0, corner + 1, float(time[0]), float(time[corner]), speed)
    if corner >= n - 2:
        return (replace(ramp, stop=n, end_s=float(time[-1])),)
    return ramp, Phase("hold", corner, n, float(time[corner]), float(time[-1]), 0.0)


def true_segmentation(trial: Trial, *, sd_mm: float = KNOWN_CONTACT_MM, noise_N: float = 0.0) -> Segmentation:
    """Contact at the first sample and at zero displacement, as the synthetic recordings have it."""
    contact = Contact(index=0, displacement_mm=0.0, sd_mm=sd_mm)
    return Segmentation(1, 1, contact, phases_of(trial), noise_N)


def handle_for(trial: Trial, segmentation: Segmentation) -> LogHandle:
    facts = fitted_log(trial, segmentation)
    assert isinstance(facts, FittedLog)
    return LogHandle(
        load=lambda: trial,
        segmentation=segmentation,
        facts=facts.without_samples(),
        contact_sd_mm=facts.contact_sd_mm,
    )


def handles_for(logs: Sequence[SyntheticLog], *, sd_mm: float = KNOWN_CONTACT_MM) -> list[LogHandle]:
    """What the pipeline would hand to the fit."""
    return [handle_for(trial, true_segmentation(trial, sd_mm=sd_mm)) for trial in as_trials(list(logs))]


def specimen_sums(logs: Sequence[SyntheticLog], *, degree: int, offset_sd_mm: float = 1e-4) -> SpecimenSums:
    """Sums of synthetic logs that start in contact."""
    data = [log_data(one.time_s, one.displacement_mm, one.force_N) for one in logs]
    return sums_of(data, degree=degree, offset_sd_mm=offset_sd_mm)


def small_recipe(**changes) -> Recipe:
    """Three ramps and two short holds of one soft specimen: a few thousand samples at 100 Hz."""
    ramps = tuple(Log(f"ramp-{v:03.0f}", (Move(4.0, v),)) for v in (60.0, 240.0, 600.0))
    holds = tuple(Log(f"hold-{d:.0f}", (Move(d, 240.0), Hold(3.0))) for d in (2.0, 4.0))
    return replace(Recipe("small", ramps + holds, rate_Hz=100.0, sigma_N=0.2), **changes)


def draw(recipe: Recipe, seed: int) -> list[SyntheticLog]:
    return simulate(recipe, rng=np.random.default_rng(seed))


def by_name(fit) -> dict:
    """Parameters of a fit by name."""
    return {one.name: one for one in fit.parameters}
