"""``tissueid fit`` follows study.toml, and data at a URL are fitted as data on this machine are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from study_folder import QUICK, fit, fit_lab, lab, recording, specimen, value

from tissueid.cli.main import main
from tissueid.store.schema import first_problem

STIFFNESS = "static_1_N_per_mm"
GROUPED = "[[trial]]\nfile = 'a*.csv'\nspecimen = 'kidney'\n"


def test_trials_of_one_specimen_are_fitted_together_and_the_others_stay_apart(tmp_path):
    code, document = fit_lab(tmp_path, GROUPED, a1=1.0, a2=1.02, b=1.5)
    assert code in (0, 4)
    assert [(one["specimen"], len(one["trials"])) for one in document["specimens"]] == [
        ("kidney", 2),
        ("b", 1),
    ]
    rows = [(Path(row["path"]), row["specimen"], row["listed"]) for row in document["study"]["trials"]]
    told = (("a1.csv", "kidney", True), ("a2.csv", "kidney", True), ("b.csv", "b", False))
    assert sorted(rows) == [(tmp_path / "lab" / name, *more) for name, *more in told]
    assert first_problem(document, "identification") is None
    assert main(["validate", str(tmp_path / "out")]) == 0


def test_a_pattern_for_specimens_that_the_study_names_is_told_to_have_no_effect(tmp_path, capsys):
    entry = "[[trial]]\nfile = 'a.csv'\nspecimen = 'liver'\n"
    code, document = fit_lab(tmp_path, entry, "--specimen-by", r"(b)_\d", a=1.0, b_1=1.0)
    assert code == 0
    assert {one["specimen"] for one in document["specimens"]} == {"liver", "b"}
    said = " ".join(capsys.readouterr().err.split())
    assert "study.toml names the specimen of 1 recording: --specimen-by does not apply there" in said
    assert "fits no recording" not in said
    assert "its own specimen" not in said


def test_only_listed_reads_nothing_else(tmp_path):
    _, document = fit_lab(tmp_path, f"[study]\nonly_listed = true\n{GROUPED}", a1=1.0, b=1.5)
    assert [one["specimen"] for one in document["specimens"]] == ["kidney"]


def test_a_study_is_found_named_or_left_out(tmp_path):
    folder = lab(tmp_path / "lab", GROUPED, a1=1.0, a2=1.02)
    for args in ([folder / "study.toml"], [folder, "--study", folder / "study.toml"], [folder]):
        _, document = fit(*args, out=tmp_path / "out")
        assert [one["specimen"] for one in document["specimens"]] == ["kidney"], args
        assert document["provenance"]["study"]["sha256"] == document["study"]["sha256"]
    _, document = fit(folder, "--no-study", out=tmp_path / "out")
    assert [one["specimen"] for one in document["specimens"]] == ["a1", "a2"]
    assert document["study"] is None


def test_two_studies_at_once_are_a_question_for_the_user(tmp_path, capsys):
    folders = [lab(tmp_path / name, GROUPED, a1=1.0) for name in ("x", "y")]
    assert main(["fit", *map(str, folders), "-o", str(tmp_path / "out")]) == 2
    assert "--study" in capsys.readouterr().err


def test_covariates_of_the_study_hold_where_a_specimen_says_nothing(tmp_path):
    manifest = (
        "[study]\nspecies = 'pig'\ntemperature = '37 C'\n[[specimen]]\nname = 'kidney'\nspecies = 'cow'\n"
        f"thickness = '2 cm'\n{GROUPED}site = 'A'\nrest = '5 min'\nprotocol = 'p'\n[[protocol]]\nname = 'p'\n"
    )
    _, document = fit_lab(tmp_path, manifest, a1=1.0, b=1.5)
    rows = {row["specimen"]: row for row in document["study"]["specimens"]}
    assert (rows["kidney"]["species"], rows["b"]["species"]) == ("cow", "pig")
    assert (rows["kidney"]["thickness_mm"], rows["b"]["thickness_mm"]) == (20.0, None)
    assert rows["kidney"]["temperature_C"] == 37.0
    (row,) = [row for row in document["study"]["trials"] if row["listed"]]
    assert (row["site"], row["rest_s"], row["protocol"]) == ("A", 300.0, "p")


def test_an_excluded_trial_is_shown_with_the_numbers_it_would_have_moved(tmp_path):
    manifest = GROUPED + "[[exclude]]\nfile = 'a3.csv'\nbecause = 'the tool <slipped>'\n"
    code, document = fit_lab(tmp_path, manifest, a1=1.0, a2=1.0, a3=1.6)
    assert code in (0, 4)
    assert not document["refused"]
    (row,) = document["study"]["exclusions"]
    assert (row["because"], row["specimen"], row["note"]) == ("the tool <slipped>", "kidney", None)
    moved = {one["name"]: one for one in row["with_it"]}
    without = value(document, "kidney", STIFFNESS)
    assert moved[STIFFNESS]["without"] == without
    # the same fit of all three, done apart
    lab(tmp_path / "all", GROUPED, a1=1.0, a2=1.0, a3=1.6)
    _, whole = fit(tmp_path / "all", out=tmp_path / "out-all")
    assert moved[STIFFNESS]["with"] == pytest.approx(value(whole, "kidney", STIFFNESS), rel=1e-9)
    assert moved[STIFFNESS]["with"] > 1.05 * without
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "the tool &lt;slipped&gt;" in page
    assert "With it" in page


def test_a_specimen_that_is_excluded_as_a_whole_is_not_fitted(tmp_path, capsys):
    manifest = "[[exclude]]\nfile = 'a.csv'\nbecause = 'another tip'\n"
    code, document = fit_lab(tmp_path, manifest, a=1.0, b=1.5)
    assert code in (0, 4)
    (row,) = document["study"]["exclusions"]
    assert (row["because"], row["with_it"]) == ("another tip", [])
    assert "no other trial that was fitted" in row["note"]
    capsys.readouterr()
    assert main(["fit", str(tmp_path / "lab"), "--exclude", "b*", "-o", str(tmp_path / "none")]) == 3
    shown = capsys.readouterr()
    assert "nothing is left to fit: 2 excluded" in shown.err
    assert "with it" not in shown.out


def test_a_damaged_recording_that_is_excluded_is_no_failure(tmp_path):
    manifest = GROUPED + "[[exclude]]\nfile = 'a2.csv'\nbecause = 'cut off by a power failure'\n"
    folder = lab(tmp_path / "lab", manifest, a1=1.0)
    (folder / "a2.csv").write_text("not a recording\n", encoding="ascii")
    code, document = fit(folder, out=tmp_path / "out")
    assert code in (0, 4)
    assert not document["refused"]
    (row,) = document["study"]["exclusions"]
    assert row["with_it"] == []
    assert "could not be fitted anyway" in row["note"]


def test_names_in_vain_are_refused_with_their_line_and_the_rest_goes_on(tmp_path):
    manifest = GROUPED + "[[override]]\nfile = 'gone.csv'\ncontact_mm = 1.0\nbecause = 'x'\n"
    code, document = fit_lab(tmp_path, manifest, a1=1.0)
    assert code == 7
    (refusal,) = document["refused"]
    assert refusal["error"]["code"] == "study_unmatched"
    assert refusal["error"]["line"] == 5
    assert "gone.csv" in refusal["error"]["message"]


def workbook(path: Path, *names: str) -> None:
    """A sheet of the same recording under each name."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name in names:
        sheet = book.create_sheet(name)
        for i, line in enumerate(recording().splitlines()):
            sheet.append([cell if i < 2 else float(cell) for cell in line.split(",")])
    book.save(path)


