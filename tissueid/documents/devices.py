"""Output of the sub-commands of devices with --json, one definition each."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from tissueid.documents.base import Count, Document, NonNegative, Positive


class Found(Document, frozen=True):
    """A device that is there."""

    name: str  # Name of the device in the registry
    where: str  # USB node, file or program
    note: str  # Obstacle and its way out; empty if there is none


class List(Document, frozen=True):
    """Devices list."""

    known: tuple[str, ...]  # Every name that a device may be asked for by
    found: tuple[Found, ...]


class Calibration(Document, frozen=True):
    """Numbers of a Falcon, docs/devices.md."""

    geometry: str
    zero_angle_deg: float  # Leg angle at count zero [deg]
    units_per_Nm: Positive  # Motor units for one N m of arm torque
    force_calibrated: bool
    damping_N_s_per_m: NonNegative  # Damping of the arm [N s/m]
    damping_measured: bool
    delay_ticks: NonNegative  # From a position to the force it causes [ms]
    delay_measured: bool
    weight_N: tuple[float, float, float]  # Force that holds the grip in the middle of the workspace [N]
    #: Its change with the position [N/m], row by row of its components
    weight_slope_N_per_m: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]
    weight_measured: bool
    confirmed: bool  # Hardware checklist was passed on this machine


class Info(Document, frozen=True):
    """Devices info."""

    name: str  # Name of the device in the registry
    clamp_N: NonNegative  # Largest force the guard lets through [nominal N]
    calibrated: bool  # That newton was weighed
    damping_N_s_per_m: NonNegative  # Damping of the arm [N s/m]
    delay_ticks: NonNegative  # From a position to the force it causes [ms]
    hardware: bool  # Motors move something
    workspace_mm: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]  # Reach in x, y and z
    calibration: Calibration | None = None


class Home(Document, frozen=True):
    """Devices home."""

    name: str  # Name of the device in the registry
    homed: bool
    position_mm: tuple[float, float, float]  # x right, y up, z toward the user [mm]


class Test(Document, frozen=True):
    """Devices test."""

    name: str  # Name of the device in the registry
    duration_s: Positive  # Length of the measurement [s]
    commands: Count  # Sent
    replies: Count  # Answered
    damaged: Count  # Replies that began and were none
    rate_hz: NonNegative  # Replies a second, each command waiting for its answer
    round_trip_ms: tuple[NonNegative, NonNegative, NonNegative]  # Median, 95 % and largest [ms]
    delay_ticks: NonNegative  # Whole ticks until the answer, and half a tick for the device [ms]


class Force(Document, frozen=True):
    """Devices calibrate-force."""

    empty_N: float  # Nominal force that held the grip [N]
    loaded_N: float  # Nominal force that held grip and mass [N]
    weight_N: Positive  # Weight of the mass [N]
    ratio: float  # Nominal force for one true newton
    stderr: NonNegative  # Standard error of the ratio
    units_per_Nm: Positive  # Motor units for one N m of arm torque
    units_per_Nm_before: Positive  # Assumed before


class Damping(Document, frozen=True):
    """Devices calibrate-damping."""

    mass_kg: Positive  # Inertia at the grip [kg]
    damping_N_s_per_m: float  # Estimate [N s/m]
    friction_N: float  # Coulomb friction [N]
    damping_stderr: NonNegative  # Standard error [N s/m]
    safe_damping_N_s_per_m: NonNegative  # Damping kept and relied on [N s/m]
