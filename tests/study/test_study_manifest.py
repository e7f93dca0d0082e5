"""study.toml: what it means, and how it is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import STUDY_HEAD, write_study

from tissueid.errors import InputError, UsageError
from tissueid.ingest.manifest import line_of, lines_of_toml, read_study, unmatched_files
from tissueid.trial import Protocol


def refused(folder: Path, text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        read_study(write_study(folder, text))
    assert caught.value.code == "invalid_study"
    assert caught.value.path == str(folder / "study.toml")
    return caught.value


@pytest.mark.parametrize(
    ("table", "line", "key", "value"),
    [
        ("[[specimen]]\nname = 'k'\n", 'thickness = "2 cm"', "thickness_mm", 20.0),
        ("[[specimen]]\nname = 'k'\n", "thickness_mm = 20", "thickness_mm", 20),
        ("[[specimen]]\nname = 'k'\n", 'thickness_mm = "0.02 m"', "thickness_mm", 20.0),
        ("[[specimen]]\nname = 'k'\n", 'age = "26 weeks"', "age_years", 26 * 7 / 365.25),
        ("[[specimen]]\nname = 'k'\n", 'time_post_mortem = "90 min"', "time_post_mortem_h", 1.5),
        ("[[specimen]]\nname = 'k'\n", 'temperature = "310.15 K"', "temperature_C", 37.0),
        ("[[specimen]]\nname = 'k'\n", 'temperature = "-20 °C"', "temperature_C", -20.0),
        ("[[protocol]]\nname = 'p'\n", 'speed = "250 mm/min"', "speed_mm_s", 250 / 60),
        ("[calibration]\n", 'frame_stiffness = "1.2 kN/mm"', "frame_stiffness_N_per_mm", 1200.0),
        ("[calibration]\n", 'load_cell_capacity = "5 kN"', "load_cell_capacity_N", 5000.0),
        ("[calibration]\n", 'sampling = "1 kHz"', "sampling_Hz", 1000.0),
        ("[calibration]\n", 'force_filter = "10 ms"', "force_filter_s", 0.01),
        ("[tip]\n", 'half_angle = "45°"', "half_angle_deg", 45.0),
        ("[study]\n", "date = 2024-05-31", "date", "2024-05-31"),
    ],
)
def test_one_quantity_has_one_key_and_one_unit_inside(tmp_path, table, line, key, value):
    study = read_study(write_study(tmp_path, table + line + "\n"))
    tables = [study.about, study.tip, study.calibration.values, *study.specimens.values()]
    (found,) = [one for one in [*tables, *study.protocols.values()] if key in one]
    # a conversion through base units is good to a few units in the last place
    assert found[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-12))


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[study]\nspeces = 'pig'\n", 3, ["speces", "species"]),
        ("[specimens]\nname = 'k'\n", 2, ["specimens", "specimen"]),
        ("[[specimen]]\nname = 'k'\n\nthickness = 5\n", 5, ["thickness = 5", "no unit", '"5 mm"']),
        ("[[specimen]]\nname = 'k'\nthickness = '5 kg'\n", 4, ["kg", "mm"]),
        ("[[specimen]]\nname = 'k'\nthickness = '0,5 mm'\n", 4, ["0,5 mm", "decimal comma"]),
        ("[[specimen]]\nname = 'k'\nthickness = '5'\n", 4, ["unit"]),
        ("[[specimen]]\nname = 'k'\nthickness_mm = -5\n", 4, ["thickness_mm", "-5"]),
        ("[[specimen]]\nname = 'k'\nthickness_mm = 5\nthickness = '5 mm'\n", 5, ["twice"]),
        ("[[specimen]]\nspecies = 'pig'\n", 2, ["name"]),
        ("[[specimen]]\nname = 'k'\n[[specimen]]\nname = 'k'\n", 5, ["twice", "line 3"]),
        ("[[specimen]]\nname = 'liver'\n[[trial]]\nfile = 'a'\nspecimen = 'livr'\n", 6, ["livr", "liver"]),
        ("[[trial]]\nfile = 'a.csv'\nprotocol = 'hold'\n", 4, ["hold", "[[protocol]]"]),
        ("[tip]\nshape = 'round'\n", 3, ["round", "sphere"]),
        ("[[exclude]]\nfile = 'a.csv'\n", 2, ["[[exclude]] 1: because is missing. because: Why"]),
        ("[tip]\nshape = 'flat'\n[[override]]\nfile = 'a'\n", 4, ["[[override]] 1: because is missing"]),
        ("[[exclude]]\nfile = 5\nbecause = 'x'\n", 3, ["[[exclude]] 1, file: 5 must be text in quotes"]),
        ("[[trial]]\nfile = 'a'\nrun = 'x'\n", 4, ["[[trial]] 1, run: 'x' must be a whole number"]),
        ("[tip]\nradius_mm = true\n", 3, ["[tip] radius_mm: True must be a number"]),
        ("[[exclude]]\nfile = 'a'\nbecause = ''\n", 4, ["[[exclude]] 1, because: it is empty"]),
        ("[[override]]\nfile = 'a'\ncontact_sd_mm = 1\nbecause = 'x'\n", 2, ["contact_mm"]),
        ("[[override]]\nfile = 'a'\nunits = {force = 'mm'}\nbecause = 'x'\n", 4, ["mm", "force"]),
        ("[[override]]\nfile = 'a'\ncolumns = {velocity = 'v'}\nbecause = 'x'\n", 4, ["velocity"]),
        ("[calibration]\nframe = 'x.json'\nframe_stiffness_N_per_mm = 5\n", 2, ["exclude each other"]),
        ("[calibration]\nframe = 'nowhere.json'\n", 3, ["nowhere.json", "calibrate-frame"]),
        ("[study]\ntitle = unquoted\n", 3, ["TOML", "unquoted"]),
        ("[study]\ntitle = 'a'\ntitle = 'b'\n", 4, ["TOML"]),
        ("[calibration]\nsampling_Hz = inf\n", 3, ["finite"]),
        ("[priors.statik_1_N_per_mm]\nmean = 1\nsd = 1\n", 2, ["statik_1", "did you mean static_1_N_per_mm"]),
        ("[priors.static_1]\nmean = 1\nsd = 1\n", 2, ["did you mean static_1_N_per_mm?"]),
        ("[priors.stiffness_0_b2]\nmean = 1\nsd = 1\n", 2, ["did you mean stiffness_0_N_per_mm_b2?"]),
        ("[priors.viscosity_N_s_per_mm]\nmean = 1\nsd = 1\n", 2, ["K times tau"]),
        ("[priors.static_1_N_per_mm]\nmean = 1\n", 2, ["[priors.static_1_N_per_mm]: sd is missing", "N/mm"]),
        ("[priors.static_1_N_per_mm]\nmean = 1\nsd = 0\n", 4, ["[priors.static_1_N_per_mm] sd", "above 0"]),
        ("[priors.static_1_N_per_mm]\nmean = 1\nsd = '1 kg'\n", 4, ["kg", "N/mm"]),
        ("[priors.static_2_N_per_mm2]\nmean = '1 N/mm'\nsd = 1\n", 3, ["N/mm", "N/mm2"]),
        ("[priors.static_1_N_per_mm]\nmean = '1'\nsd = 1\n", 3, ["mean = \"1\" has no unit"]),
        ("[priors.static_1_N_per_mm]\nmean = 1\nsd = 1\nmedian = 2\n", 2, ["median"]),
        ("[priors]\nstatic_1_N_per_mm = 20\n", 3, ["must be a table"]),
        ("[priors.relaxation_time_s]\nmedian = 1\nsd_ln = 1\n", 2, ["[[", "list"]),
        ("[[priors.relaxation_time_s]]\nmedian = -1\nsd_ln = 1\n", 3, ["[[priors.relaxation_time_s]] 1, me"]),
        (
            "priors.relaxation_time_s = [{median = 2, sd_ln = 1},\n{median = 1, sd_ln = 1}]",
            2,
            ["[[priors.relaxation_time_s]] 2, median", "shortest relaxation time first"],
        ),
        ("[priors.phi]\nlow = 0.9\nhigh = 0.5\n", 3, ["low = 0.9 is not below high = 0.5"]),
        ("[priors.phi]\nlow = 0.9\nhigh = 1.5\n", 4, ["[priors.phi] high", "1.5"]),
        ("[priors.phi]\nlow = 0.9\n", 2, ["high is missing"]),
        ("[priors.gain_sd]\nscale = true\n", 3, ["True must be a number"]),
        ("[priors.sigma_N]\nmedian = nan\nsd_ln = 1\n", 3, ["finite"]),
        (4 * "[[priors.relaxation_time_s]]\nmedian = 1\nsd_ln = 1\n", None, ["relaxation_time_s"]),
        ("[priors.static_exponent]\nmean = 1\nsd = 1\n", 2, ["static_exponent takes median and sd_ln"]),
        ("[priors.static_N_per_mm]\nmedian = 1\nsd_ln = 1\n", 2, ["static_N_per_mm takes mean and sd"]),
        ("[priors.static_exponant]\nmedian = 1\nsd_ln = 1\n", 2, ["did you mean static_exponent?"]),
        ("[priors.static_exponent]\nmedian = -1\nsd_ln = 1\n", 3, ["static_exponent"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_line_and_the_way_out(tmp_path, text, line, words):
    error = refused(tmp_path, text)
    assert error.line == line, error
    for word in words:
        assert word in error.message


@pytest.mark.parametrize(
    ("content", "line", "words"),
    [
        (b"[study]\n", None, "tissueid/study/1"),
        (b'\nschema = "tissueid/study/2"\n', 2, "tissueid/study/2"),
        (f"{STUDY_HEAD}\n".encode() + b"[study]\ntitle = 'M\xfcller'\n", 3, "UTF-8"),
        # a byte order mark and line ends of Windows
        (
            f"\ufeff{STUDY_HEAD}\n[study]\ntitle = 'Müller'\nspeces = 'pig'\n".replace("\n", "\r\n").encode(),
            4,
            "speces",
        ),
    ],
)
def test_another_schema_and_other_bytes_are_refused_with_their_line(tmp_path, content, line, words):
    (tmp_path / "study.toml").write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_study(tmp_path)
    assert line is None or caught.value.line == line


def test_a_missing_study_and_names_that_are_not_there_are_told(tmp_path):
    with pytest.raises(UsageError, match="study init"):
        read_study(tmp_path)
    study = read_study(
        write_study(tmp_path, "[[trial]]\nfile = 'gone.csv'\n[[exclude]]\nfile='g*'\nbecause='x'\n")
    )
    found = unmatched_files(study)
    assert [(one.line, one.code) for one in found] == [(2, "study_unmatched"), (4, "study_unmatched")]
    assert "gone.csv" in found[0].message


def test_lines_are_those_of_keys_behind_long_values_and_comments():
    text = (
        '# [not a table]\na = """\n[[x]]\nb = 1\n"""\n[t] # a comment\n"c d" = [\n  "]", # ]\n  2,\n]\n'
        "[[u.v]]\ne = {f = 1}\n[[u.v]]\n[u.v.w]\ng = '#'\nh.i = 2\n"
    )
    lines = lines_of_toml(text)
    expected = {
        ("a",): 2, ("t",): 6, ("t", "c d"): 7, ("u", "v", 0): 11, ("u", "v", 0, "e"): 12, ("u", "v", 1): 13,
        ("u", "v", 1, "w"): 14, ("u", "v", 1, "w", "g"): 15, ("u", "v", 1, "w", "h", "i"): 16,
    }  # fmt: skip
    assert lines == expected
    # inside an inline table the key around it is the nearest
    assert line_of(lines, ("u", "v", 0, "e", "f")) == 12


def test_later_tables_win_key_by_key_and_reasons_are_gathered(tmp_path):
    for name in ("a1.csv", "a2.csv", "b [1].csv"):
        (tmp_path / name).write_text("x")
    study = read_study(
        write_study(
            tmp_path,
            "[[trial]]\nfile = '*.csv'\nsite = 'A'\nrun = 1\n[[trial]]\nfile = 'a2.csv'\nrun = 2\n"
            "[[trial]]\nfile = 'b [1].csv'\nsheet = 'S'\nsite = 'B'\n"
            "[[override]]\nfile = 'a*.csv'\nunits = {force = 'mN'}\nbecause = 'one'\n"
            "[[override]]\nfile = 'a2.csv'\nunits = {displacement = 'um'}\nbecause = 'two'\n"
            "[[exclude]]\nfile = 'a1.csv'\nbecause = 'three'\n",
        )
    )
    assert dict(study.decision(str(tmp_path / "a1.csv"), None).trial) == {"site": "A", "run": 1}
    second = study.decision(str(tmp_path / "a2.csv"), None)
    assert dict(second.trial) == {"site": "A", "run": 2}
    assert second.override == {"units": {"force": "mN", "displacement": "um"}, "because": "one; two"}
    assert second.excluded is None
    assert study.decision(str(tmp_path / "a1.csv"), None).excluded == "three"
    # a name with brackets that exists is a name, not a glob; a sheet is one sheet
    assert study.decision(str(tmp_path / "b [1].csv"), "S").trial["site"] == "B"
    assert study.decision(str(tmp_path / "b [1].csv"), "T").trial["site"] == "A"
    assert not study.decision(str(tmp_path / "c.csv"), None).listed


def test_a_window_that_ends_before_it_starts_is_refused_whichever_tables_state_it(tmp_path):
    (tmp_path / "a.csv").write_text("x")
    error = refused(
        tmp_path,
        "[[override]]\nfile = '*.csv'\nstart_s = 5\nbecause = 'x'\n"
        "[[override]]\nfile = 'a.csv'\nend_s = 3\nbecause = 'y'\n",
    )
    assert error.line == 2
    assert "start_s = 5 is not before end_s = 3" in error.message


def test_paths_are_compared_wherever_they_are_seen_from(tmp_path, monkeypatch):
    (tmp_path / "día 1").mkdir()
    (tmp_path / "día 1" / "a b.csv").write_text("x")
    study = read_study(write_study(tmp_path, "[[trial]]\nfile = 'día 1\\a b.csv'\nsite = 'A'\n"))
    monkeypatch.chdir(tmp_path / "día 1")
    assert study.decision("a b.csv", None).trial["site"] == "A"
    assert study.decision("../día 1/a b.csv", None).trial["site"] == "A"


def test_a_protocol_fills_in_what_files_do_not_state_and_a_frame_has_an_sd(tmp_path):
    (tmp_path / "a.csv").write_text("x")
    study = read_study(
        write_study(
            tmp_path,
            "[tip]\nradius_mm = 2.0\n"
            "[[protocol]]\nname = 'p'\nspeed_mm_s = 4.0\ndepth_mm = 8.0\nhold_s = 30.0\n"
            "[[trial]]\nfile = 'a.csv'\nprotocol = 'p'\n",
        )
    )
    decision = study.decision(str(tmp_path / "a.csv"), None)
    stated = Protocol(kind="comp", speed_mm_s=1.0, hold_s=0.0)
    assert study.protocol(decision, stated) == Protocol("comp", 1.0, 8.0, 0.0, 2.0)
    study = read_study(write_study(tmp_path, "[calibration]\nframe_stiffness_N_per_mm = 1000\n"))
    assert study.calibration.values["frame_stiffness_N_per_mm_sd"] == 100.0
    frame = study.calibration.frame
    # sd(1/k) = sd(k) / k^2
    assert frame.covariance[0, 0] == pytest.approx((100.0 / 1000.0**2) ** 2)
