"""Admittance rendering on the simulated device, and who is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.errors import DeviceError, UsageError
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.registry import DEVICES
from tissueid.rendering.control import admittance
from tissueid.rendering.control.admittance import render_on_simulated, require_force_sensor
from tissueid.rendering.options import ASSUMED_DEVICE, preset_tissue
from tissueid.rendering.precheck import check_before_force

PAPER_A = preset_tissue("paper-a")


@pytest.mark.needs_jit
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_a_hand_on_the_simulated_device_feels_the_tissue_through_the_guard(scale):
    run = render_on_simulated(PAPER_A, stiffness_scale=scale)
    found = run.as_json()

    clamp_N = GuardLimits.simulated().clamp_N
    assert np.abs(run.sent_force_N).max() <= clamp_N
    # before the hand engages the guard sends nothing
    assert run.sent_force_N[0] == 0.0
    assert found["error_rms_mm"] < 0.3
    # what is left is the 0.1 N friction of the arm, and the tool's own inertia
    assert found["hand_less_tissue_rms_N"] < 0.25
    assert found["clipped_share"] < 0.05
    touching = run.environment_force_N > 0.0
    assert 0.3 < touching.mean() < 0.9
    # the tool is where the tissue's law says that force is: slow at the end of the hold
    at = int(np.searchsorted(run.time_s, 3.9))
    depth = 1e3 * run.tool_position_m[at] / found["motion_scale"]
    static = scale * (47.42 * depth - 5.577 * depth**2 + 0.3804 * depth**3)
    assert run.environment_force_N[at] == pytest.approx(found["force_scale"] * static, rel=0.05)


def test_the_admittance_type_bears_what_impedance_rendering_refuses_on_that_device():
    stiff = admittance.device_settings(
        PAPER_A, admittance.simulated_device(), stiffness_scale=100.0
    ).largest_tangent()
    own = check_before_force(PAPER_A, ASSUMED_DEVICE).scaling.device_stiffness_N_per_m

    # at which a hand is led to 0.3 mm all the same
    assert stiff > 50.0 * own


@pytest.mark.needs_jit
def test_a_loop_that_trips_the_guard_says_when_and_why(monkeypatch):
    # without the carried grip's limits the resting encoders trip the watchdog on stiff tissue
    monkeypatch.setattr(admittance, "carried", lambda limits: limits)

    with pytest.raises(DeviceError, match=r"guard took the force away after \d\.\d+ s"):
        render_on_simulated(PAPER_A, stiffness_scale=100.0)


@pytest.mark.parametrize("name", [name for name in DEVICES if name not in {"sim", "replay"}])
def test_a_device_without_a_force_sensor_is_refused_with_the_reason(name):
    with pytest.raises(DeviceError, match=r"has no force sensor: .* `tissueid render`"):
        require_force_sensor(name)


def test_a_device_that_nobody_knows_is_refused_as_everywhere():
    assert require_force_sensor("sim") == "sim"
    with pytest.raises(UsageError):
        require_force_sensor("nonsense")
