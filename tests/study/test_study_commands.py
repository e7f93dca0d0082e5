"""study init, check, exclude, include and export; decisions of a page, all else left as it was."""

import hashlib
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import STUDY_HEAD, read_json, run, write_log
from corrected_lab import corrected
from hypothesis import given, settings
from hypothesis import strategies as st
from study_folder import fit, lab, value

from tissueid.documents.inspect import Phase
from tissueid.errors import InputError, UsageError
from tissueid.ingest import read_trials
from tissueid.ingest.manifest import read_study
from tissueid.manifest import Calibration, Entry, Study
from tissueid.study.completeness import ITEMS, completeness
from tissueid.study.corrections import MARK, CorrectedInspection, Correction, corrected_text
from tissueid.study.crate import Anonymiser
from tissueid.study.draft import draft_study, programs_of
from tissueid.trial import Protocol, Source, Trial

NAMES = ("Muster", "Anna", "kidney", "E-123", "Klinikum", "2024")
WHO = (
    "[study]\ntitle = 'Stiffness of tissue'\nauthors = ['Anna Muster']\noperator = 'Anna Muster'\n"
    "laboratory = 'Klinikum Nord'\ndate = 2024-05-31\nethics = 'E-123'\nlicence = 'CC-BY-4.0'\n"
    "notes = 'kidney of Anna'\nspecies = 'pig'\n"
    "[[specimen]]\nname = 'kidney 7'\ndonor = 'Babe'\nthickness = '2 cm'\n"
    "[[trial]]\nfile = 'kidney*.csv'\nspecimen = 'kidney 7'\nsite = 'A'\n"
    "[[exclude]]\nfile = 'kidney_2.csv'\nbecause = 'Anna Muster saw kidney 7 slip'\n"
)


def test_a_first_study_file_says_what_recordings_and_headers_say_and_is_valid(tmp_path):
    head = '"Operator","A. Tester"\n"Specimen label","kidney"\n"Tip radius","2.0","mm"'
    head += '\n"Load cell capacity","500","N"'
    for i in (1, 2, 10):
        write_log(tmp_path / f"run {i}.csv", head=head)
    (tmp_path / "broken.csv").write_text("nothing\n", encoding="ascii")
    run("study", "init", tmp_path, "-q", code=7)
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    study = read_study(tmp_path)
    assert study.about["operator"] == "A. Tester"
    assert study.tip["radius_mm"] == 2.0
    assert study.calibration.values["load_cell_capacity_N"] == 500.0
    # every fourth row of 100 Hz
    assert study.calibration.values["sampling_Hz"] == 25.0
    assert list(study.specimens) == ["kidney"]
    (protocol,) = study.protocols.values()
    # 250 mm/min to 8 mm and a hold, sampled at 25 Hz
    assert protocol["kind"] == "ramp-hold"
    assert protocol["speed_mm_s"] == pytest.approx(250 / 60, rel=0.05)
    assert protocol["depth_mm"] == pytest.approx(8.0, rel=0.01)
    assert [entry.values["file"] for entry in study.trials] == ["run 1.csv", "run 2.csv", "run 10.csv"]
    assert "# not read: " in text
    assert "# thickness_mm =" in text
    # and the fit with it is the fit without it
    _, with_it = fit(tmp_path / "run 1.csv", out=tmp_path / "out")
    _, without = fit(tmp_path / "run 1.csv", "--no-study", out=tmp_path / "out2")
    assert value(with_it, "kidney", "static_1_N_per_mm") == value(without, "kidney", "static_1_N_per_mm")


def test_an_existing_study_file_is_written_over_only_by_force(tmp_path):
    folder = lab(tmp_path, "# mine\n", a=1.0)
    before = (folder / "study.toml").read_bytes()
    run("study", "init", folder, code=2)
    assert (folder / "study.toml").read_bytes() == before
    run("study", "init", folder, "--force", "-q", code=0)
    assert (folder / "study.toml").read_bytes() != before


def full_study() -> Study:
    tables: dict[str, dict[str, Any]] = {}
    for item in ITEMS:
        tables.setdefault(item.table, {})[item.keys[-1]] = "said"
    machine = {"tip": tables["tip"], "calibration": Calibration(tables["calibration"])}
    trials = (Entry({"file": "x.csv", **tables["trial"]}, ("/x.csv",), 1),)
    specimens = dict.fromkeys("ab", tables["specimen"])
    return Study("study.toml", about=tables["study"], **machine, specimens=specimens, trials=trials)


