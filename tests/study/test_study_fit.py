"""``tissueid fit`` follows study.toml, at a URL as here; flags that need several logs together."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import QUICK, log_text, read_json, run, write_csv, write_log, write_study, write_workbook
from fit_factory import specimen_fit
from study_folder import fit, lab, specimen, value

import tissueid as ti
from tissueid.between_logs import copies, order_effect, repeated_sites, spread_flags
from tissueid.result import TrialFit
from tissueid.store.schema import first_problem

STIFFNESS = "static_1_N_per_mm"
GROUPED = "[[trial]]\nfile = 'a*.csv'\nspecimen = 'kidney'\n"


#: Everything that a study may say of recordings at once.
DECIDED = (
    "[study]\nspecies = 'pig'\ntemperature = '37 C'\n"
    "[[specimen]]\nname = 'kidney'\nspecies = 'cow'\nthickness = '2 cm'\n"
    "[[trial]]\nfile = '[aw]*.*'\nspecimen = 'kidney'\nsite = 'A'\nrest = '5 min'\nprotocol = 'p'\n"
    "[[protocol]]\nname = 'p'\n"
    "[[exclude]]\nfile = 'a2.csv'\nbecause = 'cut off by a power failure'\n"
    "[[exclude]]\nfile = 'c.csv'\nbecause = 'another tip'\n"
    "[[exclude]]\nfile = 'w.xlsx'\nsheet = 'S9'\nbecause = 'x'\n"
    "[[override]]\nfile = 'gone.csv'\ncontact_mm = 1.0\nbecause = 'x'\n"
    "[[override]]\nfile = 'b.csv'\ncontact_mm = 0.5\nbecause = 'seen on the video'\n"
    "[[override]]\nfile = 'odd.csv'\ncolumns = {time = 't', displacement = 'pos', force = 'F'}\n"
    "units = {force = 'kN'}\nbecause = 'column names of a student'\n"
)


@pytest.fixture(scope="module")
def decided(tmp_path_factory):
    """A lab of which a study says all of this, and what was found: exit code and identification.json."""
    folder = tmp_path_factory.mktemp("decided")
    lab(folder / "lab", DECIDED, a1=1.0, b=1.5, c=1.0)
    (folder / "lab" / "a2.csv").write_text("not a recording\n", encoding="ascii")
    odd = log_text(label=None, force_times=1e-3)
    odd = odd.replace("Time,Extension,Load\n(sec),(mm),(N)", "t,pos,F")
    (folder / "lab" / "odd.csv").write_text(odd, encoding="ascii")
    write_workbook(folder / "lab" / "w.xlsx", "S1", "S2")
    return folder, *fit(folder / "lab", out=folder / "out")


def test_trials_are_of_the_specimens_that_the_study_names_and_covariates_hold_where_one_says_nothing(decided):
    folder, _, document = decided
    assert first_problem(document, "identification") is None
    assert document["provenance"]["study"]["sha256"] == document["study"]["sha256"]
    run("validate", folder / "out", code=0)
    logs = {one["specimen"]: len(one["trials"]) for one in document["specimens"]}
    assert logs == {"kidney": 3, "b": 1, "odd": 1}
    rows = {row["specimen"]: row for row in document["study"]["specimens"]}
    assert (rows["kidney"]["species"], rows["b"]["species"]) == ("cow", "pig")
    assert (rows["kidney"]["thickness_mm"], rows["b"]["thickness_mm"]) == (20.0, None)
    assert rows["kidney"]["temperature_C"] == 37.0
    trials = {(Path(row["path"]).name, row["sheet"]): row for row in document["study"]["trials"]}
    assert all(Path(row["path"]).parent == folder / "lab" for row in trials.values())
    listed = {where for where, row in trials.items() if row["listed"]}
    assert listed == {("a1.csv", None), ("w.xlsx", "S1"), ("w.xlsx", "S2")}
    row = trials["a1.csv", None]
    assert (row["specimen"], row["site"], row["rest_s"], row["protocol"]) == ("kidney", "A", 300.0, "p")


def test_names_in_vain_are_refused_with_their_line_or_what_is_there_and_the_rest_goes_on(decided):
    _, code, document = decided
    assert code == 7
    found = {one["error"]["line"]: one["error"] for one in document["refused"]}
    assert {one["code"] for one in found.values()} == {"study_unmatched"}
    line = 2 + DECIDED.split("[[override]]")[0].count("\n")
    assert "gone.csv" in found.pop(line)["message"]
    # a sheet that is not there, with those that are
    ((_, sheet),) = found.items()
    assert '"S9"' in sheet["message"]
    assert '"S1", "S2"' in sheet["message"]


def test_a_sheet_in_vain_is_said_where_the_study_leaves_the_others_aside(tmp_path):
    folder = lab(tmp_path / "lab", "[study]\nonly_listed = true\n[[trial]]\nfile = 'w.xlsx'\nsheet = 'S*'\n")
    write_workbook(folder / "w.xlsx", "S1", "S2")
    words = 'there is no sheet "S*" in w.xlsx; it has "S1", "S2"'
    assert words in run("fit", folder, "-o", tmp_path / "out", *QUICK, code=3).stderr
    trials, study = ti.read_trials(folder / "w.xlsx"), ti.read_study(folder / "study.toml")
    (refused,) = ti.identify(trials, study=study).refused
    assert words in refused.message


def test_what_is_excluded_is_no_failure_be_it_damaged_or_a_whole_specimen(decided):
    rows = {Path(row["path"]).name: row for row in decided[2]["study"]["exclusions"]}
    assert rows.keys() == {"a2.csv", "c.csv"}
    assert [row["with_it"] for row in rows.values()] == [[], []]
    assert "could not be fitted anyway" in rows["a2.csv"]["note"]
    assert rows["c.csv"]["because"] == "another tip"
    assert "no other trial that was fitted" in rows["c.csv"]["note"]


def test_contact_columns_and_units_are_those_that_the_study_decides(decided):
    _, _, document = decided
    # the ramp goes to 8 mm, depth is counted from contact
    assert specimen(document, "b")["trials"][0]["depth_mm"] == pytest.approx(7.5, abs=0.01)
    (row,) = [row for row in document["study"]["trials"] if row["specimen"] == "b"]
    assert (row["overridden"], row["because"]) == (["contact_mm"], "seen on the video")
    # 1/1000 of the force in kN is the same force, to the printed 0.1 N
    assert value(document, "odd", STIFFNESS) == pytest.approx(value(document, "kidney", STIFFNESS), rel=0.05)
    flags = specimen(document, "odd")["trials"][0]["flags"]
    (keys,) = [flag["keys"] for flag in flags if "column names of a student" in flag["message"]]
    assert keys == ["columns", "units"]


def test_where_nothing_is_left_to_fit_it_is_said(tmp_path):
    folder, said = lab(tmp_path / "lab", "", a=1.0), "nothing is left to fit: 1 excluded"
    ended = run("fit", folder, "--exclude", "a*", "-o", tmp_path / "out", code=3, said=said)
    assert "with it" not in ended.stdout


def test_a_pattern_for_specimens_that_the_study_names_is_told_to_have_no_effect(tmp_path):
    folder = lab(tmp_path / "lab", "[[trial]]\nfile = 'a.csv'\nspecimen = 'liver'\n", a=1.0, b_1=1.0)
    said = "study.toml names the specimen of 1 recording: --specimen-by does not apply there"
    asked = ("--specimen-by", r"(b)_\d", "-o", tmp_path / "out", "-q", *QUICK)
    ended = run("fit", folder, *asked, code=0, said=said)
    found = read_json(tmp_path / "out" / "identification.json")["specimens"]
    assert {one["specimen"] for one in found} == {"liver", "b"}
    assert "fits no recording" not in ended.stderr
    assert "its own specimen" not in ended.stderr


def test_a_study_is_found_named_or_left_out_and_may_want_nothing_that_it_does_not_list(tmp_path):
    folder = lab(tmp_path / "lab", GROUPED, a1=1.0, a2=1.02)
    own = [str(folder / name) for name in ("a1.csv", "a2.csv")]

    def specimens(*args: object) -> list[str]:
        return [one["specimen"] for one in run("inspect", *args, "--json", code=0).json()]

    for args in ([folder / "study.toml"], [folder, "--study", folder / "study.toml"], [folder]):
        assert specimens(*args) == ["kidney"] * 2, args
    assert specimens(folder, "--no-study") == own
    # a recording that is named alone follows the study beside it
    assert specimens(folder / "a1.csv") == ["kidney"]
    assert specimens(folder / "a1.csv", "--no-study") == own[:1]
    write_log(folder / "b.csv", label=None)
    assert specimens(folder) == ["kidney", "kidney", str(folder / "b.csv")]
    write_study(folder, f"[study]\nonly_listed = true\n{GROUPED}")
    assert specimens(folder) == ["kidney"] * 2


def test_a_study_that_names_none_of_the_trials_says_so(tmp_path):
    lab(tmp_path / "other", GROUPED, a1=1.0)
    folder = write_log(tmp_path / "lab" / "b.csv").parent
    study = ("--study", tmp_path / "other" / "study.toml", "-o", tmp_path / "out", *QUICK)
    assert "1 of 1 trials are not named by the study" in run("fit", folder, *study, code={0, 4}).stderr
    write_study(tmp_path / "other", "[study]\ntitle = 'of no trial'\n")
    assert "not named" not in run("fit", folder, *study, code={0, 4}).stderr


def test_two_studies_at_once_are_a_question_for_the_user(tmp_path):
    folders = [lab(tmp_path / name, GROUPED, a1=1.0) for name in ("x", "y")]
    run("fit", *folders, "-o", tmp_path / "out", code=2, said="--study")


def test_an_excluded_trial_is_shown_with_the_numbers_it_would_have_moved(tmp_path):
    manifest = GROUPED + "[[exclude]]\nfile = 'a3.csv'\nbecause = 'the tool <slipped>'\n"
    code, document = fit(lab(tmp_path / "lab", manifest, a1=1.0, a2=1.0, a3=1.6), out=tmp_path / "out")
    assert code in (0, 4)
    assert not document["refused"]
    (row,) = document["study"]["exclusions"]
    assert (row["because"], row["specimen"], row["note"]) == ("the tool <slipped>", "kidney", None)
    moved = {one["name"]: one for one in row["with_it"]}
    without = value(document, "kidney", STIFFNESS)
    assert moved[STIFFNESS]["without"] == without
    # the same fit of all three, done apart
    _, whole = fit(lab(tmp_path / "all", GROUPED, a1=1.0, a2=1.0, a3=1.6), out=tmp_path / "out-all")
    assert moved[STIFFNESS]["with"] == pytest.approx(value(whole, "kidney", STIFFNESS), rel=1e-9)
    assert moved[STIFFNESS]["with"] > 1.05 * without
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "the tool &lt;slipped&gt;" in page
    assert "With it" in page


def test_a_window_that_study_and_command_line_leave_empty_is_named(tmp_path):
    said = "[[override]]\nfile = 'a1.csv'\nhold_from_s = 2.0\nbecause = 'moved'\n"
    folder = lab(tmp_path / "lab", GROUPED + said, a1=1.0)
    told = ("hold_from_s is 2.0 and end_s 1.5", "moved")
    run("inspect", folder / "a1.csv", "--hold-to", "1.5", code=2, said=told)


def test_a_sheet_picked_by_name_needs_no_other_that_the_study_names(tmp_path):
    said = [f"[[trial]]\nfile = 'w.xlsx'\nsheet = '{name}'\nspecimen = 'cut'\n" for name in ("S1", "S2")]
    folder = lab(tmp_path / "lab", "".join(said))
    book = write_workbook(folder / "w.xlsx", "S1", "S2")
    code, document = fit(f"{book}::S1", out=tmp_path / "out")
    assert code in (0, 4)
    assert not document["refused"]
    assert [one["specimen"] for one in document["specimens"]] == ["cut"]


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
    step = np.arange(120.0)
    write_csv(folder / "rigid.csv", step / 50, 0.004 * step, np.maximum(0.0, 4.0 * (step - 20)))
    run("calibrate-frame", folder / "rigid.csv", "-o", folder / "frame.json", "-q", code=0)
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


def test_a_damaged_frame_file_is_refused_by_name(tmp_path):
    folder = lab(tmp_path / "lab", "[calibration]\nframe = 'frame.json'\n", a=1.0)
    (folder / "frame.json").write_text('{"schema": "tissueid/frame/1"}', encoding="utf-8")
    run("fit", folder, "-o", tmp_path / "out", code=3, said=("frame.json", "calibrate-frame"))


def found_in(document: dict[str, Any]) -> dict[str, Any]:
    """Results of each specimen, but for the places of its recordings."""
    return {
        one["specimen"].rsplit("/", 1)[-1]: (one["parameters"], one["nrmsd"], one["n_samples"])
        for one in document["specimens"]
    }


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_study_at_a_url_is_that_of_a_folder(tmp_path, workers):
    fsspec = pytest.importorskip("fsspec")
    folder, system = tmp_path / "lab", fsspec.filesystem("memory")
    for name, times in (("a", 1.0), ("b", 1.3)):
        log = write_log(folder / f"{name}.csv", label=None, force_times=times)
        system.pipe_file(f"/remote/{name}.csv", log.read_bytes())
    # a file system in memory is that of this process
    where = "memory://remote" if workers == "1" else f"file://{folder}"
    _, local = fit(folder, *QUICK, out=tmp_path / "local")
    _, remote = fit(where, *QUICK, "--workers", workers, out=tmp_path / "remote")
    system.rm("/remote", recursive=True)
    assert len(local["specimens"]) == 2
    assert found_in(remote) == found_in(local)


def logs(gains: Sequence[float]) -> list[TrialFit]:
    (one,) = specimen_fit(trials=1).trials
    return [replace(one, path=f"run_{i}.csv", gain=gain) for i, gain in enumerate(gains, start=1)]


def test_logs_that_differ_much_are_asked_after_and_their_order_is_that_of_the_files():
    assert spread_flags(logs([1.0, 1.04, 0.97, 1.01])) == []
    assert spread_flags(logs([1.0])) == []
    (flag,) = spread_flags(logs([0.7, 1.0, 1.3]))
    assert flag.values["sd_ln_gain"] == pytest.approx(np.log([0.7, 1.0, 1.3]).std(ddof=1))
    assert (flag.values["lowest"], flag.values["highest"]) == (0.7, 1.3)
    assert "run_1.csv" in flag.message
    assert "run_3.csv" in flag.message
    (one,) = logs([1.0])
    (flag,) = spread_flags([replace(one, path=f"run_{k}.csv", time_ratio=k) for k in (1.4, 1.0, 0.6)])
    assert flag.code == "relaxation_spread"
    assert flag.message.startswith(
        "relaxation time differs by 43 % (sd) between logs, from 0.60 (run_0.6.csv"
    )
    (flag,) = order_effect(logs([1.0, 0.95, 0.9, 0.85]), [None] * 4)
    assert "from file 1 to file 4" in flag.message
    assert order_effect(logs([1.0, 0.9, 0.8]), [1, 2, 3]) == []
    assert order_effect(logs([1.0, 1.0, 1.0, 1.0]), [1, 2, 3, 4]) == []


def test_stiffness_that_follows_the_order_is_said_with_its_change():
    rng = np.random.default_rng(31)
    runs = list(range(1, 11))
    falling = np.exp(-0.02 * np.array(runs) + 0.005 * rng.standard_normal(10))
    (flag,) = order_effect(logs(falling), runs)
    # nine steps of -2 %, each known to 0.5 % over 9^0.5
    assert flag.values["change"] == pytest.approx(np.expm1(-0.18), abs=0.01)
    assert flag.values["p"] < 1e-6
    assert "falls by" in flag.message
    # the order is that of the runs, not of the files
    (same,) = order_effect(logs(falling[::-1]), runs[::-1])
    assert same.values["change"] == pytest.approx(flag.values["change"])


def test_scatter_is_no_order_effect_more_often_than_the_chance_it_states():
    rng = np.random.default_rng(32)
    found = sum(
        bool(order_effect(logs(np.exp(0.05 * rng.standard_normal(8))), list(range(8)))) for _ in range(400)
    )
    # p < 0.01: 4 expected, 13 is the upper 99.99 % bound of a binomial of 400
    assert found <= 13


def test_a_first_test_that_is_stiffer_than_all_others_is_said():
    gains = [1.2, 1.0, 1.01, 0.99, 1.005, 0.995]
    (flag,) = order_effect(logs(gains), [None] * 6)
    assert flag.message.startswith("the first file is 20.0 % stiffer than the other 5")
    assert flag.values["first"]
    rng = np.random.default_rng(33)
    found = sum(
        bool(order_effect(logs(np.exp(0.05 * rng.standard_normal(6))), [None] * 6)) for _ in range(400)
    )
    # a stiffer first, a softer one and a slope: 10 expected at most
    assert found <= 19
    stiffer = np.exp(0.035 * rng.standard_normal((400, 6)) + np.log([1.2, 1.0, 1.0, 1.0, 1.0, 1.0]))
    assert sum(bool(order_effect(logs(gains), [None] * 6)) for gains in stiffer) >= 0.7 * len(stiffer)


@pytest.mark.parametrize(
    ("rows", "sites", "rest"),
    [
        ([{"site": "A"}, {"site": "B"}], None, None),
        ([{}, {}], None, None),
        ([{"site": "A", "rest_s": 60.0}, {"site": "A", "rest_s": 30.0}, {"site": "B"}], ["A"], 30.0),
        ([{"site": "A"}, {"site": "A"}], ["A"], None),
    ],
)
def test_a_site_that_was_tested_twice_is_named_with_its_rest(rows, sites, rest):
    flags = repeated_sites(logs([1.0] * len(rows)), rows)
    if sites is None:
        assert flags == []
        return
    (flag,) = flags
    assert flag.values["sites"] == sites
    assert flag.values["times"] == [2]
    assert flag.values.get("shortest_rest_s") == rest


@pytest.mark.parametrize(
    ("hashes", "again"), [("abc", []), ("aba", ["run_3.csv"]), ("aaa", ["run_2.csv", "run_3.csv"])]
)
def test_copies_of_a_recording_are_told(hashes, again):
    trials = logs([1.0] * 3)
    rows = [
        {"path": one.path, "sheet": one.sheet, "sha256": h} for one, h in zip(trials, hashes, strict=True)
    ]
    flags = copies(trials, rows)
    assert [one.values["copies"] for one in flags] == ([again] if again else [])
    assert all(
        f"{len(again)} of 3 recordings are copies ({again[0]} of run_1.csv)" in one.message for one in flags
    )
