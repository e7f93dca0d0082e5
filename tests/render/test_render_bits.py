"""The force step in numba, in plain Python and in C gives the same numbers, bit for bit."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk

from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block

#: The law written a second time: exact recursion, Horner's scheme, bracketed Newton where the tool leaves.
C_SOURCE = r"""
#include <math.h>
static void continued(const double *c, int n, double x, double depth, double *value, double *slope) {
    double inside = x > 0.0 ? x : 0.0;
    if (inside > depth) inside = depth;
    *value = 0.0; *slope = 0.0;
    for (int k = n - 1; k >= 0; k--) { *slope = *slope * inside + *value; *value = *value * inside + c[k]; }
    if (x > depth) { if (*slope < 0.0) *slope = 0.0; *value += *slope * (x - depth); }
}
static double following(const double *fs, const double *ks, int n, double depth, double from,
                        const double *decayed, const double *gain, double y, double *slope) {
    double force, moved = y - from;
    continued(fs, 4, y, depth, &force, slope);
    for (int j = 0; j < n; j++) {
        double k, dk, s = decayed[j] + gain[j] * moved;
        continued(ks + 3 * j, 3, y, depth, &k, &dk);
        force += k * s; *slope += dk * s + k * gain[j];
    }
    return force;
}
void tissueid_test_walk(const double *fs, const double *ks, const double *tau, int n, double depth,
                        const double *x, const double *h, int count, double *out) {
    double s[3] = {0, 0, 0}, d[3], g[3], surface = 0.0;
    for (int i = 0; i < count; i++) {
        double slope, y = x[i] > 0.0 ? x[i] : 0.0, target = y;
        for (int j = 0; j < n; j++) {
            double r = h[i] / tau[j];
            double a = r > 0.0 ? exp(-r) : 1.0;
            g[j] = r > 0.0 ? -expm1(-r) / r : 1.0;
            d[j] = a * s[j];
        }
        double force = following(fs, ks, n, depth, surface, d, g, target, &slope);
        if (force < 0.0) {
            double low = target, high = surface > target ? surface : target, width = 1e-3 * depth;
            double f = following(fs, ks, n, depth, surface, d, g, high, &slope);
            for (int k = 0; k < 60 && f < 0.0; k++) {
                low = high; high += width; width *= 2.0;
                f = following(fs, ks, n, depth, surface, d, g, high, &slope);
            }
            y = high;
            for (int k = 0; k < 60; k++) {
                if (fabs(f) <= 1e-14 * depth * slope || high - low <= 1e-14 * depth) break;
                if (f > 0.0) high = y; else low = y;
                double c = slope > 0.0 ? y - f / slope : low;
                if (!(low < c && c < high)) c = 0.5 * (low + high);
                y = c;
                f = following(fs, ks, n, depth, surface, d, g, y, &slope);
            }
        }
        for (int j = 0; j < n; j++) {
            s[j] = d[j] + g[j] * (y - surface);
            if (!(fabs(s[j]) >= 1e-200)) s[j] = 0.0;
        }
        surface = y;
        out[i] = x[i] >= 0.0 && force > 0.0 ? force : 0.0;
    }
}
"""
PYTHON = """
import json, sys
import numpy as np
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk
from test_render_bits import path_of
from tissueid.rendering.tissue_block import Plane, tissue_block
tissue = {"paper-a": PAPER_A, "two branches": TWO_BRANCHES}[sys.argv[1]]
times, depth = path_of()
block = tissue_block(tissue, Plane(), force_scale=1.0, motion_scale=1.0)
print(json.dumps(walk(block, pressed(depth, motion=1.0), times)[1][:, 3].tolist()))
"""
SAMPLES = 1500


def path_of() -> tuple[np.ndarray, np.ndarray]:
    """Presses, releases faster than the tissue follows, air, and depths beyond what was identified."""
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(2e-4, 3e-3, SAMPLES))
    depth = 4.0 * np.sin(9.0 * times) + 3.0 * np.sin(2.0 * times) + 2.5 * np.sin(40.0 * times)
    return times, depth


def compiled_C(folder: Path) -> ctypes.CDLL:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    (folder / "law.c").write_text(C_SOURCE)
    library = folder / "law.so"
    command = [compiler, "-O2", "-ffp-contract=off", "-shared", "-fPIC", "law.c", "-o", str(library), "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(library))


@pytest.mark.needs_jit
@pytest.mark.parametrize("tissue", [PAPER_A, TWO_BRANCHES], ids=lambda one: one.name)
def test_numba_python_and_C_agree_bit_for_bit(tissue: Tissue, tmp_path: Path) -> None:
    times, depth = path_of()
    block = tissue_block(tissue, Plane(), force_scale=1.0, motion_scale=1.0)
    _, infos = walk(block, pressed(depth, motion=1.0), times)
    numba_force = infos[:, 3]
    # the depths as the environment computed them, so that only the law is compared
    x, h = infos[:, 1].copy(), np.concatenate([[0.001], np.diff(times)])
    static, stiffness, tau = tissue.model.split(tissue.theta)
    padded = np.zeros((3, 3))
    padded[: tau.size, : stiffness.shape[1]] = stiffness
    fs, c_force = np.concatenate([[0.0], static]), np.zeros(SAMPLES)
    double = ctypes.POINTER(ctypes.c_double)
    compiled_C(tmp_path).tissueid_test_walk(
        *(array.ctypes.data_as(double) for array in (fs, padded, np.array(tau))),
        ctypes.c_int(tau.size),
        ctypes.c_double(tissue.model.depth_mm),
        x.ctypes.data_as(double),
        h.ctypes.data_as(double),
        ctypes.c_int(SAMPLES),
        c_force.ctypes.data_as(double),
    )
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
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
    assert c_force.tobytes() == numba_force.tobytes()
    assert python_force.tobytes() == numba_force.tobytes()