def test_a_study_is_graded_by_what_it_says_and_what_is_missing_is_named():
    best = completeness(full_study())
    assert (best.grade, best.share, best.missing) == ("A", 1.0, ())
    worst = completeness(Study("study.toml"))
    assert (worst.grade, worst.share) == ("F", 0.0)
    assert len(worst.missing) == len(ITEMS)
    # what is stated nowhere is missing everywhere
    assert {one.where for one in worst.missing} == {()}
    study = full_study()
    less = {key: text for key, text in study.specimens["b"].items() if key != "thickness_mm"}
    found = completeness(replace(study, specimens={"a": study.specimens["a"], "b": less}))
    assert found.grade == "C"
    assert found.share > 0.95
    (missing,) = found.missing
    assert (missing.keys, missing.where) == (("thickness_mm",), ("b",))
    # what the study says holds for every specimen
    general = replace(study, about={**study.about, "thickness_mm": 5.0}, specimens={"a": {}, "b": less})
    assert "thickness_mm" not in {key for one in completeness(general).missing for key in one.keys}


def test_check_prints_the_document_of_its_schema_and_ends_by_what_is_missing(tmp_path):
    folder = lab(tmp_path, "[study]\nspecies = 'pig'\n[[trial]]\nfile = 'gone.csv'\n", a=1.0)
    document = run("study", "check", folder, "--json", code=7).json("study-check")
    assert document["unmatched"][0]["error"]["line"] == 4
    assert ["species"] not in [one["keys"] for one in document["missing"]]
    run("study", "check", folder, code=7, shown="grade F", said="gone.csv")


COMMENTED = """# a study
[study]  # mine
title = 'x'   # odd   spacing
species = "pig"

# the trials
[[trial]]
file = "a.csv"
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_excluding_and_including_again_leaves_the_file_as_it_was(tmp_path, newline):
    folder = lab(tmp_path / "lab", "", a=1.0, b=1.0)
    path = folder / "study.toml"
    text = f"{STUDY_HEAD}\n{COMMENTED}".replace("\n", newline)
    path.write_bytes(text.encode())
    exclude = ("study", "exclude", folder / "b.csv", "--because")
    run(*exclude, 'it "slipped"', "-q", code=0)
    changed = path.read_bytes().decode()
    assert changed.startswith(text)
    assert changed.count("\n") == changed.count(newline)
    study = read_study(folder)
    assert study.decision(str(folder / "b.csv"), None).excluded == 'it "slipped"'
    # a second reason takes the place of the first, which is told
    for because, told in (('it "slipped"', ""), ("thawed", 'because: it "slipped"')):
        said = run(*exclude, because, code=0).stderr
        assert told in said if told else "excluded already" not in said
    assert [one.values["because"] for one in read_study(folder).exclusions] == ["thawed"]
    run("study", "exclude", folder / "a.csv", "--because", "dry", "-q", code=0)
    assert len(read_study(folder).exclusions) == 2
    for name in ("a.csv", "b.csv"):
        run("study", "include", folder / name, "-q", code=0)
    assert path.read_bytes().decode().rstrip() == text.rstrip()


def test_a_misspelt_recording_is_told_with_the_nearest_names(tmp_path):
    folder = lab(tmp_path / "lab", "", kidney_1=1.0)
    exclude = ("study", "exclude", folder / "kidny_1.csv", "--because", "x")
    run(*exclude, code=2, said=("no such recording", "did you mean kidney_1.csv?"))
    # where there is no study file, that is said
    (folder / "study.toml").unlink()
    run(*exclude, code=2, said="there is no study.toml")


def test_a_sheet_is_excluded_by_its_name_and_seen_from_anywhere(tmp_path, monkeypatch):
    folder = lab(tmp_path / "lab", "", a=1.0)
    (folder / "meat.xlsx").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    run("study", "exclude", "meat.xlsx::Sheet 3", "--because", "x", "--study", "lab", "-q", code=0)
    (entry,) = read_study(folder).exclusions
    assert dict(entry.values) == {"file": "meat.xlsx", "sheet": "Sheet 3", "because": "x"}


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["exclude", "nowhere.csv", "--because", "x"], "no such recording"),
        (["exclude", "a.csv", "--because", "  "], "reason"),
        (["include", "a.csv"], "not excluded"),
        (["include", "b.csv"], "line 2"),
    ],
)
def test_what_can_not_be_changed_is_said_and_left(tmp_path, args, words):
    folder = lab(tmp_path, "[[exclude]]\nfile = 'b*.csv'\nbecause = 'x'\n", a=1.0, b=1.0)
    before = (folder / "study.toml").read_bytes()
    run("study", *args, "--study", folder, code=2, said=words)
    assert (folder / "study.toml").read_bytes() == before


def crate(out: Path) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The metadata document and its entities by identifier."""
    document = read_json(out / "ro-crate-metadata.json")
    return document, {entity["@id"]: entity for entity in document["@graph"]}


