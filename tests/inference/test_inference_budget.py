"""The budget: shares against closed forms, against the draws, and against what is known exactly."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from instrument_factory import DEPTH, PERFECT, TISSUE, Case, drawn_theta, recorded, total_of

from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.inference.budget import SOURCES, TOTAL, reported, reported_names, shapley, uncertainty_budget
from tissueid.inference.calibration import NUISANCES, TotalPosterior
from tissueid.priors import CalibrationPrior


MODEL = KelvinVoigt(1, 1, DEPTH)
KNOWN = {name: CalibrationPrior(PERFECT[name], 0.0, stated=True) for name in NUISANCES}


def total_with(seed: int = 1, **priors: CalibrationPrior) -> TotalPosterior:
    """A specimen whose instrument is known exactly but for what is given."""
    case = Case(priors=replace(TISSUE, calibration={**KNOWN, **priors}))
    rng = np.random.default_rng(seed)
    return total_of(recorded(case, drawn_theta(TISSUE, rng), {}, rng), seed)


def shares_of(total: TotalPosterior, parameter: str) -> dict[str, float | None]:
    return {row.source: row.share for row in uncertainty_budget(total) if row.parameter == parameter}


@pytest.fixture(scope="module")
def default() -> TotalPosterior:
    rng = np.random.default_rng(2)
    return total_of(recorded(Case(), drawn_theta(TISSUE, rng), {"frame_compliance_mm_per_N": 1e-3}, rng), 2)


def test_viscosity_comes_first_then_the_parameters_of_the_model(default: TotalPosterior) -> None:
    rows = uncertainty_budget(default)
    names = list(dict.fromkeys(row.parameter for row in rows))
    assert names == ["viscosity_N_s_per_mm", *MODEL.parameter_names]
    assert [row.source for row in rows[: len(SOURCES) + 1]] == [*SOURCES, TOTAL]


def test_shares_are_never_negative_and_sum_to_one(default: TotalPosterior) -> None:
    for name in reported_names(MODEL):
        shares = shares_of(default, name)
        parts = np.array([shares[source] for source in SOURCES])
        assert (parts >= 0.0).all()
        assert parts.sum() == pytest.approx(1.0, abs=1e-9)
        assert shares[TOTAL] == 1.0


def test_squares_of_the_parts_are_the_variance_of_the_draws(default: TotalPosterior) -> None:
    rows = uncertainty_budget(default)
    draws = reported(MODEL, default.theta)
    for k, name in enumerate(reported_names(MODEL)):
        parts = [row.sd for row in rows if row.parameter == name and row.source != TOTAL]
        assert np.sqrt(np.sum(np.square(parts))) == pytest.approx(draws[:, k].std(ddof=1), rel=1e-9)


def test_a_load_cell_gives_every_force_its_own_percent() -> None:
    total = total_with(force_gain=CalibrationPrior(1.0, 0.01))
    rows = {(row.parameter, row.source): row.sd for row in uncertainty_budget(total)}
    at_mode = reported(MODEL, total.theta).mean(axis=0)
    for k, name in enumerate(reported_names(MODEL)):
        expected = 0.0 if name.startswith("relaxation") else 0.01 * abs(at_mode[k])
        # draws worth a thousand know a standard deviation to 2 %, and the priors of the tissue say a little
        assert rows[name, "force gain"] == pytest.approx(expected, rel=0.1, abs=1e-12)


def test_what_is_known_exactly_has_no_share() -> None:
    shares = shares_of(total_with(), "viscosity_N_s_per_mm")
    assert [shares[source] for source in SOURCES[3:]] == pytest.approx([0.0] * 5, abs=1e-9)
    assert sum(shares[source] for source in SOURCES[:3]) == pytest.approx(1.0)


def test_a_filter_nobody_stated_is_seen_in_the_relaxation_time() -> None:
    known = shares_of(total_with(), "relaxation_time_s")
    unknown = shares_of(total_with(force_filter_s=CalibrationPrior(0.0, 0.005, 0.0)), "relaxation_time_s")
    assert known["force filter"] == pytest.approx(0.0, abs=1e-9)
    assert unknown["force filter"] > 0.2
    assert unknown["frame"] == pytest.approx(0.0, abs=1e-9)


def test_linear_parts_add_up_to_the_sd_of_the_draws(default: TotalPosterior) -> None:
    """Near the mode the linear budget has the variance that the draws have."""
    total = total_with(skew_s=CalibrationPrior(0.0, 5e-4), displacement_gain=CalibrationPrior(1.0, 0.01))
    rows = {(row.parameter, row.source): row for row in uncertainty_budget(total)}
    row = rows["static_1_N_per_mm", "displacement gain"]
    # a1 = a1' g_x: one percent of it, whatever the rest
    assert row.sd == pytest.approx(0.01 * total.theta[:, 0].mean(), rel=0.1)


def test_shapley_values_are_averages_over_orders() -> None:
    rng = np.random.default_rng(3)
    worth = {joined: float(sum(joined)) ** 1.5 + 0.1 * k for k, joined in enumerate(
        [(a, b, c) for a in (False, True) for b in (False, True) for c in (False, True)]
    )}  # fmt: skip
    worth = {joined: value * rng.uniform(0.99, 1.0) for joined, value in worth.items()}
    expected = np.zeros(3)
    for order in permutations(range(3)):
        joined = [False, False, False]
        for player in order:
            before = worth[tuple(joined)]
            joined[player] = True
            expected[player] += max(worth[tuple(joined)] - before, 0.0) / 6.0
    found = shapley(lambda joined: np.array([worth[joined]]), 3)
    assert found[:, 0] == pytest.approx(expected, rel=1e-12)


def test_viscosity_of_draws_is_k_tau_at_half_depth() -> None:
    theta = np.array([[20.0, -1.0, 0.3, 60.0, 10.0, 0.02]])
    assert reported(MODEL, theta)[0] == pytest.approx([(60.0 + 40.0) * 0.02, *theta[0]])
