"""Readers of other distributions: the worked example of docs/readers.md, and readers that break."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from ingest_files import put, read, refusal

from tissueid.errors import UsageError
from tissueid.ingest import ReadOptions, forget_readers, match_of, reader_faults

DOCUMENT = Path(__file__).parents[2] / "docs" / "readers.md"
LOG = "INDENTO 1\nsample=A 7\nspeed=0.5\nms um mN\n0 0 0.5\n10 5 2.5\n20 10 6.5\n"
BARE = "Time,Extension,Load\n(s),(mm),(N)\n0.0,0.0,0.1\n0.1,0.5,0.2\n0.2,1.0,0.4\n"


def example() -> str:
    """The module printed in the document: what is documented is what is tested."""
    (code,) = re.findall(r"```python\n(# indento\.py\n.*?)```", DOCUMENT.read_text(), re.DOTALL)
    return str(code)


def install(folder: Path, name: str, module: str) -> None:
    """A distribution as an installer leaves it: a module, and its metadata with the entry point."""
    (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[tissueid.readers]\n{name} = {name}:RECIPE\n")
    forget_readers()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    before = set(sys.modules)
    forget_readers()
    yield folder
    forget_readers()
    for name in set(sys.modules) - before:
        if (folder / f"{name}.py").exists():
            del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return put(tmp_path / "synthetic.indento", LOG)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    return put(tmp_path / "synthetic.csv", BARE)


def test_the_worked_example_reads_a_file_that_nothing_else_knows(site: Path, log: Path) -> None:
    refusal(log)
    install(site, "indento", example())
    trial = read(log)
    assert trial.time_s.tolist() == [0.0, 0.01, 0.02]
    assert trial.displacement_mm.tolist() == [0.0, 0.005, 0.01]
    # parse, factor, product: a rounding each
    assert trial.force_N.tolist() == pytest.approx([0.0005, 0.0025, 0.0065], rel=5e-16)
    assert trial.specimen == "A 7"
    assert trial.protocol.speed_mm_s == 0.5
    assert (trial.source.recipe, trial.source.recipe_reason) == ("indento", "the file begins INDENTO")
    assert reader_faults() == ()
    assert match_of(log, ReadOptions(recipe="indento")).recipe.key == "indento"
    with pytest.raises(UsageError, match="indento"):
        match_of(log, ReadOptions(recipe="other"))
    log.write_text(LOG.replace("10 5 2.5", "10 5,5 2.5"))
    error = refusal(log)
    assert (error.code, error.line, error.column) == ("inconsistent_decimal", 6, 2)


TAKES_OUR_KEY = """
from tissueid.ingest import Recipe
RECIPE = Recipe('bluehill-csv', 'x', lambda file: (1.0, 'mine'), lambda file: iter(()))
"""
BROKEN = {
    "does not import": ("import no_such_module_anywhere\n", "ModuleNotFoundError"),
    "is no Python": ("def (:\n", "SyntaxError"),
    "has no such object": ("OTHER = 1\n", "AttributeError"),
    "is no recipe": ("RECIPE = 'mine'\n", "TypeError"),
    "raises what it likes": ("raise RuntimeError('today not')\n", "today not"),
    "takes a key of ours": (TAKES_OUR_KEY, "taken"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_reader_that_cannot_be_loaded_is_named_and_stops_nobody(site: Path, bare: Path, name: str) -> None:
    module, word = BROKEN[name]
    install(site, "broken_reader", module)
    trial = read(bare)
    assert trial.source.recipe == "bluehill-csv"
    (fault,) = reader_faults()
    assert "broken_reader" in fault
    assert word in fault


def test_a_reader_that_breaks_while_it_looks_is_out_for_that_file(site: Path, bare: Path) -> None:
    module = (
        "from tissueid.ingest import Recipe\n"
        "def detect(file):\n    raise KeyError('gone')\n"
        "RECIPE = Recipe('breaks', 'x', detect, lambda file: iter(()))\n"
    )
    install(site, "breaking", module)
    trial = read(bare)
    assert trial.source.recipe == "bluehill-csv"
    (fault,) = reader_faults()
    assert "'breaks'" in fault
    assert str(bare) in fault


@pytest.mark.parametrize(
    "body",
    [
        "raise ZeroDivisionError('oh')",
        "yield 'no table'",
        "yield Table(np.array([0.0, 1.0]), np.array([0.0]), np.array([1.0, 2.0]), NAMES)",
        "yield Table(np.array([1.0, 0.0]), np.zeros(2), np.zeros(2), NAMES)",
        "yield Table(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2), {'time': 't'})",
    ],
)
def test_a_reader_that_breaks_while_it_reads_is_a_refusal_of_that_file(site, bare, tmp_path, body) -> None:
    module = (
        "import numpy as np\nfrom tissueid.ingest import Recipe, Table\n"
        "NAMES = dict.fromkeys(('time', 'displacement', 'force'), 'a')\n"
        "def detect(file):\n"
        "    return (1.0, 'mine') if file.path.endswith('mine.csv') else (0.0, 'not mine')\n"
        f"def read(file):\n    {body}\n    yield from ()\n"
        "RECIPE = Recipe('breaks', 'x', detect, read)\n"
    )
    install(site, "breaking", module)
    error = refusal(put(tmp_path / "mine.csv", BARE))
    assert error.code == "reader_failed"
    assert "'breaks'" in error.message
    assert "--recipe" in error.message
    read(bare)
