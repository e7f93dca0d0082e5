"""Recordings that are read and fitted together, the order of the fit, and words in the terminal."""

import json
import re
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import QUICK, read_json, run, write_csv, write_log, write_study, write_workbook
from fit_factory import identification, specimen_fit, write_results
from posterior_factory import sampled
from typed_call import typed_call

from tissueid.cli.fit_command import _print_specimens
from tissueid.documents import plain
from tissueid.flags import FLAGS, MOST_WORDS, Flag, harm_rank
from tissueid.ingest import forget_readers
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.report import specimen_lines
from tissueid.report.specimen_lines import MOST_WARNINGS, WIDTH
from tissueid.store.index import Index
from tissueid.store.outputs import OutputSet
from tissueid.study.one_order import LawOrder, agreed, scores_of
from tissueid.synth import EXPORTS, Hold, Log, Move, Recipe, simulate
from tissueid.synth.machines import mach1_text, shimadzu_text, zwick_workbook
from tissueid.trial import Axes


def fit(out: Path, *args: str | Path) -> Any:
    return run("fit", *args, "-o", out, "--json", code={0, 4}).json()


def logs_of(document: dict[str, Any]) -> dict[str, int]:
    return {one["specimen"]: len(one["trials"]) for one in document["specimens"]}


def test_files_with_one_header_label_are_one_specimen(tmp_path):
    for number in (1, 2, 3):
        write_log(tmp_path / "lab" / f"log-{number}.csv", label="kidney 7", force_times=1.0 + 0.02 * number)
    document = fit(tmp_path / "out", tmp_path / "lab", *QUICK)
    assert logs_of(document) == {"kidney 7": 3}
    assert document["specimens"][0]["model"]["static_pooling"] == "scaled"
    assert (tmp_path / "out" / "bundle-kidney_7.h5").exists()
    assert {entry["specimen"] for entry in document["provenance"]["inputs"]} == {"kidney 7"}


def test_each_sheet_is_its_own_specimen(tmp_path):
    document = fit(tmp_path / "out", write_workbook(tmp_path / "book.xlsx", "left", "right"), *QUICK)
    assert logs_of(document) == {"left": 1, "right": 1}
    assert [one["trials"][0]["sheet"] for one in document["specimens"]] == ["left", "right"]


@pytest.mark.parametrize("pooling", ["scaled", "partial", "shared"])
def test_the_pooling_asked_for_is_the_one_reported(tmp_path, pooling):
    for number in (1, 2):
        write_log(tmp_path / "lab" / f"log-{number}.csv", force_times=1.0 + 0.1 * number)
    document = fit(tmp_path / "out", tmp_path / "lab", "--static", pooling, *QUICK)
    (one,) = document["specimens"]
    assert one["model"]["static_pooling"] == pooling
    assert document["provenance"]["options"]["static"] == pooling
    gains = [trial["gain"] for trial in one["trials"]]
    if pooling != "shared":
        # the same log times 1.1 and 1.2: gains stand in that ratio, but for the shrinkage of two logs
        assert gains[1] / gains[0] == pytest.approx(1.2 / 1.1, rel=0.01)
    else:
        assert gains == [1.0, 1.0]


@pytest.mark.parametrize(("branches", "degree"), [(1, 2), (2, 1), (3, 0)])
def test_branches_and_degree_asked_for_are_fitted_and_reported(tmp_path, branches, degree):
    log = write_log(tmp_path / "log.csv")
    args = ["--branches", str(branches), "--stiffness-degree", str(degree), "--sampler", "none"]
    (one,) = fit(tmp_path / "out", log, *args)["specimens"]
    assert (one["model"]["branches"], one["model"]["stiffness_degree"]) == (branches, degree)
    names = [entry["name"] for entry in one["parameters"]]
    assert sum(name.startswith("relaxation_time_s") for name in names) == branches
    assert sum(name.startswith("stiffness_") for name in names) == branches * (degree + 1)
    times = [entry["value"] or entry["detail"]["estimate"] for entry in one["parameters"]
             if entry["name"].startswith("relaxation_time_s")]  # fmt: skip
    assert times == sorted(times)
    assert one["selection"] == []


