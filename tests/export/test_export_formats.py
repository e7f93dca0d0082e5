"""Exports, read back by the programs they are for."""

import ctypes
import io
import math
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import openpyxl
import pytest
from python_calamine import CalamineWorkbook
from rendered_tissues import PAPER_A, TWO_BRANCHES, bundle_of
from scipy.io import loadmat

from tissueid.errors import UsageError
from tissueid.export.c_header import c_header
from tissueid.export.matlab import mat_bytes
from tissueid.export.prony import abaqus_card, febio_card, linearised
from tissueid.model.base import ContactPath
from tissueid.model.grammar import rebuilt
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law
from tissueid.result import ModelChoice
from tissueid.store.bundle import Bundle
from tissueid.store.xlsx import Sheet, xlsx_bytes

RENDERED = (bundle_of(PAPER_A), bundle_of(TWO_BRANCHES))


@pytest.fixture(params=RENDERED, ids=lambda bundle: bundle.specimen)
def bundle(request: pytest.FixtureRequest) -> Bundle:
    return request.param


def of_law(name: str, theta: list[float], **nodes: tuple[float, ...]) -> Bundle:
    plain = bundle_of(PAPER_A)
    choice = ModelChoice(name, 1, 1, 0, "shared", name, (0.01, 10.0), **nodes)
    model = rebuilt(choice, plain.depth_mm)
    law = {"model": choice, "theta": np.array(theta), "theta_names": model.parameter_names}
    return replace(plain, **law, covariance=np.eye(len(theta)), draws=None)


#: Pieces and a projection; the static force inside; own curves and times outside.
OTHERS = (
    of_law("power * linear * fractional", [2.0, 1.6, 20.0, 3.0, 0.4, 0.5]),
    of_law("exponential * tangent * prony:2", [12.0, 0.15, 1.2, 0.1, 0.8, 2.0]),
    of_law(
        "yardstick",
        [10.0, 60.0, 70.0, 150.0, 3.0, 0.0, 9.0, 20.0, 30.0, 10.0, 0.0],
        inside_s=(0.3,),
        outside_s=(0.05,),
    ),
)


#: K is constant, and its relaxation ends: what is left of a long hold has no slope.
STRETCHED = of_law("power * stretched", [2.0, 1.6, 20.0, 0.4, 0.7])


def compiled(bundle: Bundle, folder: Path) -> ctypes.CDLL:
    """The exported step as a shared library."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (gcc or cc) to compile the exported header with")
    (folder / "tissue.h").write_bytes(c_header(bundle))
    name = re.search(r"(\w+)_step\(&t", c_header(bundle).decode()).group(1)  # type: ignore[union-attr]
    (folder / "tissue.c").write_text(
        f'#include "tissue.h"\n'
        f"void path(int n, const double *x, const double *h, double *f, double *y)\n"
        f"{{ {name}_tissue t = {{0}};\n"
        f"  for (int i = 0; i < n; i++) {{ f[i] = {name}_step(&t, x[i], h[i]); y[i] = t.surface_mm; }} }}\n"
    )
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    subprocess.run(
        [compiler, *strict, "-shared", "-fPIC", "-o", folder / "tissue.so", folder / "tissue.c", "-lm"],
        check=True,
    )
    return ctypes.CDLL(str(folder / "tissue.so"))


def rough_path(depth_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Into the tissue, out faster than it recovers, beyond what is claimed, into air; steps of any length."""
    chance = np.random.default_rng(20_261_122)
    turns = depth_mm * np.array([0.0, 0.9, 0.2, 0.6, 0.55, 1.3, -0.2, 0.4, 0.0, 0.8, -0.1, 0.3])
    x = np.interp(np.linspace(0.0, turns.size - 1.0, 6000), np.arange(turns.size), turns)
    return x + 1e-4 * chance.standard_normal(x.size), 10.0 ** chance.uniform(-4.5, -1.0, x.size)


