"""Finished fits in another form: whole tables, draws for arviz, single tissues, and MATLAB."""

import csv
import hashlib
import importlib.util
import io
import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Self
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from command_line import REPOSITORY, read_json, run
from fit_factory import STATIC, THETA_NAMES, identification, specimen_fit, write_results
from posterior_factory import posterior, sampled
from rendered_tissues import PAPER_A, bundle_of
from typed_call import typed_call

from tissueid.documents import plain
from tissueid.documents.identification import Calibration, StatedSpecimen
from tissueid.errors import UsageError
from tissueid.result import SpecimenFit
from tissueid.store.bundle import write_bundle
from tissueid.store.files import json_bytes
from tissueid.store.outputs import OutputSet
from tissueid.store.tidy import TABLES, csv_bytes, tidy_table
from tissueid.uncertainty import netcdf_bytes

tidy_table = typed_call(tidy_table)

FITS = (
    specimen_fit("kidney 3", samples=60),
    specimen_fit('liver, "left"', trials=1, samples=60, identified=False, seed=5),
    specimen_fit("Nière", trials=2, samples=60, seed=9),
)


POSTERIOR_ENDS = ("_mean", "_sd", "_ci95_low", "_ci95_high", "_ci95_total_low", "_ci95_total_high")


def document(fits: tuple[SpecimenFit, ...] = FITS) -> dict[str, Any]:
    return plain(identification(fits, refused=True).as_json())


def written(folder: Path, *fits: SpecimenFit, refused: bool = False) -> Path:
    with OutputSet(folder) as outputs:
        write_results(outputs, identification(fits, refused=refused))
        outputs.commit()
    return folder


def rows_of(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode("utf-8"), newline="")))


def table(name: str, given: dict[str, Any] | None = None) -> list[dict[str, str]]:
    return rows_of(csv_bytes(tidy_table(given or document(), name)))


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return written(tmp_path_factory.mktemp("export") / "out", *FITS, refused=True)


SILENT = dict.fromkeys(StatedSpecimen.__struct_fields__)
STUDY: dict[str, Any] = {
    "path": "study.toml", "sha256": "", "study": {}, "tip": {}, "priors": {},
    "calibration": dict.fromkeys(Calibration.__struct_fields__),
    "specimens": [
        SILENT | {"specimen": "kidney 3", "species": "pig", "sex": "f", "thickness_mm": 18.5, "site": "pole",
         "notes": None},
        SILENT | {"specimen": "spleen 1", "species": "goat", "sex": None, "thickness_mm": None, "site": None,
         "notes": "torn"},
    ],
    "trials": [
        {
            "path": FITS[0].trials[0].path, "sheet": None, "specimen": "kidney 3", "site": "cortex",
            "protocol": "fast", "run": 2, "rest_s": 600.0, "listed": True,
            "overridden": ["contact_mm", "columns"],
            "because": "the zero was lost; the other sensor", "notes": None,
        }
    ],
    "exclusions": [
        {"path": "lab data/slipped.csv", "sheet": "B", "specimen": "kidney 3", "because": "the tool slipped",
         "note": None, "with_it": []},
    ],
}  # fmt: skip


def test_one_row_a_specimen_with_value_error_and_verdict():
    first, second, third = table("specimens")
    assert [row["specimen"] for row in (first, second, third)] == [fit.specimen for fit in FITS]
    assert float(first["static_1_N_per_mm"]) == STATIC[0]
    assert float(first["static_1_N_per_mm_stderr"]) == 0.05
    assert first["relaxation_time_s_identified"] == "TRUE"
    assert (second["relaxation_time_s"], second["relaxation_time_s_stderr"]) == ("", "")
    assert second["relaxation_time_s_identified"] == "FALSE"
    assert second["flags"] == "not_identified;compliance_unknown"
    assert second["trial_flags"] == "zero_dt"
    assert first["trials"] == "3"
    assert float(first["valid_depth_mm"]) == 6.0


