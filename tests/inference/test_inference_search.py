"""Starting points: every valley that an open machine makes is looked into."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid import FitOptions, IdentifyOptions, Trial, identify
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed


def noise_and_tissue(
    name: str, truth: list[float], *, share: float, seed: int
) -> tuple[float, dict[str, float]]:
    """Noise that a fit finds, over that of a push and hold without a stated machine, and its parameters."""
    time = np.arange(0.0, 8.5, 0.01)
    depth = np.interp(time, [0.5, 2.0], [0.0, 6.0])
    force = parsed(name).model(6.0, 0.01, 8.0).force(np.array(truth), ContactPath(time, depth))
    noise = share * float(force.max())
    force = force + np.random.default_rng(seed).normal(0.0, noise, time.size)
    travel = np.where(time < 0.5, 4.0 * (time - 0.5), depth)
    asked = IdentifyOptions(fit=FitOptions(model=name))
    (fit,) = identify([Trial("tissue", time, travel, force)], options=asked).specimens
    return fit.sigma_N / noise, dict(zip(fit.theta_names, fit.theta, strict=True))


def test_an_open_machine_hides_no_shape_behind_a_valley() -> None:
    # a springpot: 5 ms of skew and a filter stand in for a faster one, and leave 1.7 times the noise
    truth = [12.0, 30.0, 4.0, 0.41, 0.486]
    left, found = noise_and_tissue("sneddon * linear * fractional", truth, share=2.5e-4, seed=70)

    assert left < 1.15
    assert found["relaxation_exponent"] == pytest.approx(0.486, abs=0.03)


def test_branches_inside_the_convolution_begin_with_ratios_of_their_own() -> None:
    truth = [8.529, 0.834, 0.386, 0.379, 0.061, 0.98, 9.199]
    left, found = noise_and_tissue("polynomial * tangent * prony:2", truth, share=0.002, seed=0)

    assert left < 1.15
    assert found["relaxation_time_s"] == pytest.approx(0.061, rel=0.4)
    assert found["relaxation_time_s_b2"] == pytest.approx(9.2, rel=0.3)
