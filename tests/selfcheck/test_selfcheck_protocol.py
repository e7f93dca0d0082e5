"""What a recipe, a bundle and recordings become: protocols with their contact, depth and speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_factory import identification, specimen_fit

from tissueid.errors import InputError
from tissueid.selfcheck.protocol import CONTACT_SD_MM, of_bundle, of_program, of_recipe
from tissueid.selfcheck.recorded import inputs_there
from tissueid.selfcheck.tissue import described, tissue_check
from tissueid.store.bundle import Bundle, bundle_from_fit
from tissueid.synth import Branch, Hold, Log, Move, recipe


def bundle() -> Bundle:
    fit = specimen_fit()
    return bundle_from_fit(fit, provenance=identification([fit]).provenance)


def test_a_recipe_becomes_its_program_and_its_tissue() -> None:
    plan = recipe("paper-a-30-k1")
    protocol, centre = of_recipe(plan, rate_Hz=100.0)
    assert len(protocol.logs) == 30
    assert protocol.step_s == pytest.approx(0.01, rel=1e-9)
    # 10 mm/min to 8 mm takes 48 s, and the last sample lies one step before its end
    assert protocol.duration_s == pytest.approx(48.0, abs=0.011)
    assert protocol.speeds_mm_s == (10.0 / 60.0, 500.0 / 60.0)
    np.testing.assert_allclose(centre.theta, [20.0, -1.2, 0.35, 63.62, 10.0, 0.021])
    assert (centre.sigma_N, centre.phi, centre.pooling) == (1.0, 0.0, "partial")
    first = protocol.logs[0]
    assert first.contact_sd_mm == CONTACT_SD_MM
    # a second in air at the speed of the first move, to a contact at 0 s and 0 mm
    air = first.time_s < 0.0
    assert air.sum() == 100
    np.testing.assert_allclose(first.depth_mm[air], first.time_s[air] * 10.0 / 60.0, rtol=1e-12)
    assert (first.time_s[100], first.depth_mm[100]) == (0.0, 0.0)


def test_noise_of_a_recipe_is_white_correlated_or_both() -> None:
    plan = recipe("paper-a-hold-100Hz")
    both = of_recipe(replace(plan, sigma_N=0.6, ar1_sigma_N=0.8, ar1_phi=0.9))[1]
    assert (both.sigma_N, both.phi, both.white_share) == pytest.approx((1.0, 0.9, 0.36))
    only = of_recipe(replace(plan, sigma_N=0.0, ar1_sigma_N=0.8, ar1_phi=0.9))[1]
    assert (only.sigma_N, only.phi, only.white_share) == pytest.approx((0.8, 0.9, 0.0))
    protocol, centre = of_recipe(replace(plan, sigma_N=0.6, ar1_sigma_N=0.8, ar1_phi=0.9))
    assert tissue_check(protocol, centre).noise_model == "white+ar1"
    # one log has nothing to pool
    assert centre.pooling == "shared"


def test_branches_of_different_degree_share_the_highest() -> None:
    plan = replace(recipe("paper-a-hold-100Hz"), branches=(Branch((60.0, 2.0), 0.02), Branch((5.0,), 1.0)))
    _, centre = of_recipe(plan)
    assert centre.model.stiffness_degree == 1
    np.testing.assert_allclose(centre.theta[3:], [60.0, 2.0, 0.02, 5.0, 0.0, 1.0])


def test_a_log_within_its_contact_s_error_is_refused() -> None:
    with pytest.raises(InputError, match="stays within its contact's standard deviation"):
        of_program((Log("tiny", (Move(0.02, 60.0),)),), rate_Hz=100.0, contact_sd_mm=0.01, words="tiny")


def test_a_bundle_s_program_stays_within_what_it_was_identified_on() -> None:
    one = bundle()
    protocol, centre = of_bundle(one, where="bundle.h5")
    assert protocol.depth_mm <= one.depth_mm * (1.0 + 1e-9)
    assert protocol.depth_mm == pytest.approx(one.depth_mm, rel=0.01)
    low, high = one.speeds_mm_s
    assert protocol.speeds_mm_s == pytest.approx((low, high))
    np.testing.assert_array_equal(centre.theta, one.theta)
    # holds last ten relaxation times, within 5 and 60 s: tau is 1.5 s
    assert "holds of 15 s" in protocol.words
    assert inputs_there(one) == []


def test_another_contact_model_is_refused() -> None:
    with pytest.raises((KeyError, ValueError)):
        of_bundle(replace(bundle(), model=replace(bundle().model, key="hunt-crossley")), where="x")


def test_two_checks_are_told_apart_by_everything_that_decides() -> None:
    plan = recipe("paper-a-hold-100Hz")
    logs = (Log("hold", (Move(4.0, 250.0), Hold(1.0))),)
    protocol, centre = of_recipe(replace(plan, logs=logs))
    base = described(tissue_check(protocol, centre))
    assert base == described(tissue_check(protocol, centre))
    others = [
        tissue_check(protocol, replace(centre, sigma_N=2.0)),
        tissue_check(protocol, centre, defects=True),
        replace(tissue_check(protocol, centre), contact_stated=True),
        tissue_check(of_recipe(replace(plan, logs=logs), rate_Hz=50.0)[0], centre),
    ]
    assert all(described(one) != base for one in others)
