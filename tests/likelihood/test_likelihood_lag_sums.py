"""Sums for AR(1) noise against chains of noise evaluated sample by sample."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tissueid.likelihood import lag_sums as lag_module
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.chains import chain_breaks
from tissueid.likelihood.lag_sums import lag_sums
from tissueid.likelihood.noise import moving_average
from tissueid.likelihood.step_groups import MAX_LAG_GROUPS, lag_groups
from tissueid.likelihood.sums import LogData, log_sums, reduction
from tissueid.model import ContactPath, KelvinVoigt

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
N = 300 if JIT_OFF else 5000
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")
CLOCKS = ("uniform", "three rates", "gaps", "event rows", "gaps and event rows")


def sampling(clock: str, n: int, h: float = 0.01) -> np.ndarray:
    """Time stamps of n samples."""
    steps = np.full(n - 1, h)
    if clock == "three rates":
        steps[n // 4 : n // 2] = 10.0 * h
        steps[n // 2 :] = 4.0 * h
    if "gaps" in clock:
        steps[[n // 5, n // 2]] = 137.0 * h
    time = np.concatenate([[0.0], np.cumsum(steps)])
    if "event" in clock:
        extra = time[[n // 7, n // 3, n - 5]] + np.array([0.05, 0.4, 0.93]) * h
        time = np.sort(np.concatenate([time, extra]))
    return time


def make_log(time, *, include=None, breaks=None, seed=0, noise=0.5) -> LogData:
    rng = np.random.default_rng(seed)
    n = time.size
    depth = np.minimum(time / time[-1] * 6.0, 4.0) + 0.05 * np.sin(7.0 * time)
    return LogData(
        time_s=time,
        depth_mm=depth - depth[0],
        force_N=20.0 * depth + rng.normal(scale=noise, size=n),
        include=np.ones(n, dtype=bool) if include is None else include,
        fold=np.zeros(n, dtype=np.int64),
        breaks=breaks,
    )


def basis_for(data):
    steps = np.diff(data.time_s)
    return kernel_basis(step_s=float(np.median(steps)), length_s=float(data.time_s[-1]))


def direct_chain(residual, data, sigma, phi, reference_s):
    """Log density of a residual chain: one sample after the other, plain numpy."""
    used = np.flatnonzero(data.include)
    linked = links(data)[used]
    r = residual[used]
    rho = phi ** (np.diff(data.time_s[used], prepend=np.nan) / reference_s)
    before = np.concatenate([[0.0], r[:-1]])
    mean = np.where(linked, rho * before, 0.0)
    variance = sigma**2 * np.where(linked, -np.expm1(2.0 * np.log(rho)) if phi else 1.0, 1.0)
    return -0.5 * float(np.sum(np.log(2.0 * math.pi * variance) + (r - mean) ** 2 / variance))


def links(data):
    breaks = chain_breaks(data.time_s) if data.breaks is None else data.breaks
    linked = data.include & ~breaks
    linked[1:] &= data.include[:-1]
    linked[0] = False
    return linked


class Direct:
    """The model on samples, free of the likelihood's own code."""

    def __init__(self, data, branches, degree):
        self.data = data
        self.model = KelvinVoigt(branches=branches, stiffness_degree=degree, depth_mm=5.0)
        self.path = ContactPath(data.time_s, data.depth_mm)

    def log_likelihood(self, theta, sigma, phi, reference_s=0.01):
        residual = self.data.force_N - self.model.force(theta, self.path)
        return direct_chain(residual, self.data, sigma, phi, reference_s)


