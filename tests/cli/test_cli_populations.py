"""``tissueid cohort``, ``compare`` and ``rupture``: from studies to populations, pairs and failures."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cohort_outputs import cohort_folder
from command_line import REPOSITORY, read_json, run, write_csv, write_log, write_study
from rendered_tissues import PAPER_A, bundle_of

from tissueid.documents.contrast import Contrast
from tissueid.haptics.states import Lamp
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed
from tissueid.model.rupture import rupture_measures
from tissueid.population.members import thawed_among_fresh
from tissueid.store.bundle import load_bundle, write_bundle
from tissueid.store.results import validate_outputs
from tissueid.store.schema import check
from tissueid.store.session_log import read_session_log

#: One branch, constant K, few draws: what is tested is the way from a study to its population.
SMALL = ("--branches", "1", "--stiffness-degree", "0", "--draws", "400")
#: Forces of the specimens, in those of the first.
TIMES = (0.8, 0.9, 1.0, 1.1, 1.25)


def a_study(folder: Path, times: tuple[float, ...], storage: tuple[str, ...] = ()) -> Path:
    """One log a specimen, the same but for its force (and its storage)."""
    tables = []
    for number, factor in enumerate(times, 1):
        write_log(folder / f"{number}.csv", label=None, force_times=factor)
        tables += [
            f'[[specimen]]\nname = "head {number}"\nage_years = {50 + number}',
            *([f'storage = "{storage[number - 1]}"'] if storage else []),
            f'[[trial]]\nfile = "{number}.csv"\nspecimen = "head {number}"',
        ]
    write_study(folder, *tables)
    return folder


@pytest.fixture(scope="module")
def cohort(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cohort")
    ended = run("fit", a_study(folder / "heads", TIMES), "-o", folder / "out", *SMALL)
    return folder / "out", ended


def files_of(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in {".h5", ".json", ".csv"}}


def test_a_study_of_five_gets_its_population(cohort):
    out, ended = cohort
    document: dict[str, Any] = read_json(out / "population.json")
    assert "population of 5 specimens" in ended.stdout
    assert sorted(document["specimens_used"]) == [f"head {number}" for number in range(1, 6)]
    assert (out / "cohort.html").is_file()
    run("validate", out, code=0)
    run("cohort", out, "--covariate", "weight", code=2, said="stated are age_years")


DRAWN = ("--device", "sim", "--virtual", "--draw-specimen")


@pytest.mark.needs_jit
def test_a_specimen_of_the_population_is_rendered(cohort):
    script = ("--script", "indent 1 mm at 500 mm/min; retract at 500 mm/min", "--json")
    felt = run("render", cohort[0] / "population.h5", *DRAWN, "7", *script, code=0)
    draws = load_bundle(cohort[0] / "population.h5").draws
    assert f"of {len(draws)} drawn from the population of 5 specimens" in felt.stderr + felt.stdout


@pytest.mark.parametrize(
    ("bundle", "seed", "said"),
    [
        ("bundle-head_1.h5", (), "tissueid cohort OUT"),
        ("population.h5", ("seven",), "the seed is a whole number"),
    ],
)
def test_a_specimen_that_can_not_be_drawn_is_refused(cohort, bundle, seed, said):
    run("render", cohort[0] / bundle, *DRAWN, *seed, code=2, said=said)


def test_two_specimens_are_refused_and_the_set_stays(tmp_path):
    folder = cohort_folder(tmp_path / "two", 2, study=False)
    run("cohort", folder, "-q", code=4, said="a population takes 3 at least")
    assert not (folder / "population.json").exists()
    validate_outputs(folder)


def test_its_typical_tissue_and_its_spread_are_those_of_the_forces(cohort):
    out, _ = cohort
    rows = read_json(out / "population.json")["population"]["quantities"]
    own = load_bundle(out / "bundle-head_3.h5")
    typical = load_bundle(out / "population.h5")
    geometric_mean = float(np.exp(np.mean(np.log(TIMES))))
    depth = float(typical.depth_mm)
    powers = depth ** np.arange(1.0, 4.0)
    force_N = float(own.theta[:3] @ powers)
    # the factors' own mean, within the noise of one log each
    assert rows[2]["median"] == pytest.approx(force_N * geometric_mean, rel=0.05)
    assert float(typical.theta[:3] @ powers) == pytest.approx(force_N * geometric_mean, rel=0.05)
    low, high = rows[2]["cv_ci95"]
    assert low < float(np.std(np.log(TIMES), ddof=1)) < high


def test_a_cohort_is_drawn_again_without_touching_the_fit(cohort):
    out, _ = cohort
    before = files_of(out)
    asked = ("--tails", "normal", "--covariate", "age_years", "--no-held-out", "--json")
    ended = run("cohort", out, *asked, code={0, 4})
    after = files_of(out)
    changed = {name for name in after if after[name] != before.get(name)}
    assert ended.json()["population"]["held_out"] is None
    assert changed <= {"population.json", "population.h5"}
    assert "population.json" in changed


def test_thawed_specimens_among_fresh_ones_are_named_and_not_pooled_unasked(tmp_path):
    folder = a_study(tmp_path / "heads", TIMES[:3], ("fresh, 4 C", "frozen at -20 C", "fresh"))
    said = ("head 2 thawed among 2 fresh", "--mix-states")
    run("fit", folder, "-o", tmp_path / "out", *SMALL, "--population", "yes", code=4, said=said)
    assert not (tmp_path / "out" / "population.json").exists()
    run("cohort", tmp_path / "out", "--mix-states")
    assert (tmp_path / "out" / "population.json").is_file()


def test_the_state_is_read_from_storage_and_cycles():
    stated = {
        "frozen": {"storage": "frozen"}, "once": {"freeze_thaw_cycles": 1},
        "overnight": {"storage": "-80 C, thawed overnight"}, "never": {"storage": "never frozen"},
        "saline": {"storage": "saline, 4 C"}, "gel": {"freeze_thaw_cycles": 0, "storage": "frozen gel pack"},
        "unstated": {},
    }  # fmt: skip
    members: Any = [SimpleNamespace(specimen=name, covariates=known) for name, known in stated.items()]
    thawed, fresh = thawed_among_fresh(members)
    assert (thawed, fresh) == (["frozen", "once", "overnight"], ["never", "saline", "gel"])


def bundle(folder: Path, name: str, *, scale: float = 1.0, draws: int = 400) -> Path:
    chance = np.random.default_rng(len(name))
    theta = PAPER_A.theta * np.array([scale, scale, scale, scale, 1.0])
    known = theta * np.exp(0.01 * chance.standard_normal((draws, 1)) * np.array([1.0, 1.0, 1.0, 1.0, 0.0]))
    path = folder / f"{name}.h5"
    tissue = replace(PAPER_A, theta=theta, name=name)
    write_bundle(bundle_of(tissue, draws=known if draws else None), path)
    return path


def test_a_stiffer_tissue_differs_and_could_be_felt(tmp_path):
    one, other = bundle(tmp_path, "kidney"), bundle(tmp_path, "liver", scale=1.5)
    run("compare", one, other, code=0, shown=("kidney and liver: differ", "a hand could tell: force"))
    document = run("compare", one, other, "--json").json("contrast")
    assert document["pairs"][0]["difference"]["different"] is True
    said = ("kidney (1) and kidney (2): not shown to differ", "a hand would hardly tell")
    run("compare", one, one, shown=said)


def test_folders_are_compared_by_draws_that_know_the_machine_and_bundles_say_that_theirs_do_not(tmp_path):
    folder = cohort_folder(tmp_path / "out", 2)
    for args, interval, remarks in (
        ((folder,), "total", 0),
        ((folder, "--interval", "statistical"), "statistical", 1),
        (sorted(folder.glob("bundle-*.h5")), "statistical", 1),
    ):
        document = run("compare", *args, "--json").json("contrast")
        assert {one["interval"] for one in document["tissues"]} == {interval}
        assert sum("machine" in one for one in document["remarks"]) == remarks


@pytest.mark.parametrize(
    ("named", "written"),
    [("two", "two/contrast"), ("pair.json", "pair"), ("pair.html", "pair"), ("v1.2", "v1.2/contrast")],
)
def test_document_and_page_are_written_together(tmp_path, named, written):
    one, other = bundle(tmp_path, "kidney"), bundle(tmp_path, "liver", scale=1.5)
    run("compare", one, other, "-o", tmp_path / named, "-q", code=0)
    check(read_json(tmp_path / f"{written}.json"), Contrast, where="contrast.json")
    page = (tmp_path / f"{written}.html").read_text(encoding="utf-8")
    assert "kidney and liver differ" in page
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        {"kidney.h5", "liver.h5", *({named} if "/" in written else {"pair.json", "pair.html"})}
    )


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    path = bundle(tmp_path, "kidney")
    (tmp_path / "file").write_text("in the way", encoding="ascii")
    for place in ("file/below", "file/pair.json", "file"):
        run("compare", path, path, "-o", tmp_path / place, code=2, said="file")


def test_curves_are_those_of_the_law(tmp_path):
    path = bundle(tmp_path, "kidney")
    document = run("compare", path, path, "--json").json()
    curve = document["curves"][0]["loading"][-1]
    theta = PAPER_A.theta
    v, tau, x = curve["speed_mm_s"], theta[4], np.array(curve["depth_mm"])
    force = theta[0] * x + theta[1] * x**2 + theta[2] * x**3
    force = force + theta[3] * v * tau * -np.expm1(-x / (v * tau))
    # 400 draws of 1 %: the median is known to a twentieth of that
    np.testing.assert_allclose(curve["median"][1:], force[1:], rtol=0.003)
    hold = document["curves"][0]["hold"]
    held = force[-1] - theta[3] * v * tau * -np.expm1(-x[-1] / (v * tau)) * -np.expm1(
        -np.array(hold["time_s"]) / tau
    )
    np.testing.assert_allclose(hold["median"], held, rtol=0.003)
    assert hold["time_s"][-1] == pytest.approx(5.0 * tau)
    for one in (curve, hold):
        assert all(a <= b <= c for a, b, c in zip(one["low"], one["median"], one["high"], strict=True))
    # the numbers of the table are points of the curve
    last = next(
        row
        for row in document["pairs"][0]["numbers"]
        if f"{v:.3g} mm/s" in row["name"] and row["name"].startswith("force at 8")
    )
    assert last["one"] == pytest.approx([curve[name][-1] for name in ("low", "median", "high")], rel=1e-9)


@pytest.mark.parametrize(
    ("draws", "args", "said"),
    [
        (400, (), "nothing to compare"),
        (20, ("again",), "too few"),
        (400, ("--interval", "total"), "output folder"),
        (400, ("again", "--contact", "1"), "--contact is for recordings"),
        (0, ("again", "--interval", "statistical"), "no draws; fit with a sampler\n"),
    ],
)
def test_what_cannot_be_compared_is_refused(tmp_path, draws, args, said):
    path = bundle(tmp_path, "kidney", draws=draws)
    run("compare", path, *(path if arg == "again" else arg for arg in args), code=2, said=said)


MUSCLE = ("--columns", "time=Time,displacement=L,force=F")


def measured(document: Any) -> dict[tuple[str, float | None], Any]:
    """Rows of the only pair."""
    (pair,) = document["pairs"]
    return {(row["name"], row["time_s"]): row for row in pair["numbers"]}


def test_recordings_of_one_program_are_compared(tmp_path):
    one, other = write_log(tmp_path / "a.csv"), write_log(tmp_path / "b.csv", force_times=1.5)
    document = run("compare", one, other, "--json", "-o", tmp_path / "pair.json").json("measured-contrast")
    assert read_json(tmp_path / "pair.json") == document
    rows = measured(document)
    assert rows["peak", None]["ratio"] == pytest.approx(1.5, rel=0.01)
    assert rows["force", 1.0]["ratio"] == pytest.approx(1.5, rel=0.01)
    assert rows["force_over_peak", 1.0]["reason"] is None
    assert "force at 1 s [N]" in run("compare", one, other, "-o", tmp_path / "two.sides").stdout
    assert read_json(tmp_path / "two.sides" / "contrast.json") == document


def test_normalised_recordings_are_compared_in_their_units_and_with_no_other(tmp_path):
    log = write_log(tmp_path / "a.csv")
    text = log.read_text(encoding="ascii")
    strain = tmp_path / "strain.csv"
    text = text.replace("Extension,Load", "Strain,Stress").replace("(mm),(N)", "(mm/mm),(MPa)")
    strain.write_text(text, encoding="ascii")
    ended = run("compare", strain, strain)
    assert "peak [MPa]" in ended.stdout
    assert not re.search(r"\bN\b|\bmm\b", ended.stdout.split("no model")[1])
    run("compare", log, strain, code=2, said="strain.csv is in 1 and MPa, and")


def test_where_no_program_is_common_that_is_said(tmp_path):
    for number, stretch in enumerate((1.0, 8.0, 64.0, 512.0)):
        log = write_log(tmp_path / str(number // 2) / f"{number}.csv", label=None)
        names, units, *rows = log.read_text(encoding="ascii").splitlines()
        slower = [
            f"{stretch * float(time):.4f},{rest}" for time, _, rest in (row.partition(",") for row in rows)
        ]
        log.write_text("\n".join([names, units, *slower, ""]), encoding="ascii")
    assert "nothing is compared" in run("compare", tmp_path / "0", tmp_path / "1").stdout


def test_a_share_of_the_peak_is_not_compared_between_ramps(shared_data):
    folder = shared_data / "muscle-ramp-hold-mit"
    paths = [folder / f"AvgRelaxed_{seconds}s.csv" for seconds in ("0.1", "100")]
    rows = measured(run("compare", *paths, *MUSCLE, "--json").json())
    for name in ("force_over_peak", "force", "force_over_10s"):
        assert rows[name, 1.0]["ratio"] is None
        assert "depends on the ramp" in rows[name, 1.0]["reason"]
    assert "not compared: peak" in run("compare", *paths, *MUSCLE).stdout


def test_a_recording_beside_a_fit_or_alone_is_a_question(tmp_path):
    log = write_log(tmp_path / "a.csv")
    assert "name a second" in run("compare", log).stderr
    assert "--clamp is for fits" in run("compare", log, log, "--clamp", "3", code=2).stderr
    assert "no such bundle" in run("compare", log, tmp_path / "b.h5").stderr
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "identification.json").write_text("{}", encoding="ascii")
    assert "compare recordings, or fits" in run("compare", log, tmp_path / "out").stderr


SET = REPOSITORY / "datasets_synthetic" / "rupture-18"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Two specimens at three speeds, one recording excluded."""
    folder = tmp_path_factory.mktemp("recordings")
    for path in [*SET.glob("rupture-01-*.csv"), *SET.glob("rupture-02-*.csv")]:
        shutil.copy(path, folder)
    write_study(folder, '[[exclude]]\nfile = "rupture-02-rupture-0600-1.csv"\nbecause = "the tool slipped"')
    out = tmp_path_factory.mktemp("out") / "rupture"
    return run("rupture", folder, "-o", out, "--criterion", "work", "--json", code=0), out


