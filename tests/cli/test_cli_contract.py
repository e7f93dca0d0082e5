"""``--json`` prints documents that the schemas describe; every exit code, end to end, and which one wins."""

import csv
import errno
import hashlib
import os
from unittest.mock import Mock

import pytest
from command_line import HEADER_LINES, LOG, QUICK, read_json, run, write_log

from tissueid.errors import exit_code
from tissueid.ingest import RECIPES
from tissueid.store import files
from tissueid.store.outputs import OutputSet

UNITS = {
    "static_1_N_per_mm": "N/mm", "static_2_N_per_mm2": "N/mm^2", "static_3_N_per_mm3": "N/mm^3",
    "stiffness_0_N_per_mm": "N/mm", "relaxation_time_s": "s", "viscosity_N_s_per_mm": "N s/mm",
}  # fmt: skip


@pytest.fixture(scope="module")
def rows():
    """The numbers of the committed log, read by nothing of tissueid."""
    with LOG.open(encoding="ascii", newline="") as stream:
        body = list(csv.reader(stream))[HEADER_LINES:]
    return [(float(t), float(x), float(f)) for t, x, f in body]


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    out = tmp_path_factory.mktemp("contract") / "out"
    return run("fit", LOG, "-o", out, "--json", *QUICK, code=0), out


def test_inspect_gives_first_last_and_peak_as_recorded(rows):
    ended = run("inspect", LOG, "--json", code=0)
    (one,) = ended.json()
    peak = max(rows, key=lambda row: abs(row[2]))
    for key, expected in (("first", rows[0]), ("last", rows[-1]), ("peak_force", peak)):
        # the same decimal text gives the same double: no tolerance
        assert tuple(one[key].values()) == expected, key
        assert list(one[key]) == ["time_s", "displacement_mm", "force_N"]
    assert one["n_samples"] == len(rows)
    assert one["compression_sign"] == 1
    assert {phase["kind"] for phase in one["phases"]} >= {"ramp", "hold"}
    assert [one[key] for key in ("path", "sheet", "recipe", "delimiter", "decimal")] == [
        str(LOG), None, "bluehill-csv", ",", ".",
    ]  # fmt: skip


def test_recorded_signs_stay_where_compression_is_negative(tmp_path):
    text = LOG.read_text(encoding="ascii").splitlines()
    head, body = text[:HEADER_LINES], [line.split(",") for line in text[HEADER_LINES:]]
    flipped = [f"{t},{-float(x)},{-float(f)}" for t, x, f in body]
    (tmp_path / "negative.csv").write_text("\n".join([*head, *flipped]), encoding="ascii")
    (one,) = run("inspect", tmp_path / "negative.csv", "--json").json()
    assert one["compression_sign"] == -1
    peak = max(body, key=lambda row: abs(float(row[2])))
    assert one["peak_force"]["force_N"] == -float(peak[2])
    assert one["last"]["displacement_mm"] == -float(body[-1][1])


@pytest.fixture(scope="module")
def of_10_Hz(datasets, tmp_path_factory):
    """The document of junk and of logs at 10 Hz, which do not identify the relaxation time."""
    folder = tmp_path_factory.mktemp("slow")
    (folder / "junk.csv").write_bytes(bytes(range(256)) * 8)
    logs = sorted((datasets / "paper-a-30-10Hz").glob("hold-8-*.csv"))
    asked = ("--json", *QUICK, "--require", "relaxation-time")
    return run("fit", folder / "junk.csv", *logs, "-o", folder / "out", *asked, code=7).json()


def test_inspect_is_valid_with_refusals_in_their_place(tmp_path):
    junk, empty = tmp_path / "junk.csv", tmp_path / "a folder"
    junk.write_bytes(bytes(range(256)) * 8)
    empty.mkdir()
    document = run("inspect", junk, LOG, empty, "--json", code=7).json("inspect")
    assert [one["path"] for one in document] == [str(junk), str(LOG), str(empty)]
    assert [one.get("error", {}).get("code") for one in document] == ["not_an_export", None, "no_recording"]


