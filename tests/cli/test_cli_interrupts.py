"""Killed or interrupted at any moment, an output folder shows the old run or the new one, whole."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import LOG, QUICK, read_json, run, start, until, write_log

from tissueid.store.files import IDENTIFICATION, POSTERIORS
from tissueid.store.posteriors import load_posteriors

#: Options of two runs over the same logs, which give different numbers.
RUNS = (QUICK, ("--branches", "2", "--stiffness-degree", "0", "--sampler", "none"))


@dataclass(frozen=True)
class Prepared:
    """A log, what either run writes, and how long one takes in a process of its own [s]."""

    log: Path
    numbers: tuple[bytes, bytes]
    seconds: float


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kill")
    log = write_log(folder / "log.csv")
    numbers = []
    for number, options in enumerate(RUNS):
        begin = time.monotonic()
        with start("fit", log, "-o", folder / str(number), "-q", *options) as process:
            assert process.wait(timeout=120) in (0, 4)
        seconds = time.monotonic() - begin
        numbers.append((folder / str(number) / "identification.json").read_bytes())
    assert numbers[0] != numbers[1]
    return Prepared(log, (numbers[0], numbers[1]), seconds)


def survived_kills(prepared: Prepared, out: Path, *, kills: int, seed: int) -> int:
    """Kill fits at random moments; how many left one whole run, the old or the new."""
    rng = np.random.default_rng(seed)
    assert run("fit", prepared.log, "-o", out, "-q", *RUNS[0]).code in (0, 4)
    shown, whole = 0, 0
    for kill in range(kills):
        # half of the kills anywhere, half in the last third, where the files are written
        begin = 0.0 if kill % 2 else 0.67
        other = 1 - shown
        with start("fit", prepared.log, "-o", out, "-q", *RUNS[other]) as process:
            time.sleep(prepared.seconds * float(rng.uniform(begin, 1.05)))
            process.kill()
        run("validate", out, code=0)
        numbers = (out / "identification.json").read_bytes()
        assert numbers in prepared.numbers
        shown = prepared.numbers.index(numbers)
        bundle = run("export", out).json()["specimens"][0]["model"]["branches"]
        assert bundle == shown + 1
        whole += 1
    # the folder is of use afterwards
    assert run("fit", prepared.log, "-o", out, "-q", *RUNS[0]).code in (0, 4)
    assert (out / "identification.json").read_bytes() == prepared.numbers[0]
    assert len(list((out / ".runs").iterdir())) == 1
    assert not list(out.glob(".tmp-*"))
    return whole


def test_a_killed_fit_leaves_the_old_run_or_the_new(prepared, tmp_path):
    assert survived_kills(prepared, tmp_path, kills=3, seed=20) == 3


@pytest.mark.slow
def test_twenty_killed_fits_leave_the_old_run_or_the_new(prepared, tmp_path):
    assert survived_kills(prepared, tmp_path, kills=20, seed=21) == 20


@pytest.mark.skipif(sys.platform == "win32", reason="a process can't be sent SIGINT here")
def test_ctrl_c_ends_with_130_and_leaves_the_old_run(datasets, tmp_path):
    out = tmp_path / "out"
    run("fit", write_log(tmp_path / "log.csv"), "-o", out, "-q", *QUICK)
    before = (out / "identification.json").read_bytes()
    runs = set((out / ".runs").iterdir())
    with start("fit", datasets / "paper-a-30-10Hz", "-o", out) as process:
        # the new run's folder appears when the work begins, and fitting 30 logs takes seconds from there
        until(lambda: set((out / ".runs").iterdir()) != runs)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert run("validate", out).code == 0
    assert (out / "identification.json").read_bytes() == before
    assert set((out / ".runs").iterdir()) == runs


def test_a_killed_fit_into_a_new_folder_leaves_no_half_result(prepared, tmp_path):
    out = tmp_path / "out"
    with start("fit", prepared.log, "-o", out, "-q", *RUNS[1]) as process:
        until((out / ".runs").exists)
        process.kill()
    assert run("validate", out).code == 6
    assert not (out / "identification.json").exists()
    assert run("fit", prepared.log, "-o", out, "-q", *RUNS[1]).code in (0, 4)
    assert (out / "identification.json").read_bytes() == prepared.numbers[1]


#: Enough for some seconds of sampling, so that a chain is on the disk before it ends.
DRAWS = "60000"
#: A first run compiles its kernels.
PATIENCE_S = 600.0


@pytest.mark.slow
def test_the_same_command_after_a_kill_gives_the_posterior_of_an_uninterrupted_run(tmp_path):
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    command = ("fit", LOG, *QUICK, "--sampler", "emcee", "--draws", DRAWS, "--seed", "7", "-o")
    process = start(*command, killed)
    until(lambda: process.poll() is not None or any(killed.glob(".sampling/*.npz")), PATIENCE_S)
    assert process.poll() is None, "sampled to its end before it could be killed"
    process.kill()
    process.communicate()
    (saved,) = killed.glob(".sampling/*.npz")
    with np.load(saved) as file:
        steps = len(file["points"])
    assert steps > 0
    assert not (killed / IDENTIFICATION).exists()

    for out in (killed, whole):
        again = start(*command, out)
        _, errors = again.communicate(timeout=PATIENCE_S)
        assert again.returncode == 0, errors
        assert not (out / ".sampling").exists()
    (resumed,), (expected,) = (load_posteriors(out / POSTERIORS) for out in (killed, whole))
    assert np.array_equal(resumed.chain, expected.chain)
    assert np.array_equal(resumed.draws, expected.draws)
    told = [read_json(out / IDENTIFICATION)["specimens"] for out in (killed, whole)]
    assert told[0] == told[1]
    # the kill came before the end: kept chains are thinned, their report counts every step
    assert told[0][0]["sampler"]["detail"]["steps"] > steps
