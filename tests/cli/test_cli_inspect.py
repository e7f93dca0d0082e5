"""What ``inspect`` prints and writes, with and without a study."""

from __future__ import annotations

import re
import tomllib
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from command_line import Ended, run, write_log

from tissueid.store.schema import first_problem


def page_entries(page: Path) -> list[dict[str, Any]]:
    texts = re.findall(r"<textarea[^>]*>(.*?)</textarea>", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [table[0] for text in texts for table in tomllib.loads(unescape(text)).values()]


def test_text_gives_speeds_in_both_units_and_the_stop(tmp_path: Path) -> None:
    text = run("inspect", write_log(tmp_path / "log.csv"), "-v").stdout
    (ramp,) = re.findall(r"ramp +\S+ to \S+ s, (\S+) mm/s \((\S+) mm/min\)", text)
    # the log's ramp goes 8 mm at 250 mm/min: 48 samples, its ends known to one
    assert float(ramp[1]) == pytest.approx(250.0, rel=0.03)
    assert float(ramp[0]) == pytest.approx(float(ramp[1]) / 60.0, rel=1e-3)
    (stop,) = re.findall(r"stop +at (\S+) s", text)
    assert float(stop) == pytest.approx(8.0 / (250.0 / 60.0), abs=0.05)
    assert "read as bluehill-csv" in text
    assert "because " in text


def test_page_and_json_of_one_run_agree(tmp_path: Path) -> None:
    write_log(tmp_path / "data" / "one log.csv")
    page = tmp_path / "out.html"
    ended = run("inspect", tmp_path / "data", "--html", page, "--json")
    assert ended.code == 0
    (document,) = ended.json()
    assert first_problem([document], "inspect") is None
    assert "wrote " in ended.stderr
    html = page.read_text(encoding="utf-8")
    assert f"{document['n_samples']:,} samples" in html
    assert document["recipe_reason"] in unescape(html)


def test_entries_name_files_as_seen_from_the_folder_of_the_study(tmp_path: Path) -> None:
    write_log(tmp_path / "data" / "pig 1" / "läuft [3].csv")
    page = tmp_path / "out.html"
    run("inspect", tmp_path / "data", "--html", page, "-q")
    assert {entry["file"] for entry in page_entries(page)} == {"pig 1/läuft [3].csv"}
    # a study above the folder is the one that is meant
    (tmp_path / "study.toml").write_text('schema = "tissueid/study/1"\n', encoding="utf-8")
    run("inspect", tmp_path / "data" / "pig 1", "--html", page, "-q")
    assert {entry["file"] for entry in page_entries(page)} == {"data/pig 1/läuft [3].csv"}


def inspected(*args: str | Path) -> dict[str, Any]:
    ended: Ended = run("inspect", *args, "--json")
    assert ended.code == 0, ended.stderr
    (document,) = ended.json()
    return dict(document)


def test_the_study_of_the_folder_is_followed_unless_it_is_left_aside(tmp_path: Path) -> None:
    write_log(tmp_path / "läuft [3].csv")
    (tmp_path / "study.toml").write_text(
        'schema = "tissueid/study/1"\n'
        '[[override]]\nfile = "läuft [3].csv"\ncontact_mm = 0.5\nbecause = "seen by eye"\n'
        '[[exclude]]\nfile = "läuft [3].csv"\nbecause = "slipped"\n',
        encoding="utf-8",
    )
    followed = inspected(tmp_path)
    assert followed["contact"]["displacement_mm"] == 0.5
    assert followed["excluded"] == "slipped"
    assert "decision_overridden" in [flag["code"] for flag in followed["flags"]]
    assert "excluded    because: slipped" in run("inspect", tmp_path, "-v").stdout
    aside = inspected(tmp_path, "--no-study")
    assert aside["contact"]["displacement_mm"] != 0.5
    assert aside["excluded"] is None
    named = inspected(tmp_path / "läuft [3].csv", "--study", tmp_path / "study.toml")
    assert named["contact"] == followed["contact"]


def test_refused_files_stand_on_the_page_and_decide_the_exit_code(tmp_path: Path) -> None:
    write_log(tmp_path / "data" / "good.csv")
    (tmp_path / "data" / "bad.csv").write_text("no table here\n", encoding="ascii")
    page = tmp_path / "out.html"
    assert run("inspect", tmp_path / "data", "--html", page, "-q").code == 7
    assert "bad.csv" in page.read_text(encoding="utf-8")
    assert run("inspect", tmp_path / "data" / "bad.csv", "--html", page, "-q").code == 3
    assert "Nothing could be read" in page.read_text(encoding="utf-8")


def test_a_page_that_can_not_be_written_is_a_usage_error(tmp_path: Path) -> None:
    log = write_log(tmp_path / "good.csv")
    ended = run("inspect", log, "--html", tmp_path / "no" / "such" / "page.html")
    assert ended.code == 2
    assert "can't be written" in ended.stderr


def test_loops_are_measured(shared_data: Path) -> None:
    text = run("inspect", shared_data / "instron-bluehill-cyclic-cc0", "-v").stdout
    assert len(re.findall(r"^  loop \d", text, flags=re.MULTILINE)) == 3
