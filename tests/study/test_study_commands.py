"""study init, check, exclude, include and export."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import STUDY_HEAD, read_json, run, write_log
from study_folder import fit, lab, value

from tissueid.ingest import read_trials
from tissueid.ingest.manifest import read_study
from tissueid.manifest import Calibration, Entry, Study
from tissueid.study.completeness import ITEMS, completeness
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
    return Study(
        "study.toml",
        about=tables["study"],
        tip=tables["tip"],
        calibration=Calibration(tables["calibration"]),
        specimens={"a": tables["specimen"], "b": tables["specimen"]},
        trials=(Entry({"file": "x.csv", **tables["trial"]}, ("/x.csv",), 1),),
    )


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