@pytest.mark.parametrize(
    ("bundle", "most"), [(STRETCHED, 6), (STRETCHED, 12), (OTHERS[1], 6), (OTHERS[2], 6)]
)
def test_a_prony_series_of_another_law_says_its_error(bundle: Bundle, most: int) -> None:
    prony = linearised(bundle, 0.4 * bundle.depth_mm, most=most)
    time = np.geomspace(0.02, 10.0, 40)
    series = prony.long_term_N_per_mm + prony.branch_N_per_mm @ np.exp(-time / prony.tau_s[:, None])
    relaxing = prony.instantaneous_N_per_mm - prony.long_term_N_per_mm
    expected = small_step(bundle, prony.depth_mm, time)
    assert series == pytest.approx(expected, abs=1.2 * prony.error * relaxing + 3e-3 * expected.max())
    assert ("terms, at most" in abaqus_card(prony).decode()) == (prony.error > 0.0)
    assert prony.tau_s.size <= most


@pytest.mark.needs_jit
@pytest.mark.parametrize(
    "bundle", [*RENDERED, *OTHERS], ids=lambda one: one.specimen + (one.model.name or "")
)
def test_the_compiled_step_is_ours_bit_for_bit(bundle: Bundle, tmp_path: Path) -> None:
    words = c_header(bundle).decode()
    assert f"law        {bundle.model.name or bundle.model.key}" in words
    assert ("% of a sudden push" in words) == (bundle is OTHERS[0])
    x, h = rough_path(bundle.depth_mm)
    force, surface = np.empty_like(x), np.empty_like(x)
    pointers = [values.ctypes.data_as(ctypes.c_void_p) for values in (x, h, force, surface)]
    compiled(bundle, tmp_path).path(x.size, *pointers)

    law, state = servo_law(bundle.contact_model(), bundle.theta).packed(), np.zeros(STATE_SIZE)
    expected = np.array(
        [(tissue_step_in(law, 0, state, 0, *step), state[0]) for step in zip(x, h, strict=True)]
    )
    assert force.tobytes() == expected[:, 0].tobytes()
    assert surface.tobytes() == expected[:, 1].tobytes()
    # the path was worth it: contact was lost, and the claimed depth was left
    assert (surface > np.maximum(x, 0.0)).any()
    assert (x > bundle.depth_mm).any()


def test_a_name_or_comment_of_a_specimen_cannot_break_the_header(tmp_path: Path) -> None:
    odd = replace(bundle_of(PAPER_A), specimen="3 */ int main(void){} /* K\u00f6nig\n")
    text = c_header(odd).decode("ascii")
    assert "tissue_3_int_main_void_k_nig_step" in text
    assert text.count("*/") == text.count("/*")
    assert compiled(odd, tmp_path).path is not None


