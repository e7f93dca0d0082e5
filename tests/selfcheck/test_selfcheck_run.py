"""A right posterior passes, a wrong one is told why; runs are resumed, killed and shared without a trace."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import until
from conjugate_check import NormalMean

from tissueid.errors import NotIdentifiedError, UsageError
from tissueid.selfcheck import records as runs
from tissueid.selfcheck.records import DRAWS, Checkpoint, Record, Replicate, one_record, rank_of
from tissueid.selfcheck.verdicts import POINTS, ecdf_band, ecdf_counts, verdict_of


def records_of(check: NormalMean, simulations: int, *, seed: int = 11) -> tuple[Record, ...]:
    return tuple(one_record(check, seed, index) for index in range(simulations))


def simulated(path: Path, simulations: int, **options: Any) -> tuple[Record, ...]:
    """Records of simulations that go on with what a file holds."""
    with Checkpoint(path, "d") as checkpoint:
        asked = {"simulations": simulations, "seed": 3, **options}
        return runs.run_simulations(NormalMean(), checkpoint, **asked)


def test_a_right_posterior_is_calibrated():
    records = records_of(NormalMean(), 400)
    verdict = verdict_of(records)
    assert verdict.calibrated
    assert verdict.reasons == ()
    mean, _ = verdict.parameters
    # z has mean 0 and mean square 1; 3.5 standard errors
    assert mean.mean_z == pytest.approx(0.0, abs=3.5 / np.sqrt(400))
    assert mean.spread_ratio == pytest.approx(1.0, abs=3.5 / np.sqrt(2 * 400))
    # posterior variance 0.8, prior variance 4: 1 - 0.8 / 4, known like a variance of 400 truths
    assert mean.contraction == pytest.approx(0.8, abs=3.5 * 0.2 * np.sqrt(2 / 400))
    # a monotone function of a parameter has its ranks
    assert all(record.rank["mean"] == record.rank["twice"] for record in records)


@pytest.mark.parametrize(
    ("check", "says", "mean_z", "spread"),
    [
        (NormalMean(width=0.7), "mean: the 95 % interval covers", 0.0, 1.0 / 0.7),
        (NormalMean(width=1.5), "mean: the 50 % interval covers", 0.0, 1.0 / 1.5),
        (NormalMean(shift=0.4), "mean: ranks leave the family-wise 99 % band", -0.4, np.hypot(1.0, 0.4)),
    ],
    ids=["too narrow", "too wide", "biased"],
)
def test_a_wrong_posterior_is_told_why_and_by_how_much(check, says, mean_z, spread):
    verdict = verdict_of(records_of(check, 400))
    assert not verdict.calibrated
    assert any(reason.startswith(says) for reason in verdict.reasons), verdict.reasons
    first = verdict.parameters[0]
    assert first.mean_z == pytest.approx(mean_z, abs=3.5 * spread / np.sqrt(400))
    assert first.spread_ratio == pytest.approx(spread, rel=3.5 / np.sqrt(2 * 400))


def test_a_simulation_without_a_posterior_is_counted_and_told():
    # 16 % of truths lie above one prior standard deviation
    verdict = verdict_of(records_of(NormalMean(fails_above=2.0), 200))
    assert 10 < len(verdict.failed) < 60
    assert verdict.simulations + len(verdict.failed) == 200
    assert verdict.reasons[0].endswith("no posterior: ArithmeticError: no posterior here")
    with pytest.raises(NotIdentifiedError, match="none of 3 simulations has a posterior; the first: "):
        verdict_of(records_of(NormalMean(fails_above=-100.0), 3))


def test_draws_that_are_no_numbers_count_as_a_failure_and_too_few_are_refused():
    replicate = Replicate(truth={"a": 0.0}, draws={"a": np.full(399, np.nan)})
    record = runs.record_of(0, replicate, np.random.default_rng(0), seconds=0.1)
    assert record.failed == "draws of a that are no numbers"
    with pytest.raises(ValueError, match="10 draws, 399 are needed"):
        runs.thinned(np.zeros(10))


def test_a_second_call_goes_on_with_the_same_simulations(tmp_path):
    path = tmp_path / "calibrate.jsonl"
    first = simulated(path, 8)
    told: list[tuple[int, int]] = []
    both = simulated(path, 20, progress=lambda _m, done, of: told.append((done, of)))
    assert (told[0], told[-1]) == ((8, 20), (20, 20))
    assert [record.rank for record in both[:8]] == [record.rank for record in first]
    whole = records_of(NormalMean(), 20, seed=3)
    assert [record.truth for record in both] == [record.truth for record in whole]
    # fewer than there are: the first ones
    assert len(simulated(path, 5)) == 5


def test_a_torn_last_line_is_dropped_and_simulated_again(tmp_path):
    path = tmp_path / "calibrate.jsonl"
    simulated(path, 4)
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    with Checkpoint(path, "d") as checkpoint:
        assert checkpoint.missing(4) == [3]
    assert simulated(path, 4)[3].truth == one_record(NormalMean(), 3, 3).truth
    path.write_bytes(whole[:20])
    with Checkpoint(path, "d") as checkpoint:
        # killed within the first line: nothing is lost that was there
        assert checkpoint.missing(2) == [0, 1]


def test_a_file_of_another_check_or_with_a_damaged_line_is_refused_and_kept(tmp_path):
    path = tmp_path / "calibrate.jsonl"
    simulated(path, 2)
    lines = path.read_bytes().splitlines(keepends=True)
    damaged = (b"no json\n", b'{"index": 1, "unknown": 2}\n', b"[1, 2]\n")
    others = {b"".join([lines[0], broken, lines[2]]): "is damaged" for broken in damaged}
    others |= dict.fromkeys((b'{"format": "other"}\n', b"t,F\n1,2\n"), "the simulations of another check")
    for content, says in others.items():
        path.write_bytes(content)
        with pytest.raises(UsageError, match=says):
            Checkpoint(path, "d")
        assert path.read_bytes() == content


def test_workers_change_nothing_but_the_clock(tmp_path):
    one = simulated(tmp_path / "one", 6, seed=9)
    two = simulated(tmp_path / "two", 6, seed=9, workers=2)
    assert [(r.index, r.truth, r.rank) for r in one] == [(r.index, r.truth, r.rank) for r in two]


def started(path: Path, simulations: int, workers: int, records: int) -> subprocess.Popen[bytes]:
    """The check as a program of its own, once it has written so many records."""
    script, root = Path(__file__).with_name("conjugate_check.py"), Path(__file__).resolve().parents[2]
    arguments = [sys.executable, str(script), str(path), str(simulations), str(workers)]
    running = subprocess.Popen(arguments, env=os.environ | {"PYTHONPATH": str(root)})
    until(lambda: path.exists() and path.read_bytes().count(b"\n") > records, seconds=120.0)
    return running


@pytest.mark.skipif(sys.platform == "win32", reason="a kill that can't be caught is POSIX")
def test_a_killed_run_goes_on_to_the_same_end(tmp_path):
    path = tmp_path / "calibrate.jsonl"
    running = started(path, 60, 1, records=8)
    running.send_signal(signal.SIGKILL)
    running.wait()
    before = path.read_bytes()
    assert before.count(b"\n") < 61
    assert started(path, 60, 1, records=60).wait() == 0
    assert path.read_bytes().startswith(before[: before.rfind(b"\n") + 1])
    with Checkpoint(path, "killed") as checkpoint:
        found = [(r.truth, r.rank) for r in checkpoint.first(60)]
    assert found == [(r.truth, r.rank) for r in records_of(NormalMean(), 60, seed=5)]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="children are looked up in /proc")
def test_workers_end_with_a_run_that_is_killed(tmp_path):
    running = started(tmp_path / "calibrate.jsonl", 100_000, 2, records=4)
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    workers = [Path(f"/proc/{number}/stat") for number in children.read_text().split()]
    assert len(workers) >= 2
    running.kill()
    running.wait()

    def alive(stat: Path) -> bool:
        try:
            return stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"
        except (FileNotFoundError, ProcessLookupError):
            return False

    until(lambda: not any(alive(worker) for worker in workers), seconds=120.0)


@pytest.mark.parametrize(("simulations", "level"), [(60, 0.95), (200, 0.95), (200, 0.99)])
def test_band_keeps_uniform_ranks_with_its_level(simulations, level):
    band = ecdf_band(simulations, level)
    # below z and above 1 - z are mirror images
    np.testing.assert_array_equal(band.low, simulations - band.high[::-1])
    rng = np.random.default_rng(71)
    repeats = 8000
    kept = np.mean([band.holds(ecdf_counts(rng.integers(0, DRAWS + 1, simulations))) for _ in range(repeats)])
    error = np.sqrt(level * (1.0 - level) / repeats)
    # counts are whole: the band holds its level and at most a little more
    assert level - 4.0 * error < kept < level + 0.003 + 4.0 * error


def test_ranks_and_their_counts_are_those_of_their_definitions():
    counts = ecdf_counts(np.array([0, 3, 4, 199, 200, DRAWS]))
    assert counts.size == POINTS - 1
    # 1 % of 400 ranks are 0 to 3; one half are 0 to 199
    assert (counts[0], counts[1], counts[49], counts[-1]) == (2, 3, 4, 5)
    rng = np.random.default_rng(3)
    draws = np.array([1.0, 2.0, 2.0, 3.0])
    assert rank_of(2.5, draws, rng) == 3
    assert rank_of(0.0, draws, rng) == 0
    tied = [rank_of(2.0, draws, rng) for _ in range(3000)]
    # uniform on 1, 2, 3: four standard errors of a third
    assert {*tied} == {1, 2, 3}
    assert np.bincount(tied)[1:] / 3000 == pytest.approx(1 / 3, abs=4 * np.sqrt(2 / 9 / 3000))
