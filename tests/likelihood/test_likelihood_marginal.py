"""The marginal likelihood on sums against a dense Gaussian density of all samples, written without them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.lag_sums import lag_sums
from tissueid.likelihood.lanes import LANES
from tissueid.likelihood.linearise import Optimum, centre
from tissueid.likelihood.marginal import log_marginals, log_peaks
from tissueid.likelihood.marginal_lanes import log_marginals_together, log_peaks_together
from tissueid.likelihood.objective import cone_start
from tissueid.likelihood.sums import LogData
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.building import specimen_target
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors

pytestmark = pytest.mark.needs_jit

STEP = 0.01
DEPTH = 5.0
SPEEDS = (1.0, 4.0, 12.0)
STATIC = np.array([20.0, -1.2, 0.35])
STIFFNESS = np.array([30.0, 4.0])
TAU = 0.2
SIGMA = 0.4
#: Tight enough about the truth that no prior mass is cut by passivity: the dense density knows no cone.
PRIORS = Priors(
    linear={
        "static_1_N_per_mm": (20.0, 1.0),
        "static_2_N_per_mm2": (-1.2, 0.2),
        "static_3_N_per_mm3": (0.35, 0.03),
        "stiffness_0_N_per_mm": (30.0, 3.0),
        "stiffness_1_N_per_mm2": (4.0, 0.5),
    }
)
MODEL = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
THETA = np.array([*STATIC, *STIFFNESS, TAU])
GAMMA = np.array([0.03, -0.02, 0.01])
DELTA = np.array([0.01, -0.02, 0.0])
OFFSET_SD = 0.03


def logs(*, effects: bool) -> list[LogData]:
    """Three ramps of different speed, each with a short hold, with noise."""
    rng = np.random.default_rng(20261121)
    out = []
    for i, speed in enumerate(SPEEDS):
        time = np.arange(0.0, min(DEPTH / speed + 0.6, 2.0), STEP)
        depth = np.minimum(speed * time, DEPTH)
        path = ContactPath(time, depth)
        gain, delta = (np.exp(GAMMA[i]), DELTA[i]) if effects else (1.0, 0.0)
        states = MODEL.states(np.array([TAU]), path)
        force = gain * (
            MODEL.static_force(THETA, depth - delta)
            + (MODEL.stiffness(THETA, depth - delta) * states).sum(axis=0)
        )
        force += SIGMA * rng.standard_normal(time.size)
        out.append(LogData(time, depth, force, np.ones(time.size, bool), np.zeros(time.size, dtype=np.int64)))
    return out


def target_for(data: list[LogData], pooling: str, *, correlated: bool) -> tuple[SpecimenTarget, Optimum]:
    """The specimen's target, linearised at the truth."""
    basis = kernel_basis(step_s=STEP, length_s=6.0)
    partial = pooling == "partial"
    optimum = Optimum(
        theta=np.concatenate([STATIC * DEPTH ** np.arange(1.0, 4.0), STIFFNESS * DEPTH ** np.arange(2.0)]),
        log_tau=np.array([np.log(TAU)]),
        gamma=GAMMA if partial else np.zeros(3),
        delta=DELTA if partial else np.zeros(3),
        own=np.zeros((3, 4)),
        scale=DEPTH,
        degree=1,
    )
    sums = [
        lag_sums(one, basis, degree=1, reference_step_s=STEP, center=centre(basis, 1, optimum, i))
        for i, one in enumerate(data)
    ]
    facts = Facts(
        force_N=120.0,
        speed_mm_s=np.array(SPEEDS),
        depth_mm=np.full(3, DEPTH),
        log_tau_bounds=(np.log(STEP / 5.0), np.log(60.0)),
        offset_sd_mm=np.full(3, OFFSET_SD) if partial else np.zeros(3),
        offset_mean_mm=np.zeros(3),
    )
    names = 2 + correlated + partial
    target = specimen_target(
        sums,
        basis,
        optimum,
        centred=optimum,
        facts=facts,
        priors=PRIORS,
        pooling=pooling,
        correlated=correlated,
        start=np.array([np.log(TAU), np.log(SIGMA), 0.1, np.log(0.05)])[:names]
        if correlated
        else np.array([np.log(TAU), np.log(SIGMA), np.log(0.05)])[:names],
        start_sd=np.array([0.05, 0.03, 0.05, 0.3])[:names]
        if correlated
        else np.array([0.05, 0.03, 0.3])[:names],
    )
    return target, optimum


