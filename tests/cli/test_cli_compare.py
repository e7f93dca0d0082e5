"""``tissueid compare``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cohort_outputs import cohort_folder
from command_line import read_json, run, write_log
from rendered_tissues import PAPER_A, bundle_of

from tissueid.store.bundle import write_bundle
from tissueid.store.schema import check


def bundle(folder: Path, name: str, *, scale: float = 1.0, draws: int = 400) -> Path:
    chance = np.random.default_rng(len(name))
    theta = PAPER_A.theta * np.array([scale, scale, scale, scale, 1.0])
    known = theta * np.exp(0.01 * chance.standard_normal((draws, 1)) * np.array([1.0, 1.0, 1.0, 1.0, 0.0]))
    path = folder / f"{name}.h5"
    tissue = replace(PAPER_A, theta=theta, name=name)
    write_bundle(bundle_of(tissue, draws=known), path)
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
    check(read_json(tmp_path / f"{written}.json"), "contrast", where="contrast.json")
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
    assert "force at 1 s [N]" in run("compare", one, other).stdout


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
    assert "no such bundle" in run("compare", log, tmp_path / "b.h5").stderr
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "identification.json").write_text("{}", encoding="ascii")
    assert "compare recordings, or fits" in run("compare", log, tmp_path / "out").stderr
