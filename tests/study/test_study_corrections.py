"""Decisions of a page in study.toml: its own table, the recording as it is then, all else as it was."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from corrected_lab import corrected
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.documents.inspect import Phase
from tissueid.errors import InputError, UsageError
from tissueid.ingest.manifest import read_study
from tissueid.study.corrections import MARK, CorrectedInspection, Correction, corrected_text

FILES = ("a.csv", "b.csv")
BY_HAND = '''# our study
schema = "tissueid/study/1"

[[override]]  # by Anna
file = "a.csv"
contact_mm = 0.9   # seen on the film
because = "film"

# trials
[[trial]]
file = "a.csv"
notes = """
[[override]]  # by inspect --serve
"""
'''


def contact(value: float | None, file: str = "a.csv", because: str = "seen") -> Correction:
    return Correction("contact_mm", file, None, value, because)


# --- the text ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_what_stands_in_the_file_stays_to_the_last_character(end):
    before = BY_HAND.replace("\n", end)
    text = corrected_text(before, contact(1.25, because='he said "there"'))
    assert text.startswith(before)
    assert text.count("\n") == text.count(end)
    added = tomllib.loads(text)["override"][-1]
    assert added == {"file": "a.csv", "contact_mm": 1.25, "because": 'he said "there"'}
    assert corrected_text(text, contact(None)) == before + end


def test_its_own_table_is_replaced_and_others_are_left():
    text = corrected_text(BY_HAND, contact(1.0))
    text = corrected_text(text, contact(2.0, "b.csv"))
    text = corrected_text(text, Correction("rupture", "a.csv", None, value=False, because="a slip"))
    text = corrected_text(text, contact(3.0))
    found = tomllib.loads(text)["override"]
    assert [(one["file"], one.get("contact_mm")) for one in found] == [
        ("a.csv", 0.9), ("b.csv", 2.0), ("a.csv", None), ("a.csv", 3.0),
    ]  # fmt: skip
    assert found[2]["rupture"] is False
    assert text.count(MARK) == 4  # three of its own, and the one that only stands in a text


def test_a_first_decision_makes_the_file_and_a_layout_that_takes_none_is_refused():
    text = corrected_text("", Correction("exclude", "a.csv", "Sheet 1", value=True, because="slipped"))
    assert text.splitlines()[0] == 'schema = "tissueid/study/1"'
    assert tomllib.loads(text)["exclude"] == [{"file": "a.csv", "sheet": "Sheet 1", "because": "slipped"}]
    remarked = text.replace("because", "# asked twice\nbecause")
    left = corrected_text(remarked, Correction("exclude", "a.csv", "Sheet 1", None))
    assert "# asked twice" in left
    assert "exclude" not in tomllib.loads(left)
    inline = 'schema = "tissueid/study/1"\noverride = [{ file = "a.csv", rupture = false, because = "x" }]\n'
    with pytest.raises(UsageError, match=r"\[\[override\]\]"):
        corrected_text(inline, contact(1.0))


@settings(deadline=None)
@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=40), st.floats(-1e4, 1e4))
def test_any_reason_and_number_come_back_as_they_were(because, value):
    if not because.strip():
        return
    text = corrected_text(BY_HAND, contact(value, because=because))
    assert tomllib.loads(text)["override"][-1] == {
        "file": "a.csv",
        "contact_mm": value,
        "because": because.strip(),
    }
    assert tomllib.loads(corrected_text(text, contact(None))) == tomllib.loads(BY_HAND)


# --- the recordings -----------------------------------------------------------------------------------------


def decide(shown: CorrectedInspection, lab: Path, key: str, value: Any, because="seen", file="a.csv") -> str:
    words = {"path": str(lab / file), "sheet": None, "key": key, "value": value, "because": because}
    return shown.decide(words)


def hold_of(shown: CorrectedInspection) -> Phase:
    document = shown._inspection.shown[0].document
    return next(phase for phase in document.phases if phase.kind == "hold")


def test_a_decision_is_written_and_the_recording_segmented_anew(tmp_path):
    shown = corrected(tmp_path, *FILES)
    shown.page()
    decide(shown, tmp_path, "contact_mm", 1.25, "the film")
    decide(shown, tmp_path, "hold_from_s", 4.5)
    decide(shown, tmp_path, "end_s", 12.0)
    assert hold_of(shown).start_s == pytest.approx(4.5)
    assert hold_of(shown).end_s == pytest.approx(12.0)
    study = read_study(tmp_path)
    said = study.decision(str(tmp_path / "a.csv"), None).override
    assert (said["contact_mm"], said["hold_from_s"], said["end_s"]) == (1.25, 4.5, 12.0)
    assert "the film" in said["because"]
    assert study.decision(str(tmp_path / "b.csv"), None).override == {}
    page = shown.page()
    assert 'name="value" value="1.25"' in page
    assert "the film" in page


def test_what_makes_no_sense_is_refused_and_writes_nothing(tmp_path):
    (tmp_path / "c.csv").write_text("x", encoding="ascii")
    shown = corrected(tmp_path, *FILES)
    for file, key, value, because, words in (
        ("a.csv", "contact_mm", 500.0, "x", "-4 to 8 mm"),
        ("a.csv", "contact_mm", "1.0", "x", "must be a number"),
        ("a.csv", "contact_mm", True, "x", "must be a number"),
        ("a.csv", "contact_mm", float("nan"), "x", "must be a number"),
        ("a.csv", "contact_mm", 1.0, " ", "reason"),
        ("a.csv", "end_s", 0.0, "x", "outside the record"),
        ("a.csv", "hold_from_s", 99.0, "x", "outside the record"),
        ("a.csv", "start_s", 1.0, "x", "no such"),
        # only recordings of the page can be named
        ("c.csv", "exclude", True, "x", "no such recording"),
    ):
        with pytest.raises(UsageError, match=words):
            decide(shown, tmp_path, key, value, because, file)
    assert not (tmp_path / "study.toml").exists()


def test_a_window_that_ends_before_it_starts_is_refused_before_it_is_written(tmp_path):
    shown = corrected(tmp_path, *FILES)
    decide(shown, tmp_path, "hold_from_s", 6.0)
    before = (tmp_path / "study.toml").read_bytes()
    with pytest.raises(InputError, match="hold_from_s = 6 is not before end_s = 5"):
        decide(shown, tmp_path, "end_s", 5.0)
    assert (tmp_path / "study.toml").read_bytes() == before


def test_what_was_decided_by_hand_is_taken_back_by_hand(tmp_path):
    (tmp_path / "study.toml").write_text(BY_HAND, encoding="utf-8")
    shown = corrected(tmp_path, *FILES)
    decide(shown, tmp_path, "contact_mm", 1.25)
    with pytest.raises(UsageError, match=r"line 4 of study\.toml"):
        decide(shown, tmp_path, "contact_mm", None)
    assert read_study(tmp_path).decision(str(tmp_path / "a.csv"), None).override["contact_mm"] == 1.25
    decide(shown, tmp_path, "rupture", True)
    decide(shown, tmp_path, "rupture", None)
    assert "rupture" not in read_study(tmp_path).decision(str(tmp_path / "a.csv"), None).override


def test_the_page_follows_what_somebody_else_writes_meanwhile(tmp_path):
    shown = corrected(tmp_path, *FILES)
    decide(shown, tmp_path, "exclude", True, "slipped")
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    (tmp_path / "study.toml").write_text(text.replace("slipped", "the tip was bent"), encoding="utf-8")
    assert "the tip was bent" in shown.page()
    (tmp_path / "study.toml").write_text("nonsense", encoding="utf-8")
    with pytest.raises(InputError, match="not TOML"):
        shown.page()


def test_a_folder_that_takes_no_file_is_said(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    shown = corrected(tmp_path, *FILES)
    monkeypatch.setattr("tissueid.study.corrections.write_file", full)
    with pytest.raises(UsageError, match="No space left"):
        decide(shown, tmp_path, "exclude", True)
    assert hold_of(shown).kind == "hold"
    assert shown._inspection.shown[0].document.excluded is None