def test_fit_prints_identification_json_and_it_is_valid(fitted):
    ended, out = fitted
    assert ended.json("identification") == read_json(out / "identification.json")
    assert ended.json()["exit"] == {"code": 0, "reasons": []}
    public = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    bundles = {"bundle-paper-a.h5", "bundle.h5"}
    run_of_it = {"specimens.csv", "specimens", "index.sqlite"}
    assert public == bundles | run_of_it | {"identification.json", "curves.h5", "report.html"}


def test_parameters_fractions_and_windows_are_those_of_the_contract(fitted):
    (one,) = fitted[0].json()["specimens"]
    assert {entry["name"]: entry["unit"] for entry in one["parameters"]} == UNITS
    value = {entry["name"]: entry["value"] for entry in one["parameters"]}
    product = value["stiffness_0_N_per_mm"] * value["relaxation_time_s"]
    assert value["viscosity_N_s_per_mm"] == pytest.approx(product, rel=1e-9)
    (trial,) = one["trials"]
    # noise of 1 N on a range of 270 N
    assert trial["nrmsd"] == pytest.approx(1.0 / 270.0, rel=0.1)
    assert trial["rmse_N"] == pytest.approx(1.0, rel=0.05)
    assert 0.0 < trial["max_residual_fraction"] < 0.05
    assert abs(trial["residual_acf1"]) < 0.1
    (row,) = one["relaxation"]
    # 8 mm at 250 mm/min are 1.92 s, and the log ends with its hold at 31.92 s; one sample is 0.01 s
    assert row["window_s"] == pytest.approx([1.92, 31.92], abs=0.03)
    assert isinstance(row["tau_double_s"], list)
    assert isinstance(row["tau_triple_s"], list)
    assert {"tau_single_s", "nrmsd_single", "peak_force_N", "flags", "path", "sheet"} <= set(row)


def test_what_is_required_and_not_identified_comes_after_what_was_left_out(of_10_Hz):
    refused, missing = of_10_Hz["exit"]["reasons"]
    assert "junk.csv" in refused
    assert missing.endswith("not identified: relaxation_time_s")


def test_a_value_is_null_exactly_where_it_is_not_identified(of_10_Hz):
    found = [entry for one in of_10_Hz["specimens"] for entry in one["parameters"]]
    assert {entry["identified"] for entry in found} == {True, False}
    for entry in found:
        assert (entry["value"] is None) == (not entry["identified"]), entry["name"]
        if not entry["identified"]:
            assert "estimate" in entry["detail"], entry["name"]


def test_provenance_has_hashes_versions_options_and_no_time_stamp(fitted):
    provenance = fitted[0].json()["provenance"]
    assert provenance["inputs"][0]["sha256"] == hashlib.sha256(LOG.read_bytes()).hexdigest()
    assert set(provenance["versions"]) == {"emcee", "lmfit", "numba", "numpy", "scipy"}
    assert provenance["options"]["branches"] == 1
    assert provenance["options"]["seed"] == 0


def test_export_and_report_need_the_output_folder_alone(fitted, tmp_path):
    _, out = fitted
    assert run("export", out).json() == read_json(out / "identification.json")
    run("export", out, "-o", tmp_path / "copy.json")
    assert read_json(tmp_path / "copy.json") == run("export", out).json()
    assert run("report", out, "-o", tmp_path / "page.html").code == 0
    assert (tmp_path / "page.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html")
    # written anew in its folder, the set stays whole
    assert run("report", out).code == 0
    assert run("validate", out, "--json").json() == [{"path": str(out), "valid": True, "problem": None}]


@pytest.fixture
def junk(tmp_path):
    path = tmp_path / "junk.csv"
    path.write_bytes(bytes(range(256)) * 8)
    return path