def test_it_prints_rupture_json_and_it_is_valid(done):
    ended, out = done
    document = ended.json("rupture")
    assert read_json(out / "rupture.json") == document
    assert run("validate", out, code=0).stdout == f"{out}: valid\n"
    for command in ("report", "export"):
        run(command, out, code=6, said="holds tests to rupture and no fit")
    run("fit", out.parent, "-o", out, code=2, said="outputs of `tissueid rupture`")
    assert "work" in (out / "rupture.html").read_text(encoding="utf-8")
    work = next(row for row in document["criteria"] if row["criterion"] == "work")
    assert document["taken"] == "work"
    # an excluded recording takes no part
    assert not any("rupture-02-rupture-0600" in one["path"] for one in document["tests"])
    assert document["left_out"] == []
    for row in document["laws"]:
        law = load_bundle(out / row["bundle"]).rupture
        assert law.as_json() == row["law"]
        assert law.threshold == work["specimens"][row["specimen"]]
        assert (law.sd_ln, law.specimen_sd_ln) == (work["sd_ln"], work["specimen_sd_ln"])
        # the synthetic tissue keeps a fifth of its force
        assert law.residual == pytest.approx(0.2, abs=0.02)


def test_force_depth_and_work_at_failure_are_those_of_the_truth(done):
    truth = {row["file"]: row for row in read_json(SET / "truth.json")["logs"]}
    tests = done[0].json()["tests"]
    assert len(tests) == 5
    for one in tests:
        true = truth[Path(one["path"]).name]
        assert one["ruptured"] == bool(true["ruptured"])
        # 250 samples/s: 0.2 mm between two samples of the fastest ramp, 0.012 mm of noise in the contact
        for name, sd in (("depth_mm", 0.02), ("force_N", 0.5), ("work_N_mm", 0.5)):
            limit = 4.0 * np.hypot(one[name.replace("_", "_sd_", 1)], sd)
            assert one[name] == pytest.approx(true[f"rupture_{name}"], abs=limit), (one["path"], name)


