"""Sets on disk: bytes, dialects, hashes, the committed sets."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import UsageError
from tissueid.synth import DIALECTS, Hold, Log, Move, Recipe, load_recipe, recipe, simulate, write_set

COMMITTED = Path(__file__).parents[2] / "datasets_synthetic"
SMALL = Recipe(
    "small", (Log("hold", (Move(50.0, 6000.0), Hold(0.5))),), rate_Hz=100.0, static=(60.0,), sigma_N=2.0
)


def parsed(data: bytes, dialect) -> np.ndarray:
    """Numbers of an export by the plainest reading of its grammar."""
    lines = data.decode(dialect.encoding).split(dialect.newline)
    names = lines.index(dialect.delimiter.join(dialect.names))
    rows = []
    for line in lines[names + 2 : -1]:
        cells = re.findall(r'"([^"]*)"', line) if dialect.quoted else line.split(dialect.delimiter)
        plain = (cell.replace(dialect.thousands, "") if dialect.thousands else cell for cell in cells)
        rows.append([float(cell.replace(dialect.decimal, ".")) for cell in plain])
    return np.array(rows)


def is_plain(dialect) -> bool:
    """Names, units and rows of the three channels in their order, with nothing above, below or between."""
    shape = (dialect.order, dialect.columns, dialect.results, dialect.wrapped, dialect.unit_in_names)
    return shape == ((0, 1, 2), (), "", False, False) and dialect.units_row and not dialect.lead + dialect.end


@pytest.mark.parametrize("name", sorted(name for name, dialect in DIALECTS.items() if is_plain(dialect)))
def test_each_dialect_prints_the_simulated_numbers(tmp_path, name):
    write_set(SMALL, tmp_path, seed=4, dialect=name)
    log = simulate(SMALL, rng=np.random.default_rng(4))[0]
    expected = np.column_stack([log.time_s, log.displacement_mm, log.force_N])
    data = (tmp_path / "hold-1.csv").read_bytes()
    # five decimals are printed
    np.testing.assert_allclose(parsed(data, DIALECTS[name]), expected, atol=0.5e-5 * (1 + 1e-6))
    if DIALECTS[name].thousands:
        assert f'"3{DIALECTS[name].thousands}0'.encode(DIALECTS[name].encoding) in data


def test_bare_export_reads_as_documented(tmp_path):
    write_set(SMALL, tmp_path, seed=4)
    lines = (tmp_path / "hold-1.csv").read_bytes().split(b"\r\n")
    assert lines[0] == b'Text Inputs : Specimen label,"synthetic"'
    assert lines[2] == b'Test : Rate 1,"6000.00000",mm/min'
    assert lines[3:6] == [b"", b"Time,Extension,Load", b"(sec),(mm),(N)"]
    assert lines[6].startswith(b"0.00000,0.00000,")
    assert lines[-1] == b""


def test_set_holds_its_hashes_truth_and_recipe(tmp_path):
    written = write_set(replace(SMALL, cv_both=0.1), tmp_path, seed=4)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written}
    sums = dict(reversed(line.split("  ")) for line in (tmp_path / "SHA256SUMS").read_text().splitlines())
    assert set(sums) == {"hold-1.csv", "recipe.toml", "truth.json"}
    for name, digest in sums.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
    assert load_recipe(tmp_path / "recipe.toml") == replace(SMALL, cv_both=0.1)
    truth = json.loads((tmp_path / "truth.json").read_text())
    log = simulate(replace(SMALL, cv_both=0.1), rng=np.random.default_rng(4))[0]
    assert truth["logs"][0]["gain"] == pytest.approx(log.truth["gain"], rel=1e-11)
    assert truth["seed"] == 4


def test_writing_again_gives_the_same_bytes_and_leaves_nothing_temporary(tmp_path):
    first = {path.name: path.read_bytes() for path in write_set(SMALL, tmp_path, seed=4)}
    second = {path.name: path.read_bytes() for path in write_set(SMALL, tmp_path, seed=4)}
    assert first == second
    assert sorted(first) == sorted(path.name for path in tmp_path.iterdir())


def test_a_directory_with_something_else_in_it_is_refused_and_kept(tmp_path):
    (tmp_path / "mine.csv").write_text("1,2,3")
    with pytest.raises(UsageError, match=r"mine\.csv"):
        write_set(SMALL, tmp_path, seed=4)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.csv"]


def test_unknown_dialect_is_refused(tmp_path):
    with pytest.raises(UsageError, match="semicolon"):
        write_set(SMALL, tmp_path, seed=4, dialect="klingon")


@pytest.mark.parametrize("name", ["paper-a-22-250Hz", "paper-a-30-10Hz", "paper-a-hold-100Hz", "rupture-18"])
def test_committed_set_is_what_the_generator_writes(tmp_path, name):
    truth = json.loads((COMMITTED / name / "truth.json").read_text())
    write_set(recipe(name), tmp_path, seed=truth["seed"], dialect=truth["dialect"])
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        path.name for path in (COMMITTED / name).iterdir()
    )
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (COMMITTED / name / path.name).read_bytes(), path.name
