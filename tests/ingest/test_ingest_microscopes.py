"""Force curves of microscopes and nano-indenters; fixtures are synthetic, written from the formats' facts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ingest_files import put, read, refusal, zipped
from jpk_archives import SHARED, STIFFNESS_N_PER_M, Curve

from tissueid.ingest import find_inputs, read_trials
from tissueid.segment import segment
from tissueid.trial import Trial


def assert_is(trial: Trial, curve: Curve) -> None:
    for channel, wanted in zip(
        (trial.time_s, trial.displacement_mm, trial.force_N), curve.expected(), strict=True
    ):
        np.testing.assert_allclose(channel, wanted, rtol=1e-12, atol=1e-18)


def test_a_force_curve_is_decoded_through_its_slots_and_segmented(tmp_path: Path) -> None:
    path = put(tmp_path / "cell.jpk-force", zipped(Curve().files()))
    assert find_inputs([tmp_path]) == [path]
    trial = read(path)
    assert_is(trial, Curve())
    assert (trial.source.recipe, trial.source.sheet) == ("jpk-force", None)
    assert trial.source.columns["displacement"] == "measuredHeight"
    (bending,) = (flag for flag in trial.flags if flag.code == "cantilever_bending")
    assert bending.values["stiffness_N_per_mm"] == pytest.approx(STIFFNESS_N_PER_M / 1000)
    assert bending.values["bending_mm"] == pytest.approx(1e3 * np.ptp(trial.force_N) / STIFFNESS_N_PER_M)
    found = segment(trial)
    assert found.compression_sign == -1
    (hold,) = found.of_kind("hold")
    assert (hold.start_s, hold.end_s) == (pytest.approx(2.0, abs=0.01), pytest.approx(10.0, abs=0.01))


def test_a_map_and_an_archive_of_curves_give_one_trial_a_curve(tmp_path: Path) -> None:
    files = {**Curve().files("index/0/"), **Curve().files("index/2/")}
    (tmp_path / "map.jpk-force-map").write_bytes(zipped(files))
    maps = read_trials(tmp_path / "map.jpk-force-map")
    assert [trial.source.sheet for trial in maps] == ["0", "2"]
    single = zipped(Curve().files())
    (tmp_path / "cells.zip").write_bytes(zipped({"day 1/a.jpk-force": single, "day 1/b.jpk-force": single}))
    packed = read_trials(tmp_path / "cells.zip")
    assert [trial.source.sheet for trial in packed] == ["day 1/a.jpk-force", "day 1/b.jpk-force"]
    for trial in (*maps, *packed):
        assert_is(trial, Curve())


@pytest.mark.parametrize(
    ("lacking", "word"),
    [
        ("lcd-info.0.conversion-set.conversion.force.scaling.multiplier", "vDeflection in force"),
        ("lcd-info.0.conversion-set.conversion.distance.scaling.multiplier", "distance.scaling.multiplier"),
        ("lcd-info.10.encoder.type", "measuredHeight in a known type"),
    ],
)
def test_a_curve_without_its_calibration_is_refused_by_what_it_lacks(tmp_path, lacking, word) -> None:
    shared = {key: value for key, value in SHARED.items() if key != lacking}
    error = refusal(put(tmp_path / "cell.jpk-force", zipped(Curve(shared).files())))
    assert error.code == "unreadable_archive"
    assert word in error.message


def test_segments_without_a_common_height_are_refusal(tmp_path: Path) -> None:
    files = Curve().files()
    del files["segments/1/channels/measuredHeight.dat"]
    path = put(tmp_path / "cell.jpk-force", zipped(files))
    assert refusal(path).code == "no_columns"


PIUMA = (
    "Date\t12/05/2025\tTime\t11:20:38\tStatus\tOK\nPDMS\nk (N/m)\t0{m}500\nTip radius (um)\t50{m}0\n"
    "Calibration factor\t2{m}8\n\nPiezo Indentation Sweep Settings\n"
    "D[Z1] (nm)\t10000{m}000\tt[1] (s)\t2{m}000\nD[Z2] (nm)\t10000{m}000\tt[2] (s)\t30{m}000\n"
    "D[Z3] (nm)\t0{m}000\tt[3] (s)\t2{m}000\nD[Z4] (nm)\tNaN\tt[4] (s)\tNaN\n\nE[eff] (Pa)\t1560{m}09\n\n"
    "Time (s)\tLoad (uN)\tIndentation (nm)\tCantilever (nm)\tPiezo (nm)\tAuxiliary\n"
)


@pytest.mark.parametrize("mark", [".", ","])
def test_a_piuma_header_gives_tip_speed_and_hold(tmp_path: Path, mark: str) -> None:
    rows = "".join(
        "\t".join(f"{value:.6f}" for value in (k / 100, k / 7, k * 10.5, k * 2.0, k * 12.5, 0.0)) + "\n"
        for k in range(40)
    )
    path = tmp_path / "sample Indentation_001.txt"
    path.write_text(PIUMA.replace("{m}", mark) + rows.replace(".", mark), encoding="cp1252")
    trial = read(path)
    assert trial.source.recipe == "chiaro"
    assert trial.protocol.tip_radius_mm == pytest.approx(0.05)
    assert trial.protocol.speed_mm_s == pytest.approx(0.005)
    assert trial.protocol.hold_s == pytest.approx(30.0)
    assert trial.source.metadata["k (N/m)"] == f"0{mark}500"
    assert trial.source.metadata["E[eff] (Pa)"] == f"1560{mark}09"
    assert trial.displacement_mm[-1] == pytest.approx(39 * 10.5e-6)