def test_the_bundle_breaks_in_a_session_at_its_threshold_and_keeps_the_rest(done, tmp_path):
    row, log = done[0].json()["laws"][0], tmp_path / "log.h5"
    asked = ("--device", "sim", "--virtual", "--script", "indent 6 mm at 120 mm/min; hold 0.2 s")
    ended = run("render", done[1] / row["bundle"], *asked, "--log", log, code=0)
    threshold = row["law"]["threshold"]
    assert f"rupture    at a work of {threshold:.4g} N mm" in ended.stdout + ended.stderr
    records = read_session_log(log).records
    first = int(np.argmax(records["lamps"] & Lamp.RUPTURED > 0))
    depth, force = records["depth_mm"][: first + 1], records["tissue_force_N"][: first + 1].copy()
    # the force of the tick in which it broke is what is left already
    force[-1] /= row["law"]["residual"]
    inside = np.maximum(depth, 0.0)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(inside))])
    assert work[-2] < threshold <= work[-1]
    assert records["tissue_force_N"][first] == pytest.approx(
        row["law"]["residual"] * records["tissue_force_N"][first - 1], rel=0.02
    )


QUASI_LINEAR = "power * tangent * prony"
RATE_HZ, AIR_MM, DEEPEST_MM, WORK_N_MM, LEFT = 500.0, 1.0, 8.0, 100.0, 0.2


