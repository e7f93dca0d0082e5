"""Priors as rows against the density they stand for, and those that a study states of its instrument."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import log_data, point_of, ramp_hold, system_of
from scipy.interpolate import BPoly

from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.optimum import prior_cost
from tissueid.inference.prior import Scatter, bernstein, calibration_priors, prior_rows, suited, time_bounds
from tissueid.inference.system import Effects
from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.base import ContactPath
from tissueid.model.frame import linear_frame
from tissueid.priors import CALIBRATION_DEFAULTS, WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior

FRAME = "frame_compliance_mm_per_N"
LAW = kelvin_voigt_law(1, 1, 4.0)
THETA = np.array([20.0, -1.2, 0.35, 60.0, 8.0, 0.5])


def case(effects=None, logs=1):
    time, depth = ramp_hold(100.0, 4.0, 4.0, 3.0)
    log = log_data(time, depth, LAW.model().force(THETA, ContactPath(time, depth)))
    effects = effects or Effects()
    return system_of([log] * logs, LAW, effects=effects), point_of(LAW, THETA, logs=logs, own=effects.size)


@pytest.mark.parametrize("powers", [1, 2, 3, 5])
def test_bernstein_coefficients_are_those_of_the_same_polynomial(powers):
    c = np.random.default_rng(powers).standard_normal(powers)
    u = np.linspace(0.0, 1.0, 17)
    found = BPoly((bernstein(powers) @ c)[:, None], [0.0, 1.0])(u)
    np.testing.assert_allclose(found, np.polynomial.polynomial.polyval(u, c), atol=1e-12)


def test_a_weak_prior_is_of_the_largest_force_and_state():
    system, point = case()
    prior = prior_rows(system, Scatter(), Priors(), point, machine=False)
    state = 4.0 * 0.5 * -np.expm1(-1.0 / 0.5) / 4.0
    sd = WEAK_FACTOR * np.abs(system.force).max()
    static = np.array([80.0, -19.2, 22.4])
    expected = ((bernstein(3) @ static) ** 2).sum() / sd**2
    expected += ((bernstein(2) @ np.array([240.0, 128.0])) ** 2).sum() * state**2 / sd**2
    # the largest state is read at the points of the blocks
    assert prior_cost(prior, point) == pytest.approx(expected, rel=1e-4)


def test_stated_priors_are_standardised():
    system, point = case()
    priors = Priors(
        linear={"static_2_N_per_mm2": (-1.0, 0.5)},
        relaxation_time_s=(SpreadPrior(0.4, 0.3),),
        calibration={"skew_s": CalibrationPrior(0.004, 0.001, stated=True)},
    )
    weak = prior_cost(prior_rows(system, Scatter(), Priors(), point, machine=False), point)
    told = prior_cost(prior_rows(system, Scatter(), priors, point, machine=True), point)
    expected = (-0.2 / 0.5) ** 2 + (np.log(0.5 / 0.4) / 0.3) ** 2 + 4.0**2
    assert told - weak == pytest.approx(expected, rel=1e-9)


def test_bounds_are_the_passive_set_the_times_and_the_machine():
    system, point = case()
    prior = prior_rows(system, Scatter(), Priors(), point, machine=True)
    low, high = time_bounds(system)
    assert (low, high) == pytest.approx((np.log(0.2 * 0.01), np.log(40.0)), abs=0.02)
    rows = [(0, low - 0.01), (0, high + 0.01), (1, -1e-6), (3, -1e-6), (4, -1.0), (7, -1.0)]
    # a skew may have either sign
    for k, value, allowed in (*((*one, False) for one in rows), (0, point.shared[0], True), (2, -0.01, True)):
        moved = np.where(np.arange(point.shared.size) == k, value, point.shared)
        assert bool((prior.cone @ moved >= prior.least).all()) is allowed, k


def test_own_parameters_have_the_scatter_between_logs():
    effects = Effects(gain=True, shape=True)
    system, point = case(effects, logs=2)
    prior = prior_rows(system, Scatter(0.2, 0.03), Priors(), point, machine=False)
    own = np.zeros((2, effects.size))
    own[1] = [0.1, 0.002, 0.2, -0.1]
    moved = point.moved(point.shared, own)
    expected = (0.1 / 0.2) ** 2 + (0.002 / (0.02 / 4.0)) ** 2
    expected += (0.2**2 + 0.1**2) / 0.03**2
    assert prior_cost(prior, moved) - prior_cost(prior, point) == pytest.approx(expected, rel=1e-9)


def test_a_study_states_the_instrument_and_the_rest_has_defaults():
    assert calibration_priors(None) == CALIBRATION_DEFAULTS
    assert dict(calibration_priors(Calibration())) == dict(CALIBRATION_DEFAULTS)
    values = {"load_cell_class": 0.5, "displacement_class": 1.0, "skew_s": 0.004, "skew_s_sd": 0.001}
    assert calibration_priors(Calibration({**values, "force_filter_s": 0.01})) == {
        "force_gain": CalibrationPrior(1.0, 0.0025, stated=True),
        "displacement_gain": CalibrationPrior(1.0, 0.005, stated=True),
        "skew_s": CalibrationPrior(0.004, 0.001, stated=True),
        "force_filter_s": CalibrationPrior(0.01, 0.002, 0.0, stated=True),
        FRAME: CALIBRATION_DEFAULTS[FRAME],
    }
    # a filter stated as none may still be short
    assert calibration_priors(Calibration({"force_filter_s": 0.0}))["force_filter_s"].sd == 2e-4


CURVE = FrameCurve(
    np.array([0.0, 100.0]), np.array([2e-3, 1e-3]), np.diag([1e-8, 4e-8]), range_N=(5.0, 100.0)
)


@pytest.mark.parametrize(
    ("frame", "sd"),
    [
        # sd(1/k) = sd(k) / k^2; of a bare number a quarter; u(100) = 50 (c0 + c1) at the largest force
        (linear_frame(500.0, 50.0), 50.0 / 500.0**2),
        (linear_frame(500.0), 0.25 / 500.0),
        (CURVE, np.sqrt(50.0**2 * 5e-8) / 100.0),
    ],
)
def test_a_known_frame_leaves_its_own_uncertainty(frame, sd):
    found = calibration_priors(Calibration({}, frame))[FRAME]
    assert (found.mean, found.lower) == (0.0, -np.inf)
    assert found.sd == pytest.approx(sd)


def test_an_unstated_frame_is_no_softer_than_suits_the_specimen():
    """A frame of 250 N/mm under 20 kN would bend by 80 mm."""
    assert suited(Priors(), 100.0, 4.0) == Priors()
    assert suited(Priors(), 20_000.0, 4.0).calibration[FRAME].sd == pytest.approx(3e-5)
    stated = Priors(calibration={FRAME: CalibrationPrior(0.0, 0.01, 0.0, stated=True)})
    assert suited(stated, 20_000.0, 4.0) == stated