def dense_log_marginal(
    data: list[LogData], *, tau: float, sigma: float, phi: float, gain_sd: float | None
) -> float:
    """Multivariate normal density of all forces, linear parameters and effects integrated by covariance.

    Gains multiply theta: the density over their common part falls with exp(-n c / logs) for each log, n the
    number of coefficients that the data determine, and that is integrated as well.
    """
    columns, mean_force, blocks, effects = [], [], [], []
    by_gain, precisions = [], []
    for i, one in enumerate(data):
        x = one.depth_mm
        gain, delta = (np.exp(GAMMA[i]), DELTA[i]) if gain_sd is not None else (1.0, 0.0)
        path = ContactPath(one.time_s, x)
        u = x - delta
        state = MODEL.states(np.array([tau]), path)[0]
        columns.append(gain * np.column_stack([u, u**2, u**3, state, state * u]))
        lag = np.abs(np.subtract.outer(np.arange(x.size), np.arange(x.size)))
        noise = sigma**2 * phi**lag if phi > 0.0 else sigma**2 * np.eye(x.size)
        precisions.append(columns[-1].T @ np.linalg.solve(noise, columns[-1]))
        mean = np.zeros(x.size)
        if gain_sd is not None:
            best = MODEL.states(np.array([TAU]), path)[0]
            force = gain * (STATIC @ np.array([u, u**2, u**3]) + (STIFFNESS[0] + STIFFNESS[1] * u) * best)
            slope = STATIC @ np.array([np.ones_like(u), 2.0 * u, 3.0 * u**2])
            by_offset = -gain * (slope + STIFFNESS[1] * best)
            noise = noise + gain_sd**2 * np.outer(force, force)
            noise = noise + OFFSET_SD**2 * np.outer(by_offset, by_offset)
            by_gain.append(gain_sd**2 * force)
            # effects count from the optimum, their priors from zero
            mean = -GAMMA[i] * force - DELTA[i] * by_offset
        blocks.append(noise)
        mean_force.append(mean)
        effects.append(one.force_N)
    c = np.concatenate(columns)
    total = np.zeros((c.shape[0], c.shape[0]))
    first = 0
    for block in blocks:
        total[first : first + len(block), first : first + len(block)] = block
        first += len(block)
    prior_mean = np.array([value for value, _ in PRIORS.linear.values()])
    prior_sd = np.array([sd for _, sd in PRIORS.linear.values()])
    total += (c * prior_sd**2) @ c.T
    mean = c @ prior_mean + np.concatenate(mean_force)
    y = np.concatenate(effects)
    value = float(multivariate_normal.logpdf(y, mean, total))
    if gain_sd is None:
        return value
    gram = sum(precisions)
    slope = np.trace(np.linalg.solve(gram + np.diag(prior_sd**-2.0), gram)) / len(data)
    # ln E exp(-slope t) of the sum t of all ln gains, which is normal given the forces
    cross = np.concatenate(by_gain)
    t_mean = -GAMMA.sum() + cross @ np.linalg.solve(total, y - mean)
    t_variance = len(data) * gain_sd**2 - cross @ np.linalg.solve(total, cross)
    return value - slope * t_mean + 0.5 * slope**2 * t_variance


