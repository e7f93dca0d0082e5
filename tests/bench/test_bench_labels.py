"""What ``inspect --json`` says of real recordings, held against hand-made labels by their own script."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import sys
from collections import Counter
from pathlib import Path

import pytest

from tissueid.cli.main import main

KINDS = ("right", "near", "wrong", "absent")


def inspected(path: Path) -> str:
    """What the command prints of one file; a refusal is a document as well."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        main(["inspect", str(path), "--json"])
    return said.getvalue()


def told(shared_data: Path, out: Path) -> str:
    """The script's table and its list of what is wrong, of every labelled file."""
    labels = shared_data / "bench.json"
    keys = json.loads(labels.read_text(encoding="utf-8"))
    for number, name in enumerate(sorted({key.partition("#")[0] for key in keys})):
        (out / f"{number}.json").write_text(inspected(shared_data / name), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("bench_check", shared_data / "bench_check.py")
    script = importlib.util.module_from_spec(spec)
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        # nothing is written beside the recordings
        patch.setattr(sys, "dont_write_bytecode", True)
        spec.loader.exec_module(script)
        patch.setattr(sys, "argv", ["bench_check", str(labels), str(out)])
        script.main()
    return said.getvalue()


def table(text: str) -> dict[str, Counter[str]]:
    """Rows of the table: how many labels of a kind were met, and how."""
    found = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 2 + len(KINDS) and cells[1].isdigit():
            found[cells[0].strip("*")] = Counter(dict(zip(KINDS, map(int, cells[2:]), strict=True)))
    return found


def share(counts: Counter[str], kind: str = "right") -> float:
    return counts[kind] / counts.total()


# the script leaves its files to be closed by the collector
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_recordings_are_read_and_divided_as_their_labels_say(shared_data: Path, tmp_path: Path) -> None:
    text = told(shared_data, tmp_path)
    rows = table(text)
    assert rows["all"].total() >= 500, text
    assert share(rows["all"], "wrong") <= 0.01, text
    for kind in ("load ramp end", "load speed", "hold start"):
        assert share(rows[kind]) >= 0.95, text
    contact = sum((counts for kind, counts in rows.items() if kind.startswith("contact ")), Counter())
    assert share(contact) >= 0.95, text
    assert rows["no rupture claimed"]["wrong"] == 0, text
    assert share(rows["read without help"]) >= 0.93, text
