"""An adaptive controller for admittance-type rendering: equations (14) to (22) of Sadeghnejad et al."""

from tissueid.render.control.mechanics import Mechanics, PlanarArm, Signal
from tissueid.render.control.settings import ControlSettings, Gains, VirtualTool
from tissueid.render.control.simulation import ControlRun, simulate

__all__ = [
    "ControlRun",
    "ControlSettings",
    "Gains",
    "Mechanics",
    "PlanarArm",
    "Signal",
    "VirtualTool",
    "simulate",
]