def test_a_sheet_that_is_not_there_is_named_with_those_that_are(tmp_path):
    folder = lab(tmp_path / "lab", "[[exclude]]\nfile = 'w.xlsx'\nsheet = 'S9'\nbecause = 'x'\n")
    workbook(folder / "w.xlsx", "S1", "S2")
    code, document = fit(folder, out=tmp_path / "out")
    assert code == 7
    (refusal,) = document["refused"]
    assert '"S9"' in refusal["error"]["message"]
    assert '"S1", "S2"' in refusal["error"]["message"]


def test_a_recording_named_alone_follows_the_study_beside_it(tmp_path, capsys):
    said = "[[override]]\nfile = 'a1.csv'\ncontact_mm = 0.25\nbecause = 'x'\n"
    folder = lab(tmp_path / "lab", GROUPED + said, a1=1.0)
    for options, specimen_name, followed in (
        ((), "kidney", True),
        (("--no-study",), str(folder / "a1.csv"), False),
    ):
        assert main(["inspect", str(folder / "a1.csv"), "--json", *options]) == 0
        (one,) = json.loads(capsys.readouterr().out)
        assert one["specimen"] == specimen_name
        assert (one["contact"]["displacement_mm"] == 0.25) == followed


def test_a_window_that_study_and_command_line_leave_empty_is_named(tmp_path, capsys):
    said = "[[override]]\nfile = 'a1.csv'\nhold_from_s = 2.0\nbecause = 'moved'\n"
    folder = lab(tmp_path / "lab", GROUPED + said, a1=1.0)
    assert main(["inspect", str(folder / "a1.csv"), "--hold-to", "1.5"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "hold_from_s is 2.0 and end_s 1.5" in told
    assert "moved" in told


def test_a_sheet_picked_by_name_needs_no_other_that_the_study_names(tmp_path):
    said = [f"[[trial]]\nfile = 'w.xlsx'\nsheet = '{name}'\nspecimen = 'cut'\n" for name in ("S1", "S2")]
    folder = lab(tmp_path / "lab", "".join(said))
    workbook(folder / "w.xlsx", "S1", "S2")
    code, document = fit(f"{folder / 'w.xlsx'}::S1", out=tmp_path / "out")
    assert code in (0, 4)
    assert not document["refused"]
    assert [one["specimen"] for one in document["specimens"]] == ["cut"]


def test_columns_and_units_of_one_file_are_those_the_study_decides(tmp_path):
    manifest = (
        "[[override]]\nfile = 'odd.csv'\ncolumns = {time = 't', displacement = 'pos', force = 'F'}\n"
        "units = {force = 'kN'}\nbecause = 'column names of a student'\n"
    )
    folder = lab(tmp_path / "lab", manifest, plain=1.0)
    text = recording(times=1e-3, names="t,pos,F").replace("(sec),(mm),(N)\n", "")
    (folder / "odd.csv").write_text(text, encoding="ascii")
    code, document = fit(folder, out=tmp_path / "out")
    assert code in (0, 4), document["refused"]
    assert {entry["specimen"] for entry in document["specimens"]} == {"plain", "odd"}
    # 1/1000 of the force in kN is the same force, to the printed 0.1 N
    assert value(document, "odd", STIFFNESS) == pytest.approx(value(document, "plain", STIFFNESS), rel=0.05)
    (flag,) = [
        flag
        for flag in specimen(document, "odd")["trials"][0]["flags"]
        if flag["code"] == "decision_overridden" and "column names of a student" in flag["message"]
    ]
    assert flag["keys"] == ["columns", "units"]


def test_a_contact_point_is_where_the_user_put_it(tmp_path):
    manifest = "[[override]]\nfile = 'a.csv'\ncontact_mm = 0.5\nbecause = 'seen on the video'\n"
    _, document = fit_lab(tmp_path, manifest, a=1.0)
    trial = specimen(document, "a")["trials"][0]
    # the ramp goes to 8 mm, depth is counted from contact
    assert trial["depth_mm"] == pytest.approx(7.5, abs=0.01)
    row = document["study"]["trials"][0]
    assert (row["overridden"], row["because"]) == (["contact_mm"], "seen on the video")


def test_the_load_cell_of_the_study_decides_what_is_a_small_force(tmp_path):
    for line, flagged in (
        ("load_cell_capacity_N = 50000", True),
        ("load_cell_capacity_N = 500", False),
        ("load_cell_capacity_N = 500\nverified_from_N = 400", True),
    ):
        folder = lab(tmp_path / "lab", f"[calibration]\n{line}\n", a=1.0)
        _, document = fit(folder, out=tmp_path / "out")
        codes = [flag["code"] for flag in specimen(document, "a")["trials"][0]["flags"]]
        assert ("below_cell_range" in codes) is flagged, line


def test_a_rigid_block_behind_the_frame_file_is_not_a_specimen(tmp_path):
    folder = lab(tmp_path / "lab", "[calibration]\nframe = 'frame.json'\n", a=1.0)
    rows = [f"{i / 50:.3f},{0.004 * i:.5f},{max(0.0, 4.0 * (i - 20)):.4f}" for i in range(120)]
    rigid = "\n".join(["Time,Extension,Load", "(sec),(mm),(N)", *rows, ""])
    (folder / "rigid.csv").write_text(rigid, encoding="ascii")
    assert main(["calibrate-frame", str(folder / "rigid.csv"), "-o", str(folder / "frame.json"), "-q"]) == 0
    code, document = fit(folder, out=tmp_path / "out")
    assert code in (0, 4), document["refused"]
    assert [entry["specimen"] for entry in document["specimens"]] == ["a"]
    (row,) = document["study"]["exclusions"]
    assert row["path"].endswith("rigid.csv")
    assert row["with_it"] == []
    frame = document["study"]["calibration"]["frame"]
    # 4 N a step of 0.004 mm: 1000 N/mm
    assert frame["compliance_mm_per_N"][-1] == pytest.approx(1e-3, rel=0.02)
    assert document["provenance"]["study"]["calibration"]["frame"] == frame


def test_a_damaged_frame_file_is_refused_by_name(tmp_path, capsys):
    folder = lab(tmp_path / "lab", "[calibration]\nframe = 'frame.json'\n", a=1.0)
    (folder / "frame.json").write_text('{"schema": "tissueid/frame/1"}', encoding="utf-8")
    assert main(["fit", str(folder), "-o", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert "frame.json" in said
    assert "calibrate-frame" in said


def found_in(document: dict[str, Any]) -> dict[str, Any]:
    """What was found of each specimen, but for where its recordings lie."""
    return {
        one["specimen"].rsplit("/", 1)[-1]: (one["parameters"], one["nrmsd"], one["n_samples"])
        for one in document["specimens"]
    }


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_study_at_a_url_is_that_of_a_folder(tmp_path, workers):
    fsspec = pytest.importorskip("fsspec")
    folder = tmp_path / "lab"
    folder.mkdir()
    system = fsspec.filesystem("memory")
    for name, times in (("a", 1.0), ("b", 1.3)):
        text = recording(times=times)
        (folder / f"{name}.csv").write_text(text, encoding="ascii")
        system.pipe_file(f"/remote/{name}.csv", text.encode())
    # a file system in memory is that of this process
    where = "memory://remote" if workers == "1" else f"file://{folder}"
    _, local = fit(folder, *QUICK, out=tmp_path / "local")
    _, remote = fit(where, *QUICK, "--workers", workers, out=tmp_path / "remote")
    system.rm("/remote", recursive=True)
    assert len(local["specimens"]) == 2
    assert found_in(remote) == found_in(local)