class FromSums:
    """The same from the sums."""

    def __init__(self, data, direct, *, center=None, basis=None):
        self.degree = direct.model.stiffness_degree
        self.model = direct.model
        self.basis = basis_for(data) if basis is None else basis
        self.center = np.zeros(4 + self.basis.tau_s.size * (self.degree + 1)) if center is None else center
        self.sums = lag_sums(data, self.basis, degree=self.degree, reference_step_s=0.01, center=center)

    def columns(self, theta):
        """Weights of the node columns that make the force of theta."""
        static, stiffness, tau = self.model.split(theta)
        beta = np.concatenate([[0.0], static, stiffness.ravel(), np.zeros(stiffness.size), [0.0]])
        weights = reduction(self.basis, np.log(tau), degree=self.degree, columns_degree=self.degree)
        return (weights @ beta)[:-1]

    def log_likelihood(self, theta, sigma, phi):
        gram, log_det = self.sums.whitened(phi)
        full = np.concatenate([self.center - self.columns(theta), [1.0]])
        n = self.sums.count
        square = float(full @ gram @ full) / sigma**2
        return -0.5 * (square + log_det + n * math.log(2.0 * math.pi * sigma**2))


@pytest.mark.needs_jit
@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("phi", [0.0, 0.5, 0.99, 0.999])
@pytest.mark.parametrize("degree", [0, 1])
def test_log_likelihood_equals_the_direct_one(clock, phi, degree):
    include = np.ones(sampling(clock, N).size, dtype=bool)
    include[: N // 10] = False
    include[N // 2 + 7] = False
    data = make_log(sampling(clock, N), include=include)
    direct = Direct(data, 2, degree)
    stiffness = np.array([[9.0, 2.0], [4.0, -0.5]])[:, : degree + 1]
    theta = direct.model.join(np.array([15.0, -1.0, 0.3]), stiffness, np.array([0.08, 3.0]))
    sums = FromSums(data, direct)
    expected = direct.log_likelihood(theta, 2.0, phi)
    # far from the optimum, not re-centred: residuals of 30 N leave 1e-9 of their sum of squares
    assert sums.log_likelihood(theta, 2.0, phi) == pytest.approx(expected, rel=1e-9, abs=1e-4)
    assert sums.sums.count == int(data.include.sum())
    assert sums.sums.links.sum() == links(data).sum()


def noisy(direct, theta, sigma, phi, seed):
    """The log of a tissue theta with AR(1) noise on its chains."""
    rng = np.random.default_rng(seed)
    data = direct.data
    linked = links(data)
    rho = np.where(linked, phi ** (np.diff(data.time_s, prepend=0.0) / 0.01), 0.0)
    fresh = rng.normal(size=rho.size) * np.sqrt(1.0 - rho**2)
    noise = np.empty(rho.size)
    last = 0.0
    for n in range(rho.size):
        last = rho[n] * last + fresh[n]
        noise[n] = last
    return replace(data, force_N=direct.model.force(theta, direct.path) + sigma * noise)


def optimum(direct, theta, sigma, phi):
    """Linear parameters of highest direct likelihood at the tau of theta, and a root of their covariance."""
    model, data = direct.model, direct.data
    _, stiffness, tau = model.split(theta)
    size = 3 + stiffness.size
    x = data.depth_mm
    states = model.states(tau, direct.path)
    columns = [x, x**2, x**3] + [s * x**p for s in states for p in range(stiffness.shape[1])]
    design = np.column_stack([*columns, data.force_N])
    used = np.flatnonzero(data.include)
    linked = links(data)[used]
    rho = np.where(linked, phi ** (np.diff(data.time_s[used], prepend=0.0) / 0.01), 0.0)
    white = design[used]
    white[1:] -= rho[1:, None] * design[used][:-1]
    white /= np.sqrt(1.0 - rho**2)[:, None]
    unit = np.linalg.norm(white[:, :size], axis=0)
    q, r = np.linalg.qr(white[:, :size] / unit)
    best = np.linalg.solve(r, q.T @ white[:, -1]) / unit
    root = np.linalg.inv(r) * sigma / unit[:, None]
    return model.join(best[:3], best[3:].reshape(stiffness.shape), tau), root


def moved(direct, theta, root, sigma, phi, rng, drop):
    """A point in a random direction, tau and all, where the direct log likelihood is ``drop`` lower."""
    model = direct.model
    static, stiffness, tau = model.split(theta)
    step = root @ rng.normal(size=root.shape[0])
    turn = rng.normal(scale=0.02, size=tau.size)
    top = direct.log_likelihood(theta, sigma, phi)

    def at(scale):
        linear = np.concatenate([static, stiffness.ravel()]) + scale * step
        return model.join(linear[:3], linear[3:].reshape(stiffness.shape), tau * np.exp(scale * turn))

    high = 1.0
    while top - direct.log_likelihood(at(high), sigma, phi) < drop and high < 1e3:
        high *= 2.0
    low = 0.0
    for _ in range(25):
        middle = 0.5 * (low + high)
        if top - direct.log_likelihood(at(middle), sigma, phi) < drop:
            low = middle
        else:
            high = middle
    return at(low)


@pytest.mark.needs_jit
@given(
    clock=st.sampled_from(CLOCKS),
    branches=st.integers(1, 3),
    degree=st.integers(0, 1),
    sigma=st.floats(0.1, 3.0),
    phi=st.one_of(st.just(0.0), st.floats(0.0, 0.999), st.floats(0.99, 0.999)),
    drop=st.floats(0.1, 50.0),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=8 if JIT_OFF else 60, deadline=None, derandomize=True, database=None)
def test_log_likelihood_is_exact_at_the_optimum_and_around_it(
    clock, branches, degree, sigma, phi, drop, seed
):
    rng = np.random.default_rng(seed)
    time = sampling(clock, N)
    include = np.ones(time.size, dtype=bool)
    include[: rng.integers(0, N // 10 + 1)] = False
    direct = Direct(make_log(time, include=include), branches, degree)
    tau = np.sort(np.exp(rng.uniform(np.log(0.03), np.log(20.0), size=branches)))
    stiffness = rng.uniform(2.0, 40.0, size=(branches, 2))[:, : degree + 1] / [1.0, 10.0][: degree + 1]
    truth = direct.model.join(np.array([20.0, -1.2, 0.35]), stiffness, tau)
    direct.data = noisy(direct, truth, sigma, phi, seed)
    best, root = optimum(direct, truth, sigma, phi)
    elsewhere = moved(direct, best, root, sigma, phi, rng, drop)
    sums = FromSums(direct.data, direct)
    centred = FromSums(direct.data, direct, center=sums.columns(best))
    expected = direct.log_likelihood(best, sigma, phi)
    assert centred.log_likelihood(best, sigma, phi) == pytest.approx(expected, rel=0.0, abs=1e-4)
    expected = direct.log_likelihood(elsewhere, sigma, phi)
    assert centred.log_likelihood(elsewhere, sigma, phi) == pytest.approx(expected, rel=0.0, abs=1e-3)


def design(data, basis, degree):
    """Design rows of all samples."""
    x = data.depth_mm
    model, path = KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=5.0), ContactPath(data.time_s, x)
    states = [model.states(np.array([tau]), path)[0] for tau in basis.tau_s]
    columns = [np.ones_like(x), x, x**2, x**3] + [s * x**p for p in range(degree + 1) for s in states]
    return np.column_stack([*columns, data.force_N])


def reference_sums(data, basis, degree):
    """Start, later, earlier and difference Gram matrices of one group, from all rows at once."""
    z = design(data, basis, degree)
    linked = links(data)
    starts = data.include & ~linked
    later, earlier = z[linked], z[np.flatnonzero(linked) - 1]
    return [part.T @ part for part in (z[starts], later, earlier, later - earlier)]


@pytest.mark.parametrize("n", [20, 63, 64, 65, 129])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_sums_are_those_of_all_rows_at_once(n, degree, monkeypatch):
    monkeypatch.setattr(lag_module, "chunk_samples", lambda _rows: 64)
    include = np.ones(n, dtype=bool)
    include[: n // 7] = False
    include[n // 3] = False
    breaks = np.zeros(n, dtype=bool)
    breaks[n // 2] = True
    data = make_log(sampling("uniform", n), include=include, breaks=breaks)
    basis = basis_for(make_log(sampling("uniform", 3000)))
    sums = lag_sums(data, basis, degree=degree, reference_step_s=0.005)
    found = [sums.start, sums.later[0], sums.earlier[0], sums.difference[0]]
    for mine, expected in zip(found, reference_sums(data, basis, degree), strict=True):
        size = np.sqrt(np.diag(expected))
        # states are exact to 1e-12 of their column's norm; earlier is later plus edges
        assert np.abs(mine - expected).max() <= 1e-12 * max(size.max() ** 2, 1.0)
    assert sums.links.tolist() == [links(data).sum()]
    assert sums.chains == 3
    np.testing.assert_allclose(sums.ratio, [2.0], rtol=1e-9)


@pytest.mark.parametrize("clock", ["alternating", "irregular"])
def test_steps_that_alternate_are_sorted(clock):
    rng = np.random.default_rng(4)
    n = N
    steps = np.where(np.arange(n - 1) % 2, 0.01, 0.02)
    if clock == "irregular":
        steps = rng.uniform(0.01, 0.05, size=n - 1)
    data = make_log(np.concatenate([[0.0], np.cumsum(steps)]))
    basis = kernel_basis(step_s=0.01, length_s=float(data.time_s[-1]))
    sums = lag_sums(data, basis, degree=0, reference_step_s=0.01)
    _, later, earlier, difference = reference_sums(data, basis, 0)
    assert sums.links.size == (2 if clock == "alternating" else MAX_LAG_GROUPS)
    for mine, expected in zip(
        (sums.later, sums.earlier, sums.difference), (later, earlier, difference), strict=True
    ):
        np.testing.assert_allclose(mine.sum(axis=0), expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_an_irregular_clock_counts_as_one_of_eight_near_steps():
    rng = np.random.default_rng(6)
    step = np.concatenate([[0.0], rng.uniform(0.01, 0.05, size=4000)])
    linked = step > 0.0
    group, mean = lag_groups(step, linked)
    assert group[0] == -1
    assert mean.size == MAX_LAG_GROUPS
    assert np.all(np.diff(mean) > 0.0)
    off = np.log(mean[group[1:]] / step[1:])
    assert np.abs(off).max() <= 0.15
    assert np.sqrt(np.mean(off**2)) <= 0.065


def test_the_likelihood_of_an_irregular_clock_is_that_of_its_nearest_steps():
    rng = np.random.default_rng(7)
    n = N
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.05, size=n - 1))])
    data = make_log(time)
    direct = Direct(data, 1, 0)
    theta = direct.model.join(np.array([15.0, -1.0, 0.3]), np.array([[9.0]]), np.array([0.4]))
    data = noisy(direct, theta, 1.0, 0.95, 8)
    direct.data = data
    sums = FromSums(data, direct)
    group, mean = lag_groups(np.diff(time, prepend=0.0), links(data))
    residual = data.force_N - direct.model.force(theta, direct.path)
    snapped = np.concatenate([[0.0], np.cumsum(mean[group[1:]])])
    expected = direct_chain(residual, replace(data, time_s=snapped), 1.0, 0.95, 0.01)
    assert sums.log_likelihood(theta, 1.0, 0.95) == pytest.approx(expected, rel=1e-9)
    # against the true steps: random, of the size sqrt(n / 2) * rms(d), a constant for all parameters of F
    true = direct_chain(residual, data, 1.0, 0.95, 0.01)
    assert abs(expected - true) <= 4.0 * 0.065 * math.sqrt(n / 2)


def test_trembling_steps_are_one_step():
    rng = np.random.default_rng(8)
    step = np.concatenate([[0.0], 0.01 * (1.0 + 0.01 * rng.normal(size=3000))])
    group, mean = lag_groups(step, step > 0.0)
    assert mean.size == 1
    assert mean[0] == pytest.approx(step[1:].mean(), rel=1e-12)
    assert set(group[1:].tolist()) == {0}


def test_three_rates_are_kept_exactly():
    data = make_log(sampling("three rates", N))
    sums = lag_sums(data, basis_for(data), degree=0, reference_step_s=0.01)
    np.testing.assert_allclose(sums.ratio, [1.0, 4.0, 10.0], rtol=1e-9)
    assert sums.links.sum() == N - 1


def test_without_correlation_the_sums_are_those_of_white_noise():
    data = make_log(sampling("three rates", N))
    basis = basis_for(data)
    gram, log_det = lag_sums(data, basis, degree=1, reference_step_s=0.01).whitened(0.0)
    expected = log_sums(data, basis, degree=1).gram[0]
    np.testing.assert_allclose(gram, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    assert log_det == 0.0


def test_a_thinned_log_has_no_links():
    include = np.arange(N) % 3 == 0
    data = make_log(sampling("uniform", N), include=include)
    sums = lag_sums(data, basis_for(data), degree=0, reference_step_s=0.01)
    gram, log_det = sums.whitened(0.9)
    assert sums.links.size == 0
    assert sums.chains == sums.count == include.sum()
    assert log_det == 0.0
    np.testing.assert_array_equal(gram, sums.start)


def test_logs_add_up():
    one, two = make_log(sampling("uniform", N)), make_log(sampling("three rates", N), seed=2)
    basis = basis_for(one)
    first, second = (lag_sums(log, basis, degree=0, reference_step_s=0.01) for log in (one, two))
    both = first.merged(second)
    gram, log_det = both.whitened(0.97)
    parts = [first.whitened(0.97), second.whitened(0.97)]
    expected = parts[0][0] + parts[1][0]
    np.testing.assert_allclose(gram, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    assert log_det == pytest.approx(parts[0][1] + parts[1][1], rel=1e-9)
    assert both.count == 2 * N
    assert both.ratio.size == 3


def test_sums_of_other_columns_do_not_add_up():
    data = make_log(sampling("uniform", 100))
    basis = basis_for(data)
    first = lag_sums(data, basis, degree=0, reference_step_s=0.01)
    for other in (
        lag_sums(data, basis, degree=1, reference_step_s=0.01),
        lag_sums(data, basis, degree=0, reference_step_s=0.02),
    ):
        with pytest.raises(ValueError, match="can't be added"):
            first.merged(other)


@needs_jit
def test_sums_do_not_depend_on_threads():
    logs = [make_log(sampling("uniform", 4000), seed=seed) for seed in range(6)]
    basis = basis_for(logs[0])

    def summed(log):
        return lag_sums(log, basis, degree=1, reference_step_s=0.01)

    alone = [summed(log) for log in logs]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(summed, logs))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a.later, b.later)
        np.testing.assert_array_equal(a.difference, b.difference)


def test_nothing_that_counts_gives_empty_sums():
    data = make_log(sampling("uniform", 50), include=np.zeros(50, dtype=bool))
    sums = lag_sums(data, basis_for(data), degree=0, reference_step_s=0.01)
    gram, log_det = sums.whitened(0.5)
    assert sums.count == 0
    assert not gram.any()
    assert log_det == 0.0


@pytest.mark.parametrize("clock", ["uniform", "three rates", "gaps and event rows"])
@pytest.mark.parametrize(("phi", "white"), [(0.9, 0.3), (0.99, 0.8), (0.999, 0.5)])
def test_filtered_sums_are_those_of_white_plus_ar1_noise(clock, phi, white):
    n = 300
    include = np.arange(sampling(clock, n).size) != 77
    data = make_log(sampling(clock, n), include=include)
    basis = kernel_basis(step_s=0.01, length_s=100.0, log_range=(-3.0, -1.0))
    theta = moving_average(phi, white)
    sums = lag_sums(data, basis, degree=1, reference_step_s=0.01, moving_average=theta, phi=phi)
    used = data.include
    chain, time = np.cumsum(~links(data))[used], data.time_s[used]
    apart = np.abs(time[:, None] - time[None, :]) / 0.01
    covariance = (1.0 - white) * phi**apart * (chain[:, None] == chain[None, :]) + white * np.eye(time.size)
    z = design(data, basis, 1)[used]
    expected = z.T @ np.linalg.solve(covariance, z)
    gram, _ = sums.whitened(phi)
    variance = 1.0 / (1.0 - 2.0 * phi * theta + theta**2)
    size = np.sqrt(np.diag(expected))
    # solving with a covariance of condition 1e3
    assert np.abs(gram / variance - expected).max() <= 1e-10 * size.max() ** 2


@needs_jit
def test_away_from_its_phi_the_filter_is_a_moving_average():
    phi, other, theta = 0.99, 0.97, 0.9
    data = make_log(sampling("uniform", 4000))
    basis = kernel_basis(step_s=0.01, length_s=100.0, log_range=(-3.0, -1.0))
    sums = lag_sums(data, basis, degree=0, reference_step_s=0.01, moving_average=theta, phi=phi)
    z = design(data, basis, 0)
    zeta = lfilter([1.0], [1.0, -theta], z, axis=0)
    innovations = (zeta[1:] - other * zeta[:-1]) / math.sqrt(1.0 - other**2)
    expected = zeta[:1].T @ zeta[:1] + innovations.T @ innovations
    # theta^n has died away after a hundred samples of four thousand
    assert np.abs(sums.whitened(other)[0] - expected).max() <= 0.02 * np.abs(expected).max()


@pytest.mark.parametrize(("phi", "theta"), [(0.0, 0.5), (0.5, 0.6), (1.0, 0.5), (0.9, -0.1)])
def test_no_white_noise_plus_ar1_has_such_a_theta(phi, theta):
    data = make_log(sampling("uniform", 60))
    with pytest.raises(ValueError, match="theta < phi"):
        lag_sums(data, basis_for(data), degree=0, reference_step_s=0.01, moving_average=theta, phi=phi)


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.9, 0.999])
@pytest.mark.parametrize("clock", ["uniform", "three rates"])
def test_half_a_million_samples_of_low_noise_lose_no_digits(clock, phi):
    sigma, drop = 0.1, 49.0
    direct = Direct(make_log(sampling(clock, 570_000, h=1e-3)), 3, 1)
    stiffness = np.array([[30.0, 2.0], [12.0, 1.0], [6.0, 0.5]])
    truth = direct.model.join(np.array([20.0, -1.2, 0.35]), stiffness, np.array([0.02, 0.5, 12.0]))
    direct.data = noisy(direct, truth, sigma, phi, 3)
    best, root = optimum(direct, truth, sigma, phi)
    elsewhere = moved(direct, best, root, sigma, phi, np.random.default_rng(4), drop)
    basis = kernel_basis(step_s=1e-3, length_s=float(direct.data.time_s[-1]))
    raw = FromSums(direct.data, direct, basis=basis)
    centred = FromSums(direct.data, direct, basis=basis, center=raw.columns(best))
    expected = direct.log_likelihood(best, sigma, phi)
    assert centred.log_likelihood(best, sigma, phi) == pytest.approx(expected, rel=0.0, abs=1e-4)
    expected = direct.log_likelihood(elsewhere, sigma, phi)
    assert centred.log_likelihood(elsewhere, sigma, phi) == pytest.approx(expected, rel=0.0, abs=1e-3)


@needs_jit
def test_many_gaps_cost_no_memory_and_lose_no_link():
    n = 50_000
    breaks = np.arange(n) % 320 == 100
    data = make_log(sampling("uniform", n), breaks=breaks)
    basis = kernel_basis(step_s=0.01, length_s=float(data.time_s[-1]), log_range=(-3.0, -2.0))
    sums = lag_sums(data, basis, degree=0, reference_step_s=0.01)
    expected = reference_sums(data, basis, 0)
    for mine, one in zip(
        (sums.start, sums.later[0], sums.earlier[0], sums.difference[0]), expected, strict=True
    ):
        np.testing.assert_allclose(mine, one, rtol=0.0, atol=1e-11 * np.abs(one).max())
    assert sums.chains == 1 + breaks.sum()
