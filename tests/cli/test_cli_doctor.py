"""``tissueid doctor``."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_line import run

from tissueid import doctor
from tissueid.rendering import first_start
from tissueid.viewer import bundling

NAMES = [
    "tissueid", "machine", "libraries", "extras", "servo loop", "real time", "devices",
    "viewer page", "browser",
]  # fmt: skip


def test_every_check_is_told_with_what_to_do() -> None:
    ended = run("doctor", "--json")
    document = json.loads(ended.stdout)
    assert [check["name"] for check in document["checks"]] == NAMES
    assert ended.code == (7 if document["missing"] else 0), ended.stderr
    for check in document["checks"]:
        assert check["state"] in {"ok", "note", "missing"}
        assert check["words"]
    told = run("doctor").stdout
    for check in document["checks"]:
        assert check["name"] in told


def look(name: str) -> doctor.Check:
    return next(check for check in doctor.examine() if check.name == name)


def test_a_page_that_was_not_built_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundling, "BUNDLE", tmp_path)
    assert look("viewer page").state == "missing"
    (tmp_path / "index.html").touch()
    assert look("viewer page").state == "ok"


def test_a_loop_that_is_not_compiled_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_start, "is_compiled", lambda: False)
    check = look("servo loop")
    assert (check.state, check.way_out) == ("note", "tissueid doctor --warm")


def test_a_library_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        doctor, "requires", lambda _name: ["numpy>=1", "no-such-library>=2", "arviz; extra == 'arviz'"]
    )
    check = look("libraries")
    assert (check.state, check.way_out) == ("missing", "pip install no-such-library")


def test_asking_for_rights_changes_nothing_here() -> None:
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    assert look("real time").state in {"ok", "note"}
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


@pytest.mark.slow
def test_warming_leaves_nothing_to_compile() -> None:
    ended = run("doctor", "--warm", "--json")
    states = {check["name"]: check["state"] for check in json.loads(ended.stdout)["checks"]}
    assert states["servo loop"] == "ok"
