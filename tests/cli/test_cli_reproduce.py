"""``tissueid reproduce``."""

from __future__ import annotations

import pytest
from command_line import read_json, run

from tissueid.store.schema import check


@pytest.mark.needs_jit
def test_both_papers_are_recomputed_and_written(tmp_path):
    run("reproduce", "all", "-o", tmp_path / "out", "-q", "--set", "stiffness=linear", code=0)
    document = read_json(tmp_path / "out" / "reproduction.json")
    check(document, "reproduction", where="reproduction.json")
    rows = {one["item"]: one for one in document["items"]}
    assert (rows["table-3/1"]["kind"], rows["table-3/1"]["recomputed"]) == ("given", None)
    for name in ("table-2/stiffness", "table-2/tau"):
        assert rows[name]["agrees"], rows[name]


def test_a_paper_is_recomputed_and_written(tmp_path):
    asked = ("--json", "--set", "surface=cone")
    document = run("reproduce", "pires", "-o", tmp_path / "out", *asked, code=0).json("reproduction")
    assert document == read_json(tmp_path / "out" / "reproduction.json")
    assert document["readings"]["surface"]["choice"] == "cone"
    assert [paper["name"] for paper in document["papers"]] == ["pires"]
    assert "recomputed" in (tmp_path / "out" / "reproduction.html").read_text(encoding="utf-8")
