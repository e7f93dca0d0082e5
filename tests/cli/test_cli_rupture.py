"""``tissueid rupture``: a cohort from recordings to bundles that break."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import REPOSITORY, read_json, run, write_csv, write_study

from tissueid.haptics.states import Lamp
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed
from tissueid.model.rupture import rupture_measures
from tissueid.store.bundle import load_bundle
from tissueid.store.session_log import read_session_log

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
    assert "work" in (out / "rupture.html").read_text(encoding="utf-8")
    work = next(row for row in document["criteria"] if row["criterion"] == "work")
    assert document["taken"] == "work"
    # an excluded recording takes no part
    assert not any("rupture-02-rupture-0600" in one["path"] for one in document["tests"])
    assert document["left_out"] == []
    for row in document["laws"]:
        law = load_bundle(out / row["bundle"]).rupture
        assert law is not None
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