def test_a_crate_describes_itself_its_data_and_every_file_as_the_specification_asks(tmp_path):
    folder = lab(tmp_path / "lab", WHO, kidney_1=1.0, kidney_2=1.1)
    out = tmp_path / "crate"
    run("study", "export", folder, "--crate", out, "--date", "2025-01-02", "-q", code=0)
    document, entities = crate(out)
    # RO-Crate 1.1: a flat graph, each identifier once, the descriptor about the root
    assert len(entities) == len(document["@graph"])
    assert document["@context"][0] == "https://w3id.org/ro/crate/1.1/context"
    descriptor = entities["ro-crate-metadata.json"]
    assert descriptor["@type"] == "CreativeWork"
    assert descriptor["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert descriptor["about"] == {"@id": "./"}
    root = entities["./"]
    assert root["@type"] == "Dataset"
    assert (root["name"], root["datePublished"]) == ("Stiffness of tissue", "2025-01-02")
    assert root["license"]["@id"] in entities
    assert [entities[one["@id"]]["name"] for one in root["author"]] == ["Anna Muster"]
    # every file is listed, there, and the one whose hash is printed
    listed = [one["@id"] for one in root["hasPart"]]
    assert sorted(listed) == ["kidney_1.csv", "kidney_2.csv", "study.toml"]
    for name in listed:
        content = (out / name).read_bytes()
        assert content == (folder / name).read_bytes()
        assert entities[name]["@type"] == "File"
        assert entities[name]["sha256"] == hashlib.sha256(content).hexdigest()
        assert entities[name]["contentSize"] == str(len(content))
    assert {path.name for path in out.iterdir()} == {*listed, "ro-crate-metadata.json"}


def test_a_crate_without_a_licence_or_into_a_full_folder_is_refused(tmp_path):
    folder = lab(tmp_path / "lab", "", a=1.0)
    run("study", "export", folder, "--crate", tmp_path / "out", code=2, said="licence")
    lab(tmp_path / "lab", "[study]\nlicence = 'CC0-1.0'\n")
    run("study", "export", folder, "--crate", folder, code=2)
    assert not (folder / "ro-crate-metadata.json").exists()


def test_an_anonymised_crate_holds_no_name_and_the_same_numbers(tmp_path):
    folder = lab(tmp_path / "lab", WHO)
    head = '"Operator","Anna Muster"\n"Specimen label","kidney 7"\n"Start date","31/05/2024"'
    for i, times in ((1, 1.0), (2, 1.1), (3, 1.02)):
        write_log(folder / f"kidney_{i}.csv", head=head, force_times=times)
    out = tmp_path / "crate"
    run("study", "export", folder, "--crate", out, "--anonymise", "--date", "2025-01-02", "-q", code=0)
    whole = "\n".join(path.read_text(encoding="utf-8") for path in out.iterdir())
    assert [name for name in (*NAMES, "Babe") if re.search(name, whole, re.IGNORECASE)] == []
    assert str(tmp_path) not in whole
    study = read_study(out)
    assert study.about["species"] == "pig"
    ((hashed, table),) = study.specimens.items()
    assert re.fullmatch(r"S-[0-9a-f]{10}", hashed)
    assert table["thickness_mm"] == 20.0
    assert re.fullmatch(r"D-[0-9a-f]{10}", table["donor"])
    # the exclusion and every sample survive, and no header
    assert len(study.exclusions) == 1
    first = read_trials(folder / "kidney_1.csv")[0]
    again = read_trials(out / "trial-001.csv")[0]
    for channel in ("time_s", "displacement_mm", "force_N"):
        assert np.array_equal(getattr(first, channel), getattr(again, channel))
    assert not again.source.metadata
    _, named = fit(folder, out=tmp_path / "out")
    _, nameless = fit(out, out=tmp_path / "out2")
    static = "static_1_N_per_mm"
    assert value(nameless, hashed, static) == value(named, "kidney 7", static)


def test_hashes_are_stable_under_one_salt_and_strange_under_another():
    study = Study("study.toml")
    one, same, other = (Anonymiser(study, [], salt) for salt in (b"a", b"a", b"b"))
    assert one.hashed("kidney 7") == same.hashed("kidney 7")
    assert one.hashed("kidney 7") != other.hashed("kidney 7")
    assert one.hashed("kidney 7") != one.hashed("kidney 8")


def pushed(
    name: str, *steps: tuple[float, float, float], air_mm: float = 0.5, stated: float | None = None
) -> Trial:
    """Steps of (travel [mm], speed [mm/s], hold [s]) from above a springy tissue; 50 Hz."""
    times, places = [0.0, 1.0], [0.0, 0.0]
    for travel, speed, hold in steps:
        times += [times[-1] + travel / speed, times[-1] + travel / speed + hold]
        places += [places[-1] + travel, places[-1] + travel]
    time = np.arange(0.0, times[-1], 0.02)
    x = np.interp(time, times, places)
    depth = np.maximum(x - air_mm, 0.0)
    lag = np.zeros_like(depth)
    for i in range(1, depth.size):
        lag[i] = lag[i - 1] + (depth[i] - lag[i - 1]) * 0.02 / 1.5
    force = 2.0 * depth + 3.0 * (depth - lag) + np.random.default_rng(5).normal(0.0, 0.002, depth.size)
    protocol = Protocol(speed_mm_s=stated)
    return Trial(name, time, x, force, source=Source(path=f"{name}.csv"), protocol=protocol)


def test_recordings_of_one_program_are_one_whatever_their_depth():
    trials = [
        pushed("a", (4.0, 1.0, 12.0)),
        pushed("b", (4.02, 1.01, 12.1)),
        pushed("c", (4.0, 0.25, 12.0)),
        pushed("d", (3.0, 1.0, 12.0), air_mm=0.3),
    ]
    fast, slow = programs_of(trials)
    assert (fast.trials, slow.trials) == ([0, 1, 3], [2])
    assert fast.table["kind"] == "ramp-hold"
    assert fast.table["speed_mm_s"] == pytest.approx(1.0, rel=0.02)
    assert fast.table["hold_s"] == pytest.approx(12.0, rel=0.02)
    # 3 and 4 mm are no one depth: a range in the comments
    assert "depth_mm" not in fast.table
    assert slow.table["depth_mm"] == pytest.approx(4.0, rel=0.01)
    assert "3 recordings of 3 specimens" in fast.comments()
    assert "travel 3.00 to 4.02 mm" in fast.comments()


def test_steps_are_told_and_the_speed_of_a_header_is_the_program_s():
    (alike,) = programs_of([pushed("a", *3 * [(1.0, 0.5, 15.0)])])
    assert re.fullmatch(r"3 steps, each 1\.0+ mm at 0\.500 mm/s, held 15\.0 s", alike.table["notes"])
    assert alike.table["hold_s"] == pytest.approx(15.0, rel=0.02)
    assert alike.name.startswith("ramp-hold in 3 steps")
    (mixed,) = programs_of([pushed("a", (1.5, 0.5, 10.0), (1.0, 0.1, 20.0))])
    told = r"2 steps: 1\.50 mm at 0\.500 mm/s, held 10\.0 s; 1\.0+ mm at 0\.10+ mm/s, held 20\.0 s"
    assert re.fullmatch(told, mixed.table["notes"])
    assert not {"hold_s", "speed_mm_s"} & set(mixed.table)
    trials = [pushed("a", (4.0, 1.0, 12.0), stated=1.2), pushed("b", (4.0, 0.9, 12.0), stated=1.2)]
    (program,) = programs_of(trials)
    assert program.table["speed_mm_s"] == 1.2


def test_the_drafted_file_holds_the_counts_and_is_read_again(tmp_path):
    trials = [
        pushed(name, (4.0, 1.0, 12.0), *more)
        for name, more in (("a", ()), ("b", ()), ("c", [(1.0, 1.0, 12.0)]))
    ]
    text = draft_study(tmp_path, trials)
    assert "# 2 recordings of 2 specimens\n" in text
    assert "mm/s, held 12.0 s\n" in text
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("x", encoding="ascii")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    study = read_study(tmp_path)
    assert [entry.values["protocol"] in study.protocols for entry in study.trials] == [True] * 3
    assert len(study.protocols) == 2


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
    for file, key, chosen, because, words in (
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
            decide(shown, tmp_path, key, chosen, because, file)
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