def quasi_linear_cohort(folder: Path) -> None:
    """Four specimens that break at one work, at three speeds each, under a law without K(x)."""
    rng, model = np.random.default_rng(5), parsed(QUASI_LINEAR).model(DEEPEST_MM, 1.0 / RATE_HZ, 1.0)
    for specimen in range(4):
        theta = np.array([5.0 * np.exp(rng.normal(0.0, 0.1)), 1.8, 1.2, 0.05])
        for speed in (2.0, 10.0, 50.0):
            time = np.arange(0.0, (AIR_MM + DEEPEST_MM) / speed, 1.0 / RATE_HZ)
            depth = np.maximum(speed * time - AIR_MM, 0.0)
            measures = rupture_measures(model, theta, ContactPath(time, depth))
            force = np.where(measures["work"] < WORK_N_MM, 1.0, LEFT) * measures["force"]
            force += rng.normal(0.0, 0.1, time.size)
            write_csv(folder / f"q-{specimen}-{speed:.0f}.csv", time, speed * time, force)


def test_ruptures_under_a_quasi_linear_law_are_decided_and_felt(tmp_path):
    (tmp_path / "logs").mkdir()
    quasi_linear_cohort(tmp_path / "logs")
    out = tmp_path / "out"
    asked = ("--model", QUASI_LINEAR, "--criterion", "auto", "--specimen-by", "(q-[0-9])", "--json")
    document = run("rupture", tmp_path / "logs", "-o", out, *asked).json()
    assert (document["decision"]["answer"], document["taken"]) == ("decided", "work")
    work = next(row for row in document["criteria"] if row["criterion"] == "work")
    assert work["median"] == pytest.approx(WORK_N_MM, rel=0.03)
    # the sign test is of exponentials outside the convolution
    assert document["hardening"] is None
    assert any("outside the convolution" in one for one in document["sentences"])
    bundle, log = out / document["laws"][0]["bundle"], tmp_path / "log.h5"
    assert load_bundle(bundle).model.name == QUASI_LINEAR
    script = "indent 7 mm at 600 mm/min; hold 0.2 s"
    run("render", bundle, "--device", "sim", "--virtual", "--script", script, "--log", log)
    assert (read_session_log(log).records["lamps"] & Lamp.RUPTURED > 0).any()


@pytest.mark.parametrize(
    ("model", "words"), [("yardstick", "no parameters to quote"), ("power * sand", "sand")]
)
def test_a_law_that_can_not_be_quoted_or_is_none_is_refused(tmp_path, model, words):
    run("rupture", SET, "-o", tmp_path / "out", "--model", model, code=2, said=words)


def test_what_a_fit_wrote_is_not_replaced(tmp_path):
    (tmp_path / "identification.json").write_text("{}", encoding="utf-8")
    run("rupture", SET, "-o", tmp_path, code=2, said="choose another folder")
    assert (tmp_path / "identification.json").read_text(encoding="utf-8") == "{}"


def test_recordings_without_a_rupture_are_refused_with_what_is_needed(datasets, tmp_path):
    bad, whole = tmp_path / "bad.csv", datasets / "paper-a-hold-100Hz" / "hold-8-1.csv"
    bad.write_text("nothing here\n", encoding="utf-8")
    few = "0 of 1 tests end in a rupture, and 4 are needed"
    for path, code, said in ((whole, 4, few), (bad, 3, "bad.csv")):
        run("rupture", path, "-o", tmp_path / "out", code=code, said=said)
        assert not (tmp_path / "out" / "rupture.json").exists()
