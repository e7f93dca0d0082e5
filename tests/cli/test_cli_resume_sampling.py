"""A fit that is killed while it samples goes on where it was, and ends as if it had never been."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import LOG, QUICK, start

from tissueid.store.files import IDENTIFICATION, POSTERIORS
from tissueid.store.posteriors import load_posteriors

#: Enough for some seconds of sampling, so that a chain is on the disk before it ends.
DRAWS = "60000"
#: A first run compiles its kernels.
PATIENCE_S = 600.0


@pytest.mark.slow
def test_the_same_command_after_a_kill_gives_the_posterior_of_an_uninterrupted_run(tmp_path: Path) -> None:
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    command = ("fit", LOG, *QUICK, "--sampler", "emcee", "--draws", DRAWS, "--seed", "7", "-o")
    process = start(*command, killed)
    until = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < until and not any(killed.glob(".sampling/*.npz")):
        time.sleep(0.02)
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
    told = [json.loads((out / IDENTIFICATION).read_bytes())["specimens"] for out in (killed, whole)]
    assert told[0] == told[1]
    # the kill came before the end: kept chains are thinned, their report counts every step
    assert told[0][0]["sampler"]["detail"]["steps"] > steps
