"""Recordings that are no test at all: stairs, noise, jumps, equal times, nothing in the force."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tissueid.inference.window import fitted_log
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Protocol, Trial


def odd(rng: np.random.Generator) -> tuple[Trial, SegmentOptions]:
    """Any path with any force, few samples or many, some at one time."""
    n = int(rng.integers(2, 60)) if rng.random() < 0.5 else int(rng.integers(60, 400))
    steps = rng.choice([0.0, 0.01, 0.02, 1.0], n) * rng.random(n)
    time = np.arange(n) * 0.01 if rng.random() < 0.3 else np.cumsum(steps)
    depth = [
        lambda: rng.normal(0.0, 1.0, n),
        lambda: np.zeros(n),
        lambda: np.cumsum(rng.normal(0.0, 1.0, n)),
        lambda: np.repeat(rng.normal(0.0, 1.0, n // 5 + 1), 5)[:n],
        lambda: np.interp(np.arange(n), np.sort(rng.integers(0, n, 5)), rng.normal(0.0, 3.0, 5)),
        lambda: np.sin(np.arange(n) * rng.uniform(0.01, 1.0)),
        lambda: np.round(np.cumsum(rng.normal(0.1, 1.0, n))),
    ][int(rng.integers(7))]()
    force = [
        rng.normal(0.0, 1.0, n),
        10.0 * depth,
        np.zeros(n),
        np.maximum(depth, 0.0) ** 2,
        1e-9 * depth,
        1e6 * depth,
    ][int(rng.integers(6))]
    middle = float(time[n // 3])
    cut = rng.random() < 0.1 and middle < time[-1]
    options = SegmentOptions(
        contact_displacement_mm=float(rng.normal()) if rng.random() < 0.2 else None,
        minimum_hold_s=0.01 if rng.random() < 0.2 else None,
        start_s=middle if cut else None,
        end_s=float(time[-1]) if cut else None,
    )
    stated = Protocol(depth_mm=5.0, hold_s=1.0, load_limit_N=3.0) if rng.random() < 0.5 else Protocol()
    return Trial("odd", time, depth, force, stated), options


def test_anything_is_divided_without_an_error() -> None:
    rng = np.random.default_rng(99)
    for case in range(250):
        trial, options = odd(rng)
        with np.errstate(all="ignore"):
            found = segment(trial, options=options)
            fitted_log(trial, found)
        assert all(a.stop - 1 == b.start for a, b in pairwise(found.phases)), case
        assert all(phase.start <= phase.stop - 1 < trial.time_s.size for phase in found.phases), case
        numbers = [corner.duration_s for corner in found.corners]
        numbers += [value for event in found.events for value in event.values.values()]
        assert np.isfinite(numbers).all(), case
