"""What a study says of its instrument, as priors."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.prior import calibration_priors
from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.frame import linear_frame
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior


def test_priors_of_an_unknown_instrument_are_the_defaults() -> None:
    assert calibration_priors(None) == CALIBRATION_DEFAULTS
    assert dict(calibration_priors(Calibration())) == dict(CALIBRATION_DEFAULTS)


def test_a_study_states_the_instrument() -> None:
    stated = calibration_priors(
        Calibration(
            {
                "load_cell_class": 0.5,
                "displacement_class": 1.0,
                "skew_s": 0.004,
                "skew_s_sd": 0.001,
                "force_filter_s": 0.01,
            }
        )
    )
    assert stated["force_gain"] == CalibrationPrior(1.0, 0.0025, stated=True)
    assert stated["displacement_gain"] == CalibrationPrior(1.0, 0.005, stated=True)
    assert stated["skew_s"] == CalibrationPrior(0.004, 0.001, stated=True)
    assert stated["force_filter_s"] == CalibrationPrior(0.01, 0.002, 0.0, stated=True)
    assert stated["frame_compliance_mm_per_N"] == CALIBRATION_DEFAULTS["frame_compliance_mm_per_N"]


def test_a_filter_stated_as_none_may_still_be_short() -> None:
    assert calibration_priors(Calibration({"force_filter_s": 0.0}))["force_filter_s"].sd == pytest.approx(
        2e-4
    )


def test_a_known_frame_leaves_its_own_uncertainty() -> None:
    frame = calibration_priors(Calibration({}, linear_frame(500.0, 50.0)))["frame_compliance_mm_per_N"]
    assert frame.mean == 0.0
    assert frame.lower == -np.inf
    # sd(1/k) = sd(k) / k^2
    assert frame.sd == pytest.approx(50.0 / 500.0**2)
    bare = calibration_priors(Calibration({}, linear_frame(500.0)))["frame_compliance_mm_per_N"]
    assert bare.sd == pytest.approx(0.25 / 500.0)


def test_a_calibrated_curve_counts_at_the_largest_calibrated_force() -> None:
    covariance = np.diag([1e-8, 4e-8])
    curve = FrameCurve(np.array([0.0, 100.0]), np.array([2e-3, 1e-3]), covariance, range_N=(5.0, 100.0))
    sd = calibration_priors(Calibration({}, curve))["frame_compliance_mm_per_N"].sd
    # u(100) = 50 (c0 + c1)
    assert sd == pytest.approx(np.sqrt(50.0**2 * 5e-8) / 100.0)
