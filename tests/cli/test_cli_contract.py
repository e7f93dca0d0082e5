"""What ``inspect --json`` and ``fit --json`` print is what the schemas and the contracts say."""

from __future__ import annotations

import csv
import hashlib

import pytest
from command_line import HEADER_LINES, LOG, QUICK, read_json, run, same_run, write_log

UNITS = {
    "static_1_N_per_mm": "N/mm",
    "static_2_N_per_mm2": "N/mm^2",
    "static_3_N_per_mm3": "N/mm^3",
    "stiffness_0_N_per_mm": "N/mm",
    "relaxation_time_s": "s",
    "viscosity_N_s_per_mm": "N s/mm",
}


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


def test_numbers_are_converted_to_mm_and_newton(tmp_path):
    text = LOG.read_text(encoding="ascii").replace("(mm),(N)", "(cm),(kN)")
    (tmp_path / "si.csv").write_text(text, encoding="ascii")
    (here,), (there,) = (run("inspect", path, "--json").json() for path in (LOG, tmp_path / "si.csv"))
    for key in ("first", "last", "peak_force"):
        # one multiplication by the factor rounds once
        assert there[key]["force_N"] == pytest.approx(1e3 * here[key]["force_N"], rel=1e-15)
        assert there[key]["displacement_mm"] == pytest.approx(10.0 * here[key]["displacement_mm"], rel=1e-15)


def test_inspect_is_valid_with_refusals_in_their_place(tmp_path):
    junk, empty = tmp_path / "junk.csv", tmp_path / "a folder"
    junk.write_bytes(bytes(range(256)) * 8)
    empty.mkdir()
    document = run("inspect", junk, LOG, empty, "--json", code=7).json("inspect")
    assert [one["path"] for one in document] == [str(junk), str(LOG), str(empty)]
    assert [one.get("error", {}).get("code") for one in document] == ["not_an_export", None, "no_recording"]


def test_inspect_for_people_says_the_same(rows):
    ended = run("inspect", LOG, "-v", shown=f"{len(rows)}, compression is positive displacement")
    for word in ("ramp", "hold", "bluehill-csv", "Extension", "paper-a"):
        assert word in ended.stdout
    assert run("inspect", LOG, "-q", "-v").stdout == ""


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


def test_refused_files_stand_in_identification_json_and_on_stderr(tmp_path):
    good, bad = write_log(tmp_path / "good.csv"), [write_log(tmp_path / f"bad-{k}.csv") for k in range(3)]
    for number, path in enumerate(bad):
        lines = path.read_text(encoding="ascii").splitlines()
        lines[9 + number] = lines[9 + number].rsplit(",", 1)[0] + ",NaN"
        path.write_text("\n".join(lines), encoding="ascii")
    ended = run("fit", good, *bad, "-o", tmp_path / "out", "--json", *QUICK, code=7)
    document = ended.json("identification")
    assert document["exit"]["code"] == 7
    for number, (path, refused) in enumerate(zip(bad, document["refused"], strict=True)):
        error = refused["error"]
        assert refused["path"] == str(path)
        assert [error[key] for key in ("code", "line", "column")] == ["not_finite", 10 + number, 3]
        assert f"{path}, line {10 + number}" in document["exit"]["reasons"][number]
    quiet = run("fit", good, *bad, "-o", tmp_path / "out", "-q", *QUICK, code=7)
    assert quiet.stdout == ""
    for number, path in enumerate(bad):
        assert quiet.stderr.count(f"{path}, line {10 + number}") == 1


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


def test_same_inputs_options_and_seed_give_the_same_numbers(fitted, tmp_path):
    run("fit", LOG, "-o", tmp_path / "again", *QUICK)
    assert same_run(tmp_path / "again", fitted[1])


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
