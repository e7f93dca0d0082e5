"""Sums of squares from Gram matrices against the force law evaluated sample by sample."""

from __future__ import annotations

import os

import numpy as np
import pytest

from tissueid.likelihood import sums
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.kernels import fill_states
from tissueid.likelihood.sums import (
    MAX_STEP_GROUPS,
    N_STATIC,
    LogData,
    log_sums,
    reduced_grams,
    reduction,
    step_tables,
)
from tissueid.model import ContactPath, KelvinVoigt

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
N = 300 if JIT_OFF else 5000
TAUS = np.array([0.05, 0.9, 6.0])

#: The Gram matrix loses the square of force over residual: 1e-11 of the force's own sum of squares.
OF_FORCE_SQUARED = 1e-10


def sampling(kind: str, n: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    steps = {
        "uniform": np.full(n - 1, 0.01),
        "printed": np.diff(np.round(np.arange(n) * 0.01, 3)),
        "irregular": rng.uniform(0.01, 0.05, size=n - 1),
        "repeated": np.where(np.arange(n - 1) % 5 == 0, 0.0, 0.01),
        "two rates": np.where(np.arange(n - 1) < n // 2, 0.01, 0.1),
    }[kind]
    return np.concatenate([[0.0], np.cumsum(steps)])


def make_log(time, *, include=None, fold=None, seed=0) -> LogData:
    rng = np.random.default_rng(seed)
    n = time.size
    depth = np.minimum(time / time[-1] * 6.0, 4.0) + 0.2 * np.sin(7.0 * time)
    depth -= depth[0]
    force = 20.0 * depth + rng.normal(scale=0.5, size=n)
    return LogData(
        time_s=time,
        depth_mm=depth,
        force_N=force,
        include=np.ones(n, dtype=bool) if include is None else include,
        fold=np.zeros(n, dtype=np.int64) if fold is None else fold,
    )


def theta_for(branches, degree, seed=1):
    rng = np.random.default_rng(seed)
    model = KelvinVoigt(branches=branches, stiffness_degree=degree, depth_mm=5.0)
    stiffness = rng.uniform(0.5, 20.0, size=(branches, degree + 1))
    return model, model.join(np.array([18.0, -1.0, 0.3]), stiffness, TAUS[:branches])


def sse_from_sums(gram, basis, model, theta, columns_degree):
    static, stiffness, tau = model.split(theta)
    weights = reduction(basis, np.log(tau), degree=model.stiffness_degree, columns_degree=columns_degree)
    size = stiffness.size
    beta = np.concatenate([[0.0], static, stiffness.ravel(), np.zeros(size), [-1.0]])
    full = weights @ beta
    return float(full @ gram @ full)


def basis_for(data):
    steps = np.diff(data.time_s)
    return kernel_basis(step_s=float(steps[steps > 0].min()), length_s=float(data.time_s[-1]))


@pytest.mark.needs_jit
@pytest.mark.parametrize("kind", ["uniform", "printed", "irregular", "repeated", "two rates"])
@pytest.mark.parametrize("branches", [1, 2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_sum_of_squares_equals_the_direct_one(kind, branches, degree):
    data = make_log(sampling(kind, N))
    basis = basis_for(data)
    columns_degree = min(degree + 1, 2)
    sums = log_sums(data, basis, degree=columns_degree)
    model, theta = theta_for(branches, degree)
    direct = float(((data.force_N - model.force(theta, ContactPath(data.time_s, data.depth_mm))) ** 2).sum())
    found = sse_from_sums(sums.gram[0], basis, model, theta, columns_degree)
    assert found == pytest.approx(direct, rel=1e-9, abs=OF_FORCE_SQUARED * float(data.force_N @ data.force_N))
    assert sums.count.tolist() == [N]


def test_irregular_steps_beyond_the_table_are_still_exact():
    time = sampling("irregular", N)
    assert np.unique(np.diff(time)).size > MAX_STEP_GROUPS  # so that no step is tabulated
    data = make_log(time)
    basis = basis_for(data)
    gram = log_sums(data, basis, degree=0).gram[0]
    model, theta = theta_for(1, 0)
    residual = data.force_N - model.force(theta, ContactPath(data.time_s, data.depth_mm))
    assert sse_from_sums(gram, basis, model, theta, 0) == pytest.approx(float(residual @ residual), rel=1e-9)


def test_derivative_columns_are_the_slope_of_the_force_by_log_tau():
    data = make_log(sampling("uniform", N))
    basis = basis_for(data)
    gram = log_sums(data, basis, degree=1).gram[0]
    model, theta = theta_for(2, 1)
    static, stiffness, tau = model.split(theta)
    weights = reduction(basis, np.log(tau), degree=1, columns_degree=1)
    q = weights.T @ gram @ weights
    beta = np.concatenate([[0.0], static, stiffness.ravel(), np.zeros(4), [-1.0]])
    path = ContactPath(data.time_s, data.depth_mm)
    jacobian = model.jacobian(theta, path)
    residual = model.force(theta, path) - data.force_N
    for j, column in enumerate((5, 8)):
        slope = np.zeros(q.shape[0])
        slope[N_STATIC + 4 + 2 * j : N_STATIC + 6 + 2 * j] = stiffness[j]
        expected = tau[j] * float(jacobian[:, column] @ residual)
        scale = tau[j] * np.linalg.norm(jacobian[:, column]) * np.linalg.norm(residual)
        assert float(slope @ q @ beta) == pytest.approx(expected, abs=1e-7 * scale)


@pytest.mark.parametrize("folds", [1, 6])
def test_excluded_samples_drive_the_state_and_do_not_count(folds):
    time = sampling("uniform", N)
    include = np.ones(N, dtype=bool)
    include[: N // 4] = False
    include[::9] = False
    fold = np.arange(N) // 11 % folds
    data = make_log(time, include=include, fold=fold)
    basis = basis_for(data)
    sums = log_sums(data, basis, degree=1)
    model, theta = theta_for(2, 1)
    residual = data.force_N - model.force(theta, ContactPath(data.time_s, data.depth_mm))
    for index in range(folds):
        used = include & (fold == index)
        direct = float((residual[used] ** 2).sum())
        assert sse_from_sums(sums.gram[index], basis, model, theta, 1) == pytest.approx(direct, rel=1e-8)
        assert sums.count[index] == used.sum()


def test_folds_add_up_to_the_whole():
    time = sampling("uniform", N)
    parts = log_sums(make_log(time, fold=np.arange(N) // 50 % 6), basis_for(make_log(time)), degree=1)
    whole = log_sums(make_log(time), basis_for(make_log(time)), degree=1)
    scale = np.sqrt(np.outer(np.diag(whole.gram[0]), np.diag(whole.gram[0])))
    assert np.abs(parts.gram.sum(axis=0) - whole.gram[0]).max() <= 1e-12 * scale.max()
    assert parts.count.sum() == whole.count[0] == N


@pytest.mark.parametrize("n", [63, 64, 65, 129])
def test_nothing_is_lost_where_a_chunk_ends(n, monkeypatch):
    monkeypatch.setattr(sums, "chunk_samples", lambda _rows: 64)
    data = make_log(sampling("uniform", n))
    gram = log_sums(data, basis_for(data), degree=0).gram[0]
    assert gram[0, 0] == n
    assert gram[1, 1] == pytest.approx(float(data.depth_mm @ data.depth_mm), rel=1e-13)
    assert gram[0, -1] == pytest.approx(float(data.force_N.sum()), rel=1e-12)


def test_printed_time_stamps_have_one_step_not_nineteen():
    # 0.001 s steps differ in their last bits; tabulated or not, the sums are those of exact times
    exact = np.arange(N) * 1e-3
    printed = np.array([float(f"{value:.3f}") for value in exact])
    assert np.unique(np.diff(printed)).size > 1
    a, b = make_log(exact), make_log(printed)
    basis = basis_for(a)
    first, second = (log_sums(one, basis, degree=0).gram[0] for one in (a, b))
    np.testing.assert_allclose(second, first, rtol=1e-9, atol=1e-9 * np.abs(first).max())


def test_no_branch_leaves_the_static_columns():
    data = make_log(sampling("uniform", 200))
    basis = basis_for(data)
    weights = reduction(basis, np.zeros(0), degree=0, columns_degree=0)
    q = weights.T @ log_sums(data, basis, degree=0).gram[0] @ weights
    x = data.depth_mm
    design = np.column_stack([np.ones_like(x), x, x**2, x**3, data.force_N])
    np.testing.assert_allclose(q, design.T @ design, rtol=1e-11)


def test_gram_is_positive_semidefinite():
    data = make_log(sampling("uniform", N))
    gram = log_sums(data, basis_for(data), degree=2).gram[0]
    unit = 1.0 / np.sqrt(np.diag(gram))
    assert np.linalg.eigvalsh(gram * unit[:, None] * unit).min() >= -1e-11 * gram.shape[0]


@pytest.mark.parametrize("spread", [0.3, 3.0, 1000.0])
def test_states_of_an_irregular_clock_are_those_of_their_own_steps(spread):
    # weights follow from a table of near steps: exact for steps far shorter and far longer than tau
    rng = np.random.default_rng(9)
    n = 600
    steps = 0.01 * np.exp(rng.uniform(0.0, np.log(1.0 + spread), size=n - 1))
    steps[40] = 0.0
    data = make_log(np.concatenate([[0.0], np.cumsum(steps)]))
    tau = np.geomspace(0.002, 500.0, 24)
    step = np.diff(data.time_s, prepend=0.0)
    tables = step_tables(step, tau, float(data.time_s[-1]))
    rows = np.zeros((n, 2 + tau.size))
    state, place = np.zeros(tau.size), np.arange(n)
    fill_states(data.depth_mm, step, *tables, tau, state, 0, n, data.include, place, rows, 2)
    model, path = (
        KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=5.0),
        ContactPath(data.time_s, data.depth_mm),
    )
    expected = np.array([model.states(np.array([one]), path)[0] for one in tau])
    assert tables.off_s.size == n
    # a relative error of 1e-15 a step, as often as a state remembers
    assert np.abs(rows[:, 2:].T - expected).max() <= 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize(("branches", "degree"), [(0, 0), (1, 0), (2, 1), (3, 2), (1, 2)])
def test_reduced_grams_are_products_with_the_weights(branches: int, degree: int) -> None:
    basis = kernel_basis(step_s=0.01, length_s=5.0)
    rng = np.random.default_rng(branches)
    log_tau = np.sort(rng.uniform(*basis.log_bounds, branches))
    columns = rng.standard_normal((3, 200, 4 + 3 * basis.tau_s.size + 1))
    gram = np.swapaxes(columns, 1, 2) @ columns
    weights = reduction(basis, log_tau, degree=degree, columns_degree=2)
    expected = weights.T @ gram @ weights
    found = reduced_grams(gram, basis, log_tau, degree=degree)
    size = np.sqrt(np.einsum("ijj->ij", expected))
    assert (np.abs(found - expected) <= 1e-13 * size[:, :, None] * size[:, None, :]).all()
