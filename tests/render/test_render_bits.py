"""The force step in numba and in plain Python gives the same numbers, bit for bit; C is tests/export's."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk

from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block

PYTHON = """
import json, sys
from rendered_tissues import PAPER_A, TWO_BRANCHES
from test_render_bits import forces_of
tissue = {"paper-a": PAPER_A, "two branches": TWO_BRANCHES}[sys.argv[1]]
print(json.dumps(forces_of(tissue).tolist()))
"""
SAMPLES = 1500


def forces_of(tissue: Tissue) -> np.ndarray:
    """Forces on presses, releases faster than the tissue follows, in air, and beyond what was identified."""
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(2e-4, 3e-3, SAMPLES))
    depth = 4.0 * np.sin(9.0 * times) + 3.0 * np.sin(2.0 * times) + 2.5 * np.sin(40.0 * times)
    block = tissue_block(tissue, Plane(), force_scale=1.0, motion_scale=1.0)
    return walk(block, pressed(depth, motion=1.0), times)[1][:, 3]


@pytest.mark.needs_jit
@pytest.mark.parametrize("tissue", [PAPER_A, TWO_BRANCHES], ids=lambda one: one.name)
def test_numba_and_python_agree_bit_for_bit(tissue: Tissue) -> None:
    numba_force = forces_of(tissue)
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    shown = subprocess.run(
        [sys.executable, "-c", PYTHON, tissue.name],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(folders)},
        check=True,
        capture_output=True,
        text=True,
    )
    python_force = np.array(json.loads(shown.stdout))
    assert (numba_force > 0.0).sum() > SAMPLES // 4
    assert (numba_force == 0.0).sum() > SAMPLES // 10
    assert python_force.tobytes() == numba_force.tobytes()
