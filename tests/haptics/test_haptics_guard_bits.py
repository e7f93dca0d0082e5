"""The guard in numba, in plain Python and in C gives the same numbers, bit for bit."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_library import compiled
from guarded import FREE

from tissueid.haptics import guard as machine
from tissueid.haptics.guard import guard, new_guard

REFERENCE = Path(__file__).resolve().parents[2] / "benchmarks" / "servo_reference.c"
TICKS = 4000
SHAKEN = replace(FREE, clamp_N=4.0, rms_limit_N=2.5, rms_window_s=0.5)

IN_PYTHON = """
import sys
import numpy as np
from test_haptics_guard_bits import walk
from tissueid.haptics.guard import guard
np.save(sys.argv[1], walk(guard, int(sys.argv[2])))
"""


def walk(step, seed: int) -> np.ndarray:
    """Everything the guard sent and remembers, over a session with stalls, releases, ramps and a fault."""
    rng = np.random.default_rng(seed)
    limits, memory = SHAKEN.block(), new_guard()
    memory[machine.STATE], memory[machine.READY] = machine.ARMED, 1.0
    force, out = np.zeros(3), np.zeros(3)
    seen = np.zeros((TICKS, 3 + memory.size))
    for k in range(TICKS):
        force += 0.6 * rng.standard_normal(3)
        memory[machine.VELOCITY : machine.VELOCITY + 3] = 0.2 * rng.standard_normal(3)
        if k % 900 == 600:
            memory[machine.PHASE] = machine.RELEASING
        if k == TICKS - 100:
            force[1] = np.nan
        dt = 1e-3 * (1.0 + 0.3 * rng.standard_normal()) if k % 401 else 0.04
        step(memory, limits, force, dt, out)
        seen[k, :3], seen[k, 3:] = out, memory
    return seen


def in_c(folder: Path):
    """The guard of the reference in C."""
    library = compiled(REFERENCE, folder, "-O2", "-ffp-contract=off")
    function = ctypes.CDLL(str(library)).reference_guard
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    function.argtypes = [array, array, array, ctypes.c_double, array]
    function.restype = None
    return function


def bits(values: np.ndarray) -> np.ndarray:
    return values.view(np.uint64)


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numba_and_c_agree_bit_for_bit(tmp_path, seed):
    ours, theirs = walk(guard, seed), walk(in_c(tmp_path), seed)
    assert np.array_equal(bits(ours), bits(theirs))
    # the session shows what it is to show: force, ramps, the sustained limit, a fault
    lamps = np.bitwise_or.reduce(ours[:, 3 + machine.LAMPS].astype(int))
    assert lamps & 0b1_0110_0011 == 0b1_0110_0011
    assert ours[-1, 3 + machine.STATE] == machine.FAULTED


@pytest.mark.needs_jit
def test_numba_and_plain_python_agree_bit_for_bit(tmp_path):
    there = tmp_path / "python.npy"
    subprocess.run(
        [sys.executable, "-c", IN_PYTHON, there, "4"],
        cwd=Path(__file__).parent, env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, check=True,
    )  # fmt: skip
    assert np.array_equal(bits(walk(guard, 4)), bits(np.load(there)))