PRESET = ("control", "--preset", "paper-a")
CALIBRATE = ("calibrate", "paper-a-30", "-o", "out")
FIT = ("fit", "log.csv", "--model")


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["fit", "--no-such-flag", "x"], "No such option"),
        (["inspcet", "x"], "Did you mean 'inspect'?"),
        (["zzzz"], "No such command"),
        (["inspect", "nowhere.csv"], "nowhere.csv"),
        (["fit", "nowhere/", "-o", "out"], "nowhere"),
        (["fit"], "Missing argument"),
        (["validate", "nowhere"], "nowhere"),
        (["report", "nowhere"], "nowhere"),
        (["export", "nowhere"], "nowhere"),
        (["synth", "no-such-recipe", "-o", "out"], "paper-a-30"),
        (["synth", "no-such-recipe.toml", "-o", "out"], "no-such-recipe.toml"),
        (["synth", "paper-a-22", "-o", "out", "--rate", "0"], "--rate"),
        (["synth", "paper-a-22", "-o", "out", "--rate", "nan"], "--rate"),
        (["synth", "paper-a-22", "-o", "out", "--seed", "-1"], "--seed"),
        (["synth", "paper-a-22", "-o", "out", "--dialect", "klingon"], "klingon"),
        (["fit", "x", "--branches", "4"], "--branches"),
        (["fti"], "Did you mean 'fit'?"),
        (["reports"], "Did you mean 'report'?"),
        (["valdate"], "Did you mean 'validate'?"),
        (["export", ".", "--specimen", "a"], "leave it out"),
        (["export", ".", "--format", "c-header", "--depth", "3"], "leave it out"),
        (["export", __file__, "--format", "trials"], "from the whole output folder"),
        (["control"], "give a bundle, or --preset, and not both"),
        (["control", "--preset", "nonsense"], "there is no preset 'nonsense'"),
        ([*PRESET, "--virtual-mass", "0.3"], "variant B bears from 0.396 kg on; take 0.594 kg"),
        ([*PRESET, "--variant", "A", "--virtual-mass", "1.2"], "or variant B"),
        ([*PRESET, "--interface", "0", "1", "1"], "the device needs a mass"),
        ([*PRESET, "--kr", "4000"], "overshoots within one sample"),
        (["calibrate", "nowhere"], "no such file, folder or recipe; recipes are paper-a-22"),
        ([*CALIBRATE, "--rate", "0"], "--rate is 0.0"),
        ([*CALIBRATE, "--phi", "0.9"], "--phi is the correlation of --noise ar1"),
        ([*CALIBRATE, "--noise", "ar1"], "needs its correlation here: add --phi"),
        ([*CALIBRATE, "--simulations", "3"], "3 is not in the range x>=20"),
        (["watch", "nowhere"], "there is no such folder"),
        ([*FIT, "cubic * prony"], "there are exponential, flat"),
        ([*FIT, "prony"], "STATIC * [STIFFNESS *] RELAXATION"),
        ([*FIT, "polynomial * prony:7"], "7 branches"),
        ([*FIT, "polynomial * prony", "--branches", "2"], "says it already"),
        (["fit", "a.csv", "--sampler", "none", "--draws", "500"], "takes no draws"),
        (["fit", "a.csv", "--mix-states", "--population", "no"], "--mix-states is of a population"),
        (["reproduce", "shakespeare"], "sadeghnejad"),
        (["reproduce", "pires", "--set", "surface=torus"], "hyperboloid, cone"),
        (["reproduce", "pires", "-o", "/dev/null/out"], "choose another folder"),
    ],
)
def test_wrong_usage_is_2(args, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(*args, code=2, said=said)
    # nothing is made for nothing
    assert list(tmp_path.iterdir()) == []


#: Options of reading, and of a fit, that can't be understood.
READING = [
    ("--columns zeit=t", "--columns"), ("--columns time", "--columns"), ("--units force=blorb", "blorb"),
    ("--specimen-by (", "not a regular expression"), ("--recipe nope", tuple(RECIPES)),
    ("--contact nan", "--contact"), ("--contact deep", "--contact"), ("--compression up", "--compression"),
]  # fmt: skip
FITTING = [
    ("--frequencies 0.1;1", "--frequencies"), ("--frequencies 0,1", "--frequencies"),
    ("--depths deep", "--depths"), ("--tip sphere", "sphere:3"), ("--tip pyramid:3", "not offered"),
    ("--tip cone:95", "half angle"), ("--thickness 5", "--tip"), ("--tip flat:2 --thickness -5", "thickness"),
    ("--tip flat:2 --poisson 0.6", "0.6"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("command", "args", "said"),
    [*(("inspect", *row) for row in READING), *(("fit", *row) for row in (*READING, *FITTING))],
)
def test_an_option_that_cannot_be_understood_is_2(tmp_path, command, args, said):
    log, out = write_log(tmp_path / "log.csv"), tmp_path / "out"
    run(command, log, *args.split(), *(("-o", out) if command == "fit" else ()), code=2, said=said)
    assert not out.exists()


def test_a_reader_that_is_none_is_2_in_a_folder_that_knows_the_recording(tmp_path):
    log, out = write_log(tmp_path / "log.csv"), ("-o", tmp_path / "out")
    run("fit", log, "--columns", "time=nope", *out, code=3)
    run("fit", log, "--recipe", "nope", *out, code=2, said=tuple(RECIPES))


def test_all_inputs_refused_is_3_and_the_old_set_stays(fitted_log, junk):
    out = fitted_log / "out"
    before = (out / "identification.json").read_bytes()
    document = run("fit", junk, "-o", out, "--json", code=3).json()
    assert (document["exit"]["code"], document["specimens"]) == (3, [])
    assert (out / "identification.json").read_bytes() == before
    assert run("validate", out).code == 0
    assert run("inspect", junk).code == 3


def test_a_recipe_that_is_none_is_3(tmp_path):
    (tmp_path / "r.toml").write_text("rate_Hz = 'fast'", encoding="utf-8")
    run("synth", tmp_path / "r.toml", "-o", tmp_path / "out", code=3, said="r.toml")


def test_a_required_parameter_that_is_not_identified_is_4(datasets, tmp_path):
    logs = sorted((datasets / "paper-a-30-10Hz").glob("hold-[48]-*.csv"))
    # viscosity and static curve are identified at 10 Hz, and they are what is required by default
    for required, code in (("relaxation-time",), 4), ((), 0), (("none",), 0):
        asked = [word for name in required for word in ("--require", name)]
        run("fit", *logs, "-o", tmp_path, "-q", *QUICK, *asked, code=code)


def test_a_damaged_bundle_is_6(fitted_log, tmp_path):
    out = fitted_log / "out"
    whole = (out / "bundle.h5").read_bytes()
    broken = tmp_path / "broken.h5"
    broken.write_bytes(whole[: len(whole) // 2])
    run("validate", broken, code=6, said="broken.h5")


@pytest.mark.parametrize("command", ["validate", "report", "export", "cohort"])
def test_a_folder_without_a_run_is_6(tmp_path, command):
    run(command, tmp_path, code=6, said=("no finished run", "tissueid fit"))


def test_a_second_writer_is_6(tmp_path):
    log = write_log(tmp_path / "log.csv")
    with OutputSet(tmp_path):
        run("fit", log, "-o", tmp_path, *QUICK, code=6, said="is writing here")


def test_precedence_of_codes_is_that_of_the_table():
    order = [1, 2, 3, 6, 5, 7, 4, 0]
    for index, first in enumerate(order):
        assert exit_code(set(order[index:])) == first


def caused(error: BaseException, cause: BaseException) -> BaseException:
    error.__cause__ = cause
    return error


#: An interrupt, also where a compiled kernel wraps it.
INTERRUPTS = (KeyboardInterrupt(), caused(SystemError("with an exception set"), KeyboardInterrupt()))


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (ZeroDivisionError("for the test"), 1, "tissueid: internal error (ZeroDivisionError: for the test)."),
        (OSError(errno.EIO, "the disk is gone", "here"), 6, "tissueid: here: the disk is gone\n"),
        *((one, 130, "tissueid: interrupted; what was finished is kept\n") for one in INTERRUPTS),
    ],
)
def test_an_internal_error_is_1_in_one_line_an_output_that_fails_6_and_an_interrupt_130(
    monkeypatch, tmp_path, error, code, said
):
    monkeypatch.setattr("tissueid.study.inspected.describe_segmented", Mock(side_effect=error))
    ended = run("inspect", write_log(tmp_path / "log.csv"), code=code)
    assert ended.stdout == ""
    assert ended.stderr.lstrip("\n").startswith(said)


def test_a_full_disk_is_6_and_no_bug(monkeypatch, tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "here")
    monkeypatch.setattr(files.Path, "write_bytes", Mock(side_effect=full))
    run("fit", write_log(tmp_path / "log.csv"), "-o", tmp_path / "out", *QUICK, code=6, said=full.strerror)
