"""Blocks of a log: what they keep of it, and the model through them against the mean over samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from inference_cases import blocks_from, log_data, point_of, ramp_hold, system_of

from tissueid.inference.blocks import SAMPLED, _digits, log_blocks
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.window import LogData
from tissueid.model.base import ContactPath

LAW = kelvin_voigt_law(1, 1, 4.0)
THETA = np.array([20.0, -1.2, 0.35, 60.0, 8.0, 0.02])


def direct(time, depth, theta=THETA, law=LAW):
    return law.model().force(np.asarray(theta), ContactPath(time, depth))


def between(log, blocks):
    """Mean over the samples of each block: blocks are neighbours, and cover the log."""
    edges = np.concatenate([[0], np.cumsum(blocks.count)])
    assert edges[-1] == log.time_s.size
    return np.add.reduceat(log.force_N, edges[:-1]) / blocks.count


@pytest.mark.parametrize("tau", [0.02, 2.0])
@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_means_through_blocks_are_those_of_the_samples(tau, rate):
    # the corner lies on a sample, which belongs to both lines
    time, depth = ramp_hold(rate, 4.0, 4.0, 10.0)
    theta = np.append(THETA[:-1], max(tau, 20.0 / rate))
    log = log_data(time, depth, direct(time, depth, theta))
    system = system_of([log], LAW)
    assert system.force.size < 0.4 * time.size
    np.testing.assert_allclose(system.force, between(log, system.logs[0]), rtol=1e-12)
    error = system.predict(point_of(LAW, theta)) - system.force
    assert np.abs(error).max() <= 1e-4 * np.ptp(log.force_N)


def test_a_constant_speed_between_holds_is_no_digit():
    # most travel repeats and all steps are alike: corners stay sharp all the same
    time = np.arange(1001) / 50.0
    depth = np.interp(time, [0.0, 2.0, 3.0, 4.0, 7.0, 20.0], [0.0, 2.0, 1.0, 2.0, 4.0, 4.0])
    theta = np.append(THETA[:-1], 2.0)
    log = log_data(time, depth, direct(time, depth, theta))
    error = system_of([log], LAW).predict(point_of(LAW, theta)) - system_of([log], LAW).force
    assert np.abs(error).max() <= 2e-4 * np.ptp(log.force_N)


def test_noise_of_the_travel_is_averaged_and_not_followed():
    rng = np.random.default_rng(1)
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 10.0)
    noisy = depth + 0.002 * rng.standard_normal(time.size)
    quiet, found = (blocks_from(log_data(time, x, 0.0 * x)) for x in (depth, noisy))
    assert found.force_N.size < 3 * quiet.force_N.size
    off = np.abs(found.depth_mm - np.interp(found.time_s, time, depth))
    # single samples near corners keep their noise, most points lie on lines through many
    assert np.median(off) < 0.5 * 0.002
    assert off.max() < 4.0 * 0.002


def test_a_short_log_is_kept_sample_by_sample_and_a_long_one_where_asked():
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 10.0)
    found = blocks_from(log_data(time, depth, direct(time, depth)), whole=True)
    assert found.force_N.size == time.size
    time, depth = ramp_hold(100.0, 4.0, 4.0, 2.0)
    assert time.size <= SAMPLED
    include = np.arange(time.size) >= 5
    found = blocks_from(log_data(time, depth, direct(time, depth), include=include))
    np.testing.assert_array_equal(found.force_N, direct(time, depth)[5:])
    np.testing.assert_array_equal(found.mid_s, time[5:])
    assert (found.count == 1).all()
    assert (found.within_freedom, found.chain.sum()) == (0, 1)


def held_log(hold_s, *, noise=0.0, **given):
    """A second of ramp at 1 kHz and a hold."""
    time, depth = ramp_hold(1000.0, 4.0, 4.0, hold_s)
    more = noise * np.random.default_rng(2).standard_normal(time.size)
    return log_data(time, depth, direct(time, depth) + more, **given)


def test_blocks_grow_behind_the_corner():
    found = blocks_from(held_log(30.0))
    since = found.mid_s - 1.0
    held = found.count[since > 0.0]
    assert held[0] <= 2
    assert held.max() >= 400
    # evenly in ln time: a block is no longer than 0.4 of the time since the corner
    late = since > 0.02
    assert (found.count[late] * 1e-3 <= 0.4 * since[late]).all()


def test_what_is_left_within_blocks_is_the_noise():
    found = blocks_from(held_log(10.0, noise=0.5))
    # some ten thousand degrees of freedom know a standard deviation to 0.7 %
    assert found.within_freedom > 8_000
    assert np.sqrt(found.within_N2 / found.within_freedom) == pytest.approx(0.5, rel=0.03)


def test_samples_that_take_no_part_start_chains_and_folds_are_not_mixed():
    at = np.arange(2001)
    include = (at < 600) | (at >= 700)
    found = blocks_from(held_log(1.0, include=include))
    assert found.count.sum() == include.sum()
    assert found.chain.sum() == 2
    assert found.mid_s[np.flatnonzero(found.chain)[1]] >= 0.7
    # a corner's own block starts none
    assert (found.count == 1).any()
    fold = at // 477
    found = blocks_from(held_log(1.0, fold=fold))
    edges = np.concatenate([[0], np.cumsum(found.count)])
    for number, (a, b) in enumerate(pairwise(edges)):
        assert set(fold[a:b]) == {int(found.fold[number])}


def test_a_path_that_leads_begins_in_air():
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 5.0)
    log = log_data(time, depth, direct(time, depth))
    found, plain = (log_blocks(log, step_s=1e-3, contact_sd_mm=0.02, leads=leads) for leads in (True, False))
    # on the line of the first samples, at 4 mm/s
    assert (found.depth_mm[0], found.time_s[0]) == pytest.approx((-0.1, -0.025))
    np.testing.assert_array_equal(found.at, plain.at + 1)


@pytest.mark.parametrize("whole", [True, False])
def test_a_corner_between_two_samples_is_a_point_of_the_path(whole):
    time = np.arange(801) / 100.0
    depth = np.round(np.minimum(3.7 * time, 4.0), 5)
    blocks = blocks_from(log_data(time, depth, depth), whole=whole)
    corner = 4.0 / 3.7
    nearest = int(np.argmin(np.abs(blocks.time_s - corner)))
    assert blocks.time_s[nearest] == pytest.approx(corner, abs=1e-5)
    assert blocks.depth_mm[nearest] == pytest.approx(4.0, abs=2e-5)
    # observations are where they were
    middle = blocks.at[:, 1]
    one = blocks.count == 1
    np.testing.assert_allclose(blocks.time_s[middle[one]], blocks.mid_s[one], atol=1e-12)


def test_a_stop_that_brakes_or_lies_on_a_sample_gets_no_corner():
    time = np.arange(801) / 100.0
    braked = np.convolve(
        np.minimum(4.0 * np.pad(time, 10, mode="edge"), 4.0), np.ones(11) / 11.0, mode="same"
    )[10:-10]
    for depth in (braked, np.minimum(4.0 * time, 4.0)):
        blocks = blocks_from(log_data(time, depth, depth), whole=True)
        assert blocks.time_s.size == time.size


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("slope", [1e-3, 1.0])
def test_rounding_that_samples_share_is_not_averaged(noise, slope):
    """Means of 200 samples of a slow force keep its rounding; quick ones and much noise do not."""
    rng, step = np.random.default_rng(4), 0.1
    time = np.arange(40_000.0) * 0.01
    level = slope * time
    force = np.round((level + noise * rng.standard_normal(time.size)) / step) * step
    off = (force - level).reshape(-1, 200)
    found = float(np.median(_digits(force, force.reshape(-1, 200).mean(axis=1))))
    # variance of the means, less the part that averages
    left = (off.mean(axis=1).var() - off.var() / 200) / off.var()
    assert left - 0.02 <= found <= 2.7 * left + 0.02


@pytest.mark.parametrize("share", [0.05, 0.4, 0.9])
def test_samples_beside_a_contact_between_samples_are_compared_where_they_are(share):
    """Contact a part of a step before the first sample: nothing of a noise-free log is missed."""
    time = np.concatenate([[0.0], (share + np.arange(1_000.0)) * 0.01])
    depth = np.minimum(4.0 * time, 6.0)
    include = np.arange(time.size) > 0
    data = LogData(time, depth, 50.0 * depth, include, np.zeros(time.size, dtype=np.int64))
    blocks = log_blocks(data, step_s=0.01, contact_sd_mm=0.004, leads=True)
    assert blocks.count.max() > 1
    x = blocks.depth_mm[blocks.at]
    mean = (x[:, 0] + 4.0 * x[:, 1] + x[:, 2]) / 6.0
    np.testing.assert_allclose(blocks.force_N, 50.0 * mean, atol=1e-9)


def test_rows_that_share_one_instant_are_no_straight_line():
    """A logger that stood still for twelve rows: no slope is taken over no time."""
    time = np.arange(2_000) * 0.01
    for at in (300, 600, 1_500):
        time[at : at + 12] = time[at]
    depth = np.minimum(np.arange(2_000) * 0.01, 6.0)
    data = LogData(time, depth, 5.0 * depth, np.ones(2_000, dtype=bool), np.zeros(2_000, dtype=np.int64))
    with np.errstate(all="raise"):
        blocks = log_blocks(data, step_s=0.01, contact_sd_mm=0.004, leads=False)
    assert np.isfinite(blocks.time_s).all()
    assert np.isfinite(blocks.depth_mm).all()