def test_auto_prints_the_candidates_it_chose_from(tmp_path):
    log = write_log(tmp_path / "log.csv")
    (one,) = fit(tmp_path / "out", log)["specimens"]
    tried = {(row["branches"], row["stiffness_degree"]) for row in one["selection"]}
    (chosen,) = [row for row in one["selection"] if row["chosen"]]
    # a bending K, and branches that can't be seen, are no candidates of one ramp and hold
    assert (1, 0) in tried
    assert chosen["branches"] == one["model"]["branches"]
    assert chosen["stiffness_degree"] == one["model"]["stiffness_degree"]
    options = read_json(tmp_path / "out" / "identification.json")["provenance"]["options"]
    assert options["branches"] == options["stiffness_degree"] == "auto"


HOLDS = Log("hold", (Move(8.0, 300.0), Hold(2.0)), repeats=3)
SMALL = Recipe("small", (HOLDS,), rate_Hz=50.0, static=(60.0,), sigma_N=0.1)


@pytest.fixture(scope="module")
def logs():
    return simulate(SMALL, rng=np.random.default_rng(3))


def inspected(*args: str | Path) -> Any:
    return run("inspect", *args, "--json").json()


@pytest.fixture(scope="module")
def files(tmp_path_factory, logs):
    folder = tmp_path_factory.mktemp("sheets")
    found = {name: folder / f"synthetic.{name}" for name in ("xlsx", "txt", "csv", "zip")}
    found["xlsx"].write_bytes(zwick_workbook(logs))
    found["txt"].write_bytes(mach1_text(logs))
    found["csv"].write_bytes(shimadzu_text(logs))
    with zipfile.ZipFile(found["zip"], "w") as archive:
        for i, log in enumerate(logs, 1):
            archive.writestr(f"log {i}.csv", EXPORTS["bare"].write(log))
        archive.writestr("book.xlsx", zwick_workbook(logs))
    return found


PICKED = [
    ("xlsx", "synthetic hold-2", ["synthetic hold-2"]),
    ("txt", "3: Stress Relaxation", ["3: Stress Relaxation"]),
    ("txt", "3", ["3: Stress Relaxation"]),
    ("csv", "synthetic hold-3", ["synthetic hold-3"]),
    ("zip", "log 2.csv", ["log 2.csv"]),
    ("zip", "book.xlsx::synthetic hold-1", ["book.xlsx::synthetic hold-1"]),
    ("zip", "book.xlsx", [f"book.xlsx::synthetic hold-{i}" for i in (1, 2, 3)]),
]


@pytest.mark.parametrize(("kind", "sheet", "expected"), PICKED)
def test_one_sheet_is_picked_by_option_or_behind_the_file(files, kind, sheet, expected):
    assert [one["sheet"] for one in inspected(files[kind], "--sheet", sheet)] == expected
    assert [one["sheet"] for one in inspected(f"{files[kind]}::{sheet}")] == expected


def test_a_sheet_that_is_not_there_is_refused_with_those_that_are(files):
    ended = run("inspect", f"{files['xlsx']}::nothing", code=3, said="unknown_sheet")
    assert "'synthetic hold-1', 'synthetic hold-2', 'synthetic hold-3'" in ended.stderr


def test_a_file_whose_name_has_the_mark_is_that_file(tmp_path, logs):
    path = tmp_path / "a::b.csv"
    path.write_bytes(EXPORTS["bare"].write(logs[0]))
    (one,) = inspected(path)
    assert one["path"] == str(path)


def test_one_picked_sheet_is_fitted(files, tmp_path):
    (entry,) = fit(tmp_path / "out", f"{files['txt']}::2", *QUICK)["provenance"]["inputs"]
    assert (entry["sheet"], entry["recipe"]) == ("2: Stress Relaxation", "mach-1")


def test_a_pattern_that_fits_nothing_is_a_wrong_option_and_one_that_fits_some_names_the_others(
    files, tmp_path
):
    said = ("'cow(\\\\d)'", "synthetic hold-1")
    for args in (("inspect",), ("fit", *QUICK, "-o", tmp_path / "out")):
        run(*args, files["xlsx"], "--specimen-by", r"cow(\d)", code=2, said=said)
    assert not (tmp_path / "out" / "identification.json").exists()
    ended = run("inspect", files["xlsx"], "--specimen-by", "hold-[12]", code=0, said="synthetic hold-3")
    assert "synthetic hold-1" not in ended.stderr


