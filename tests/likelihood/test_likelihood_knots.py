"""Knots against the samples they stand for: sums by explicit matrices, forces by other code, derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from instrument_factory import Case, drawn_theta, every_sample, recorded
from scipy.linalg import toeplitz

from tissueid.likelihood.instrument_kernels import ALL, EFFECTS, TISSUE, instrument_force
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.knots import KnotSums, choose_knots, knot_sums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import LogData
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.synth.path import Path
from tissueid.synth.recipe import Branch
from tissueid.synth.response import low_pass, tissue_force

THETA = np.array([20.0, -1.2, 0.35, 63.62, 10.0, 0.021])
RIGID = np.zeros(3)
DEPTH = 8.0
POWERS = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])


def one_optimum(logs: int = 1, **changes: object) -> Optimum:
    plain = Optimum(
        theta=THETA[:5] * POWERS,
        log_tau=np.log(THETA[5:]),
        gamma=np.zeros(logs),
        delta=np.zeros(logs),
        own=np.zeros((logs, 4)),
        scale=DEPTH,
        degree=1,
    )
    return replace(plain, **changes)


def ramp_hold(rate: float, speed: float = 250.0 / 60.0, depth: float = 4.0, hold: float = 2.0) -> LogData:
    time = np.arange(int((depth / speed + hold) * rate)) / rate
    x = np.minimum(speed * time, depth)
    return LogData(time, x, np.zeros(time.size), x >= 0.05, np.zeros(time.size, dtype=np.int64))


def hats(knot_s: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(time_s, knot_s, one) for one in np.eye(knot_s.size)])


def test_sums_are_those_of_explicit_matrices_under_white_noise() -> None:
    log = ramp_hold(100.0)
    e = np.random.default_rng(1).standard_normal(log.time_s.size)
    sums = knot_sums(log, e, phi=0.0, reference_step_s=0.01)
    h = hats(sums.time_s, log.time_s)[log.include]
    gram = h.T @ h
    # every product of a few hundred numbers of the size of one
    assert sums.pull == pytest.approx(h.T @ e[log.include], abs=1e-10)
    assert sums.band[:, 0] == pytest.approx(np.diag(gram), abs=1e-10)
    assert sums.band[:-1, 1] == pytest.approx(np.diagonal(gram, 1), abs=1e-10)
    assert sums.band.shape[1] == 2
    assert sums.square == pytest.approx(float(e[log.include] @ e[log.include]))
    assert sums.count == int(log.include.sum())


def test_sums_are_those_of_explicit_matrices_under_correlated_noise() -> None:
    log = ramp_hold(50.0, hold=1.0)
    rng = np.random.default_rng(2)
    # unequal steps, one sample left out: two chains
    time = log.time_s + 0.004 * rng.random(log.time_s.size)
    include = log.include.copy()
    include[40] = False
    log = replace(log, time_s=time, include=include, breaks=np.arange(time.size) == 0)
    e = rng.standard_normal(time.size)
    sums = knot_sums(log, e, phi=0.8, reference_step_s=0.02)
    chains = [np.flatnonzero(include & (np.arange(time.size) < 40)), np.arange(41, time.size)]
    h = hats(sums.time_s, time)
    gram, pull, square = np.zeros((h.shape[1],) * 2), np.zeros(h.shape[1]), 0.0
    for rows in chains:
        apart = np.abs(time[rows][:, None] - time[rows])
        inverse = np.linalg.inv(0.8 ** (apart / 0.02))
        gram += h[rows].T @ inverse @ h[rows]
        pull += h[rows].T @ inverse @ e[rows]
        square += float(e[rows] @ inverse @ e[rows])
    # the explicit inverse is good to some 1e-12 of entries of the size of ten
    assert sums.pull == pytest.approx(pull, abs=1e-9)
    assert np.diagonal(gram, 1) == pytest.approx(sums.band[:-1, 1], abs=1e-9)
    assert np.abs(np.triu(gram, 2)).max() < 1e-9
    assert sums.square == pytest.approx(square, rel=1e-11)


def test_white_and_correlated_noise_together_are_whitened_by_their_moving_average() -> None:
    log = ramp_hold(50.0, hold=1.0)
    n, phi, theta = log.time_s.size, 0.9, 0.6
    log = replace(log, include=np.ones(n, dtype=np.bool_))
    e = np.random.default_rng(3).standard_normal(n)
    sums = knot_sums(log, e, phi=phi, reference_step_s=0.02, moving_average=theta)
    # zeta = (1 - theta L)^-1 z from zeta_0 = z_0, and zeta is AR(1)
    prefilter = np.linalg.inv(np.eye(n) - theta * np.eye(n, k=-1))
    inverse = prefilter.T @ np.linalg.inv(toeplitz(phi ** np.arange(n))) @ prefilter
    h = hats(sums.time_s, log.time_s)
    gram = h.T @ inverse @ h
    width = sums.band.shape[1]
    whole = np.zeros_like(gram)
    for d in range(width):
        whole += np.diag(sums.band[: gram.shape[0] - d, d], d)
    # memories below 1e-9 are forgotten
    assert np.triu(gram) == pytest.approx(whole, abs=1e-6)
    assert sums.pull == pytest.approx(h.T @ inverse @ e, abs=1e-6)
    assert sums.square == pytest.approx(float(e @ inverse @ e), rel=1e-10)


def test_knots_are_dense_after_corners_and_few() -> None:
    log = ramp_hold(1_000.0, hold=30.0)
    knots = choose_knots(log.time_s, log.depth_mm)
    corner = int(np.argmax(log.depth_mm >= 4.0 - 1e-12))
    assert {0, corner - 1, corner, corner + 1, corner + 2, log.time_s.size - 1} <= set(knots.tolist())
    assert 60 < knots.size < 190
    # a step after a corner is a sample, or a sixth of the time since it
    since = log.time_s[knots[knots > corner]] - log.time_s[corner]
    early = since < 5.0
    assert (np.diff(since[early]) <= np.maximum(0.15 * since[early][:-1], 0.001) + 0.0011).all()


@pytest.mark.parametrize("noise_mm", [0.0, 1e-3, 2e-2])
def test_noise_of_the_displacement_makes_no_corners(noise_mm: float) -> None:
    log = ramp_hold(1_000.0, hold=5.0)
    rough = log.depth_mm + noise_mm * np.random.default_rng(4).standard_normal(log.time_s.size)
    assert choose_knots(log.time_s, rough).size < 200


def test_of_samples_with_one_time_a_single_one_is_a_knot() -> None:
    log = ramp_hold(100.0)
    time = log.time_s.copy()
    time[97] = time[96]
    knots = choose_knots(time, log.depth_mm)
    assert (np.diff(time[knots]) > 0.0).all()


@pytest.mark.parametrize("hold", [0.0, 2.0])
def test_force_of_a_rigid_instrument_is_the_closed_form(hold: float) -> None:
    log = ramp_hold(100.0, speed=4.0, hold=hold)
    data = every_sample([log], one_optimum(), ())
    path = Path(np.array([0.0, 1.0, 100.0]), np.array([0.0, 4.0, 4.0]))
    expected = tissue_force(
        path,
        log.time_s,
        offset_mm=0.0,
        static=tuple(THETA[:3]),
        branches=(Branch(tuple(THETA[3:5]), THETA[5]),),
    )
    assert data.base == pytest.approx(expected, abs=1e-9)


def test_load_channel_is_low_passed_and_late() -> None:
    skew, filter_s = 0.0033, 0.008
    log = ramp_hold(100.0, speed=4.0)
    optimum = one_optimum()
    shown = instrument_force(
        every_sample([log], optimum, ()), optimum.theta, optimum.log_tau, np.array([skew, filter_s, 0.0])
    )
    fine = np.arange(0.0, log.time_s[-1] + 1e-3, 1e-4)
    path = Path(np.array([0.0, 1.0, 100.0]), np.array([0.0, 4.0, 4.0]))
    clean = tissue_force(
        path, fine, offset_mm=0.0, static=tuple(THETA[:3]), branches=(Branch(tuple(THETA[3:5]), THETA[5]),)
    )
    expected = np.interp(log.time_s - skew, fine, low_pass(fine, clean, filter_s))
    # the cubic between samples 10 ms apart, half a relaxation time, is off by this; a line would be by 0.036
    assert shown == pytest.approx(expected, abs=1e-3)
    assert np.abs(shown - every_sample([log], optimum, ()).base).max() > 1.0


@pytest.mark.needs_jit
@pytest.mark.parametrize("compliance", [0.001, 0.005])
def test_frame_takes_its_deflection_off_the_depth(compliance: float) -> None:
    log = ramp_hold(200.0, speed=4.0)
    optimum = one_optimum()
    shown = instrument_force(
        every_sample([log], optimum, ()), optimum.theta, optimum.log_tau, np.array([0.0, 0.0, compliance])
    )
    model = KelvinVoigt(1, 1, DEPTH)
    finer = 8
    time = np.arange((log.time_s.size - 1) * finer + 1) / (200.0 * finer)
    depth = np.interp(time, log.time_s, log.depth_mm)
    force = np.zeros(time.size)
    for _ in range(60):
        tip = ContactPath(time, depth - compliance * force)
        force += 0.5 * (model.force(THETA, tip) - force)
    # the tip is on a parabola for 5 ms, a fourth of the relaxation time; a line would be 0.001 N off, or more
    assert shown == pytest.approx(force[::finer], abs=2e-4)


@pytest.mark.parametrize("effects", [("gain", "offset"), ("static",), ()])
@pytest.mark.parametrize("instrument", [RIGID, np.array([1.3e-3, 2.7e-3, 1.1e-3])])
def test_normal_equations_are_derivatives_of_the_sum_of_squares(
    effects: tuple[str, ...], instrument: np.ndarray
) -> None:
    specimen = recorded(Case(hold_s=1.0), THETA, {}, np.random.default_rng(5))
    logs = specimen.logs[4:8]
    optimum = one_optimum(len(logs), gamma=np.array([0.0, 0.02, -0.01, 0.03]))
    if effects == ("static",):
        own = np.outer([1.0, 1.1, 0.9, 1.0], np.concatenate([[0.1], THETA[:3]]))
        optimum = replace(optimum, theta=optimum.theta[3:], gamma=np.zeros(4), own=own)
    direct = every_sample(logs, optimum, effects)
    residual = np.split(np.concatenate([log.force_N for log in logs]) - direct.base, direct.first[1:-1])
    data = packed(
        [knot_sums(log, e, phi=0.5, reference_step_s=0.01) for log, e in zip(logs, residual, strict=True)],
        optimum,
        effects,
    )
    _, pull, _ = log_terms(data, optimum.theta, optimum.log_tau, instrument, ALL)

    def square(theta: np.ndarray, log_tau: np.ndarray, at: np.ndarray, changed=data) -> np.ndarray:
        return log_terms(changed, theta, log_tau, at, EFFECTS)[2]

    q = pull.shape[1] - optimum.theta.size - 1 - 3
    for k in range(optimum.theta.size):
        step = np.eye(optimum.theta.size)[k] * 1e-4 * abs(optimum.theta[k])
        up, down = (square(optimum.theta + s * step, optimum.log_tau, instrument) for s in (1.0, -1.0))
        # derivatives behind a filter are linear between knots, forces are not: a few percent
        assert pull[:, q + k] == pytest.approx(
            -(up - down) / (4.0 * step[k]), rel=0.05, abs=2e-3 * np.abs(pull[:, q + k]).max()
        )
    up, down = (square(optimum.theta, optimum.log_tau + s * 1e-5, instrument) for s in (1.0, -1.0))
    at = q + optimum.theta.size
    assert pull[:, at] == pytest.approx(-(up - down) / 4e-5, rel=0.05, abs=0.02 * np.abs(pull[:, at]).max())
    if "gain" in effects:
        moved = [
            square(optimum.theta, optimum.log_tau, instrument, data._replace(gamma=data.gamma + s))
            for s in (1e-6, -1e-6)
        ]
        assert pull[:, 0] == pytest.approx(-(moved[0] - moved[1]) / 4e-6, rel=0.01, abs=1.0)
        moved = [
            square(optimum.theta, optimum.log_tau, instrument, data._replace(delta=data.delta + s))
            for s in (1e-6, -1e-6)
        ]
        assert pull[:, 1] == pytest.approx(-(moved[0] - moved[1]) / 4e-6, rel=0.01, abs=1.0)


def test_integrated_effects_leave_the_marginal_normal_density() -> None:
    rng = np.random.default_rng(6)
    n, logs, q, v = 12, 3, 2, 4
    columns = rng.standard_normal((logs, n, q + v))
    residual = rng.standard_normal((logs, n))
    precision, mean, sigma2 = rng.uniform(0.5, 2.0, (logs, q)), rng.standard_normal((logs, q)), 0.7
    gram = np.einsum("inp,inq->ipq", columns, columns)
    pull = np.einsum("inp,in->ip", columns, residual)
    square = (residual**2).sum(axis=1)
    curvature, slope, value, back = without_effects(
        gram, pull, square, np.ones(logs), precision, mean, sigma2
    )
    change = rng.standard_normal(v)

    def marginal(d: np.ndarray) -> float:
        total = 0.0
        for i in range(logs):
            effect = columns[i, :, :q]
            covariance = sigma2 * np.eye(n) + effect / precision[i] @ effect.T
            away = residual[i] - columns[i, :, q:] @ d - effect @ mean[i]
            total -= 0.5 * float(away @ np.linalg.solve(covariance, away))
            total -= 0.5 * float(np.linalg.slogdet(covariance / sigma2)[1])
        return total

    expected = marginal(change) - marginal(np.zeros(v))
    assert slope @ change - 0.5 * change @ curvature @ change == pytest.approx(expected, rel=1e-10)
    assert value == pytest.approx(marginal(np.zeros(v)), rel=1e-10)
    effect = columns[0, :, :q]
    left = residual[0] - columns[0, :, q:] @ change
    solved = np.linalg.solve(
        effect.T @ effect / sigma2 + np.diag(precision[0]), effect.T @ left / sigma2 + precision[0] * mean[0]
    )
    assert back[0, :, v] - back[0, :, :v] @ change == pytest.approx(solved, rel=1e-10)


@pytest.mark.needs_jit
@pytest.mark.parametrize(("rate", "phi"), [(100.0, 0.0), (100.0, 0.9), (1_000.0, 0.0)])
def test_knots_know_the_likelihood_of_other_models(rate: float, phi: float) -> None:
    rng = np.random.default_rng(7)
    case = Case(rate_Hz=rate, hold_s=5.0, phi=phi)
    theta = drawn_theta(case.priors, rng)
    specimen = recorded(case, theta, {}, rng)
    logs = specimen.logs
    optimum = one_optimum(len(logs), theta=theta[:5] * POWERS, log_tau=np.log(theta[5:]))
    direct = every_sample(logs, optimum, ("gain", "offset"))
    residual = np.split(np.concatenate([log.force_N for log in logs]) - direct.base, direct.first[1:-1])
    sums = [
        knot_sums(log, e, phi=phi, reference_step_s=1.0 / rate) for log, e in zip(logs, residual, strict=True)
    ]
    data = packed(sums, optimum, ("gain", "offset"))
    here = log_terms(data, optimum.theta, optimum.log_tau, RIGID, EFFECTS)[2].sum()
    kept = [
        log.include & ((log.time_s <= log.time_s[-1] - 0.006) | (log.depth_mm[-1] == log.depth_mm[-2]))
        for log in logs
    ]

    def on_samples(theta: np.ndarray, log_tau: np.ndarray, instrument: np.ndarray) -> float:
        force = np.split(instrument_force(direct, theta, log_tau, instrument), direct.first[1:-1])
        total = 0.0
        for log, one, rows in zip(logs, force, kept, strict=True):
            e = (log.force_N - one)[rows]
            total += e[0] ** 2 + ((e[1:] - phi * e[:-1]) ** 2).sum() / (1.0 - phi**2)
        return total

    reference = on_samples(optimum.theta, optimum.log_tau, RIGID)
    assert here == pytest.approx(reference, rel=1e-12)
    assert sum(one.time_s.size for one in sums) < 140 * len(logs)
    for _ in range(6):
        log_tau = optimum.log_tau + 0.03 * rng.standard_normal(1)
        instrument = np.abs(rng.standard_normal(3)) * [3e-4, 3e-4, 3e-5]
        at = optimum.theta
        for _ in range(3):
            gram, pull, _ = log_terms(data, at, log_tau, instrument, TISSUE)
            at = at + np.linalg.solve(gram[:, 2:, 2:].sum(axis=0), pull[:, 2:].sum(axis=0))
        at = at + 0.002 * rng.standard_normal(5) * at
        knots = 0.5 * (here - log_terms(data, at, log_tau, instrument, EFFECTS)[2].sum())
        samples = 0.5 * (reference - on_samples(at, log_tau, instrument))
        # hats cut the curvature between knots: under a percent of a difference, and 0.05 where it is small
        assert knots == pytest.approx(samples, abs=0.05 + 0.012 * abs(samples))


def test_knots_of_a_log_are_merged_with_narrower_bands() -> None:
    wide = KnotSums(np.arange(3.0), np.arange(3.0), np.zeros(3), np.ones((3, 3)), 1.0, 5)
    narrow = KnotSums(np.arange(4.0), np.arange(4.0), np.zeros(4), np.ones((4, 1)), 2.0, 6)
    data = packed([wide, narrow], one_optimum(2), ("gain", "offset"))
    assert data.first.tolist() == [0, 3, 7]
    assert data.band.shape == (7, 3)
    assert data.band[3:, 1:].sum() == 0.0
