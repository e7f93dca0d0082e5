"""The profile of a relaxation time: closed where the data know it, open where they don't."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.inference.estimates import LEVEL_95, _crossing, profile
from tissueid.synth import Branch, Hold, Log, Move


def profiled(recipe, seed=1, branch=0, **asked):
    ours = identified(handles_for(draw(recipe, seed)), noise="white", **asked)
    return ours, *profile(ours, branch)


def test_a_well_determined_time_is_closed_and_about_its_standard_errors():
    ours, interval, curve = profiled(small_recipe(branches=(Branch((30.0,), 0.2),)))
    assert interval.closed
    assert interval.low < np.log(0.2) < interval.high
    half = np.sqrt(LEVEL_95 * ours.optimum.covariance[0, 0])
    centre = ours.optimum.point.log_times[0]
    assert interval.low == pytest.approx(centre - half, abs=0.05 * half)
    assert interval.high == pytest.approx(centre + half, abs=0.05 * half)
    assert interval.width == pytest.approx(2.0 * half, rel=0.05)
    # the rise of a parabola in standard errors
    rise = ((np.log(curve["tau_s"]) - centre) / np.sqrt(ours.optimum.covariance[0, 0])) ** 2
    np.testing.assert_allclose(curve["rise"], rise, rtol=0.15, atol=0.05)
    # K tau is what the ramps know
    product = np.array(curve["tau_s"]) * curve["stiffness_N_per_mm"]
    assert np.ptp(product) < 0.6 * np.ptp(curve["tau_s"]) / 0.2 * product.mean()


def test_a_time_far_below_the_sampling_is_open_at_the_short_end():
    ramps = tuple(Log(f"ramp-{v:.0f}", (Move(4.0, v),)) for v in (60.0, 120.0))
    _, interval, _ = profiled(small_recipe(branches=(Branch((60.0,), 0.005),), logs=ramps, rate_Hz=20.0))
    assert interval.open_low
    assert not interval.closed
    assert interval.low == pytest.approx(np.log(0.2 / 20.0), abs=1e-6)


def test_a_time_far_beyond_the_record_is_open_at_the_long_end():
    logs = (Log("hold", (Move(4.0, 240.0), Hold(2.0))),)
    _, interval, _ = profiled(small_recipe(branches=(Branch((30.0,), 200.0),), logs=logs, sigma_N=0.5))
    assert interval.open_high
    assert not interval.closed


def test_each_branch_has_its_own():
    two = (Branch((30.0,), 0.05), Branch((25.0,), 1.5))
    recipe = small_recipe(branches=two, sigma_N=0.05)
    for branch, tau in enumerate((0.05, 1.5)):
        ours, interval, curve = profiled(recipe, branches=(2,), branch=branch)
        assert interval.closed
        assert interval.low < np.log(tau) < interval.high
        assert min(curve["tau_s"]) < np.exp(ours.optimum.point.log_times[branch]) < max(curve["tau_s"])


def test_an_end_is_where_the_root_of_the_rise_passes_the_level():
    # of a parabola the root is straight: exact between two points
    place = np.array([-3.0, -1.0, 0.0, 1.0, 2.5])
    height = place**2
    assert _crossing(place, height, 0.0, 1) == (pytest.approx(np.sqrt(LEVEL_95)), False)
    assert _crossing(place, height, 0.0, -1) == (pytest.approx(-np.sqrt(LEVEL_95)), False)
    assert _crossing(place[1:4], height[1:4], 0.0, 1) == (1.0, True)
