"""Recordings in the grammars of laboratories whose files were never seen, with numbers of their own.

A press into a tissue of two branches: every grammar must give back its samples, and every phase its ends.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal

from tissueid.ingest import ReadOptions, read_each
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.segment import segment
from tissueid.trial import Segmentation, Trial

CONTACT_MM, DEPTH_MM, SPEED_MM_S, HOLD_S = 1.5, 4.0, 2.0, 20.0
REST_S = 0.5
STOP_S = REST_S + (CONTACT_MM + DEPTH_MM) / SPEED_MM_S
Row = tuple[float, float, float]


def press(rate_hz: float = 20.0, *, noise_N: float = 0.0, friction_N: float = 0.0) -> list[Row]:
    """Rest, approach, ramp, hold, and the way back under a friction: time [s], travel [mm], force [N]."""
    fine = np.arange(0.0, STOP_S + HOLD_S + 4.0, 1e-3)
    knots = [0.0, REST_S, STOP_S, STOP_S + HOLD_S, STOP_S + HOLD_S + STOP_S - REST_S]
    travel = np.interp(fine, knots, [0.0, 0.0, CONTACT_MM + DEPTH_MM, CONTACT_MM + DEPTH_MM, 0.0])
    depth = np.clip(travel - CONTACT_MM, 0.0, None)
    force = 1.2 * depth + 0.25 * depth**2
    for tau_s, stiffness in ((0.5, 0.8), (6.0, 0.5)):
        branch = np.zeros_like(fine)
        for i, step in enumerate(np.diff(depth), 1):
            branch[i] = branch[i - 1] * np.exp(-1e-3 / tau_s) + step
        force += stiffness * branch
    force[(depth <= 0.0) | (force < 0.0)] = 0.0
    back = (fine > knots[3]) & (depth > 0.0)
    force[back] -= friction_N
    force += noise_N * np.random.default_rng(7).standard_normal(fine.size)
    every = round(1e3 / rate_hz)
    return list(zip(*(values[::every].tolist() for values in (fine, travel, force)), strict=True))


PRESS = press()
STEP = "\n[step]\nRelaxation - 2\nTime\tAxial force\tGap\ns\tN\tmm\n"

GRAMMARS: dict[str, tuple[str, Callable[[int, Row], str]]] = {
    "comments-before-names-and-units": (
        "# operator: kb\n# time, pos, force\n# s, mm, mN\n",
        lambda _, r: f"{r[0]:.3f},{r[1]:.4f},{1e3 * r[2]:.1f}\n",
    ),
    "names-behind-a-word-for-them": (
        "# force gauge\n# Columns: time_s, pos_mm, force_mN\n",
        lambda _, r: f"{r[0]:.3f},{r[1]:.4f},{1e3 * r[2]:.1f}\n",
    ),
    "time-named-by-its-unit": (
        "N\t[s]\tForce [kN]\tPiston [mm]\n",
        lambda i, r: f"{i}\t{r[0]:.3f}\t{r[2] / 1e3:.7f}\t{r[1]:.4f}\n",
    ),
    "pose-and-wrench": (
        "timestamp (s),tool x (m),tool y (m),tool z (m),fx (N),fy (N),sensor fz (N)\n",
        lambda _, r: f"{1.7e9 + r[0]:.3f},0.4,0.1,{0.3 - r[1] / 1e3:.7f},0.02,0.01,{-r[2]:.4f}\n",
    ),
    "paths-of-messages": (
        "ts,/arm/target_pose/position/z,/arm/pose/position/z,/ft/wrench/force/x,/ft/wrench/force/z\n",
        lambda _, r: f"{1.7e9 + r[0]:.3f},{300.2 - r[1]:.4f},{300.0 - r[1]:.4f},0.01,{-r[2]:.4f}\n",
    ),
    "set-beside-measured": (
        "t_s,pos_set_mm,z_set_mm,z_meas_mm,F_N\n",
        lambda _, r: f"{r[0]:.3f},{r[1] + 0.2:.4f},{r[1] + 0.2:.4f},{r[1]:.4f},{r[2]:.4f}\n",
    ),
    "words-by-their-capitals": (
        "Time_s,ProbePos_mm,MaxForce_N,Fn_N,FnRef_N\n",
        lambda _, r: f"{r[0]:.3f},{r[1]:.4f},99.0,{r[2]:.4f},1.25\n",
    ),
    "epoch-of-a-clock": (
        "epoch,position,force\n",
        lambda _, r: f"{1.71e9 + r[0]:.3f},{r[1]:.4f},{r[2]:.4f}\n",
    ),
    "nul-at-the-end-of-a-line": (
        '"C:\\run.xml","3/4/2015",\0\r\n"Elapsed Time ","Disp  ","Load ",\r\n"Sec","mm","N",\r\n',
        lambda _, r: f"{r[0]:.3f},{-r[1]:.4f},{-r[2]:.4f},\r\n",
    ),
    "steps-under-heads-of-their-own": (
        f"Sample name\tliver 3\n{STEP}",
        lambda i, r: STEP * (i % 200 == 199) + f"{r[0]:.3f}\t{r[2]:.4f}\t{10.0 - r[1]:.4f}\n",
    ),
}  # fmt: skip


@pytest.mark.parametrize("grammar", GRAMMARS)
def test_a_foreign_grammar_gives_back_its_samples(tmp_path: Path, grammar: str) -> None:
    head, line = GRAMMARS[grammar]
    trial = read(put(tmp_path / "a.csv", head + "".join(line(i, row) for i, row in enumerate(PRESS))))
    time, travel, force = np.array(PRESS).T
    np.testing.assert_allclose(trial.time_s - trial.time_s[0], time, atol=1e-3)
    np.testing.assert_allclose(np.abs(trial.displacement_mm - trial.displacement_mm[0]), travel, atol=2e-4)
    np.testing.assert_allclose(np.abs(trial.force_N), force, atol=2e-4)


@pytest.mark.parametrize(("per_mm", "asked"), [(1e-3, True), (1.0, False)])
def test_a_place_without_a_unit_that_may_be_in_metres_is_asked_about(tmp_path, per_mm, asked) -> None:
    """A robot writes metres and names no unit: 13 N within 0.0055 mm are stiffer than a frame."""
    rows = "".join(f"{t:.3f},{0.3 - per_mm * x:.7f},{f:.4f}\n" for t, x, f in PRESS)
    said = [flag.message for flag in read(put(tmp_path / "a.csv", "t,z,Fz\n" + rows)).flags]
    assert said[0].endswith("is it in m?") is asked
    if asked:
        stated = read(put(tmp_path / "b.csv", "t,z,Fz\n" + rows), ReadOptions(units={"displacement": "m"}))
        assert np.ptp(stated.displacement_mm) == pytest.approx(CONTACT_MM + DEPTH_MM, abs=1e-3)
        assert not any("in m?" in flag.message for flag in stated.flags)


@pytest.mark.parametrize("above", ["", "Test ID,Batch,Test ID,Batch\nT1,,T2,\n", "T1,,,,T2\n"])
def test_tables_side_by_side_may_be_parted_by_an_empty_column(tmp_path: Path, above: str) -> None:
    names = "Force (g),Distance (mm),Time (sec)"
    rows = [f"{r[2] / 9.80665e-3:.3f},{r[1]:.3f},{r[0]:.3f}" for r in PRESS]
    text = above + f"{names},,{names}\n" + "".join(f"{row},,{row}\n" for row in rows[:-9])
    trials = list(read_each(put(tmp_path / "a.csv", text + "".join(f"{row},,,,\n" for row in rows[-9:]))))
    assert [one.time_s.size for one in trials if isinstance(one, Trial)] == [len(rows), len(rows) - 9]
    peaks = [float(one.force_N.max()) for one in trials if isinstance(one, Trial)]
    assert peaks == pytest.approx([max(r[2] for r in PRESS)] * 2, rel=1e-3)


def by_a_spreadsheet(value: float, decimals: int) -> str:
    """A number after a spreadsheet that takes a point for thousands: ``1.0114`` becomes ``10,114``."""
    shown = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return f"{int(shown.replace('.', '')):,}" if value >= 1.0 and "." in shown else shown.replace(".", ",")


@pytest.mark.parametrize(
    ("channel", "decimals", "most"), [(1, 4, 99.0), (2, 4, 99.0), (1, 4, 1.03), (1, 5, 1.009), (2, 4, 2.0)]
)
def test_tenths_that_a_spreadsheet_made_are_refused(tmp_path, channel, decimals, most) -> None:
    # digits differ from row to row
    rows = [[value + 0.0037 * row[0] * (k > 0) for k, value in enumerate(row)] for row in PRESS]
    text = "Time;Displacement;Force\n(s);(mm);(N)\n"
    for row in rows[: next((k for k, row in enumerate(rows) if row[channel] > most), None)]:
        sound = [f"{value:.4f}".replace(".", ",") for value in row]
        text += (
            ";".join([*sound[:channel], by_a_spreadsheet(row[channel], decimals), *sound[channel + 1 :]])
            + "\n"
        )
    error = refusal(put(tmp_path / "a.csv", text))
    assert (error.code, error.column) == ("damaged_number", channel + 1)
    assert f"the {CHANNELS[channel]} is" in error.message
    assert "original export" in error.message


@pytest.mark.parametrize("row", ["{0:.0f},{1:.0f},{2:.0f}\n", "{0:.2f},{3:.1f},{2:.1f}\n"])
def test_counts_of_a_logger_and_noise_about_zero_have_lost_no_marks(tmp_path: Path, row: str) -> None:
    rows = press(50.0, noise_N=2e-3)
    text = "".join(row.format(1e3 * t, 1e3 * x, 1e3 * f, 1e3 * x + 0.3) for t, x, f in rows)
    trial = read(put(tmp_path / "a.csv", "time(ms),position(um),force(mN)\n" + text))
    assert "no_decimals" not in codes(trial)
    assert trial.force_N.max() == pytest.approx(max(r[2] for r in rows), abs=1e-3)


@pytest.mark.parametrize("kind", ["noise", "square wave of 1 and 10", "a jump to where digits are fewer"])
def test_noise_and_steps_are_no_tenths(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(3)
    force = rng.normal(0.0, 1.0, 4000) if kind == "noise" else np.repeat([1.0, 10.0] * 1000, 2)
    if "jump" in kind:
        force = np.linspace(0.9, 0.99, 4000) + 8.5 * (np.arange(4000) > 2000)
    rows = "".join(f"{0.01 * i:.2f},{0.001 * i:.4f},{f:.4g}\n" for i, f in enumerate(force))
    assert read(put(tmp_path / "a.csv", "Time (s),Position (mm),Force (N)\n" + rows)).force_N.size == 4000


def segmented(path: Path, decimals: int, rows: list[Row]) -> Segmentation:
    lines = "".join(f"{t:.3f},{x:.4f},{f:.{decimals}f}\n" for t, x, f in rows)
    return segment(read(put(path / "a.csv", "Time (s),Extension (mm),Load (N)\n" + lines)))


@pytest.mark.parametrize(
    ("decimals", "rows"),
    [
        pytest.param(2, press(10.0, noise_N=2e-3), id="hundredths-at-10-Hz"),
        pytest.param(2, press(50.0, noise_N=2e-3), id="hundredths-at-50-Hz"),
        pytest.param(1, press(50.0, noise_N=2e-2), id="tenths-at-50-Hz"),
        pytest.param(4, press(50.0, noise_N=3e-3, friction_N=10.0), id="needle-whose-friction-turns"),
    ],
)
def test_neither_digits_nor_the_corner_of_a_hold_are_its_noise(tmp_path, decimals, rows) -> None:
    found = segmented(tmp_path, decimals, rows)
    assert found.contact.in_record
    assert found.contact.displacement_mm == pytest.approx(CONTACT_MM, abs=0.05)
    (hold,) = found.of_kind("hold")
    assert hold.end_s - hold.start_s == pytest.approx(HOLD_S, abs=0.15)


@pytest.mark.parametrize("tau_s", [1.5, 4.0, 8.0])
def test_creep_that_dies_away_under_a_held_load_is_no_hold(tmp_path: Path, tau_s: float) -> None:
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 60.0, 0.05)
    load = np.interp(time, [2.0, 7.0, 47.0, 52.0], [0.0, 5.0, 5.0, 0.0])
    late = np.clip(np.minimum(time, 47.0) - 7.0, 0.0, None)
    travel = 0.5 * load * (1.0 + 0.12 * (1.0 - np.exp(-late / tau_s)))
    travel += rng.normal(0.0, 1e-3, time.size)
    force = load + rng.normal(0.0, 3e-3, time.size)
    found = segmented(tmp_path, 4, list(zip(time.tolist(), travel.tolist(), force.tolist(), strict=True)))
    (creep,) = found.of_kind("creep")
    assert (creep.start_s, creep.end_s) == pytest.approx((7.0, 47.0), abs=0.3)
    assert not found.of_kind("hold")
