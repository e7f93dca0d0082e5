"""Cycles, functionals, spectra and moduli: parts of identification.json and inspect.

Every number stands with its standard error, and where it can't be given it is null with the reason: nothing
is extrapolated silently.  Standard errors are those of white force noise.
"""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Count, Document, NonNegative, OfSheet, Positive, PositiveCount, Text


class Measure(Document, frozen=True, omit_defaults=False):
    """A measured number and its standard error under white force noise; null where it can't be had."""

    value: float | None = None
    stderr: NonNegative | None = None


class AtDepth(Document, frozen=True):
    """Stiffness of a loop at one depth."""

    depth_mm: float
    secant_N_per_mm: Measure
    tangent_N_per_mm: Measure


CycleKind = Literal["cycle", "ramp-retract", "ramp-hold-retract"]


class Cycle(OfSheet, frozen=True):
    """One load-unload loop, measured from its samples, no model but for viscosity_model_N_s_per_mm."""

    number: PositiveCount
    kind: CycleKind  # The area of a loop with a hold includes what relaxed in the hold
    start_s: float
    peak_s: float
    end_s: float
    floor_mm: float  # Depth from which the loop is closed
    peak_depth_mm: float
    #: Force at the end of loading (the ramp's, before a hold), from a quadratic in depth over its last part
    peak_force_N: Measure
    loading_work_mJ: Measure  # Work of loading [mJ = N mm]
    dissipated_mJ: Measure  # Area of the closed loop [mJ = N mm]
    hysteresis: Measure  # Area over work of loading, a fraction
    secant_N_per_mm: Measure  # Force over depth at the end of loading
    tangent_N_per_mm: Measure  # Slope of loading at its end
    #: Depth at which unloading falls to 1 % of the peak force, or three sd of the noise; null where never
    residual_depth_mm: Measure
    #: Loop area above the residual depth over the integral of v^2 dt: eta where v tau is small against the
    #: depth; null for a loop with a hold
    viscosity_N_s_per_mm: Measure
    #: eta with which the fitted model has the measured area, its relaxation times kept; null without a fit
    viscosity_model_N_s_per_mm: Measure
    #: Against the loop before, a fraction; null for the first loop and for another amplitude
    peak_force_change: Measure
    dissipated_change: Measure  # Against the loop before, a fraction
    at_depths: tuple[AtDepth, ...]


class Conditions(Document, frozen=True):
    """Conditions that a number holds at; those that do not apply are left out."""

    path: str | None = None  # ideal step, or ramp as recorded
    formula: str | None = None
    doi: str | None = None  # of the formula
    frequency_Hz: float | None = None
    depth_mm: float | None = None
    speed_mm_s: float | None = None
    time_s: float | None = None
    amplitude_mm: float | None = None
    holds: float | None = None  # of the depth test: how many
    low: float | None = None  # of the depth test: its 95 % interval
    high: float | None = None
    verdict: str | None = None  # of the depth test


class Assumptions(Document, frozen=True):
    """Tip, thickness and Poisson's ratio behind the moduli; empty where the tip is not known."""

    shape: str | None = None
    radius_mm: float | None = None
    half_angle_deg: float | None = None
    thickness_mm: float | None = None
    poisson: float | None = None
    support: str | None = None


class Quantity(Document, frozen=True):
    """Number derived from the fit, or measured in a hold; value is null where the data do not support it."""

    name: Text
    unit: str
    at: Conditions
    value: float | None
    stderr: NonNegative | None
    reason: str | None  # Why there is no value


class Spectrum(OfSheet, frozen=True):
    """Regularised spectrum of one hold as seen after its ramp: F = plateau + sum A_k exp(-t / tau_k)."""

    start_s: float
    end_s: float
    plateau_N: float
    tau_s: tuple[Positive, ...]
    amplitude_N: tuple[NonNegative, ...]
    smoothing: NonNegative
    rmse_N: NonNegative


class Quoted(Document, frozen=True):
    """Numbers that people quote."""

    window_s: NonNegative  # Longest hold (longest log without one): nothing later is said
    resolution_s: NonNegative  # Two sampling intervals: nothing earlier is said
    noise: Literal["white"]  # Noise that the standard errors assume
    model: tuple[Quantity, ...]  # Functionals of the fitted model, errors by the delta method
    #: With tip, and thickness where given; empty where the tip is not known: the stiffness is then
    #: structural, of this tip on this support
    moduli: tuple[Quantity, ...]
    spectra: tuple[Spectrum, ...]
    assumptions: Assumptions  # Tip, thickness and Poisson's ratio behind the moduli


class UnloadingMiss(Document, frozen=True):
    """Unloading as the fit of loading and holds predicts it, against the measured force in contact.

    Each log's force is taken over the range of its own; a law without adhesion pulls nowhere.
    """

    logs: PositiveCount
    samples: PositiveCount
    nrmsd: NonNegative  # Root mean square, a fraction
    nrmsd_worst: NonNegative  # Of the log that is predicted worst
    mean: float  # Measured less predicted, a fraction: negative where the tissue gives less than is predicted


class Unloading(Document, frozen=True):
    """Fit of unloading: rounds, and residuals of a direct simulation with contact loss."""

    rounds: PositiveCount
    converged: bool
    change_sd: float | None
    samples_in_contact: Count
    samples_in_air: Count
    samples_pulled: Count  # Samples with a negative force beyond noise: adhesion, which the law does not have
    rms_in_contact_N: float | None
    rms_in_air_N: float | None
    surface_unique: bool