def test_marks_that_the_text_leaves_open_can_be_stated(tmp_path):
    path = tmp_path / "open.csv"
    rows = "".join(f"{i + 1}.000;{i + 2}.500;{i + 3}.250\n" for i in range(20))
    path.write_text("Time;Extension;Load\n(s);(mm);(N)\n" + rows)
    run("inspect", path, code=3, said="--decimal")
    (one,) = inspected(path, "--decimal", "point", "--delimiter", "semicolon")
    assert one["first"]["displacement_mm"] == 2.5


def test_every_dialect_is_listed_with_what_it_is_and_that_of_another_machine_is_written(tmp_path):
    run("synth", "--dialects", code=0, shown=(*EXPORTS, *(one.description for one in EXPORTS.values())))
    folder = tmp_path / "synthetic"
    run("synth", "paper-a-22", "-o", folder, "--rate", "10", "--dialect", "mts-793-de", code=0)
    described = inspected(folder)
    assert len(described) == 22
    assert {one["recipe"] for one in described} == {"mts-793"}


def test_a_broken_installed_reader_is_warned_of_and_the_files_are_read(tmp_path, logs, monkeypatch):
    info = tmp_path / "site" / "broken-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tissueid.readers]\nmine = no_such_module_at_all:RECIPE\n")
    path = tmp_path / "synthetic.csv"
    path.write_bytes(EXPORTS["bare"].write(logs[0]))
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(info.parent))
        forget_readers()
        ended = run("inspect", path, "-v")
    forget_readers()
    assert ended.code == 0
    assert "bluehill-csv" in ended.stdout
    assert "warning: the installed reader 'mine (no_such_module_at_all:RECIPE)'" in ended.stderr


def test_a_mean_curve_is_left_out_with_one_line(tmp_path):
    write_log(tmp_path / "Mean.csv")
    write_log(tmp_path / "cow.csv")
    ended = run("fit", tmp_path, "-o", tmp_path / "out", *QUICK, code=0)
    (line,) = (line for line in ended.stdout.splitlines() if line.startswith("excluded"))
    assert "Mean.csv" in line
    assert "no specimen" in line
    assert "1 log," in ended.stdout


KV = "kelvin-voigt"
PLAIN, TWO, BENT = LawOrder(KV, 1, 0), LawOrder(KV, 2, 0), LawOrder(KV, 2, 1)


@pytest.mark.parametrize(
    ("tables", "taken"),
    [
        # the simplest within one standard error over specimens
        ([{PLAIN: -0.5 + k, TWO: 0.0} for k in (0.1, 0.0, -0.1, 0.05)], TWO),
        # as much is gained in one specimen as is lost in another
        ([{PLAIN: 0.0, TWO: gain} for gain in (0.3, -0.2, 0.25, -0.3)], PLAIN),
        # one that is not resolved predicts as what it contains: of the last specimen two branches are one
        ([{PLAIN: -0.6, TWO: 0.0}] * 3 + [{PLAIN: 0.0}], TWO),
        # one that few were tried with is none of the study
        ([{PLAIN: -0.6, TWO: 0.0}] * 4 + [{PLAIN: -0.9, TWO: -0.8, BENT: 0.0}], TWO),
        ([{TWO: 0.0}, {LawOrder("power * fung", 1, 0): 0.0}], None),
    ],
)
def test_an_order_is_agreed_on(tables, taken):
    assert agreed(tables) == taken


def test_other_laws_are_weighed_where_one_of_them_may_be_taken():
    rows = [
        {"branches": 1, "stiffness_degree": 0, "score": -0.3},
        {"model": "power * fung", "branches": 1, "stiffness_degree": 0, "score": 0.0},
        {"model": "yardstick", "branches": 4, "stiffness_degree": 0, "score": 0.2},
    ]
    assert list(scores_of({"selection": rows}, laws=False)) == [PLAIN]
    assert list(scores_of({"selection": rows}, laws=True)) == [PLAIN, LawOrder("power * fung", 1, 0)]


