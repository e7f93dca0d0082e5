"""A tissue under the servo's ticks: its force along a path, and what random closed loops put out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law

TICK = 1e-3


def walked(model: Any, theta: Any, time: Any, depth: Any) -> NDArray[np.float64]:
    """Force of the servo at every tick."""
    law, state = servo_law(model, theta).packed(), np.zeros(STATE_SIZE)
    steps = np.diff(time, prepend=time[0])
    return np.array([tissue_step_in(law, 0, state, 0, x, h) for x, h in zip(depth, steps, strict=True)])


def assert_no_energy(model: Any, theta: Any, rng: np.random.Generator, *, turns: int) -> None:
    """The work done on the tissue along a random closed loop is never negative, and it never pulls."""
    knots = np.concatenate([[0.0], rng.uniform(-0.2, 1.0, turns) * model.depth_mm, [-0.2]])
    time = np.cumsum(0.1 + rng.exponential(0.15, knots.size))
    ticks = np.arange(0.0, time[-1], TICK)
    depth = np.interp(ticks, time, knots)
    force = walked(model, theta, ticks, depth)
    work = float((0.5 * (force[1:] + force[:-1]) * np.diff(depth)).sum())
    assert work >= -1e-6 * force.max() * model.depth_mm
    assert force.min() >= 0.0
