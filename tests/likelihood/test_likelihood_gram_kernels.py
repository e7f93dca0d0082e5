"""Tiled Gram matrices against plain products, and samples sorted by label."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.likelihood.gram_kernels import (
    BLOCK,
    LANES,
    LINE,
    WIDE,
    add_grams,
    aligned_zeros,
    chunk_samples,
    mirrored,
    places,
    plain_grams,
    tiled_columns,
    tiled_grams,
)
from tissueid.likelihood.lag_kernels import add_link_grams, plain_link_grams, tiled_link_grams

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"


def expected_grams(rows, weight, powers):
    return np.stack([np.einsum("i,ik,il->kl", weight**q, rows, rows) for q in range(powers)])


@pytest.mark.parametrize(
    "summed", [plain_grams, add_grams] if JIT_OFF else [tiled_grams, plain_grams, add_grams]
)
@given(
    registers=st.integers(1, 2 * WIDE + 2),
    plain=st.integers(0, 2),
    powers=st.integers(1, 5),
    samples=st.integers(0, 3 * BLOCK),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=6 if JIT_OFF else 30, deadline=None, derandomize=True, database=None)
def test_weighted_grams_are_those_of_plain_sums(summed, registers, plain, powers, samples, seed):
    rng = np.random.default_rng(seed)
    rows, weight = rng.normal(size=(samples, LANES * registers)), rng.normal(size=samples)
    before = rng.normal(size=(powers, rows.shape[1], rows.shape[1]))
    out, plain = before.copy(), LANES * min(plain, registers)
    summed(rows, weight, plain, out)
    expected = before + expected_grams(rows, weight, powers)
    upper = np.triu(np.ones(out.shape[1:], dtype=bool))
    # rounding of sums of a few hundred numbers, weights up to 4^4
    np.testing.assert_allclose(out[0][upper], expected[0][upper], rtol=0.0, atol=1e-10)
    wanted = upper.copy()
    wanted[:plain] = False
    np.testing.assert_allclose(out[:, wanted], expected[:, wanted], rtol=0.0, atol=1e-8)
    # columns that take no part leave higher powers alone
    np.testing.assert_array_equal(out[1:, :plain], before[1:, :plain])


@pytest.mark.parametrize(
    "summed", [plain_link_grams, add_link_grams] if JIT_OFF else [tiled_link_grams, plain_link_grams]
)
@pytest.mark.parametrize("samples", [0, 1, BLOCK, 3 * BLOCK + 5])
def test_grams_of_links_are_those_of_means_and_differences(summed, samples):
    rng = np.random.default_rng(samples)
    groups, rows = 3, rng.normal(size=(samples + 1, 4 * LANES))
    label = rng.integers(0, groups + 1, size=samples)
    found = np.zeros((2, groups, rows.shape[1], rows.shape[1]))
    # links of the last label start chains: they take no part
    summed(rows, *places(label, groups + 1), 0, rows.shape[1], found[0], found[1])
    mean, change = 0.5 * (rows[1:] + rows[:-1]), rows[1:] - rows[:-1]
    for k in range(groups):
        for one, part in zip(found[:, k], (mean[label == k], change[label == k]), strict=True):
            np.testing.assert_allclose(np.triu(one), np.triu(part.T @ part), rtol=0.0, atol=1e-10)


def test_mirrored_matrices_are_symmetric_and_keep_their_upper_half():
    upper = np.arange(32.0).reshape(2, 4, 4)
    found = mirrored(upper)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))
    np.testing.assert_array_equal(np.triu(found), np.triu(upper))


@given(label=st.lists(st.integers(0, 3), max_size=60))
@settings(deadline=None, derandomize=True, database=None)
def test_places_sort_by_label_and_keep_the_order(label):
    label = np.array(label, dtype=np.int64)
    place, bound = places(label, 4)
    for k in range(4):
        mine = place[label == k]
        np.testing.assert_array_equal(mine, bound[k] + np.arange(mine.size))
        assert bound[k + 1] == bound[k] + mine.size
    assert (bound[0], bound[4]) == (0, label.size)


def test_columns_fill_whole_registers_and_chunks_have_samples():
    assert [tiled_columns(count) // LANES for count in (1, LANES, LANES + 1)] == [1, 1, 2]
    assert chunk_samples(72) > BLOCK
    assert chunk_samples(10**9) == 1


def test_aligned_zeros_begin_with_a_line_of_the_cache():
    for shape in ((3,), (5, 7), (2, 3, 4)):
        found = aligned_zeros(*shape)
        assert found.shape == shape
        assert found.ctypes.data % (LINE * found.itemsize) == 0
        assert not found.any()
