"""The compiler refuses what a tick must not do; the guard in numba, in C and in Python gives the same bits.

So does the force step in numba and in Python; that in C is tests/export's.
"""

from __future__ import annotations

import ctypes
import os
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from command_line import PACKAGES, REPOSITORY, python
from guarded import FREE
from numba.core.errors import NumbaError
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk

from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics import guard as machine
from tissueid.haptics.guard import guard, new_guard
from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block

KINDS = pytest.mark.parametrize("compiled", [tick_kernel, tick_part])


def allocates(values):
    return np.zeros(3)[0] + values[0]


def doubles_in_place(values):
    for i in range(values.size):
        values[i] *= 2.0
    return values[values.size - 1]


@pytest.mark.needs_jit
@KINDS
def test_a_function_that_allocates_is_not_compiled(compiled):
    # nothing else is wrong with it
    assert numba.njit(allocates)(np.ones(3)) == 1.0
    with pytest.raises(NumbaError, match="zeros"):
        compiled(allocates)(np.ones(3))


@KINDS
def test_a_function_works_on_the_array_of_its_caller(compiled):
    values = np.array([1.0, 2.0, 4.0])
    assert compiled(doubles_in_place)(values[1:]) == 8.0
    assert values.tolist() == [1.0, 4.0, 8.0]


def test_scipy_is_out_of_reach_only_while_numba_sets_itself_up():
    program = (
        "import importlib.util, sys\n"
        "from tissueid.compiled import without_scipy\n"
        "from tissueid.haptics.guard import new_guard, transition\n"
        "from tissueid.haptics.guard import SHUT\n"
        "from tissueid.haptics.limits import GuardLimits\n"
        "with without_scipy():\n"
        "    transition(new_guard(), GuardLimits().block(), SHUT)\n"
        "print([name for name in sys.modules if name.startswith('scipy.linalg')])\n"
        "import scipy.linalg\n"
        "with without_scipy():\n"
        "    print(sys.modules['scipy.linalg'] is scipy.linalg)\n"
    )
    assert python("-c", program).stdout == "[]\nTrue\n"


HERE = Path(__file__).resolve().parent
REFERENCE = REPOSITORY / "benchmarks" / "servo_reference.c"
TICKS, SAMPLES, SEED = 4000, 1500, 4
SHAKEN = replace(FREE, clamp_N=4.0, rms_limit_N=2.5, rms_window_s=0.5)

IN_PYTHON = "import sys; import test_haptics_compiled as here; here.save(sys.argv[1])"


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


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numba_and_c_agree_bit_for_bit(tmp_path, c_library, seed):
    library = c_library(REFERENCE, tmp_path, "-O2", "-ffp-contract=off")
    reference = ctypes.CDLL(str(library)).reference_guard
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    reference.argtypes, reference.restype = [array, array, array, ctypes.c_double, array], None
    ours = guarded(guard, seed)
    assert ours.tobytes() == guarded(reference, seed).tobytes()
    # the session shows what it is to show: force, ramps, the sustained limit, a fault
    lamps = np.bitwise_or.reduce(ours[:, 3 + machine.LAMPS].astype(int))
    assert lamps & 0b1_0110_0011 == 0b1_0110_0011
    assert ours[-1, 3 + machine.STATE] == machine.FAULTED


@pytest.mark.needs_jit
def test_numba_and_plain_python_agree_bit_for_bit(tmp_path):
    there = tmp_path / "python.npz"
    folders = os.pathsep.join(map(str, (HERE, HERE.parent, PACKAGES)))
    python("-c", IN_PYTHON, there, NUMBA_DISABLE_JIT="1", PYTHONPATH=folders)
    found, plain = everything(), np.load(there)
    assert {name: plain[name].tobytes() for name in found} == {
        name: one.tobytes() for name, one in found.items()
    }
    for tissue in (PAPER_A, TWO_BRANCHES):
        assert (found[tissue.name] > 0.0).sum() > SAMPLES // 4
        assert (found[tissue.name] == 0.0).sum() > SAMPLES // 10
