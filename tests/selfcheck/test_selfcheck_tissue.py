"""One simulation: what goes into ``identify`` and comes out, and uniform ranks where that is exact."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identify_stand_ins import conjugate, of_draws, of_prior
from msgspec import structs

from tissueid.flags import Flag
from tissueid.model.frame import tangent_stiffness
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import Identification
from tissueid.segment import SegmentOptions, segment
from tissueid.selfcheck.protocol import Centre, of_program
from tissueid.selfcheck.records import one_record
from tissueid.selfcheck.tissue import TissueCheck, tissue_check
from tissueid.selfcheck.truth import Widths
from tissueid.selfcheck.verdicts import Verdict, verdict_of
from tissueid.synth import Hold, Log, Move

#: A tissue of which only the curves are unknown: no gains, times and noise that are known.
ONLY_CURVES = Widths(ln_tau=1e-9, ln_sigma=1e-9, gain_sd=1e-9)
MODEL = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=4.0)
THETA = np.array([20.0, 1.2, 0.35, 60.0, 10.0, 0.2])


def check_of(*, pooling: str = "partial", **options: Any) -> TissueCheck:
    logs = (Log("ramp", (Move(4.0, 240.0),)), Log("hold", (Move(4.0, 480.0), Hold(1.0))))
    protocol = of_program(logs, rate_Hz=50.0, contact_sd_mm=0.0, words="two logs")
    return tissue_check(protocol, Centre(MODEL, THETA, sigma_N=0.5, pooling=pooling), **options)


def identified_by(monkeypatch: pytest.MonkeyPatch, identify: Callable[..., Identification]) -> None:
    monkeypatch.setattr("tissueid.selfcheck.tissue.identify", identify)


def verdict_on(check: TissueCheck, simulations: int) -> Verdict:
    return verdict_of([one_record(check, 31, index) for index in range(simulations)])


def test_an_exact_posterior_of_the_recordings_is_calibrated(monkeypatch):
    identified_by(monkeypatch, conjugate)
    verdict = verdict_on(check_of(widths=ONLY_CURVES), 150)
    # a right posterior leaves its bands with 2 %, this seed does not
    assert verdict.reasons == ()
    known = {one.name: one.contraction for one in verdict.parameters}
    # what is recorded is the tissue: 0.5 N of noise leaves next to nothing of a prior of 15 %
    assert known["force_N at 4 mm, 4 mm/s"] > 0.999
    assert known["viscosity_N_s_per_mm"] > 0.99


def test_identify_is_given_the_order_the_noise_and_the_very_priors(monkeypatch):
    given: dict[str, Any] = {}

    def watched(trials: Any, **options: Any) -> Identification:
        given.update(options, trials=trials)
        return of_prior(trials, **options)

    identified_by(monkeypatch, watched)
    check = check_of()
    check(np.random.default_rng(2))
    fit, posterior = given["options"].fit, given["options"].posterior
    assert (fit.branches, fit.stiffness_degree, fit.static, fit.noise) == (1, 1, "partial", "white")
    assert posterior.draws >= 399
    assert given["study"].priors == check.priors
    # nothing of the machine is asked: its frame gives a millionth of a mm under 1 N, all else is perfect
    machine = given["study"].calibration
    assert tangent_stiffness(machine.frame, 100.0) >= 1e6
    assert (machine.values["skew_s"], machine.values["force_filter_s"]) == (0.0, 0.0)
    trials = given["trials"]
    check_of(defects=True)(np.random.default_rng(2))
    assert (given["study"].calibration.values, given["study"].calibration.frame) == ({}, None)
    # one specimen, each log behind an approach in air in which its contact is found
    assert {trial.specimen for trial in trials} == {"simulated"}
    for trial in trials:
        contact = segment(trial).contact
        assert contact.in_record
        assert contact.displacement_mm == pytest.approx(0.0, abs=4.0 * contact.sd_mm)


def test_a_contact_that_is_stated_is_not_looked_for(monkeypatch):
    asked: list[Any] = []

    def watched(trials: Any, **options: Any) -> Identification:
        asked.append(options["options"].segment)
        return of_prior(trials, **options)

    identified_by(monkeypatch, watched)
    ramp, hold = check_of().logs
    logs = (replace(ramp, contact_sd_mm=0.01), replace(hold, contact_sd_mm=0.02))
    for stated in (False, True):
        replace(check_of(), logs=logs, contact_stated=stated)(np.random.default_rng(2))
    assert asked[0] == SegmentOptions()
    assert (asked[1].contact_displacement_mm, asked[1].contact_sd_mm) == (0.0, 0.02)


def test_the_order_of_theta_is_that_of_its_names(monkeypatch):
    check = check_of()
    identified_by(monkeypatch, of_prior)
    straight = check(np.random.default_rng(3))

    def backwards(trials: Any, **options: Any) -> Identification:
        found = of_prior(trials, **options)
        (fit,) = found.specimens
        own = fit.posterior
        turned = replace(own, theta_names=own.theta_names[::-1], draws=own.draws[:, ::-1])
        return replace(found, specimens=(replace(fit, posterior=turned),))

    identified_by(monkeypatch, backwards)
    turned = check(np.random.default_rng(3))
    assert list(turned.draws) == list(straight.draws)
    for name, values in straight.draws.items():
        np.testing.assert_array_equal(turned.draws[name], values)


def test_a_viscosity_is_compared_at_half_of_the_fitted_depth(monkeypatch):
    identified_by(monkeypatch, of_prior)
    found = check_of()(np.random.default_rng(4))
    names = ("stiffness_0_N_per_mm", "stiffness_1_N_per_mm2", "relaxation_time_s")
    k0, k1, tau = (found.truth[name] for name in names)
    # the last sample lies at 3.92 mm of 4: 240 mm/min at 50 Hz
    depth = max(log.depth_mm.max() for log in check_of().logs)
    assert found.truth["viscosity_N_s_per_mm"] == pytest.approx((k0 + 0.5 * depth * k1) * tau, rel=1e-12)


def test_the_quoted_interval_counts_where_there_is_one(monkeypatch):
    def far_off(trials: Any, **options: Any) -> Identification:
        found = of_prior(trials, **options)
        (fit,) = found.specimens
        wide = [
            replace(one, uncertainty=replace(one.uncertainty, ci95=(1e6, 2e6), ci95_total=(-1e6, 1e6)))
            for one in fit.parameters
        ]
        wide[0] = replace(wide[0], uncertainty=replace(wide[0].uncertainty, ci95=(float("nan"), 1.0)))
        return replace(found, specimens=(replace(fit, parameters=tuple(wide)),))

    identified_by(monkeypatch, far_off)
    statistical, total = verdict_on(check_of(), 15), verdict_on(check_of(defects=True), 15)
    at_95 = {one.name: 15 * one.coverage[-1].fraction for one in statistical.parameters}
    assert at_95["relaxation_time_s"] == 0
    # a parameter without an end, and a force, which is quoted nowhere: the central interval of the draws
    assert at_95["static_1_N_per_mm"] > 10
    assert at_95["force_N at 4 mm, 4 mm/s"] > 10
    quoted = [one for one in total.parameters if not one.name.startswith("force")]
    assert {one.coverage[-1].fraction for one in quoted} == {1.0}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"draws": np.ones((10, 6))}, "10 draws, 399 are needed"),
        ({"draws_total": None}, "0 draws, 399 are needed"),
    ],
)
def test_too_few_draws_are_no_posterior(monkeypatch, change, says):
    theta = np.tile(THETA, (399, 1))
    identified_by(monkeypatch, lambda *_, **__: of_draws(MODEL, theta, **change))
    assert says in one_record(check_of(defects="draws_total" in change), 1, 0).failed


def test_a_fit_without_a_posterior_is_a_failure_with_its_reason(monkeypatch):
    whole = of_draws(MODEL, np.tile(THETA, (399, 1)))
    (fit,) = whole.specimens
    flag = Flag("sampler_not_converged", "standard errors only", {"reason": "R-hat is 1.2"})
    stuck = replace(fit.posterior, sampler=structs.replace(fit.posterior.sampler, converged=False))
    ends = {
        "standard errors only: R-hat is 1.2": replace(
            whole, specimens=(replace(fit, posterior=None, flags=(flag,)),)
        ),
        "no posterior was sampled": replace(whole, specimens=(replace(fit, posterior=stuck, flags=()),)),
        "no recording was found": replace(
            whole, specimens=(), exit=structs.replace(whole.exit, reasons=("no recording was found",))
        ),
    }
    for says, found in ends.items():
        identified_by(monkeypatch, lambda *_, found=found, **__: found)
        assert one_record(check_of(), 1, 0).failed == f"ArithmeticError: {says}"


def test_a_check_goes_to_other_processes():
    assert pickle.loads(pickle.dumps(check_of())).priors == check_of().priors
