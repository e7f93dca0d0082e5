"""Tiled Gram matrices against plain products, and samples sorted by label."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.likelihood.gram_kernels import (
    LANES,
    TILE,
    add_grams,
    chunk_samples,
    clear_gaps,
    mirrored,
    places,
    plain_grams,
    tiled_grams,
    tiled_rows,
)

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"


def expected_grams(rows, weight, powers):
    return np.stack([np.einsum("i,ki,li->kl", weight**q, rows, rows) for q in range(powers)])


@pytest.mark.parametrize("summed", [tiled_grams, plain_grams, add_grams])
@given(
    tiles=st.integers(1, 2 if JIT_OFF else 6),
    plain=st.integers(0, 2),
    powers=st.integers(1, 5),
    samples=st.integers(1, 20 if JIT_OFF else 2500),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=6 if JIT_OFF else 30, deadline=None, derandomize=True, database=None)
def test_weighted_grams_are_those_of_plain_sums(summed, tiles, plain, powers, samples, seed):
    rng = np.random.default_rng(seed)
    rows, weight = rng.normal(size=(TILE * tiles, samples)), rng.normal(size=samples)
    first = int(rng.integers(0, samples))
    last = int(rng.integers(first, samples + 1))
    before = rng.normal(size=(powers, rows.shape[0], rows.shape[0]))
    out, plain = before.copy(), TILE * min(plain, tiles)
    summed(rows, weight, plain, first, last, out)
    expected = before + expected_grams(rows[:, first:last], weight[first:last], powers)
    upper = np.triu(np.ones(out.shape[1:], dtype=bool))
    # rounding of sums of a few thousand numbers, weights up to 4^4
    np.testing.assert_allclose(out[0][upper], expected[0][upper], rtol=0.0, atol=1e-10)
    wanted = upper.copy()
    wanted[:plain] = False
    np.testing.assert_allclose(out[:, wanted], expected[:, wanted], rtol=0.0, atol=1e-8)
    # rows that take no part leave higher powers alone
    np.testing.assert_array_equal(out[1:, :plain], before[1:, :plain])


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
        np.testing.assert_array_equal(mine, bound[k, 0] + np.arange(mine.size))
        assert bound[k].tolist() == [bound[k, 0], bound[k, 0] + mine.size]
        assert bound[k, 0] % LANES == 0
    assert (np.diff(bound.ravel()) >= 0).all()


def test_gaps_between_labels_are_cleared_and_nothing_else():
    _, bound = places(np.array([0, 0, 1, 2, 2, 2]), 3)
    rows = np.ones((2, 3 * LANES))
    clear_gaps(rows, bound)
    kept = np.zeros(3 * LANES)
    for k, count in enumerate((2, 1, 3)):
        kept[k * LANES : k * LANES + count] = 1.0
    np.testing.assert_array_equal(rows, [kept, kept])


def test_rows_fill_whole_tiles_and_chunks_whole_lanes():
    assert [tiled_rows(count) for count in (1, 4, 5, 62)] == [4, 4, 8, 64]
    assert chunk_samples(72) % LANES == 0
    assert chunk_samples(10**9) == LANES
