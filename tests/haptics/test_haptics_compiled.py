"""The compiler refuses what a tick must not do."""

from __future__ import annotations

import subprocess
import sys

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from tissueid.compiled import tick_kernel, tick_part

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
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stdout == "[]\nTrue\n"
