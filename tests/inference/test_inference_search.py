"""Starting points: every valley that an open machine makes is looked into."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid import FitOptions, IdentifyOptions, Trial, identify
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed

NAME, NOISE_N = "sneddon * linear * fractional", 0.15


def test_an_open_machine_hides_no_shape_behind_a_valley() -> None:
    # a springpot, and a machine that nobody stated: 5 ms of skew and a filter stand in for a faster one
    time = np.arange(0.0, 8.5, 0.01)
    depth = np.interp(time, [0.5, 2.0], [0.0, 6.0])
    truth = np.array([12.0, 30.0, 4.0, 0.41, 0.486])
    force = parsed(NAME).model(6.0, 0.01, 8.0).force(truth, ContactPath(time, depth))
    force = force + np.random.default_rng(70).normal(0.0, NOISE_N, time.size)
    travel = np.where(time < 0.5, 4.0 * (time - 0.5), depth)
    asked = IdentifyOptions(fit=FitOptions(model=NAME))

    (fit,) = identify([Trial("springpot", time, travel, force)], options=asked).specimens

    # the end of the valley leaves 1.7 times the noise
    assert fit.sigma_N < 1.15 * NOISE_N
    found = dict(zip(fit.theta_names, fit.theta, strict=True))
    assert found["relaxation_exponent"] == pytest.approx(0.486, abs=0.03)


def test_branches_inside_the_convolution_begin_with_ratios_of_their_own() -> None:
    name = "polynomial * tangent * prony:2"
    time = np.arange(0.0, 8.5, 0.01)
    depth = np.interp(time, [0.5, 2.0], [0.0, 6.0])
    truth = np.array([8.529, 0.834, 0.386, 0.379, 0.061, 0.98, 9.199])
    force = parsed(name).model(6.0, 0.01, 8.0).force(truth, ContactPath(time, depth))
    noise = 0.002 * float(force.max())
    force = force + np.random.default_rng(0).normal(0.0, noise, time.size)
    travel = np.where(time < 0.5, 4.0 * (time - 0.5), depth)
    asked = IdentifyOptions(fit=FitOptions(model=name))

    (fit,) = identify([Trial("two times", time, travel, force)], options=asked).specimens

    assert fit.sigma_N < 1.15 * noise
    found = dict(zip(fit.theta_names, fit.theta, strict=True))
    assert found["relaxation_time_s"] == pytest.approx(0.061, rel=0.4)
    assert found["relaxation_time_s_b2"] == pytest.approx(9.2, rel=0.3)
