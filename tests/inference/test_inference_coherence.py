"""Values inside their intervals, and what is withheld where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_factory import specimen_fit

from tissueid.flags import Flag
from tissueid.inference.estimates import TissueEstimate
from tissueid.inference.reported import interval95, reported_draws
from tissueid.inference.verdict import outside, unsampled, withheld
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import Estimate
from tissueid.uncertainty import ParameterUncertainty

MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=4.0)
OPTIMUM = np.array([2.0, 0.1, 0.0, 5.0, 0.5])


def tissue(theta: np.ndarray = OPTIMUM) -> TissueEstimate:
    values = reported_draws(MODEL, theta[None])
    parameters = tuple(
        Estimate(name, name, "", float(one[0]), 0.1, identified=True, detail={"estimate": float(one[0])})
        for name, one in values.items()
    )
    return TissueEstimate(MODEL, theta, np.eye(theta.size), parameters, (), bounded=True)


def draws(centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    out = np.tile(centre, (4000, 1))
    out[:, :3] += np.array([0.05, 0.01, 0.002]) * rng.standard_normal((4000, 3))
    viscosity = centre[3] * centre[4] * np.exp(0.02 * rng.standard_normal(4000))
    out[:, 4] = centre[4] * np.exp(0.2 * rng.standard_normal(4000))
    out[:, 3] = viscosity / out[:, 4]
    return out


def uncertainties(theta: np.ndarray, wider: float | None = 1.5) -> dict[str, ParameterUncertainty]:
    out = {}
    for name, (low, high) in interval95(reported_draws(MODEL, theta)).items():
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        total = None if wider is None else (middle - wider * half, middle + wider * half)
        out[name] = ParameterUncertainty(middle, half / 2.0, (low, high), total, 1e3, 1e3, 1.0)
    return out


def test_values_inside_their_intervals_are_coherent() -> None:
    found = uncertainties(draws(OPTIMUM, np.random.default_rng(1)))
    assert outside(tissue().parameters, found) == ()
    # nearly half of an interval from its ends is its middle: most values are not there
    assert len(outside(tissue().parameters, found, margin=0.499)) >= 4


def test_a_value_outside_an_interval_of_its_is_named() -> None:
    found = uncertainties(draws(OPTIMUM + np.array([0.2, 0.0, 0.0, 0.0, 0.0]), np.random.default_rng(2)))
    assert outside(tissue().parameters, found) == ("static_1_N_per_mm",)
    none = tuple(replace(one, value=None) for one in tissue().parameters)
    assert outside(none, found) == ()


def test_a_fit_without_draws_keeps_its_values_and_identifies_none() -> None:
    fit = specimen_fit()
    flag = Flag("sampler_not_converged", "too few draws")
    bare = unsampled(fit, "no posterior could be sampled", (flag,))
    assert [one.value for one in bare.parameters] == [one.value for one in fit.parameters]
    assert not any(one.identified for one in bare.parameters)
    assert bare.flags == (*fit.flags, flag)
    assert bare.parameters[0].detail["withheld"] == "no posterior could be sampled"


def test_a_total_interval_that_is_missing_counts_as_outside_where_others_have_one() -> None:
    theta = draws(OPTIMUM, np.random.default_rng(3))
    found = uncertainties(theta)
    one = found["stiffness_N_per_mm"] if "stiffness_N_per_mm" in found else found[next(iter(found))]
    name = next(key for key, value in found.items() if value is one)
    found[name] = ParameterUncertainty(one.mean, one.sd, one.ci95, None, 1.0, 1.0, 1.0)
    assert outside(tissue().parameters, found) == (name,)
    assert outside(tissue().parameters, uncertainties(theta, wider=None)) == ()


def test_what_is_withheld_is_not_identified_and_says_why() -> None:
    parameters, (flag,) = withheld(tissue().parameters, ("static_1_N_per_mm",), "the value lies outside it")
    first, *others = parameters
    assert not first.identified
    assert first.value == OPTIMUM[0]
    assert first.as_json()["ci95"] is None
    assert all(one.identified for one in others)
    assert flag.code == "interval_withheld"
    assert "the value lies outside it" in flag.message
    assert withheld(tissue().parameters, (), "") == (tissue().parameters, ())


def test_an_interval_at_an_active_bound_includes_it():
    """Of highest density: from the bound where draws are densest there; central elsewhere, and for times."""
    rng = np.random.default_rng(2)
    near = np.abs(rng.standard_normal(20_000))
    far = 4.0 + rng.standard_normal(20_000)
    far = far[far > 0.0]
    found = interval95({"stiffness_0_N_per_mm": near, "static_1_N_per_mm": far, "relaxation_time_s": near})
    assert found["stiffness_0_N_per_mm"] == pytest.approx((0.0, 1.96), abs=0.04)
    assert found["static_1_N_per_mm"] == pytest.approx((2.04, 5.96), abs=0.06)
    assert found["relaxation_time_s"][0] == pytest.approx(0.0313, abs=0.01)