@pytest.mark.parametrize("phi", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_marginal_on_sums_equals_the_dense_density_of_all_samples(pooling: str, phi: float) -> None:
    data = logs(effects=pooling == "partial")
    target, _ = target_for(data, pooling, correlated=True)
    for tau, sigma, gain_sd in ((TAU, SIGMA, 0.05), (0.185, 0.45, 0.02), (0.22, 0.37, 0.2)):
        point = [np.log(tau), np.log(sigma), np.arctanh(phi)]
        if pooling == "partial":
            point.append(np.log(gain_sd))
        points = np.array([point])
        found = float((target.log_density(points) - target.log_prior(points))[0])
        expected = dense_log_marginal(
            data, tau=tau, sigma=sigma, phi=phi, gain_sd=gain_sd if pooling == "partial" else None
        )
        # the dense density itself is known to some 1e-7 at prior standard deviations of 1e3 noises
        assert found == pytest.approx(expected, abs=2e-5)


def test_redrawn_parameters_have_the_moments_of_the_dense_conditional() -> None:
    data = logs(effects=False)
    target, _ = target_for(data, "shared", correlated=False)
    point = np.array([np.log(TAU), np.log(SIGMA)])
    n = 40_000
    drawn = target.redraw(np.tile(point, (n, 1)), np.random.default_rng(5))
    c = np.concatenate(
        [
            np.column_stack(
                [
                    one.depth_mm,
                    one.depth_mm**2,
                    one.depth_mm**3,
                    (s := MODEL.states(np.array([TAU]), ContactPath(one.time_s, one.depth_mm))[0]),
                    s * one.depth_mm,
                ]
            )
            for one in data
        ]
    )
    y = np.concatenate([one.force_N for one in data])
    prior_mean = np.array([value for value, _ in PRIORS.linear.values()])
    prior_sd = np.array([sd for _, sd in PRIORS.linear.values()])
    covariance = np.linalg.inv(c.T @ c / SIGMA**2 + np.diag(1.0 / prior_sd**2))
    mean = covariance @ (c.T @ y / SIGMA**2 + prior_mean / prior_sd**2)
    sd = np.sqrt(np.diag(covariance))
    # 4.5 standard errors of a mean and of a standard deviation of 40,000 draws
    np.testing.assert_allclose(drawn.theta[:, :5].mean(axis=0), mean, atol=(4.5 * sd / np.sqrt(n)).max())
    np.testing.assert_allclose(drawn.theta[:, :5].std(axis=0), sd, rtol=4.5 / np.sqrt(2 * n))
    np.testing.assert_allclose(drawn.theta[:, 5], TAU, rtol=1e-12)


def test_gains_and_offsets_are_redrawn_about_the_truth() -> None:
    data = logs(effects=True)
    target, _ = target_for(data, "partial", correlated=False)
    drawn = target.redraw(np.tile(target.mode, (4000, 1)), np.random.default_rng(6))
    ratio = drawn.gain / drawn.gain[:, :1]
    expected = np.exp(GAMMA - GAMMA[0])
    z = (ratio.mean(axis=0) - expected)[1:] / ratio.std(axis=0)[1:]
    assert np.abs(z).max() < 3.5
    away = drawn.offset_mm.mean(axis=0) - DELTA
    assert np.abs(away / drawn.offset_mm.std(axis=0)).max() < 3.5


@pytest.mark.parametrize("pooling", ["partial", "shared", "per-log"])
@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("count", [1, LANES, LANES + 7])
def test_points_side_by_side_have_the_density_of_each(pooling: str, correlated: bool, count: int) -> None:
    target, _ = target_for(logs(effects=pooling == "partial"), pooling, correlated=correlated)
    rng = np.random.default_rng(4)
    spread = np.sqrt(np.diag(target.covariance))
    points = target.mode + 3.0 * spread * rng.standard_normal((count, target.mode.size))
    # far out, where the passive cone cuts, and at a node of the interpolation
    points[count // 2] += 20.0 * spread
    points[0, 0] = target.data.nodes[0, 3]
    expected = log_marginals(target.data, points)
    assert np.isfinite(expected).any()
    assert log_marginals_together(target.data, points) == pytest.approx(expected, rel=1e-9)
    start = cone_start(target.data.blocks)
    expected = log_peaks(target.data, points, start)
    assert log_peaks_together(target.data, points, start) == pytest.approx(expected, rel=1e-9)
