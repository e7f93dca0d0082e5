"""Killed or interrupted at any moment, an output folder shows the old run or the new one, whole."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import QUICK, run, start, until, write_log

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


@pytest.mark.parametrize(("kills", "seed"), [(3, 20), pytest.param(20, 21, marks=pytest.mark.slow)])
def test_fits_killed_at_random_moments_leave_the_old_run_or_the_new(prepared, tmp_path, kills, seed):
    out = tmp_path
    rng = np.random.default_rng(seed)
    run("fit", prepared.log, "-o", out, "-q", *RUNS[0], code={0, 4})
    shown = 0
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
    # the folder is of use afterwards
    run("fit", prepared.log, "-o", out, "-q", *RUNS[0], code={0, 4})
    assert (out / "identification.json").read_bytes() == prepared.numbers[0]
    assert len(list((out / ".runs").iterdir())) == 1
    assert not list(out.glob(".tmp-*"))


def test_a_killed_fit_into_a_new_folder_leaves_no_half_result(prepared, tmp_path):
    out = tmp_path / "out"
    with start("fit", prepared.log, "-o", out, "-q", *RUNS[1]) as process:
        until((out / ".runs").exists)
        process.kill()
    assert run("validate", out).code == 6
    assert not (out / "identification.json").exists()
    assert run("fit", prepared.log, "-o", out, "-q", *RUNS[1]).code in (0, 4)
    assert (out / "identification.json").read_bytes() == prepared.numbers[1]
