"""Where chains of noise are broken."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.window import chain_breaks


def stamps(steps):
    return np.concatenate([[0.0], np.cumsum(steps)])


def broken(steps):
    return np.flatnonzero(chain_breaks(stamps(steps))).tolist()


def test_a_regular_clock_is_one_chain():
    assert broken(np.full(500, 1e-3)) == [0]


def test_time_stamps_printed_with_rounding_are_one_chain():
    time = np.array([float(f"{k / 30.0:.3f}") for k in range(600)])
    assert np.flatnonzero(chain_breaks(time)).tolist() == [0]


@pytest.mark.parametrize("fast_first", [True, False])
def test_a_change_of_rate_breaks_nothing(fast_first):
    steps = np.concatenate([np.full(300, 1e-3), np.full(300, 0.1), np.full(200, 1.0)])
    assert broken(steps if fast_first else steps[::-1]) == [0]


def test_a_gap_starts_a_chain():
    steps = np.full(400, 0.01)
    steps[[100, 250]] = [0.03, 5.0]
    assert broken(steps) == [0, 101, 251]


@pytest.mark.parametrize("share", [0.02, 0.5, 0.93])
def test_an_event_row_and_the_sample_after_it_start_chains(share):
    steps = np.full(400, 0.01)
    steps = np.insert(steps, 200, share * 0.01)
    steps[201] = (1.0 - share) * 0.01
    assert broken(steps) == [0, 201, 202]


def test_an_event_row_at_a_change_of_rate_starts_chains():
    steps = np.concatenate([np.full(300, 1e-3), [4e-4, 6e-4], np.full(300, 0.1)])
    assert broken(steps) == [0, 301, 302]


def test_repeated_times_start_chains():
    steps = np.full(400, 0.01)
    steps[50] = 0.0
    assert 51 in broken(steps)


def test_an_irregular_clock_is_broken_by_real_gaps_only():
    rng = np.random.default_rng(1)
    steps = rng.uniform(0.01, 0.05, size=800)
    steps[400] = 3.0
    assert broken(steps) == [0, 401]


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_short_records_have_their_first_sample(n):
    assert np.flatnonzero(chain_breaks(np.arange(float(n)))).tolist() == list(range(min(n, 1)))
