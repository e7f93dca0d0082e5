"""Force curves of microscopes and nano-indenters; fixtures are synthetic, written from the public formats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from ingest_files import put, read, refusal, zipped
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.ingest import find_inputs, read_trials
from tissueid.segment import segment
from tissueid.trial import Trial

STIFFNESS_N_PER_M, SENSITIVITY_M_PER_V = 0.05, 5e-8
VOLTS_PER_COUNT, HEIGHT_PER_COUNT, HEIGHT_FACTOR, HEIGHT_ZERO_M = 1e-7, 1e-12, 2.0, 1e-6
RATE_HZ = 250.0


def _properties(values: Mapping[str, object]) -> bytes:
    return ("#Tue\n" + "\n".join(f"{key}={value}" for key, value in values.items())).encode()


def _slot(head: str, slot: str, base: str, multiplier: float, offset: float = 0.0) -> dict[str, object]:
    conversion = f"{head}.conversion-set.conversion.{slot}"
    return {
        f"{head}.conversion-set.conversions.base": "volts",
        f"{conversion}.base-calibration-slot": base,
        f"{conversion}.scaling.multiplier": multiplier,
        f"{conversion}.scaling.offset": offset,
    }


def _encoder(head: str, kind: str, multiplier: float) -> dict[str, object]:
    scaling = f"{head}.encoder.scaling"
    return {f"{head}.encoder.type": kind, f"{scaling}.multiplier": multiplier, f"{scaling}.offset": 0.0}


SHARED: dict[str, object] = {
    **_encoder("lcd-info.0", "signedinteger", VOLTS_PER_COUNT),
    **_slot("lcd-info.0", "distance", "volts", SENSITIVITY_M_PER_V),
    **_slot("lcd-info.0", "force", "distance", STIFFNESS_N_PER_M),
    **_encoder("lcd-info.10", "signedlong-limited", HEIGHT_PER_COUNT),
    **_slot("lcd-info.10", "nominal", "volts", HEIGHT_FACTOR, HEIGHT_ZERO_M),
}


@dataclass(frozen=True)
class Curve:
    """An approach, a hold at constant height and a retract; channels to the last count [s, mm, N]."""

    shared: dict[str, object] = field(default_factory=lambda: dict(SHARED))

    def parts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Height [m] and force [N] of each segment."""
        down, held = 20e-6 - 10e-6 * np.arange(500) / 500, np.full(2000, 10e-6)
        relaxing = 0.5 + 0.5 * np.exp(-np.arange(2000) / 500)
        pressed = 10e-9 * np.maximum(15e-6 - down, 0.0) / 1e-6
        return [(down, pressed), (held, 50e-9 * relaxing), (down[::-1], 0.5 * pressed[::-1])]

    def counts(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """What is stored."""
        per_count = STIFFNESS_N_PER_M * SENSITIVITY_M_PER_V * VOLTS_PER_COUNT
        return [
            (
                np.rint((height - HEIGHT_ZERO_M) / HEIGHT_FACTOR / HEIGHT_PER_COUNT).astype(np.int64),
                np.rint(force / per_count).astype(np.int64),
            )
            for height, force in self.parts()
        ]

    def expected(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, travel and force of the whole curve, by the arithmetic of the format."""
        height = np.concatenate([one for one, _ in self.counts()])
        force = np.concatenate([one for _, one in self.counts()])
        travel = HEIGHT_FACTOR * (HEIGHT_PER_COUNT * height) + HEIGHT_ZERO_M
        volts = VOLTS_PER_COUNT * force
        return (
            np.arange(height.size) / RATE_HZ,
            travel * 1e3,
            STIFFNESS_N_PER_M * (SENSITIVITY_M_PER_V * volts),
        )

    def files(self, folder: str = "") -> dict[str, bytes]:
        """Members of the archive."""
        found = {"shared-data/header.properties": _properties(self.shared), "header.properties": b"a=b\n"}
        for number, (height, force) in enumerate(self.counts()):
            segment = f"{folder}segments/{number}/"
            head = {
                "force-segment-header.duration": height.size / RATE_HZ,
                "channel.vDeflection.lcd-info.*": 0,
                "channel.measuredHeight.lcd-info.*": 10,
            }
            found[f"{segment}segment-header.properties"] = _properties(head)
            found[f"{segment}channels/measuredHeight.dat"] = height.astype(">i8").tobytes()
            found[f"{segment}channels/vDeflection.dat"] = force.astype(">i4").tobytes()
        return found


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
