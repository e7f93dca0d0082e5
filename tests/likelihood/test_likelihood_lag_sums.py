"""Sums for AR(1) noise against chains of noise evaluated sample by sample."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.chains import chain_breaks
from tissueid.likelihood.lag_sums import CHUNK, LagSums, lag_sums
from tissueid.likelihood.step_groups import MAX_LAG_GROUPS, lag_groups
from tissueid.likelihood.sums import LogData, log_sums, reduction
from tissueid.model import ContactPath, KelvinVoigt

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
N = 300 if JIT_OFF else 5000
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


def direct_chain(residual, time_s, linked, sigma, phi, reference_s):
    """Log density of a residual chain: one sample after the other, plain numpy."""
    total = 0.0
    variance = np.full(residual.size, sigma**2)
    mean = np.zeros(residual.size)
    rho = phi ** (np.diff(time_s) / reference_s)
    inside = np.flatnonzero(linked)
    mean[inside] = rho[inside - 1] * residual[inside - 1]
    variance[inside] = sigma**2 * (1.0 - rho[inside - 1] ** 2)
    return total - 0.5 * float(np.sum(np.log(2.0 * math.pi * variance) + (residual - mean) ** 2 / variance))


def from_sums(sums, weights, beta, sigma, phi):
    gram, log_det = sums.whitened(phi)
    full = weights @ beta
    n = sums.count
    return -0.5 * (float(full @ gram @ full) / sigma**2 + log_det + n * math.log(2.0 * math.pi * sigma**2))


def links(data):
    breaks = chain_breaks(data.time_s) if data.breaks is None else data.breaks
    linked = data.include & ~breaks
    linked[1:] &= data.include[:-1]
    linked[0] = False
    return linked


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("phi", [0.0, 0.5, 0.99, 0.999])
@pytest.mark.parametrize("degree", [0, 1])
def test_log_likelihood_equals_the_direct_one(clock, phi, degree):
    include = np.ones(sampling(clock, N).size, dtype=bool)
    include[: N // 10] = False
    include[N // 2 + 7] = False
    data = make_log(sampling(clock, N), include=include)
    basis = basis_for(data)
    sums = lag_sums(data, basis, degree=degree, reference_step_s=0.01)
    model = KelvinVoigt(branches=2, stiffness_degree=degree, depth_mm=5.0)
    stiffness = np.array([[9.0, 2.0], [4.0, -0.5]])[:, : degree + 1]
    static, tau = np.array([15.0, -1.0, 0.3]), np.array([0.08, 3.0])
    residual = data.force_N - model.force(
        model.join(static, stiffness, tau), ContactPath(data.time_s, data.depth_mm)
    )
    weights = reduction(basis, np.log(tau), degree=degree, columns_degree=degree)
    beta = np.concatenate([[0.0], static, stiffness.ravel(), np.zeros(stiffness.size), [-1.0]])
    linked = links(data)
    used = np.flatnonzero(data.include)
    expected = direct_chain(residual[used], data.time_s[used], linked[used], 2.0, phi, 0.01)
    found = from_sums(sums, weights, beta, 2.0, phi)
    # far from the optimum here: residuals of 30 N and a sum of squares of 1e6 leave 1e-9 of it
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-4)
    assert sums.count == int(data.include.sum())
    assert sums.links.sum() == linked.sum()