def recording(path: Path, branches: int, seed: int) -> None:
    """A push to 5 mm and a hold of 12 s at 50 Hz, of one or two relaxation times."""
    rng, rate = np.random.default_rng(seed), 50.0
    model = kelvin_voigt(branches, 0, 5.0)
    theta = np.array([8.0, -0.5, 0.2, *(12.0, 0.3, *((10.0, 3.0) if branches > 1 else ()))])
    time = np.arange(0.0, 14.0, 1.0 / rate)
    depth = np.interp(time, [1.0, 2.0], [0.0, 5.0])
    force = model.force(theta, ContactPath(time, depth)) + rng.normal(0.0, 0.02, time.size)
    travel = np.interp(time, [0.0, 1.0, 2.0], [-5.0, 0.0, 5.0])
    write_csv(path, time, travel, force)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out: Path = tmp_path_factory.mktemp("study")
    for number, branches in enumerate((2, 2, 1)):
        recording(out / f"s{number}.csv", branches, number)
    write_study(out, "[study]", 'title = "orders"')
    return out


def orders(document: dict) -> list[int]:
    return [one["model"]["branches"] for one in document["specimens"]]


def flagged(document: dict) -> list[str]:
    own = {one["specimen"]: {flag["code"] for flag in one["flags"]} for one in document["specimens"]}
    return [name for name, codes in own.items() if "study_order" in codes]


ASKED = ("--sampler", "none", "--json", "--workers", "1")


@pytest.fixture(scope="module")
def own(folder, tmp_path_factory):
    """The study with the orders that its specimens take alone."""
    out = tmp_path_factory.mktemp("own") / "out"
    document = run("fit", folder, *ASKED, "--orders", "own", "-o", out).json()
    assert (orders(document), flagged(document)) == ([2, 2, 1], [])
    return out


@pytest.fixture
def out(own, tmp_path):
    """A copy of its folder."""
    return shutil.copytree(own, tmp_path / "out", symlinks=True)


def test_specimens_of_a_study_are_fitted_with_one_order_and_the_other_one_says_so(folder, out):
    document = run("fit", folder, *ASKED, "-o", out).json()
    assert (orders(document), flagged(document)) == ([2, 2, 2], ["s2"])
    run("validate", out, code=0)
    run("status", out, shown="3 of 3 done")
    # the same again computes nothing: the file of what the specimen would take alone is there
    assert run("fit", folder, *ASKED, "-o", out).json()["specimens"] == document["specimens"]
    with Index(out) as index:
        assert index.count("superseded") == 1
    # the same order asked for by name is none of the study's
    named = run("fit", folder, *ASKED, "--branches", "2", "--stiffness-degree", "0", "-o", out).json()
    assert (orders(named), flagged(named)) == ([2, 2, 2], [])


def test_files_that_are_no_study_keep_their_own_orders(folder, out):
    assert orders(run("fit", folder, *ASKED, "--no-study", "-o", out).json()) == [2, 2, 1]


def test_a_specimen_that_the_order_of_its_study_can_not_be_fitted_to_keeps_its_own(folder, out, monkeypatch):
    monkeypatch.setattr("tissueid.study.specimen_job.Flag", Mock(side_effect=ArithmeticError))
    document = run("fit", folder, *ASKED, "-o", out).json()
    assert (orders(document), document["refused"]) == ([2, 2, 1], [])


#: Functions that write lines, of documents in plain values.
said = SimpleNamespace(
    **{
        name: typed_call(one)
        for name, one in vars(specimen_lines).items()
        if name.endswith(("_lines", "_codes"))
    }
)


def test_a_parameter_stands_with_both_intervals_to_one_place():
    fit = sampled(specimen_fit())
    known = fit.parameter("viscosity_N_s_per_mm").uncertainty
    low, high = known.ci95
    wide_low, wide_high = known.ci95_total
    (first,) = [line for line in said.parameter_lines(fit.as_json()) if line.startswith("eta")]
    expected = f"9.00 N s/mm [{low:.2f}, {high:.2f}] [{wide_low:.2f}, {wide_high:.2f}]"
    # sd 0.27: two digits of it end at the second decimal
    assert " ".join(first.replace("95 %", "").replace("total", "").split()) == f"eta {expected}"


def test_sampler_and_noise_are_one_line_each_and_without_them_the_standard_error_stands():
    lines = said.parameter_lines(specimen_fit().as_json())
    assert lines[0] == "tau    1.500 ± 0.030 s"
    assert "eta    9.00 ± 0.11 N s/mm" in lines
    assert said.sampling_lines(specimen_fit().as_json()) == []
    assert said.alarm_lines(specimen_fit().as_json()) == []
    assert said.sampling_lines(sampled(specimen_fit()).as_json()) == [
        "emcee  4,000 draws, R-hat at most 1.001, 34 % accepted, converged",
        "noise  ar1, 0.3 N, correlation 0.6 over 0.01 s",
    ]


