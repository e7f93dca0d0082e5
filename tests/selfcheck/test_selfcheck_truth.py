"""Truths have the moments of their priors, are passive, and every number of them is the model's own."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.stats import kstest

from tissueid.errors import InputError
from tissueid.model.channels import loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.priors import CALIBRATION_DEFAULTS, Priors, SpreadPrior
from tissueid.selfcheck.truth import (
    Widths,
    centred_priors,
    draw_truth,
    force_points,
    numbers_of,
    prior_words,
)

MODEL = kelvin_voigt(branches=2, stiffness_degree=1, depth_mm=8.0)
THETA = np.array([20.0, -1.2, 0.35, 63.0, 10.0, 0.02, 8.0, 1.0, 0.6])
DRAWN = 2000


def truths(priors: Priors, *, defects: bool = False, pooling: str = "partial") -> list:
    rng = np.random.default_rng(17)
    return [
        draw_truth(
            MODEL,
            priors,
            offset_sd_mm=np.array([0.01, 0.02]),
            pooling=pooling,
            correlated=True,
            defects=defects,
            rng=rng,
        )
        for _ in range(DRAWN)
    ]


def priors_for(**options: object) -> Priors:
    return centred_priors(MODEL, THETA, sigma_N=0.5, phi=0.9, **options)


def test_truths_are_passive_ascending_and_follow_their_priors() -> None:
    priors = priors_for()
    found = truths(priors)
    theta = np.array([one.theta for one in found])
    assert all(MODEL.is_passive(row) for row in theta)
    assert (theta[:, 5] < theta[:, 8]).all()
    # far from the cone's faces the cut takes nothing: three coefficients of F_s are normal
    for k, name in enumerate(MODEL.parameter_names[:3]):
        mean, sd = priors.linear[name]
        assert kstest((theta[:, k] - mean) / sd, "norm").pvalue > 1e-4, name
    ln_tau = np.log(theta[:, 5] / 0.02) / priors.relaxation_time_s[0].sd_ln
    assert kstest(ln_tau, "norm").pvalue > 1e-4
    assert kstest([np.log(one.sigma_N / 0.5) / 0.3 for one in found], "norm").pvalue > 1e-4
    low, high = priors.phi
    assert kstest([(one.phi - low) / (high - low) for one in found], "uniform").pvalue > 1e-4
    assert kstest([one.gain_sd / priors.gain_sd for one in found], "halfnorm").pvalue > 1e-4
    assert kstest([one.offset_mm[1] / 0.02 for one in found], "norm").pvalue > 1e-4
    assert kstest([np.log(one.gain[0]) / one.gain_sd for one in found], "norm").pvalue > 1e-4


def test_a_prior_that_reaches_beyond_the_cone_is_cut_there() -> None:
    wide = Priors(
        linear={
            **dict(priors_for().linear),
            "stiffness_0_N_per_mm": (0.0, 10.0),
            "stiffness_1_N_per_mm2": (0.0, 1e-9),
        }
    )
    theta = np.array(
        [one.theta for one in truths(centred_priors(MODEL, THETA, sigma_N=0.5, phi=0.9, stated=wide))]
    )
    # a constant K with mean 0 is half-normal once it may not be negative
    assert kstest(theta[:, 3] / 10.0, "halfnorm").pvalue > 1e-4


def test_calibration_nuisances_follow_their_priors_and_are_cut() -> None:
    found = truths(priors_for(), defects=True)
    for name, prior in CALIBRATION_DEFAULTS.items():
        values = np.array([(one.calibration[name] - prior.mean) / prior.sd for one in found])
        shape = "halfnorm" if np.isfinite(prior.lower) else "norm"
        assert kstest(values, shape).pvalue > 1e-4, name
    assert truths(priors_for())[0].calibration == {}


def test_one_tissue_for_all_logs_has_no_gains() -> None:
    one = truths(priors_for(), pooling="shared")[0]
    np.testing.assert_array_equal(one.gain, 1.0)
    assert one.gain_sd == 0.0


def test_what_a_study_states_stays() -> None:
    stated = Priors(
        linear={name: (mean, 2.0) for name, mean in zip(MODEL.parameter_names[:3], THETA[:3], strict=True)},
        relaxation_time_s=(SpreadPrior(0.03, 0.1),),
        sigma_N=SpreadPrior(1.5, 0.05),
        phi=(0.5, 0.6),
        gain_sd=0.2,
    )
    priors = priors_for(stated=stated)
    assert priors.linear["static_2_N_per_mm2"] == (-1.2, 2.0)
    assert priors.relaxation_time_s[0] == SpreadPrior(0.03, 0.1)
    assert priors.relaxation_time_s[1].median == pytest.approx(0.6, rel=1e-12)
    assert (priors.sigma_N, priors.phi, priors.gain_sd) == (SpreadPrior(1.5, 0.05), (0.5, 0.6), 0.2)
    # what it does not state is centred: 20 % of K at full depth over the power of it
    widened = priors_for(stated=stated, widths=Widths(curve=0.2))
    assert widened.linear["stiffness_1_N_per_mm2"] == pytest.approx((10.0, 0.2 * (63.0 + 80.0) / 8.0))


def test_a_curve_stated_in_part_is_refused() -> None:
    stated = Priors(linear={"static_1_N_per_mm": (20.0, 1.0)})
    with pytest.raises(InputError, match="states static_1_N_per_mm and not static_2_N_per_mm2, static_3"):
        priors_for(stated=stated)


def test_priors_without_passive_tissue_are_refused() -> None:
    impossible = Priors(linear={"stiffness_0_N_per_mm": (-50.0, 0.1), "stiffness_1_N_per_mm2": (0.0, 0.1)})
    with pytest.raises(InputError, match="leave no passive tissue"):
        truths(priors_for(stated=impossible))


def test_priors_of_times_in_the_wrong_order_are_refused() -> None:
    backwards = Priors(relaxation_time_s=(SpreadPrior(10.0, 0.01), SpreadPrior(0.1, 0.01)))
    with pytest.raises(InputError, match="do not ascend"):
        truths(priors_for(stated=backwards))


def test_numbers_are_those_of_the_contact_model() -> None:
    points = force_points(8.0, (0.5, 8.0))
    assert points == ((2.0, 8.0), (4.0, 2.0), (8.0, 0.5))
    theta = np.array([THETA, THETA * 1.1])
    numbers = numbers_of(MODEL, theta, points)
    for depth, speed in points:
        expected = [loading_force(MODEL, row, np.array([depth]), speed_mm_s=speed)[0] for row in theta]
        # the same closed form, summed in another order
        np.testing.assert_allclose(
            numbers[f"force_N at {depth:.3g} mm, {speed:.3g} mm/s"], expected, rtol=1e-12
        )
    assert numbers["viscosity_N_s_per_mm_b2"][0] == pytest.approx((8.0 + 4.0) * 0.6, rel=1e-12)
    assert numbers["relaxation_time_s"][0] == 0.02


def test_every_prior_is_said_with_its_numbers() -> None:
    words = prior_words(priors_for(), correlated=True, pooling="partial", defects=True)
    assert words["static_1_N_per_mm"].startswith("normal, 20 ± ")
    assert words["relaxation_time_s_b2"] == "log-normal, median 0.6, sd of ln 0.4"
    assert words["gain_sd"] == "half-normal, scale 0.05"
    assert words["force_filter_s"] == "normal, 0 ± 0.005, not below 0"
    assert "phi" not in prior_words(priors_for(), correlated=False, pooling="shared", defects=False)


def test_priors_go_to_other_processes() -> None:
    priors = priors_for()
    assert pickle.loads(pickle.dumps(priors)) == priors