def test_one_row_a_trial_with_its_hold_and_its_hash():
    rows = table("trials")
    fitted = [row for row in rows if row["status"] == "fitted"]
    assert [row["path"] for row in fitted] == [trial.path for fit in FITS for trial in fit.trials]
    first = fitted[0]
    assert (first["holds"], float(first["tau_single_s"])) == ("1", 1.48)
    assert (float(first["tau_double_1_s"]), float(first["tau_double_2_s"])) == (0.9, 1.7)
    assert first["tau_triple_1_s"] == ""
    assert first["flags"] == "zero_dt;one_tau_inadequate"
    assert first["input_sha256"] == f"{0:064x}"
    assert (fitted[1]["holds"], fitted[1]["tau_single_s"]) == ("0", "")
    for row, trial in zip(fitted, (one for fit in FITS for one in fit.trials), strict=True):
        assert float(row["nrmsd"]) == trial.nrmsd.range
        assert int(row["n_samples"]) == trial.n_samples


def test_what_was_refused_or_excluded_keeps_its_row_and_reason():
    rows = table("trials", document() | {"study": STUDY})
    (refused,) = [row for row in rows if row["status"] == "refused"]
    assert refused["path"] == "lab data/<b>notes</b>.csv"
    assert refused["reason"] == "not_an_export: line 3: the file is prose; export raw data"
    (excluded,) = [row for row in rows if row["status"] == "excluded"]
    assert (excluded["path"], excluded["sheet"], excluded["reason"]) == (
        "lab data/slipped.csv", "B", "the tool slipped",
    )  # fmt: skip
    assert excluded["species"] == "pig"


def test_covariates_of_the_study_stand_beside_the_numbers():
    with_study = document() | {"study": STUDY}
    first = table("trials", with_study)[0]
    keys = ("species", "specimen_site", "site", "run")
    assert [first[key] for key in keys] == ["pig", "pole", "cortex", "2"]
    assert (first["listed"], first["overridden"]) == ("TRUE", "contact_mm;columns")
    assert first["reason"] == "the zero was lost; the other sensor"
    specimens = {row["specimen"]: row for row in table("specimens", with_study)}
    assert float(specimens["kidney 3"]["thickness_mm"]) == 18.5
    assert specimens["kidney 3"]["excluded_trials"] == "1"
    # listed in the study, and nothing of it could be fitted
    assert (specimens["spleen 1"]["status"], specimens["spleen 1"]["static_1_N_per_mm"]) == ("not fitted", "")


@pytest.mark.parametrize("name", TABLES)
def test_columns_do_not_depend_on_what_was_found_and_stand_in_the_documentation(name):
    full = tidy_table(document() | {"study": STUDY}, name)
    assert full.columns == tidy_table(document(()) | {"study": None}, name).columns
    assert len(set(full.columns)) == len(full.columns)
    assert all(set(row) <= set(full.columns) for row in full.rows)
    page = (REPOSITORY / "docs" / "export.md").read_text(encoding="utf-8")
    section = page.split(f"## {name}\n")[1].split("\n## ")[0]
    for column in set(full.columns) - {"tissueid", "identification_sha256"}:
        assert f"`{column}`" in section or any(
            f"`{column.removesuffix(end)}`" in section and f"`*{end}`" in section
            for end in ("_stderr", "_identified", *POSTERIOR_ENDS)
        ), column


def test_a_posterior_fills_mean_sd_and_the_ends_of_both_intervals():
    fits = tuple(sampled(fit) for fit in FITS)
    first, second, _ = table("specimens", document(fits))
    known = fits[0].parameter("viscosity_N_s_per_mm").uncertainty
    name = "viscosity_N_s_per_mm"
    expected = [known.mean, known.sd, *known.ci95, *known.ci95_total]
    assert [float(first[f"{name}{end}"]) for end in POSTERIOR_ENDS] == expected
    assert (first["sampler"], first["converged"], first["draws"]) == ("emcee", "TRUE", "4000")
    assert (first["noise"], float(first["phi"]), first["misfit"]) == ("ar1", 0.6, "FALSE")
    # of what is not identified no interval stands in a column
    assert [second[f"relaxation_time_s{end}"] for end in POSTERIOR_ENDS] == [""] * 6
    assert second["relaxation_time_s_identified"] == "FALSE"