def test_no_interval_stands_where_nothing_is_identified_or_the_model_is_contradicted():
    lines = said.parameter_lines(sampled(specimen_fit(identified=False)).as_json())
    assert [line for line in lines if "tau" in line] == ["tau    not identified"]
    fit = sampled(specimen_fit(), misfit=True)
    assert not re.search("95 %|total|±", "\n".join(said.parameter_lines(fit.as_json())))
    (line,) = said.alarm_lines(fit.as_json())
    assert line.endswith("the force just after the peak lies 2.1 N above the model")
    assert line.startswith("no interval is given")
    # a flag that says the same is not said again
    flagged = replace(fit, flags=(*fit.flags, Flag("misfit", "the residuals show a slow mode")))
    assert said.alarm_lines(flagged.as_json()) == []


def test_a_sampler_that_stopped_early_is_told_with_its_reason():
    fit = sampled(specimen_fit(), converged=False)
    (line,) = said.alarm_lines(fit.as_json())
    assert line.endswith("intervals are rough: R-hat of ln_tau_1 is 1.08 after 20,000 steps")
    assert "not converged" in said.sampling_lines(fit.as_json())[0]


def test_normalised_results_are_said_in_their_units():
    fit = replace(sampled(specimen_fit(), total=False), axes=Axes("1", "MPa"))
    lines = said.parameter_lines(fit.as_json())
    assert any(line.startswith("eta    9.00 MPa s") for line in lines)
    assert not any("total" in line or "mm" in line for line in lines)
    assert said.sampling_lines(fit.as_json())[1].startswith("noise  ar1, 0.3 MPa")


def test_a_report_made_again_has_bands_and_draws_from_the_folder_alone(tmp_path):
    with OutputSet(tmp_path / "out") as outputs:
        write_results(outputs, identification([sampled(specimen_fit(trials=2, samples=60))]))
        outputs.commit()
    run("report", tmp_path / "out", "-o", tmp_path / "again.html", code=0)
    html = (tmp_path / "again.html").read_text(encoding="utf-8")
    payload = json.loads(html.split('id="curves">')[1].split("</script>")[0])
    assert all("low" in trial and "high" in trial for trial in payload["specimens"][0])
    assert payload["posteriors"][0]["draws"]["count"] == 1_000
    assert "How sure" in html


_print_specimens = typed_call(_print_specimens)

#: Lines of a specimen without -v.
MOST_LINES = 12
CODES = ("corner_slow", "preload", "clipped_force", "gap", "units_assumed", "misfit", "spike", "no_hold")


def document(name: str = "cow", codes: tuple[str, ...] = CODES, **options: Any) -> dict[str, Any]:
    fit = replace(sampled(specimen_fit()), flags=(), specimen=name, **options)
    found: dict[str, Any] = fit.as_json()
    flags = plain([Flag(code, f"{code} was seen at 3 s") for code in codes])
    found["trials"] = [{**found["trials"][0], "flags": flags, "sheet": name}]
    return found


def test_the_five_of_most_harm_stand_first_and_the_rest_is_counted():
    lines = said.warning_lines(document())
    assert len(lines) == MOST_WARNINGS
    words = [line.split()[0] for _, line in lines]
    expected = sorted(set(CODES) - {"no_hold"}, key=harm_rank)
    assert words == expected[:MOST_WARNINGS]
    assert words[0] == "clipped_force"
    assert lines[0][0] == "serious"
    assert lines[-1][1].endswith("(2 more: -v)")
    for (_, line), code in zip(lines, words, strict=True):
        assert FLAGS[code].remedy in line
        assert len(line.replace("(2 more: -v)", "").split()) <= MOST_WORDS
    every = said.warning_lines(document(), verbose=1)
    told = " ".join(line for _, line in every)
    assert all(f"{code} was seen" in told for code in CODES)


