"""Flags of a specimen, each with the number that says so."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from tissueid.inference.estimates import ProfileInterval
from tissueid.inference.verdict import specimen_flags
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import Estimate

MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=4.0)
CLOSED = ProfileInterval(-1.0, -0.8, False, False)
AGREE = {"agree": True, "relative_difference": 0.0, "lm_converged": True}


def flags(
    *, tau=0.5, stiffness=30.0, interval=CLOSED, bounded=False, step=0.01, speeds=((1.0,), (5.0,)), hold=True,
    sigma=0.1, acf=0.0, optimisers=AGREE, missing=(), slope=None,
):  # fmt: skip
    parameters = tuple(
        Estimate(name, name, "s", None if name in missing else 1.0, None, name not in missing)
        for name in ("relaxation_time_s", "viscosity_N_s_per_mm")
    )
    tissue = SimpleNamespace(
        model=MODEL, theta=np.array([20.0, -1.0, 0.3, stiffness, tau]), intervals=(interval,),
        bounded=bounded, parameters=parameters,
    )  # fmt: skip
    if slope is not None:
        tissue.model = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=4.0)
        tissue.theta = np.array([20.0, -1.0, 0.3, stiffness, slope, tau])
    facts = [SimpleNamespace(speeds_mm_s=one, depth_mm=4.0, has_hold=hold, step_s=step) for one in speeds]
    trials = [SimpleNamespace(residual_acf1=acf) for _ in speeds]
    found = specimen_flags(tissue, facts, trials, sigma_N=sigma, optimisers=optimisers)
    return {flag.code: flag for flag in found}


def test_a_good_fit_has_no_flag():
    assert flags() == {}


def test_missing_parameters_are_named():
    found = flags(missing=("viscosity_N_s_per_mm",))["not_identified"]
    assert found.values["names"] == ["viscosity_N_s_per_mm"]


@pytest.mark.parametrize(("open_low", "word"), [(True, "shortest"), (False, "longest")])
def test_an_open_interval_says_at_which_end(open_low, word):
    interval = ProfileInterval(np.log(0.01), np.log(9.0), open_low, not open_low)
    found = flags(interval=interval)["interval_open"]
    assert word in found.message
    assert found.values["low_s"] == pytest.approx(0.01)
    assert found.values["high_s"] == pytest.approx(9.0)


def test_a_time_below_two_sampling_intervals():
    assert flags(tau=0.5, step=0.26)["tau_below_resolution"].values["step_s"] == 0.26
    assert "tau_below_resolution" not in flags(tau=0.5, step=0.24)


def test_amplitude_against_its_noise():
    """A = K v tau (1 - exp(-d / (v tau))) of the fastest ramp, against 3 sigma sqrt(8 h / tau)."""
    amplitude = 30.0 * 2.5 * -np.expm1(-4.0 / 2.5)
    need = amplitude / (3.0 * np.sqrt(8.0 * 0.01 / 0.5))
    found = flags(sigma=1.01 * need)["amplitude_small"]
    assert found.values["amplitude_N"] == pytest.approx(amplitude)
    assert found.values["needed_N"] == pytest.approx(1.01 * amplitude)
    assert "amplitude_small" not in flags(sigma=0.99 * need)


def test_amplitude_of_a_stiffness_that_ends_at_zero():
    """K = 30 - 7.5 x has none at 4 mm; its force is largest on the way, where its slope is none."""
    length = 5.0 * 0.5
    on_the_way = brentq(lambda x: (4.0 - x) * np.exp(-x / length) + length * np.expm1(-x / length), 0.1, 3.9)
    amplitude = 7.5 * (4.0 - on_the_way) * length * -np.expm1(-on_the_way / length)
    need = amplitude / (3.0 * np.sqrt(8.0 * 0.01 / 0.5))
    found = flags(sigma=1.01 * need, slope=-7.5)["amplitude_small"]
    assert found.values["amplitude_N"] == pytest.approx(amplitude, rel=1e-3)
    assert "amplitude_small" not in flags(sigma=0.99 * need, slope=-7.5)


def test_times_that_instruments_imitate():
    assert flags(tau=0.1)["compliance_unknown"].values["tau_s"] == pytest.approx(0.1)


def test_one_speed_and_no_hold():
    assert "single_speed" in flags(speeds=((2.0,), (2.1,)), hold=False)
    assert "single_speed" not in flags(speeds=((2.0,), (2.1,)), hold=True)
    assert "single_speed" not in flags(speeds=((2.0,), (4.0,)), hold=False)


def test_bound_disagreement_convergence_and_correlation():
    assert "bound_active" in flags(bounded=True)
    apart = {"agree": False, "relative_difference": -0.01, "lm_converged": True}
    assert flags(optimisers=apart)["optimisers_disagree"].values["relative_difference"] == -0.01
    assert "optimisers_disagree" not in flags(optimisers=AGREE | {"agree": None})
    assert "not_converged" in flags(optimisers=AGREE | {"lm_converged": False})
    assert flags(acf=0.6)["residual_correlated"].values["residual_acf1"] == pytest.approx(0.6)
    assert "residual_correlated" not in flags(acf=0.4)
