"""study.toml, its priors and its rendering: what they mean, and how they are refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cohort_outputs import study_of
from command_line import STUDY_HEAD, run, write_study
from fit_factory import THETA, specimen_fit
from posterior_factory import sampled
from study_folder import fit, lab, specimen
from typed_call import typed_call

from tissueid import FitOptions, IdentifyOptions, identify
from tissueid.documents import plain
from tissueid.documents.base import typed
from tissueid.documents.study import Priors as Recorded
from tissueid.errors import InputError, UsageError
from tissueid.haptics.limits import GuardLimits
from tissueid.ingest.manifest import line_of, lines_of_toml, read_study, unmatched_files
from tissueid.ingest.stated import unit_of
from tissueid.manifest import Study
from tissueid.model import grammar
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.laws.static import Power
from tissueid.priors import PopulationPriors, Priors, SpreadPrior
from tissueid.rendering.precheck import Demands, check_before_force
from tissueid.rendering.tissue_block import Tissue
from tissueid.report.rendering_words import NORMALISED
from tissueid.result import SpecimenFit
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.store.schema import first_problem
from tissueid.study.completeness import ITEMS, completeness_of_result
from tissueid.study.pages import rendering_of
from tissueid.trial import Axes, Protocol


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
    stated = Protocol(kind="comp", speed_mm_s=1.0, hold_s=0.0, load_limit_N=20.0)
    assert study.protocol(decision, stated) == Protocol("comp", 1.0, 8.0, 0.0, 2.0, load_limit_N=20.0)
    study = read_study(write_study(tmp_path, "[calibration]\nframe_stiffness_N_per_mm = 1000\n"))
    assert study.calibration.values["frame_stiffness_N_per_mm_sd"] == 100.0
    frame = study.calibration.frame
    # sd(1/k) = sd(k) / k^2
    assert frame.covariance[0, 0] == pytest.approx((100.0 / 1000.0**2) ** 2)


def study_in(folder: Path, text: str) -> Study:
    return read_study(write_study(folder, text))


def priors_in(folder: Path, text: str) -> Priors:
    return study_in(folder, text).priors


WHOLE = """
[priors]
static_1_N_per_mm = {mean = 20.0, sd = 5.0}
stiffness_0_N_per_mm_b2 = {mean = 3, sd = 2}
relaxation_time_s = [{median = 0.02, sd_ln = 0.5}, {median = 4, sd_ln = 0.7}]
sigma_N = {median = 0.5, sd_ln = 0.3}
phi = {low = 0.2, high = 0.95}
gain_sd = {scale = 0.05}
"""


def test_every_prior_that_is_stated_is_kept_and_recorded_as_a_valid_table(tmp_path):
    found = priors_in(tmp_path, WHOLE)
    assert dict(found.linear) == {"static_1_N_per_mm": (20.0, 5.0), "stiffness_0_N_per_mm_b2": (3, 2)}
    assert found.relaxation_time_s == (SpreadPrior(0.02, 0.5), SpreadPrior(4, 0.7))
    assert found.sigma_N == SpreadPrior(0.5, 0.3)
    assert found.phi == (0.2, 0.95)
    assert found.gain_sd == 0.05
    for nothing in ("", "[priors]\n"):
        assert priors_in(tmp_path, nothing) == Priors()
    found = priors_in(tmp_path, WHOLE)
    document = {"schema": "tissueid/study/1", "priors": found.as_json()}
    assert first_problem(document, "study") is None
    assert document["priors"]["relaxation_time_s"][1] == {"median": 4, "sd_ln": 0.7}
    assert document["priors"]["static_1_N_per_mm"] == {"mean": 20.0, "sd": 5.0}
    # a default that is in use is recorded as well
    assert Priors().as_json() == {"phi": {"low": 0.0, "high": 1.0}, "gain_sd": {"scale": 0.3}}


def test_numbers_may_carry_another_unit(tmp_path):
    stated = {
        "static_1_N_per_mm": ("'0.02 kN/mm'", "'5 N/mm'", (20, 5)),
        "static_2_N_per_mm2": ("'2 N/mm^2'", "'1 N/mm2'", (2, 1)),
        "static_3_N_per_mm3": ("'1 kN/cm3'", "'1 N/cm^3'", (1, 1e-3)),
        "stiffness_1_N_per_mm2_b3": ("'1e6 N/m2'", "1", (1, 1)),
    }
    text = "".join(f"[priors.{name}]\nmean = {mean}\nsd = {sd}\n" for name, (mean, sd, _) in stated.items())
    times = "[[priors.relaxation_time_s]]\nmedian = '20 ms'\nsd_ln = 0.5\n"
    noise = "[priors.sigma_N]\nmedian = '500 mN'\nsd_ln = 1\n"
    found = priors_in(tmp_path, text + times + noise)
    # a conversion through base units is good to a few units in the last place
    for name, (_, _, expected) in stated.items():
        assert found.linear[name] == pytest.approx(expected, rel=1e-12)
    assert found.relaxation_time_s[0].median == pytest.approx(0.02, rel=1e-12)
    assert found.sigma_N.median == pytest.approx(0.5, rel=1e-12)


def test_priors_of_the_population_are_read_and_the_rest_keeps_its_default(tmp_path):
    found = study_in(
        tmp_path,
        "[population]\nmean_sd = 8\n[population.between]\nmedian = 0.15\nsd_ln = 0.3\n"
        "[population.tails]\nshape = 3\nrate = 0.2\n",
    )
    stated = PopulationPriors(mean_sd=8, between=SpreadPrior(0.15, 0.3), tail_shape=3, tail_rate=0.2)
    assert found.population == stated
    assert study_in(tmp_path, "").population is None
    with pytest.raises(InputError, match="sd_ln is missing") as refused:
        study_in(tmp_path, "[population]\n[population.between]\nmedian = 0.15\n")
    assert refused.value.line == 3


STATED = (
    "[priors]\nstatic_1_N_per_mm = {mean = 30.0, sd = 0.5}\n"
    "relaxation_time_s = [{median = '21 ms', sd_ln = 0.02}]\n[calibration]\nload_cell_class = 0.5\n"
)


def test_a_stated_prior_enters_the_posterior_and_is_shown_with_its_shrinkage(tmp_path):
    folder = lab(tmp_path / "lab", STATED, a=1.0)
    sample = ("--sampler", "emcee", "--draws", "400")
    _, document = fit(folder, *sample, out=tmp_path / "out")
    assert document["study"]["priors"]["static_1_N_per_mm"] == {"mean": 30.0, "sd": 0.5}
    assert document["provenance"]["study"]["priors"] == document["study"]["priors"]
    (found,) = document["specimens"]
    rows = {row["name"]: row for row in found["priors"]}
    assert rows["static_1_N_per_mm"]["stated"] is True
    assert "30" in rows["static_1_N_per_mm"]["prior"]
    assert rows["force_gain"]["stated"] is True
    assert rows["displacement_gain"]["stated"] is False
    # a relaxation time that is known to 2 % before can't be known worse after: sd of 400 draws, 3.5 % each
    time = next(one for one in specimen(document, "a")["parameters"] if one["name"] == "relaxation_time_s")
    sampled = time["detail"].get("posterior") or time
    assert sampled["sd"] <= 1.15 * 0.02 * 0.021
    run("validate", tmp_path / "out", code=0)


def test_parameters_of_any_law_have_priors_and_are_recorded(tmp_path):
    found = priors_in(
        tmp_path,
        "[priors.static_N_per_mm]\nmean = '2 N/mm'\nsd = 1\n"
        "[priors.static_exponent]\nmedian = 1.5\nsd_ln = 0.1\n"
        "[priors.relaxation_ratio_b2]\nmedian = 0.5\nsd_ln = 1\n",
    )
    linear = {"static_N_per_mm": (2.0, 1.0)}
    shapes = {"static_exponent": SpreadPrior(1.5, 0.1), "relaxation_ratio_b2": SpreadPrior(0.5, 1)}
    assert (dict(found.linear), dict(found.shapes)) == (linear, shapes)
    recorded = found.as_json()
    assert typed(recorded, Recorded) is not None
    assert {*linear, *shapes} <= set(recorded)


def test_a_prior_that_the_fitted_law_has_no_parameter_for_is_refused(tmp_path):
    study = study_in(tmp_path, "[priors.static_exponent]\nmedian = 1.5\nsd_ln = 0.1\n")
    with pytest.raises(UsageError, match=r"static_exponent\] is of no parameter of kelvin-voigt"):
        identify([], study=study)
    options = IdentifyOptions(fit=FitOptions(model="power * prony:2"))
    assert identify([], study=study, options=options).exit.code == 3


def test_a_law_that_is_registered_later_has_its_priors(tmp_path, monkeypatch):
    text = "[priors.static_own]\nmedian = 1.5\nsd_ln = 0.1\n"
    with pytest.raises(InputError, match="no prior of 'static_own'"):
        priors_in(tmp_path, text)
    spec = replace(Power.shapes[0].spec, name="static_own")
    own = type("Own", (Power,), {
        "about": replace(Power.about, key="own"),
        "shapes": (replace(Power.shapes[0], spec=spec),),
    })  # fmt: skip
    monkeypatch.setitem(grammar._OWN, "own", own)
    assert priors_in(tmp_path, text).shapes["static_own"] == SpreadPrior(1.5, 0.1)


completeness_of_result = typed_call(completeness_of_result)
rendering_of = typed_call(rendering_of)


def rendering(fit: SpecimenFit) -> Any:
    posteriors = posteriors_of_fits([fit])
    return rendering_of(plain(fit.as_json()), posteriors[0] if posteriors else None)


def test_scales_and_damping_are_those_of_the_check_before_force():
    found = rendering(sampled(specimen_fit()))
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=6.0)
    tissue = Tissue(model=model, theta=THETA, speeds_mm_s=(0.5, 4.0), tip_radius_mm=3.0)
    clamp = GuardLimits.simulated().clamp_N
    check = check_before_force(tissue, Demands(clamp, 0.5, 1.5, travel_m=0.064))
    _, simulated = found.devices
    assert simulated.scale.force_scale == pytest.approx(check.scaling.force)
    assert simulated.scale.required_damping_N_s_per_m == pytest.approx(check.required_damping_N_s_per_m)
    # 6 mm at five-fold motion are 30 of the 40 mm that a session on it has
    assert simulated.outside_share == pytest.approx(1 - 30 / 40)
    assert simulated.fastest_hand_mm_s == pytest.approx(20.0)
    assert (found.passive, found.unique) == (True, True)
    assert found.draws == found.draws_passive == 500


def test_what_can_not_be_rendered_is_said_with_its_reason(monkeypatch):
    fit = specimen_fit()
    sinking = tuple(
        replace(one, detail={"estimate": -3.0}) if one.name == "stiffness_0_N_per_mm" else one
        for one in fit.parameters
    )
    assert rendering(replace(fit, parameters=sinking)).passive is False
    assert rendering(replace(fit, axes=Axes("1", "MPa"))) == NORMALISED
    weak = {"a weak device": Demands(2.0, 1e-9, 1.5)}
    monkeypatch.setattr("tissueid.study.pages._devices", lambda: weak)
    (row,) = rendering(specimen_fit()).devices
    assert "can't be felt on this device" in row.why


def test_without_a_study_nothing_is_stated_and_a_result_is_graded_by_what_it_carries():
    nothing = completeness_of_result(None)
    assert (nothing.grade, nothing.share, len(nothing.missing)) == ("F", 0.0, len(ITEMS))
    tables: dict[str, dict[str, Any]] = {item.table: {} for item in ITEMS}
    frame: dict[str, Any] = dict.fromkeys(("path", "sha256", "range_N"))
    frame |= dict.fromkeys(("force_N", "compliance_mm_per_N", "covariance"), ())
    words = {"authors": ["stated"], "shape": "sphere", "freeze_thaw_cycles": 1, "run": 1, "frame": frame}
    for item in ITEMS:
        key = item.keys[0]
        tables[item.table][key] = words.get(key, 1.0 if unit_of(key) or "class" in key else "stated")
    result = study_of(tuple(specimen_fit(name, trials=1) for name in "ab"))
    for name in ("study", "calibration", "tip"):
        result[name] |= tables[name]
    for name in ("specimen", "trial"):
        result[f"{name}s"] = [row | tables[name] for row in result[f"{name}s"]]
    assert completeness_of_result(result).grade == "A"
    result["specimens"][1]["storage"] = None
    (missing,) = completeness_of_result(result).missing
    assert (missing.keys, missing.where) == (("storage",), ("b",))