def test_columns_follow_the_posterior_and_the_branches():
    first, *_ = table("specimens")
    assert (first["viscosity_N_s_per_mm_ci95_low"], first["sampler"], first["misfit"]) == ("", "", "")
    two = document()
    two["specimens"][0]["model"]["branches"] = 2
    assert "relaxation_time_s_b2" in tidy_table(two, "specimens").columns
    assert "relaxation_time_s_b2" not in tidy_table(document(), "specimens").columns


def test_loops_and_quoted_numbers_have_tables_of_their_own():
    given = document()
    measure = {"value": 0.25, "stderr": 0.01}
    names = [column for column in tidy_table(given, "cycles").columns if f"{column}_stderr" in
             tidy_table(given, "cycles").columns]  # fmt: skip
    loop: dict[str, Any] = dict.fromkeys(names, measure)
    loop |= {"path": "a.csv", "sheet": None, "number": 2, "kind": "cycle", "start_s": 1.0, "peak_s": 2.0,
             "end_s": 3.0, "floor_mm": 0.0, "peak_depth_mm": 4.0, "at_depths": []}  # fmt: skip
    given["specimens"][0]["cycles"] = [loop]
    (row,) = table("cycles", given)
    assert (row["specimen"], row["number"], float(row["hysteresis"])) == ("kidney 3", "2", 0.25)
    given["unfitted_cycles"] = [loop | {"path": "b.csv"}]
    assert [(one["specimen"], one["path"]) for one in table("cycles", given)] == [
        ("kidney 3", "a.csv"),
        ("", "b.csv"),
    ]
    quantity = {"name": "fraction_relaxed", "unit": "1", "at": {"time_s": 10.0}, "value": None,
                "stderr": None, "reason": "the hold lasts 5 s"}  # fmt: skip
    given["specimens"][0]["quoted"] = {
        "window_s": 5.0, "resolution_s": 0.02, "noise": "white", "model": [quantity], "moduli": [],
        "spectra": [], "assumptions": {},
    }  # fmt: skip
    (row,) = table("quantities", given)
    keys = ("kind", "name", "time_s", "value")
    assert [row[key] for key in keys] == ["model", "fraction_relaxed", "10.0", ""]
    assert row["reason"] == "the hold lasts 5 s"
    given["specimens"][0]["measured"] = [
        {"name": "force", "unit": "N", "program": 1, "hold": 1, "time_s": 10.0, "ramp_time_s": [2.0, 2.1],
         "count": 3, "mean": 4.5, "sd": 0.25, "reason": None}
    ]  # fmt: skip
    row = table("quantities", given)[-1]
    assert [row[key] for key in ("kind", "name", "time_s", "hold", "value", "sd", "logs", "stderr")] == [
        "measured", "force", "10.0", "1", "4.5", "0.25", "3", "",
    ]  # fmt: skip
    # a force while loading is one of a depth, and of a program: its row says of which
    given["specimens"][0]["measured"][0] |= {
        "name": "force_at_depth", "time_s": None, "depth_mm": 0.5, "program": 2,
    }  # fmt: skip
    row = table("quantities", given)[-1]
    keys = ("name", "time_s", "depth_mm", "program")
    assert [row[key] for key in keys] == ["force_at_depth", "", "0.5", "2"]


def test_the_bytes_are_rfc_4180_in_utf_8():
    content = csv_bytes(tidy_table(document(), "specimens"))
    text = content.decode("utf-8")
    assert not text.startswith("\ufeff")
    assert text.endswith("\r\n")
    assert text.count("\r\n") == text.count("\n") == 4
    assert '"liver, ""left"""' in text
    assert "Nière" in text
    assert "None" not in text
    assert "nan" not in text


