"""The guard and the force step in numba and in plain Python, and the guard in C, give the same bits.

The force step in C is tests/export's.
"""

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
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk

from tissueid.haptics import guard as machine
from tissueid.haptics.guard import guard, new_guard
from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block

pytestmark = pytest.mark.needs_jit

HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parents[1] / "benchmarks" / "servo_reference.c"
TICKS, SAMPLES, SEED = 4000, 1500, 4
SHAKEN = replace(FREE, clamp_N=4.0, rms_limit_N=2.5, rms_window_s=0.5)

IN_PYTHON = "import sys; import test_haptics_bits as here; here.save(sys.argv[1])"


def guarded(step, seed: int) -> np.ndarray:
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


def forces_of(tissue: Tissue) -> np.ndarray:
    """Forces on presses, releases faster than the tissue follows, in air, and beyond what was identified."""
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(2e-4, 3e-3, SAMPLES))
    depth = 4.0 * np.sin(9.0 * times) + 3.0 * np.sin(2.0 * times) + 2.5 * np.sin(40.0 * times)
    block = tissue_block(tissue, Plane(), force_scale=1.0, motion_scale=1.0)
    return walk(block, pressed(depth, motion=1.0), times)[1][:, 3]


def everything() -> dict[str, np.ndarray]:
    return {"guard": guarded(guard, SEED), **{one.name: forces_of(one) for one in (PAPER_A, TWO_BRANCHES)}}


def save(path: str) -> None:
    np.savez(path, **everything())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numba_and_c_agree_bit_for_bit(tmp_path, seed):
    library = compiled(REFERENCE, tmp_path, "-O2", "-ffp-contract=off")
    in_c = ctypes.CDLL(str(library)).reference_guard
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    in_c.argtypes, in_c.restype = [array, array, array, ctypes.c_double, array], None
    ours = guarded(guard, seed)
    assert ours.tobytes() == guarded(in_c, seed).tobytes()
    # the session shows what it is to show: force, ramps, the sustained limit, a fault
    lamps = np.bitwise_or.reduce(ours[:, 3 + machine.LAMPS].astype(int))
    assert lamps & 0b1_0110_0011 == 0b1_0110_0011
    assert ours[-1, 3 + machine.STATE] == machine.FAULTED


def test_numba_and_plain_python_agree_bit_for_bit(tmp_path):
    there = tmp_path / "python.npz"
    folders = [str(HERE), str(HERE.parent), os.environ.get("PYTHONPATH", "")]
    subprocess.run(
        [sys.executable, "-c", IN_PYTHON, there],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(folders)}, check=True,
    )  # fmt: skip
    found, plain = everything(), np.load(there)
    assert {name: plain[name].tobytes() for name in found} == {
        name: one.tobytes() for name, one in found.items()
    }
    for tissue in (PAPER_A, TWO_BRANCHES):
        assert (found[tissue.name] > 0.0).sum() > SAMPLES // 4
        assert (found[tissue.name] == 0.0).sum() > SAMPLES // 10
