"""The exact sampler against closed forms, and the ensemble sampler against it on specimens."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_form_targets import AtBound, Banana, Holed, LogSpread, Normal, Plain
from numpy.typing import NDArray
from scipy import stats

from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.fit.window import fitted_log
from tissueid.posterior.at_optimum import posterior_target
from tissueid.posterior.diagnostics import MonteCarloErrors, monte_carlo_errors
from tissueid.posterior.ensemble import sample_ensemble
from tissueid.posterior.exact import sample_exact
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors
from tissueid.synth import as_trials, recipe, simulate
from tissueid.trial import Contact, Phase, Segmentation

FloatArray = NDArray[np.float64]

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
#: ln of the integral of each density, in closed form.
TARGETS = {
    "normal 1": (lambda: Normal(1), HALF_LOG_2PI + math.log(0.01)),
    "normal 2": (lambda: Normal(2), 2 * HALF_LOG_2PI + 0.5 * math.log(0.01**2 * (1 - 0.95**2))),
    "normal 4": (lambda: Normal(4), None),
    "banana": (Banana, 2 * HALF_LOG_2PI),
    "at a bound": (AtBound, HALF_LOG_2PI),
    "ln of a spread": (LogSpread, math.log(math.sqrt(math.pi / 2.0)) + HALF_LOG_2PI),
}


class Wider(Plain):
    """Another target beside a standard normal coordinate or two, so that a mixture has to fit it."""

    def __init__(self, inner: Plain, more: int) -> None:
        d = inner.mode.size
        covariance = np.eye(d + more)
        covariance[:d, :d] = inner.covariance
        super().__init__(np.concatenate([inner.mode, np.zeros(more)]), covariance)
        self.inner, self.d = inner, d

    def log_density(self, points: FloatArray) -> FloatArray:
        return self.inner.log_density(points[:, : self.d]) - 0.5 * (points[:, self.d :] ** 2).sum(axis=1)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        return self.inner.moments()

    def quantile(self, coordinate: int, probability: float) -> float:
        return self.inner.quantile(coordinate, probability)


class Plateau(Plain):
    """Flat between two far bounds in the first coordinate; the Laplace covariance knows nothing of that."""

    def __init__(self, size: int) -> None:
        covariance = np.eye(size)
        covariance[0, 0] = 0.3
        super().__init__(np.zeros(size), covariance)

    def log_density(self, points: FloatArray) -> FloatArray:
        inside = (points[:, 0] >= -5.0) & (points[:, 0] <= 20.0)
        return np.where(inside, -0.5 * (points[:, 1:] ** 2).sum(axis=1), -np.inf)


class Nowhere(Normal):
    def log_density(self, points: FloatArray) -> FloatArray:
        return np.full(points.shape[0], -np.inf)


class TwoModes(Plain):
    """A tenth of its mass in a normal around the mode, the rest in a narrower one that it overlaps little."""

    def __init__(self) -> None:
        super().__init__(np.zeros(3), np.eye(3))

    def log_density(self, points: FloatArray) -> FloatArray:
        first = -0.5 * (points**2).sum(axis=1)
        second = -0.5 * (((points - 2.5) / 0.6) ** 2).sum(axis=1) - 3.0 * math.log(0.6) + math.log(9.0)
        return np.logaddexp(first, second)


def errors_of(points: FloatArray) -> list[MonteCarloErrors]:
    """Standard errors of independent draws, as four chains."""
    n = points.shape[0] // 4 * 4
    chains = points[:n].reshape(4, -1, points.shape[1])
    return list(monte_carlo_errors({str(k): chains[:, :, k] for k in range(points.shape[1])}).values())


@pytest.mark.parametrize("more", [0, 2])
@pytest.mark.parametrize("name", TARGETS)
def test_moments_bounds_and_evidence_are_the_closed_form(name: str, more: int) -> None:
    build, evidence = TARGETS[name]
    inner = build()
    target = Wider(inner, more) if more else inner
    found = sample_exact(target, draws=6000, seed=3)
    assert found.converged, found.reason
    assert found.points.shape == (6000, target.mode.size)
    assert found.method == ("cells" if target.mode.size <= 2 else "mixture")
    np.testing.assert_allclose(found.log_density, target.log_density(found.points), rtol=1e-12)
    mean, sd = target.moments()
    for k in range(inner.mode.size):
        errors, draws = errors_of(found.points)[k], found.points[:, k]
        assert abs(draws.mean() - mean[k]) < 4.0 * errors.mean
        assert abs(draws.std() - sd[k]) < 4.0 * errors.sd
        for p, error in ((0.025, errors.q025), (0.975, errors.q975)):
            assert abs(np.quantile(draws, p) - target.quantile(k, p)) < 4.0 * error
    if evidence is not None:
        # cells end where the density has fallen by 25
        wanted = evidence + more * HALF_LOG_2PI
        assert abs(found.log_evidence - wanted) < 4.0 * found.log_evidence_se + 1e-9
        assert found.log_evidence_se < 0.01


@pytest.mark.parametrize("size", [2, 4])
def test_draws_are_independent_and_have_the_distribution_itself(size: int) -> None:
    target = Normal(size)
    found = sample_exact(target, draws=8000, seed=11)
    for k in range(size):
        z = (found.points[:, k] - target.mode[k]) / np.sqrt(target.covariance[k, k])
        assert stats.kstest(z, "norm").pvalue > 1e-4
        # correlation of neighbours: 4 standard errors of independent draws
        assert abs(np.corrcoef(z[1:], z[:-1])[0, 1]) < 4.0 / math.sqrt(8000)
    assert found.acceptance > 0.4


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_density_that_is_flat_up_to_far_bounds_is_covered(size: int) -> None:
    found = sample_exact(Plateau(size), draws=4000, seed=5)
    assert found.converged, found.reason
    assert stats.kstest((found.points[:, 0] + 5.0) / 25.0, "uniform").pvalue > 1e-4
    wanted = math.log(25.0) + (size - 1) * HALF_LOG_2PI
    assert abs(found.log_evidence - wanted) < 4.0 * found.log_evidence_se + 1e-3


def test_where_the_density_cannot_be_worked_out_there_is_none() -> None:
    target = Holed()
    found = sample_exact(target, draws=6000, seed=6)
    assert np.hypot(found.points[:, 0] - 1.5, found.points[:, 1]).min() >= 1.0
    assert found.points[:, 1].min() >= -3.0
    mean, sd = target.moments()
    errors = errors_of(found.points)[0]
    assert abs(found.points[:, 0].mean() - mean[0]) < 4.0 * errors.mean
    assert abs(found.points[:, 0].std() - sd[0]) < 4.0 * errors.sd


def test_draws_follow_from_the_seed_alone() -> None:
    for size in (2, 3):
        first = sample_exact(Normal(size), draws=500, seed=8)
        again = sample_exact(Normal(size), draws=500, seed=8)
        other = sample_exact(Normal(size), draws=500, seed=9)
        assert (first.points == again.points).all()
        assert first.log_evidence == again.log_evidence
        assert (first.points != other.points).any()


def test_a_second_mode_beside_the_first_has_its_share() -> None:
    found = sample_exact(TwoModes(), draws=4000, seed=1)
    assert found.converged, found.reason
    # the mean of the first coordinate is that of the mixture; its sd is below 1.25
    assert abs(found.points[:, 0].mean() - 0.9 * 2.5) < 4.0 * 1.25 / math.sqrt(4000)
    wanted = math.log(10.0) + 3 * HALF_LOG_2PI
    assert abs(found.log_evidence - wanted) < 4.0 * found.log_evidence_se


def test_a_bound_that_the_pilot_set_too_low_is_raised_and_the_draws_stay_exact() -> None:
    raised, draws = 0, []
    for seed in range(12):
        found = sample_exact(Wider(LogSpread(), 1), draws=500, seed=seed, pilot=200)
        raised += found.raised
        draws.append(found.points[:, 0])
    assert raised > 0
    target = LogSpread()
    pooled = np.concatenate(draws)
    mean, sd = target.moments()
    assert abs(pooled.mean() - mean[0]) < 4.0 * sd[0] / math.sqrt(pooled.size)
    assert stats.kstest(np.exp(pooled), stats.halfnorm.cdf).pvalue > 1e-4


def test_too_few_proposals_are_said_and_the_draws_kept() -> None:
    found = sample_exact(Normal(3), draws=5000, seed=1, max_proposals=3000)
    assert not found.converged
    assert 0 < found.points.shape[0] < 5000
    assert found.reason.startswith(f"{found.points.shape[0]:,} of 5,000 draws after 3,000 proposals")


def test_no_density_at_the_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="no density at its mode"):
        sample_exact(Nowhere(2), draws=10, seed=0)


def test_report_has_the_acceptance_and_the_evidence() -> None:
    found = sample_exact(Normal(2), draws=400, seed=2)
    report = found.report()
    assert report.as_json()["name"] == "exact"
    assert report.draws == 400
    assert report.converged
    assert report.acceptance == found.acceptance > 0.8
    assert report.detail["log_evidence"] == found.log_evidence
    assert "reason" not in report.detail


def specimen(seed: int, options: FitOptions, *, logs: int, thin: int) -> SpecimenTarget:
    """The posterior of a few logs of a known recipe, contact at the first sample as simulated."""
    simulated = simulate(recipe("paper-a-30-k1"), rng=np.random.default_rng(seed))
    handles = []
    for one in as_trials(simulated, specimen="s")[:: 30 // logs][:logs]:
        trial = one.__class__(
            specimen="s",
            time_s=one.time_s[::thin].copy(),
            displacement_mm=one.displacement_mm[::thin].copy(),
            force_N=one.force_N[::thin].copy(),
            source=one.source,
        )
        last = float(trial.time_s[-1])
        ramp = Phase("ramp", 0, trial.time_s.size, float(trial.time_s[0]), last, 1.0)
        segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.02), (ramp,), 1.0)
        facts = fitted_log(trial, segmentation).without_samples()
        handles.append(
            LogHandle(
                load=lambda trial=trial: trial, segmentation=segmentation, facts=facts, contact_sd_mm=0.02
            )
        )
    return posterior_target(fit_with_state("s", handles, options=options), Priors())


SHORT = [FitOptions(branches=1, stiffness_degree=1, static="shared", noise="white")]
LONG = [
    FitOptions(branches=1, stiffness_degree=1, noise="ar1"),
    FitOptions(branches=1, stiffness_degree=2, noise="white"),
]


def differences(target: SpecimenTarget, draws: int) -> dict[str, float]:
    """Largest differences of emcee and exact in joint Monte-Carlo standard errors, printed."""
    walked = sample_ensemble(target, draws=draws, seed=4)
    exact = sample_exact(target, draws=draws, seed=4)
    assert walked.converged, walked.reason
    assert exact.converged, exact.reason
    independent = draws // 4 * 4
    chains = {"emcee": walked.points, "exact": exact.points[:independent].reshape(4, -1, len(target.names))}
    # what was integrated counts as well: the parameters of the contact model, drawn anew for each point
    full = {}
    for name, chain in chains.items():
        points = chain.reshape(-1, chain.shape[2])
        theta = target.redraw(points, np.random.default_rng(7)).theta
        free = theta[:, theta.std(axis=0) > 0.0]
        full[name] = np.concatenate([points, free], axis=1).reshape(*chain.shape[:2], -1)
    out: dict[str, float] = {}
    for k in range(full["exact"].shape[2]):
        a, b = full["emcee"][:, :, k], full["exact"][:, :, k]
        e, x = (monte_carlo_errors({"one": c})["one"] for c in (a, b))
        for what, left, right, errors in (
            ("mean", a.mean(), b.mean(), (e.mean, x.mean)),
            ("sd", a.std(), b.std(), (e.sd, x.sd)),
            ("2.5 %", np.quantile(a, 0.025), np.quantile(b, 0.025), (e.q025, x.q025)),
            ("97.5 %", np.quantile(a, 0.975), np.quantile(b, 0.975), (e.q975, x.q975)),
        ):
            gap = abs(float(left - right)) / math.hypot(*errors)
            print(f"coordinate {k} {what:6} emcee {left:.6g} exact {right:.6g}: {gap:.2f} MCSE")  # noqa: T201
            out[what] = max(out.get(what, 0.0), gap)
    return out


@pytest.mark.slow
def test_emcee_agrees_with_exact_on_a_specimen_within_four_standard_errors() -> None:
    found = differences(specimen(20260301, SHORT[0], logs=3, thin=10), draws=4000)
    assert max(found.values()) < 4.0, found


@pytest.mark.slow
@pytest.mark.parametrize("options", SHORT + LONG)
@pytest.mark.parametrize("seed", [20260302, 20260303])
def test_emcee_agrees_with_exact_on_specimens_with_all_their_effects(seed: int, options: FitOptions) -> None:
    found = differences(specimen(seed, options, logs=6, thin=10), draws=10_000)
    assert max(found.values()) < 4.0, found