def test_what_most_of_a_batch_shares_is_counted_once():
    names = [f"FF{k}" for k in range(124)]
    batch = [document(name, ("preload",)) for name in names[:-1]] + [document(names[-1], ("gap",))]
    shared = said.shared_codes(batch)
    assert shared == ("preload",)
    (line,) = said.shared_lines(batch, shared)
    assert line == "123 of 124 sheets start preloaded. Start in air, or state --contact."
    assert said.warning_lines(batch[0], shared=shared) == []
    (own,) = said.warning_lines(batch[-1], shared=shared)
    assert own[1].startswith("gap was seen")
    # two of a kind are no batch
    assert said.shared_codes(batch[:2]) == ()


def test_a_specimen_takes_few_lines_and_the_block_comes_first(capsys):
    _print_specimens([document()], verbose=0)
    blank, head, *lines = capsys.readouterr().out.splitlines()
    assert not blank
    assert "NRMSD" in head
    block = [line.split()[0] for line in lines if not line.startswith("   ")][:4]
    assert block == ["relaxation", "viscosity", "static", "dynamic"]
    assert len([head, *lines[:-1]]) <= MOST_LINES
    assert lines[-1].startswith("In brackets: 95 % intervals")
    _print_specimens([document()], verbose=1)
    assert "95 % [" in capsys.readouterr().out


def test_the_block_names_what_is_not_identified_and_wraps_what_is_long():
    lines = said.block_lines(sampled(specimen_fit(identified=False)).as_json())
    assert any(line.endswith("tau not identified") for line in lines)
    fits = (sampled(specimen_fit()), sampled(specimen_fit(identified=False)))
    every = [
        line
        for fit in fits
        for line in (*said.parameter_lines(fit.as_json()), *said.sampling_lines(fit.as_json()))
    ]
    assert all(len(line) <= WIDTH for line in (*lines, *every))
    contradicted = said.block_lines(sampled(specimen_fit(), misfit=True).as_json())
    assert not any("[" in line or "±" in line for line in contradicted)


def row(name: str, mean: float | None, **more: Any) -> dict[str, Any]:
    kept = {"unit": "N", "program": 1, "hold": 1, "time_s": None, "ramp_time_s": [2.0, 2.0], "count": 3}
    return {"name": name, "mean": mean, "sd": 0.5, "reason": None} | kept | more


ROWS = (
    row("peak", 10.0), row("force", 8.0, time_s=1.0), row("force", 6.0, time_s=10.0),
    row("peak", 4.0, program=2, hold=0), row("peak", 2.0, program=3, hold=0),
)  # fmt: skip


def test_a_specimen_among_many_has_one_line_of_its_first_program():
    assert said.brief_measured_lines(ROWS) == [
        "measured    peak 10.00 ± 0.50 N, F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N, 2 more programs"
    ]
    assert said.brief_measured_lines(()) == []
    assert said.brief_measured_lines([row("peak", None)]) == []


def test_a_specimen_alone_shows_two_programs_and_counts_the_others():
    lines = said.measured_lines(ROWS)
    assert lines[0].startswith(
        "measured program 1, no model, ± sd of 3 logs, ramp of 2 s: peak 10.00 ± 0.50 N"
    )
    assert lines[1] == "  F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N"
    assert lines[2].startswith("measured program 2, no model")
    assert lines[3] == "the report has 1 more of these, by program and hold"


def test_numbers_that_are_asked_for_are_in_the_document_and_in_few_lines(tmp_path):
    log = write_log(tmp_path / "log.csv", stride=1)
    out = tmp_path / "out"
    asked = "--tip sphere:4 --thickness 30 --poisson 0.45 --frequencies 1,500 --unloading"
    ended = run("fit", log, "-o", out, *QUICK, *asked.split(), code={0, 4})
    lines = [line for line in ended.stdout.splitlines() if line.startswith(("  measured", "  modulus"))]
    assert [line.split()[0] for line in lines] == ["modulus", "measured,"]
    specimen = read_json(out / "identification.json")["specimens"][0]
    asked = {
        entry["at"]["frequency_Hz"]: entry
        for entry in specimen["quoted"]["model"]
        if entry["name"] == "tan_delta"
    }
    assert set(asked) == {1.0, 500.0}
    assert asked[500.0]["value"] is None
    assert "outside" in asked[500.0]["reason"]
    assert specimen["quoted"]["assumptions"]["poisson"] == 0.45
    # the contact is where the load channel's lag puts it: a sample more or less
    assert specimen["unloading"]["samples_in_air"] <= 1
