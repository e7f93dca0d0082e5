"""Random passive tissues and tool paths for the model tests, and their walk under the servo's ticks."""

from collections.abc import Callable
from typing import Any

import numpy as np
from closed_forms import from_coordinates
from hypothesis import settings
from hypothesis import strategies as st
from law_cases import typical
from numpy.typing import NDArray

from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law

DEPTH_MM = 8.0
#: Same examples in every run, none stored: a failure is reproduced by running the test again.
settings.register_profile("model", deadline=None, derandomize=True, database=None)
SETTINGS = settings.get_profile("model")

#: Table 2 and the cubic through the peaks of Table 1.
SEED_MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=DEPTH_MM)
SEED_THETA = np.array([47.42, -5.577, 0.3804, 63.62, 0.021])

#: One passive tissue for every number of branches and degree of K; K > 0, so that (5) may divide by it.
STATIC = np.array([12.0, -1.5, 0.35])
STIFFNESS = np.array([[20.0, 3.0, 0.4], [9.0, -0.8, 0.05], [4.0, 0.5, -0.03]])
TAU = np.array([0.021, 0.4, 6.0])


def tissue(branches: int, degree: int) -> tuple[ChannelModel, np.ndarray]:
    model = kelvin_voigt(branches=branches, stiffness_degree=degree, depth_mm=DEPTH_MM)
    return model, model.join(STATIC, STIFFNESS[:branches, : degree + 1], TAU[:branches])


def of_law(name: str, depth_mm: float = DEPTH_MM, window_s: float = 20.0) -> tuple[ChannelModel, np.ndarray]:
    named = parsed(name)
    if named.paper:
        model = kelvin_voigt(named.branches, named.degree, depth_mm)
    else:
        model = named.model(depth_mm, 0.01, window_s)
    return model, typical(model)


def cone_coordinates(degree: int) -> st.SearchStrategy[np.ndarray]:
    """Cone coordinates of a polynomial of that degree, the boundary of the cone included."""
    lowest = [0.0 if degree == 2 and i == 1 else -2.0 for i in range(degree + 1)]
    return st.tuples(*(st.floats(low, 2.0, width=32) for low in lowest)).map(np.array)


@st.composite
def passive_tissues(draw: st.DrawFn, min_branches: int = 1) -> tuple[ChannelModel, np.ndarray]:
    branches = draw(st.integers(min_branches, 3))
    degree = draw(st.integers(0, 2))
    model = kelvin_voigt(branches=branches, stiffness_degree=degree, depth_mm=DEPTH_MM)
    static = 10.0 * from_coordinates(draw(cone_coordinates(2))) / DEPTH_MM ** np.arange(3)
    stiffness = [
        10.0 * from_coordinates(draw(cone_coordinates(degree))) / DEPTH_MM ** np.arange(degree + 1)
        for _ in range(branches)
    ]
    tau = 10.0 ** np.array([draw(st.floats(-2.0, 1.0)) for _ in range(branches)])
    return model, model.join(static, np.array(stiffness).reshape(branches, degree + 1), tau)


def legs(lowest_mm: float, deepest_mm: float) -> st.SearchStrategy[list[tuple[float, float]]]:
    """Corners of a piecewise linear path: depth reached [mm] and time taken [s]."""
    leg = st.tuples(st.floats(lowest_mm, deepest_mm), st.floats(-2.5, 1.5).map(lambda e: 10.0**e))
    return st.lists(leg, min_size=1, max_size=5)


def sampled(corners: list[tuple[float, float]], per_leg: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and depths of a path from rest: ``per_leg`` equal steps in every leg, cut at the rest level."""
    time, depth = [0.0], [0.0]
    fraction = np.arange(1, per_leg + 1) / per_leg
    for x, duration in corners:
        start = depth[-1]
        share = start / (start - x) if start * x < 0.0 else 1.0
        parts = [(0.0, share * duration), (x, (1.0 - share) * duration)]
        for end, lasting in [(x, duration)] if share == 1.0 else parts:
            time.extend(time[-1] + lasting * fraction)
            depth.extend(depth[-1] + (end - depth[-1]) * fraction)
    return np.array(time), np.array(depth)


def derivative(function: Callable[[float], Any], step: float) -> Any:
    """Derivative of a function of a shift, at none: central differences of fourth order."""
    a, b, c, d = (function(k * step) for k in (-2, -1, 1, 2))
    return (a - 8.0 * b + 8.0 * c - d) / (12.0 * step)


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


def assert_stiffer_scales_forces(model: Any, theta: Any, depth: Any) -> None:
    """A servo's law times three pushes back three times as much at every tick."""
    law = servo_law(model, theta)
    blocks = [(one.packed(), np.zeros(STATE_SIZE)) for one in (law, law.stiffer(3.0))]
    for x in depth:
        once, thrice = (tissue_step_in(packed, 0, state, 0, x, TICK) for packed, state in blocks)
        assert abs(thrice - 3.0 * once) <= 1e-9 * max(thrice, 1.0)
