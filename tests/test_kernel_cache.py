"""Compiled functions are those of the sources: an edit of a callee in another file is seen by its caller."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tissueid
from tissueid.compiled import kernel_sources, sources_key

PACKAGE = Path(tissueid.__file__).resolve().parent
#: A leaf of the force of a law, which stands in another file: F_s of a depth of 0.5 mm where it is 1 N/mm.
LEAF = "model/kernels.py"
ASK = (
    "import numpy as np; from tissueid.model.rupture import static_force_in; "
    "law = np.zeros(200); law[[0, 2, 5]] = 1.0; "
    "print(repr(float(static_force_in(law, 0, np.full(50, 0.5), 0))))"
)


def copied(folder: Path) -> Path:
    """The sources of all kernels, and what importing them takes, as a package of their own."""
    target = folder / "tissueid"
    shutil.copytree(PACKAGE, target, ignore=shutil.ignore_patterns("__pycache__", "static", "web", "*.html"))
    return target


def test_sources_hold_kernels_and_what_they_import() -> None:
    names = set(kernel_sources())
    assert {"compiled.py", "model/kernels.py", "model/rupture.py", "haptics/guard.py"} <= names
    assert {"rendering/servo_loop.py", "rendering/environment.py"} <= names
    assert not names & {"pipeline.py", "cli/main.py", "report/page.py", "population/chains.py"}


def test_the_key_follows_sources_and_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = copied(tmp_path)
    before = sources_key(package)
    assert sources_key(package) == before
    cli = package / "pipeline.py"
    cli.write_text(cli.read_text(encoding="utf-8") + "\n# a remark\n", encoding="utf-8")
    assert sources_key(package) == before
    leaf = package / LEAF
    leaf.write_text(leaf.read_text(encoding="utf-8") + "\n# a remark\n", encoding="utf-8")
    after = sources_key(package)
    assert after != before
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert sources_key(package) != after


def answer(root: Path) -> float:
    """The answer of the compiled caller, from a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(root / "cache")}
    done = subprocess.run(  # our own interpreter and code
        [sys.executable, "-c", ASK], env=environment, capture_output=True, text=True, check=True, cwd=root
    )
    return float(done.stdout)


@pytest.mark.system
@pytest.mark.needs_jit
def test_an_edited_leaf_is_seen_by_a_caller_that_was_compiled_before(tmp_path: Path) -> None:
    leaf = copied(tmp_path) / LEAF
    before = answer(tmp_path)
    assert answer(tmp_path) == before
    folders = {path.name for path in (tmp_path / "cache").iterdir()}
    assert len(folders) == 1
    # and the same where every coefficient counts twice
    assert before == pytest.approx(0.5, abs=1e-12)
    text, line = leaf.read_text(encoding="utf-8"), "value = value * inside + block[k]"
    assert line in text
    leaf.write_text(text.replace(line, line.replace("block", "2.0 * block")), encoding="utf-8")
    assert answer(tmp_path) == pytest.approx(1.0, abs=1e-12)
    assert {path.name for path in (tmp_path / "cache").iterdir()} > folders