def test_matlab_s_file_holds_every_number(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "tissues.mat"
    strain = {"length": "1", "force": "MPa", "time": "s"}
    path.write_bytes(mat_bytes([bundle, replace(bundle, specimen="other", units=strain)]))
    found = loadmat(str(path), squeeze_me=True)["tissueid"]
    assert [str(one["specimen"]) for one in found] == [bundle.specimen, "other"]
    assert [(one["length_unit"], one["force_unit"]) for one in found] == [("mm", "N"), ("1", "MPa")]
    one = found[0]
    np.testing.assert_array_equal(one["theta"], bundle.theta)
    np.testing.assert_array_equal(one["covariance"], bundle.covariance)
    assert [str(name) for name in one["theta_names"]] == list(bundle.theta_names)
    assert float(one["depth_mm"]) == bundle.depth_mm
    values = {str(row["name"]): float(row["value"]) for row in np.atleast_1d(one["parameters"])}
    assert values == {
        entry.name: np.nan if entry.value is None else entry.value for entry in bundle.parameters
    }


def small_step(bundle: Bundle, depth_mm: float, time_s: np.ndarray) -> np.ndarray:
    """Force per mm after a step of 1 um about a depth that was held for long, by the model."""
    step, before = 1e-3, 1e4
    path = ContactPath(
        np.concatenate([[0.0, 1.0, before, before], before + time_s]),
        np.concatenate([[0.0, depth_mm, depth_mm, depth_mm + step], np.full(time_s.size, depth_mm + step)]),
    )
    force = bundle.contact_model().force(bundle.theta, path)
    return (force[4:] - force[2]) / step


@pytest.mark.parametrize("form", ["abaqus", "febio"])
def test_a_prony_series_relaxes_as_the_model_does_after_a_small_step(bundle: Bundle, form: str) -> None:
    prony = linearised(bundle, 0.4 * bundle.depth_mm)
    time = np.geomspace(1e-4, 10.0, 40)
    if form == "abaqus":
        lines = abaqus_card(prony).decode("ascii").splitlines()
        rows = [
            [float(cell) for cell in line.split(",")]
            for line in lines[lines.index("*VISCOELASTIC, TIME=PRONY") + 1 :]
        ]
        share = 1.0 - sum(g for g, _, _ in rows) + sum(g * np.exp(-time / tau) for g, _, tau in rows)
        series = prony.instantaneous_N_per_mm * share
    else:
        root = ET.fromstring(febio_card(prony))
        terms = [
            (float(root.findtext(f"g{k}") or "nan"), float(root.findtext(f"t{k}") or "nan"))
            for k in range(1, 7)
        ]
        series = prony.long_term_N_per_mm * (1.0 + sum(g * np.exp(-time / tau) for g, tau in terms))
    # linear in the step up to the curvature over 1 um
    assert series == pytest.approx(small_step(bundle, prony.depth_mm, time), rel=2e-3)


def test_what_no_series_can_say_is_refused() -> None:
    bundle = bundle_of(PAPER_A)
    with pytest.raises(UsageError, match="outside what is claimed"):
        linearised(bundle, 2.0 * bundle.depth_mm)
    theta = bundle.theta.copy()
    # falls between 3 and 5 mm and stays above zero
    theta[:3] = 45.0, -12.0, 1.0
    falling = replace(bundle, theta=theta)
    with pytest.raises(UsageError, match="does not rise"):
        linearised(falling, 4.0)


ROWS = [
    ["liver <1> & 'co'", 0.1, True, None],
    ["=1+1", 1.25e-300, False, math.nan],
    ["a\nb\x07\u202e\uffff", -7, "", math.inf],
    ["  äöü µ  ", 5_000_000.25, "x" * 40_000, 0],
]


def test_two_readers_find_every_cell():
    raw = xlsx_bytes([Sheet("numbers", ("name", "value", "known", "rest"), ROWS)])
    (head, *rows) = openpyxl.load_workbook(io.BytesIO(raw)).active.iter_rows()
    assert [cell.value for cell in head] == ["name", "value", "known", "rest"]
    assert all(cell.font.bold for cell in head)
    assert [row[1].value for row in rows] == [0.1, 1.25e-300, -7, 5_000_000.25]
    assert [row[2].value for row in rows[:2]] == [True, False]
    assert [row[3].value for row in rows] == [None, None, None, 0]
    # text that begins with a sign of equality is no formula, and control characters are spelt out
    assert (rows[1][0].value, rows[1][0].data_type) == ("=1+1", "s")
    assert rows[0][0].value == "liver <1> & 'co'"
    assert rows[2][0].value == "a\\nb\\x07\\u202e"
    assert rows[3][0].value == "  äöü µ  "
    assert len(rows[3][2].value) == 32_767
    again = CalamineWorkbook.from_filelike(io.BytesIO(raw)).get_sheet_by_index(0).to_python()
    assert [row[1] for row in again[1:]] == [0.1, 1.25e-300, -7, 5_000_000.25]


def test_names_of_sheets_are_cut_cleaned_and_told_apart():
    wanted = ["a/b:c", "A b c", "x" * 40, "x" * 50, "", "'"]
    raw = xlsx_bytes([Sheet(name, ("h",), []) for name in wanted])
    names = openpyxl.load_workbook(io.BytesIO(raw)).sheetnames
    assert names == ["a b c", "A b c 2", "x" * 31, "x" * 29 + " 2", "Sheet", "Sheet 2"]


def test_equal_tables_give_equal_bytes_and_every_part_is_well_formed():
    sheets = [Sheet("one", ("a",), [[1.0]]), Sheet("two", ("b",), [["x"]])]
    raw = xlsx_bytes(sheets)
    assert raw == xlsx_bytes(sheets)
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for name in archive.namelist():
            ET.fromstring(archive.read(name))
    with pytest.raises(ValueError, match="needs a sheet"):
        xlsx_bytes([])
