"""The calibration file: defaults, ranges, and no silent replacement."""

import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.falcon import calibration as module
from tissueid.haptics.falcon import kinematics
from tissueid.haptics.falcon.device import limits_of
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY, forward, inverse, torque
from tissueid.haptics.falcon.transport import UDEV_RULE
from tissueid.haptics.limits import UNCALIBRATED_N, WORST_UNITS_PER_NM

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "devices.md").read_text(encoding="utf-8")


def test_what_is_saved_is_loaded(tmp_path):
    file = tmp_path / "new folder" / "falcon.toml"
    weight = ((0.05, 0.7, -0.1), (2.0, *(0.5,) * 8), True)
    own = module.Calibration("martin-hillier", 41.5, 5123.4, True, 0.81, True, 1.83, True, True, *weight)
    assert module.save_calibration(own, file) == file
    assert module.load_calibration(file) == own
    assert [path.name for path in file.parent.iterdir()] == ["falcon.toml"]


def test_file_lies_in_the_configuration_directory(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("APPDATA", str(tmp_path / "roaming"))
    for platform, configured, folder in (
        ("linux", str(tmp_path / "own"), "own"),
        ("linux", "", ".config"),
        ("win32", "", "roaming"),
        ("darwin", "", "Library/Application Support"),
    ):
        monkeypatch.setattr(module.sys, "platform", platform)
        monkeypatch.setenv("XDG_CONFIG_HOME", configured)
        assert module.calibration_path() == tmp_path / folder / "tissueid" / "falcon.toml"


def test_without_a_file_or_a_key_the_assumptions_hold(tmp_path):
    file = tmp_path / "falcon.toml"
    assert module.load_calibration(file) == module.Calibration()
    file.write_text("zero_angle_deg = 40\n", encoding="utf-8")
    assert module.load_calibration(file) == module.Calibration(zero_angle_deg=40.0)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("units_per_Nm = 66000", "is no number from 1000 to 30000"),
        *((f"units_per_Nm = {value}", "is no number") for value in ("nan", "'6600'", "true")),
        ("force_calibrated = 1", "neither true nor false"),
        ("geometry = 'delta'", "known are stamper, martin-hillier"),
        ("geometry = 3", "known are"),
        ("clamp_N = 8.0", "unknown key 'clamp_N'"),
        ("zero_angle_deg = ", "is no TOML"),
        ("damping_N_s_per_m = -1.0", "is no number from 0 to 20"),
        ("weight_N = [0.0, 0.7]", "not 3 numbers"),
        ("weight_N = [0.0, 70.0, 0.0]", "weight_N"),
        ("\xff\xfe", "can't be read"),
        (None, "can't be read"),
    ],
)
def test_a_damaged_file_is_refused_with_the_way_out(line, reason, tmp_path):
    file = tmp_path / "falcon.toml"
    if line is None:
        file.mkdir()
    else:
        file.write_text(line + "\n", encoding="latin-1")
    with pytest.raises(DeviceError, match=reason) as refused:
        module.load_calibration(file)
    assert str(file) in refused.value.message
    assert "delete it" in refused.value.message


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"units_per_Nm": float("inf")}, r"units_per_Nm = inf is not from 1000\.0 to 30000\.0"),
        ({"weight_N": (0.0, 9.0, 0.0)}, "weight_N"),
    ],
)
def test_nothing_that_would_be_refused_is_written(tmp_path, wrong, words):
    file = tmp_path / "falcon.toml"
    with pytest.raises(DeviceError, match=f"not kept: {words}"):
        module.save_calibration(module.Calibration(**wrong), file)
    assert not file.exists()


def test_a_place_that_can_not_be_written_is_named(tmp_path):
    (tmp_path / "blocked").write_text("", encoding="utf-8")
    with pytest.raises(DeviceError, match="can't be written"):
        module.save_calibration(module.Calibration(), tmp_path / "blocked" / "falcon.toml")


