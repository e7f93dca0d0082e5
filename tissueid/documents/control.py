"""Simulated loops of the adaptive controller."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Document, Fraction, NonNegative, Positive


class Tissue(Document, frozen=True):
    """Tissue the controller met."""

    name: str
    source: str
    depth_mm: Positive
    speeds_mm_s: tuple[Positive, Positive]


class VirtualMass(Document, frozen=True):
    """Mass of the virtual tool against its bound."""

    given_kg: Positive
    bound_kg: NonNegative
    enough: bool  # At least 1.5 times the bound


class Chatter(Document, frozen=True):
    """Sigma [N m/s]."""

    floor: NonNegative  # Below it the sampled robust term chatters
    used: NonNegative


class Number(Document, frozen=True):
    """Number of the simulation, and where it comes from."""

    name: str
    value: float | str | None  # Null is without a limit
    unit: str
    kind: Literal["reading", "derived", "assumed", "stated"]
    source: str


class Measures(Document, frozen=True):
    """Errors and forces of one run."""

    diverged_s: NonNegative | None
    over_s: NonNegative
    error_rms_mm: NonNegative
    error_max_mm: NonNegative
    velocity_error_rms_mm_s: NonNegative
    deepest_mm: float
    outside_share: Fraction
    environment_force_max_N: NonNegative
    control_force_max_N: NonNegative
    saturated_share: Fraction
    lyapunov_start: NonNegative
    lyapunov_max: NonNegative
    lyapunov_end: NonNegative
    violated_share: Fraction
    violation_max_W: NonNegative


class Estimate(Document, frozen=True):
    """Estimate of one parameter over a run."""

    name: Literal["mass_kg", "damping_N_s_per_m", "stiffness_N_per_m"]
    start: float
    end: float
    true: NonNegative
    low: float
    high: float


class Run(Document, frozen=True):
    """One simulated run."""

    name: Literal["adaptive", "frozen", "unscaled"]
    adapts: bool
    stiffness_scale: Positive
    measures: Measures
    estimates: tuple[Estimate, Estimate, Estimate]


class Device(Document, frozen=True):
    """A hand on the simulated device, through its guard."""

    force_scale: Positive
    motion_scale: Positive
    error_rms_mm: NonNegative
    error_max_mm: NonNegative
    hand_force_max_N: float
    environment_force_max_N: NonNegative
    hand_less_tissue_rms_N: NonNegative
    clipped_share: Fraction


class Control(Document, frozen=True):
    """Adaptive controller against a tissue, simulated."""

    schema: Literal["tissueid/control/1"]
    tissue: Tissue
    variant: Literal["A", "B"]
    environment: Literal["admittance", "impedance"]
    stiffness_scale: Positive
    projection: bool
    seconds: Positive
    virtual_mass: VirtualMass
    chatter: Chatter  # sigma [N m/s]
    numbers: tuple[Number, ...]
    runs: Annotated[tuple[Run, ...], Meta(min_length=2)]  # Run that was asked for comes first
    device: Device | None
