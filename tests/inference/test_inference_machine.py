"""A machine that nobody has is said: what a law can't follow must not be put down to it silently."""

from __future__ import annotations

import numpy as np
import pytest

import tissueid
from tissueid.inference.frame_effect import machine_flag
from tissueid.inference.specimen import FitOptions
from tissueid.model.channels import loading_force
from tissueid.model.grammar import rebuilt
from tissueid.pipeline import IdentifyOptions
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior

FRAME = "frame_compliance_mm_per_N"


@pytest.mark.parametrize(
    ("machine", "name", "words"),
    [
        ((0.0, 0.0, 0.0581), "force_filter_s", "a force filter of 58.1 ms, 11.6 standard deviations off"),
        ((0.0, -0.0131, 0.0), "skew_s", "channels 13.1 ms apart, 6.5 standard deviations off"),
        ((0.0152, 0.0, 0.0), FRAME, "a frame of 65.8 N/mm, 3.8 standard deviations off"),
        # a soft frame is no surprise by itself, one that takes a third of the travel is
        ((0.009, 0.0, 0.0), FRAME, "a frame of 111 N/mm, which would take 29 % of the travel"),
    ],
)
def test_a_machine_that_is_unlikely_is_named_with_its_size(machine, name, words):
    flag = machine_flag(np.array(machine), CALIBRATION_DEFAULTS, force_N=260.0, depth_mm=8.0)
    assert flag is not None
    assert flag.message == f"the fit needs {words}"
    assert flag.values["name"] == name


def test_an_ordinary_machine_and_a_stated_soft_frame_are_not():
    ordinary = np.array([0.003, 0.004, 0.008])
    assert machine_flag(ordinary, CALIBRATION_DEFAULTS, force_N=20.0, depth_mm=8.0) is None
    # of an ordinary machine: a stiff specimen takes little of the travel, which is no miss of the law
    stiff = np.array([0.00067, 0.0, 0.0])
    assert machine_flag(stiff, CALIBRATION_DEFAULTS, force_N=390.0, depth_mm=1.0) is None
    stated = {**CALIBRATION_DEFAULTS, FRAME: CalibrationPrior(0.009, 0.0005, stated=True)}
    assert machine_flag(np.array([0.009, 0.0, 0.0]), stated, force_N=260.0, depth_mm=8.0) is None


@pytest.mark.parametrize(("model", "raised"), [("power * prony", True), ("kelvin-voigt", False)])
def test_a_law_that_leans_on_the_machine_says_so(datasets, model, raised):
    (log,) = tissueid.read(datasets / "paper-a-hold-100Hz")
    (fit,) = tissueid.identify([log], options=IdentifyOptions(fit=FitOptions(model=model))).specimens
    assert ("machine_implausible" in {flag.code for flag in fit.flags}) is raised
    # the depth that is claimed is the tip's: behind such a frame no travel of 8 mm was 8 mm of tissue
    assert (fit.depth_mm < 7.0) is raised
    model = rebuilt(fit.model, fit.depth_mm)
    force = loading_force(model, fit.theta, np.array([fit.depth_mm]), speed_mm_s=fit.speeds_mm_s[1])
    assert force[0] == pytest.approx(266.0, rel=0.2)
