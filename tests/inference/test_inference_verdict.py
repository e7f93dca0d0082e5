"""Flags of a specimen, each with the number that says so."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from tissueid.documents.identification import NoiseFit, Nrmsd
from tissueid.inference.estimates import ProfileInterval
from tissueid.inference.verdict import discrepancy_flags, specimen_flags
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import Estimate

MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=4.0)
CLOSED = ProfileInterval(-1.0, -0.8, False, False)
AGREE = {"agree": True, "relative_difference": 0.0, "lm_converged": True}


def flags(
    *, tau=0.5, stiffness=30.0, interval=CLOSED, bounded=False, step=0.01, speeds=((1.0,), (5.0,)), hold=True,
    sigma=0.1, acf=0.0, optimisers=AGREE, missing=(), slope=None, duration=30.0,
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
    facts = [
        SimpleNamespace(speeds_mm_s=one, depth_mm=4.0, has_hold=hold, step_s=step, duration_s=duration)
        for one in speeds
    ]
    trials = [SimpleNamespace(residual_acf1=acf) for _ in speeds]
    found = specimen_flags(tissue, facts, trials, sigma_N=sigma, optimisers=optimisers)
    return {flag.code: flag for flag in found}


APART = {"agree": False, "relative_difference": -0.01, "lm_converged": True}
ONE_SPEED = ((2.0,), (2.1,))


@pytest.mark.parametrize(
    ("given", "code", "values"),
    [
        ({"missing": ("viscosity_N_s_per_mm",)}, "not_identified", {"names": ["viscosity_N_s_per_mm"]}),
        ({"step": 0.26}, "tau_below_resolution", {"step_s": 0.26}),
        ({"tau": 0.1}, "compliance_unknown", {"tau_s": 0.1}),
        ({"duration": 1.4}, "tau_exceeds_window", {"branch": 1, "tau_s": 0.5, "window_length_s": 1.4}),
        ({"speeds": ONE_SPEED, "hold": False}, "single_speed", {}),
        ({"bounded": True}, "bound_active", {}),
        ({"optimisers": APART}, "optimisers_disagree", {"relative_difference": -0.01}),
        ({"optimisers": AGREE | {"lm_converged": False}}, "not_converged", {}),
        ({"acf": 0.6}, "residual_correlated", {"residual_acf1": 0.6}),
    ],
)
def test_a_flag_has_the_number_that_says_so(given, code, values):
    found = flags(**given)[code].values
    assert {name: found[name] for name in values} == values


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"step": 0.24}, "tau_below_resolution"),
        ({"speeds": ONE_SPEED}, "single_speed"),
        ({"speeds": ((2.0,), (4.0,)), "hold": False}, "single_speed"),
        ({"optimisers": AGREE | {"agree": None}}, "optimisers_disagree"),
        ({"acf": 0.4}, "residual_correlated"),
        ({"duration": 1.6}, "tau_exceeds_window"),
        # the end of what was seen is said already
        ({"duration": 1.4, "interval": ProfileInterval(-1.0, 2.6, False, True)}, "tau_exceeds_window"),
    ],
)
def test_short_of_its_limit_there_is_no_flag(given, code):
    assert flags() == {}
    assert code not in flags(**given)


@pytest.mark.parametrize(("open_low", "word"), [(True, "shortest"), (False, "longest")])
def test_an_open_interval_says_at_which_end(open_low, word):
    interval = ProfileInterval(np.log(0.01), np.log(9.0), open_low, not open_low)
    found = flags(interval=interval)["interval_open"]
    assert word in found.message
    assert found.values["low_s"] == pytest.approx(0.01)
    assert found.values["high_s"] == pytest.approx(9.0)


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


@pytest.mark.parametrize(
    ("sigma", "said"), [(0.30, "3 times the noise"), (0.099, "as correlated noise would")]
)
def test_a_residual_of_the_size_of_the_noise_is_not_said_to_exceed_it(sigma, said):
    noise = SimpleNamespace(discrepant=True, measured_N=0.1, sigma_N=sigma, samples_per_independent=4.0)
    (flag,) = discrepancy_flags(noise, SimpleNamespace(range=0.01))
    assert said in flag.message


@pytest.mark.parametrize(("share", "codes"), [(4e-8, []), (0.02, ["discrepancy"])])
def test_what_rounding_leaves_of_a_log_without_noise_is_no_discrepancy(share, codes):
    noise = NoiseFit("white", 100.0 * share, 0.0, 0.001, measured_N=1e-12, samples_per_independent=1.1)
    assert [one.code for one in discrepancy_flags(noise, Nrmsd(share, share, 100.0 * share))] == codes
