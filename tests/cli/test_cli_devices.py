"""``tissueid devices``: what it lists, measures and refuses, on machines without a device."""

import os
import re
import select
import signal
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import run, start

from tissueid.documents import devices
from tissueid.haptics.arm import Arm
from tissueid.haptics.falcon.calibration import Calibration, load_calibration
from tissueid.haptics.falcon.device import FalconDevice, limits_of
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure import ArmEstimate, Weighing
from tissueid.haptics.registry import DEVICES, HARDWARE


@pytest.fixture(autouse=True)
def configuration(tmp_path, monkeypatch, empty_usb):
    """A configuration directory of this test, and no Falcon on this machine's USB."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("TISSUEID_FORCEDIM", str(tmp_path / "none.so"))
    return tmp_path / "config" / "tissueid" / "falcon.toml"


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """A busy machine starves an emulator for longer than a device may be silent."""

    def limits(calibration: Calibration, *, hands_off: bool = False) -> GuardLimits:
        return replace(limits_of(calibration, hands_off=hands_off), no_reply_s=10.0)

    monkeypatch.setattr("tissueid.haptics.falcon.device.limits_of", limits)


@pytest.fixture
def port():
    """A pseudo-terminal with an emulated Falcon in virtual time."""
    with EmulatedLink(EmulatorSettings(period_s=5e-3), pty=True) as link:
        yield link.path


@pytest.fixture
def homed(monkeypatch):
    """Homing that is over at once."""
    monkeypatch.setattr(FalconDevice, "home", lambda _self: None)


def test_list_names_every_device_found_or_not_and_a_missing_library(monkeypatch, tmp_path):
    run("devices", "list", code=0, shown=("this program", f"not found: {', '.join(HARDWARE)}"))
    document = run("devices", "list", "--json").json("devices")
    assert set(document["known"]) >= set(DEVICES)
    assert {one["name"] for one in document["found"]} >= {"emulator", "sim"}
    monkeypatch.setenv("TISSUEID_LIBUSB", str(tmp_path / "none.so"))
    run("devices", "list", code=0, shown="apt install libusb-1.0-0")


@pytest.fixture
def written(configuration):
    """Function that writes the calibration of the user."""
    configuration.parent.mkdir(parents=True)
    return lambda text: configuration.write_text(text, encoding="utf-8")


def info(*args: object) -> Any:
    return run("devices", "info", *args, "--json").json("devices")


def test_info_says_what_is_assumed(written):
    document = info("falcon")
    assert (document["clamp_N"], document["calibrated"]) == (2.0, False)
    assert document["calibration"]["units_per_Nm"] == 6600.0
    assert document["workspace_mm"][2] == pytest.approx([66.0, 183.0])
    run("devices", "info", "falcon", shown="not calibrated: a newton of this device may be anything from")
    written("zero_angle_deg = 41\nconfirmed = true\n")
    document = info("falcon")
    assert document["clamp_N"] == pytest.approx(2.62, abs=0.01)
    assert document["calibration"]["zero_angle_deg"] == 41.0


def test_info_without_a_name_says_what_was_taken():
    ended = run("devices", "info", said="device sim, simulated: no haptic device was found")
    assert ended.stdout.startswith("sim: force at most 5.00 N")


def test_an_emulator_does_not_wear_the_calibration_of_the_real_device(configuration, written):
    written("units_per_Nm = 9000\n")
    for asked, units in (
        (("falcon",), 9000.0), (("emulator",), 6600.0), (("emulator", "--calibration", configuration), 9000.0)
    ):  # fmt: skip
        assert info(*asked)["calibration"]["units_per_Nm"] == units
    written("units_per_Nm = 1\n")
    run("devices", "info", "falcon", code=5, said=str(configuration))


NONE = "no haptic device was found. Name one that needs no hardware: emulator or sim"
NO_FALCON = "no Falcon is plugged in"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("home",), NONE),
        (("test",), NONE),
        (("home", "falcon"), NO_FALCON),
        (("test", "falcon"), NO_FALCON),
        (("calibrate-damping", "--yes"), NO_FALCON),
        (("calibrate-force", "--yes", "--mass", "100"), NO_FALCON),
    ],
)
def test_no_device_is_exit_5_with_what_needs_none_and_a_named_one_is_never_replaced(words, said):
    assert run("devices", *words, code=5, said=said).stdout == ""


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("home", "nonsense"), "no device named 'nonsense'"),
        (("home", "sim", "--port", "/dev/null"), "--port belongs to falcon"),
        (("test", "sim", "--firmware", "x"), "--firmware belongs to falcon"),
        (("home", "emulator", "--port", "/dev/null"), "emulator makes its own port"),
        (("info", "falcon", "--calibration", "nope.toml"), "--calibration nope.toml: there is no such file"),
        (("test", "sim", "--save"), "--save keeps the calibration of a real device"),
        (("calibrate-force", "sim", "--mass", "100"), "the device sim has no calibration"),
        (("calibrate-force", "--mass", "5000"), "5000.0 is not in the range"),
        (("calibrate-force", "--mass", "100"), "Give --yes where nobody can be asked"),
        (
            ("emulate", "--hand", "fist"),
            "'fist' is not one of 'step', 'slow press', 'tap', 'release', 'tremor', 'hold'",
        ),
        (("emulate", "--fault", "rain@3"), "there is no fault 'rain'"),
    ],
)
def test_what_makes_no_sense_is_exit_2(words, reason, monkeypatch):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    run("devices", *words, code=2, said=reason)


def test_test_measures_the_link(port, configuration):
    report = run("devices", "test", "--port", port, "--seconds", "1", "--json", code=0).json("devices")
    assert 0 < report["replies"] <= report["commands"]
    # whole ticks at least one, and half a tick for the device
    assert report["delay_ticks"] >= 1.5
    assert not configuration.exists()


@pytest.mark.parametrize(("delay", "code"), [(1.62, 0), (11.0, 5)])
def test_delay_is_kept_where_it_makes_sense(delay, code, port, configuration, monkeypatch):
    found = devices.Test("falcon", 5.0, 5000, 4990, 0, 998.0, (1.0, 1.1, 3.0), delay)
    monkeypatch.setattr("tissueid.haptics.measure.measure_link", lambda *_: found)
    ended = run("devices", "test", "--port", port, "--save", code=code, shown="10 unanswered, 0 damaged")
    if code == 0:
        kept = load_calibration(configuration)
        assert (kept.delay_ticks, kept.delay_measured) == (delay, True)
        assert f"kept in {configuration}" in ended.stderr
    else:
        assert "not kept: delay_ticks = 11.0 is not from 0.0 to 10.0" in ended.stderr
        assert not configuration.exists()


def test_home_leads_through_homing(port):
    ended = run("devices", "home", "--port", port, "--json", code=0)
    assert re.search(r"pull the grip all the way out(?s:.*)until the light is green", ended.stderr)
    assert ended.json("devices")["position_mm"][2] > 170.0


def test_home_gives_up_after_its_time_out():
    with EmulatedLink(EmulatorSettings(homes=False, period_s=1e-3), pty=True) as link:
        said = "homing never completed (leg 1 and 2 and 3 missing"
        run("devices", "home", "--port", link.path, "--timeout", "1", code=5, said=said)


@pytest.mark.usefixtures("homed")
def test_calibrate_force_keeps_what_was_weighed(port, configuration, monkeypatch):
    seen: list[tuple[float, bool]] = []

    def weighed(device: FalconDevice, mass_kg: float, _hang: object) -> Weighing:
        seen.append((mass_kg, device.limits.dead_man))
        return Weighing(0.4, 1.7, 0.98, 1.25, 0.01)

    monkeypatch.setattr("tissueid.haptics.measure.weigh", weighed)
    weigh = ("devices", "calibrate-force", "--mass", "100", "--port", port, "--yes")
    ended = run(*weigh, code=0)
    assert seen == [(0.1, False)]
    assert load_calibration(configuration).units_per_Nm == pytest.approx(1.25 * 6600.0)
    assert "with at most 2.0 N. Keep hands" in ended.stderr
    assert "1.250 ± 0.010 nominal newton for one true newton: 8250 motor units" in ended.stdout
    assert run(*weigh, "--json").json("devices")
    kept = load_calibration(configuration)
    assert (kept.units_per_Nm, kept.force_calibrated) == (pytest.approx(1.25**2 * 6600.0), True)
    # the second weighing began with the first; nobody has gone through the checklist: still 2 N
    assert kept.clamp_N == 2.0


@pytest.mark.usefixtures("homed")
def test_calibrate_damping_keeps_what_can_be_relied_on(port, tmp_path, monkeypatch):
    found = ArmEstimate(0.25, 0.62, 0.11, 0.02)
    monkeypatch.setattr("tissueid.haptics.measure.ring_down", lambda *_: found)
    file = tmp_path / "mine.toml"
    asked = ("--port", port, "--yes", "--calibration", file, "--json")
    document = run("devices", "calibrate-damping", *asked, code=0).json("devices")
    # less two standard errors, and half a tick of delay on a spring of 60 N/m
    assert document["safe_damping_N_s_per_m"] == pytest.approx(0.62 - 0.04 - 0.03)
    assert load_calibration(file) == Calibration(damping_N_s_per_m=pytest.approx(0.55), damping_measured=True)


def test_emulate_prints_a_path_that_a_driver_can_open():
    process = start("devices", "emulate", "--hand", "tap")
    try:
        ready, _, _ = select.select([process.stdout], [], [], 60.0)
        assert ready
        line = process.stdout.readline()
        path = line.rpartition(" ")[2].strip()
        assert line.startswith("emulated Falcon at /dev/")
        assert os.path.exists(path)  # noqa: PTH110 - a device
        report = run("devices", "test", "--port", path, "--seconds", "0.2", "--json").json()
        assert report["replies"] > 10
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == 0


@pytest.mark.slow
def test_the_free_grip_of_an_emulator_gives_back_the_damping_it_has():
    ended = run("devices", "calibrate-damping", "emulator", "--yes", "--json", code=0, said="not kept")
    assert ended.json()["damping_N_s_per_m"] == pytest.approx(Arm().damping_N_s_per_m, rel=0.2)