@pytest.fixture(scope="module")
def printed(out):
    """The tables of specimens and trials as they are printed."""
    return {name: run("export", out, "--format", name, code=0).stdout for name in ("specimens", "trials")}


def test_an_independent_reader_finds_numbers_logicals_and_gaps(printed):
    # as read.csv of R does: types by column, empty cells missing
    frame, trials = (pd.read_csv(io.StringIO(text)) for text in printed.values())
    assert frame["viscosity_N_s_per_mm"].dtype == float
    assert frame["viscosity_N_s_per_mm_identified"].dtype == bool
    assert frame["relaxation_time_s"].isna().tolist() == [False, True, False]
    assert len(trials.merge(frame[["specimen", "viscosity_N_s_per_mm"]], on="specimen")) == 6


def test_numbers_come_back_to_the_last_bit_with_the_hash_of_the_document(out, printed):
    stored, content = read_json(out / "identification.json"), (out / "identification.json").read_bytes()
    assert json_bytes(stored) == content
    rows, trials = (rows_of(text.encode("utf-8")) for text in printed.values())
    for row, specimen in zip(rows, stored["specimens"], strict=True):
        for estimate in specimen["parameters"]:
            value = row[estimate["name"]]
            assert (float(value) if value else None) == estimate["value"]
    digest = hashlib.sha256(content).hexdigest()
    assert {row["identification_sha256"] for row in (*rows, *trials)} == {digest}


def test_a_file_is_written_where_it_is_asked_for(out, printed, tmp_path):
    target = tmp_path / "Übersicht für R.csv"
    assert run("export", out, "--format", "trials", "-o", target, code=0).stdout == ""
    assert target.read_bytes().decode("utf-8") == printed["trials"]
    run("export", out, "--format", "trials", "-o", tmp_path / "no" / "such.csv", code=2)
    run("export", tmp_path, "--format", "trials", code=6)


NO_ARVIZ = importlib.util.find_spec("arviz") is None