def test_clamp_grows_with_what_was_checked():
    # 2 N until the checklist was passed; 5 N for the worst constant: 5 * 3460 / 6600; 8 N when weighed
    assert module.Calibration().clamp_N == 2.0
    assert module.Calibration(confirmed=True).clamp_N == pytest.approx(2.621, abs=1e-3)
    assert module.Calibration(confirmed=True, force_calibrated=True).clamp_N == 8.0
    assert module.Calibration(force_calibrated=True).clamp_N == 2.0
    assert (limits_of(module.Calibration()).dead_man, limits_of(module.Calibration()).clamp_N) == (True, 2.0)
    assert not limits_of(module.Calibration(), hands_off=True).dead_man


def rates(place: ArrayLike, geometry: kinematics.Geometry) -> FloatArray:
    """Torques of one newton along each axis, shape (3, 3) [m]."""
    return np.array([torque(place, push, geometry=geometry) for push in np.eye(3)])


def test_motor_clamp_bounds_the_force_even_of_the_worst_constant():
    uncalibrated = module.Calibration(confirmed=True, units_per_Nm=30_000.0)
    clamp = module.LONGEST_ARM_M * UNCALIBRATED_N * WORST_UNITS_PER_NM
    random = np.random.default_rng(3)
    directions = random.normal(size=(300, 3))
    directions *= 0.04 * random.uniform(size=(300, 1)) / np.linalg.norm(directions, axis=1)[:, None]
    places = directions + np.array([0.0, 0.0, 0.130])
    all_rates = [[rates(place, one) for place in places] for one in kinematics.GEOMETRIES.values()]
    worst = float(np.linalg.norm(all_rates, axis=-2).max())
    # 5 N along the worst direction, at 3460 units for one N m, must fit under it, and not much more
    assert worst * 5.0 * 3460.0 == pytest.approx(clamp, rel=0.05)
    assert uncalibrated.clamp_units <= clamp
    weighed = replace(uncalibrated, force_calibrated=True)
    assert weighed.clamp_units == 4095


@pytest.mark.parametrize("geometry", sorted(kinematics.GEOMETRIES))
def test_motors_have_no_more_torque_than_the_clamp_needs_in_the_middle(geometry):
    """A pose that is believed wrongly turns the clamp into less than twice of it in the middle."""
    calibration = module.Calibration(geometry=geometry)
    torques = calibration.clamp_units / calibration.units_per_Nm
    arms = np.linalg.svd(rates((0.0, 0.0, 0.120), kinematics.GEOMETRIES[geometry]), compute_uv=False)
    assert torques == pytest.approx(arms[0] * calibration.clamp_N, rel=0.05)
    assert torques / arms[-1] < 2.0 * calibration.clamp_N
    assert limits_of(calibration).motor_clamp == calibration.clamp_units


def test_every_key_and_the_rule_for_its_link_stand_on_the_page():
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([\w.]+)`? \|", PAGE, flags=re.MULTILINE))
    said = {bool: lambda value: str(value).lower(), float: "{:g}".format, tuple: lambda _: "zeros", str: str}
    calibration = asdict(module.Calibration())
    assert not any(calibration["weight_N"] + calibration["weight_slope_N_per_m"])
    for key, value in calibration.items():
        assert rows[key] == said[type(value)](value)
    assert UDEV_RULE in PAGE


def test_a_wrong_zero_angle_shows_on_a_ruler_as_the_page_says():
    true, wrong = DEFAULT_GEOMETRY, replace(DEFAULT_GEOMETRY, zero_angle_deg=36.0)
    counts = [(inverse([0.0, 0.0, z]) - np.radians(35.0)) / true.radians_per_count for z in (0.182, 0.132)]
    angles = [np.radians(36.0) + true.radians_per_count * count for count in counts]
    shown = [forward(one, geometry=wrong)[2] for one in angles]
    (less,) = re.findall(r"falls by about ([\d.]+) mm less", PAGE)
    assert 50.0 - 1e3 * (shown[0] - shown[1]) == pytest.approx(float(less), abs=0.1)
