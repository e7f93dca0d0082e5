"""An adaptive controller for admittance-type rendering: equations (14) to (22) of Sadeghnejad et al."""

from tissueid.rendering.control.settings import (
    ControlSettings,
    Gains,
    Mechanics,
    Signal,
    VirtualTool,
)
from tissueid.rendering.control.simulation import ControlRun, simulate

__all__ = [
    "ControlRun",
    "ControlSettings",
    "Gains",
    "Mechanics",
    "Signal",
    "VirtualTool",
    "simulate",
]