@pytest.fixture
def arviz():
    if NO_ARVIZ:
        pytest.skip("arviz is not installed: pip install 'tissueid[arviz]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz


class _Recorded:
    """A data set, or a tree of them, that keeps what it was made from."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    @classmethod
    def from_dict(cls, groups: dict[str, Any]) -> Self:
        return cls("tree", groups)


def _install(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    arviz, xarray = types.ModuleType("arviz"), types.ModuleType("xarray")
    arviz.__dict__.update(__version__=version, InferenceData=_Recorded)
    xarray.__dict__.update(Dataset=_Recorded, DataTree=_Recorded)
    monkeypatch.setitem(sys.modules, "arviz", arviz)
    monkeypatch.setitem(sys.modules, "xarray", xarray)


@pytest.mark.parametrize("version", ["0.18.0", "1.2.0"])
def test_quarters_of_the_draws_are_chains_and_so_are_walkers(monkeypatch, version):
    _install(monkeypatch, version)
    given = posterior(draws=53)
    made = given.to_arviz()
    groups = made.kwargs if version.startswith("0") else made.args[1]
    assert (made.args == ()) == version.startswith("0")
    theta, chain = groups["posterior"].args[0], groups["unconstrained_posterior"].args[0]
    assert list(theta) == [*THETA_NAMES, *(f"{name}_total" for name in THETA_NAMES)]
    for k, name in enumerate(THETA_NAMES):
        assert theta[name][0] == ("chain", "draw")
        assert np.array_equal(theta[name][1], np.stack(np.split(given.draws[:52, k], 4)))
        assert np.array_equal(theta[f"{name}_total"][1], given.draws_total[:52, k].reshape(4, 13))
    assert list(chain) == list(given.chain_names)
    for k, name in enumerate(given.chain_names):
        assert np.array_equal(chain[name][1], given.chain[:, :, k])
    assert "sample_stats" not in groups
    coordinates = groups["unconstrained_posterior"].kwargs["coords"]
    assert (coordinates["chain"].size, coordinates["draw"].size) == given.chain.shape[:2]


def test_the_log_density_of_a_walked_chain_goes_along_and_no_total_variables_without_total_draws(monkeypatch):
    _install(monkeypatch, "0.18.0")
    given = posterior(draws=50, total=False)
    made = replace(given, log_density=given.chain.sum(axis=2)).to_arviz().kwargs
    assert np.array_equal(made["sample_stats"].args[0]["lp"][1], given.chain.sum(axis=2))
    assert list(made["posterior"].args[0]) == list(THETA_NAMES)


def test_what_stands_in_the_way_of_draws_for_arviz_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    bare, known = specimen_fit("kidney 3", samples=60), sampled(specimen_fit("kidney 3", samples=60))
    asked, into = ("--format", "netcdf"), ("-o", tmp_path / "chains.nc")
    run("export", written(tmp_path / "bare", bare), *asked, *into, code=2, said="no posterior was sampled")
    out = written(tmp_path / "out", known)
    run("export", out, *asked, code=2, said="name a file with -o")
    run("export", out, *asked, *into, code=2, said="pip install 'tissueid[arviz]'")
    assert not (tmp_path / "chains.nc").exists()
    unwritable = Mock(to_netcdf=Mock(side_effect=ImportError("No module named 'h5netcdf'")))
    with pytest.raises(UsageError, match="pip install h5netcdf"):
        netcdf_bytes(unwritable)


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_arviz_reads_the_draws_of_each_specimen(arviz, tmp_path):
    fits = [sampled(specimen_fit(name, samples=60)) for name in ("kidney 3", "liver/left")]
    out = written(tmp_path / "out", *fits)
    run(
        "export", written(tmp_path / "one", fits[0]), "--format", "netcdf", "-o", tmp_path / "mine.nc", code=0
    )
    summary = arviz.summary(arviz.from_netcdf(str(tmp_path / "mine.nc"))["unconstrained_posterior"])
    assert summary.loc["ln_tau_1", "r_hat"] < 1.01
    run("export", out, "--format", "netcdf", "-o", tmp_path / "chains.nc", code=0)
    names = ["chains-kidney_3.nc", "chains-liver_left.nc"]
    assert sorted(path.name for path in tmp_path.glob("*.nc")) == [*names, "mine.nc"]
    for fit, name in zip(fits, names, strict=True):
        found = arviz.from_netcdf(str(tmp_path / name))
        assert found["posterior"].attrs["specimen"] == fit.specimen
        stored = fit.posterior
        first = stored.theta_names[0]
        assert np.array_equal(np.asarray(found["posterior"][first]).ravel(), stored.draws[:, 0])
        walkers = np.asarray(found["unconstrained_posterior"][stored.chain_names[1]])
        assert np.array_equal(walkers, stored.chain[:, :, 1])


@pytest.fixture
def bundle(tmp_path):
    path = tmp_path / "bundle.h5"
    write_bundle(bundle_of(PAPER_A), path)
    return path


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (("c-header",), 0, "paper_a_step("),
        (("febio",), 0, '<material id="1"'),
        (("abaqus",), 0, "*VISCOELASTIC, TIME=PRONY"),
        (("mat",), 2, "-o tissues.mat"),
        (("abaqus", "--depth", "40"), 2, "outside what is claimed"),
        (("abaqus", "--depth", "nan"), 2, "outside what is claimed"),
    ],
)
def test_a_bundle_is_written_for_another_program_or_refused(bundle, args, code, said):
    ended = run("export", bundle, "--format", *args, code=code)
    assert said in (ended.stderr if code else ended.stdout)


def test_of_several_specimens_one_is_chosen(tmp_path):
    out = written(tmp_path / "out", specimen_fit("kidney 3"), specimen_fit("spleen 1"))
    form = ("--format", "c-header")
    run("export", out, *form, code=2, said="--specimen")
    for place in (out, next(out.glob("bundle-*.h5"))):
        run("export", place, *form, "--specimen", "nobody", code=2, said="nobody")
    run("export", out, *form, "--specimen", "kidney 3", shown="kidney_3_step(")
