"""Settings of a controlled loop, as frozen data, with where each number comes from.

Sadeghnejad et al. print "1.25 2 30 1.158 115.4 31.46" in Table 3: that these are mass, damping and stiffness
of operator and device, in kg, N s/m and N/m, is a reading.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError, refuse
from tissueid.rendering.tissue_block import Tissue

#: Axes that a loop may have.
MOST_AXES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Mechanics:
    """Mass, damping and stiffness of a device or a hand; UsageError where they are none."""

    #: (n, n): symmetric; a number is one axis.
    mass_kg: FloatArray
    damping_N_s_per_m: FloatArray  # (n, n)
    stiffness_N_per_m: FloatArray  # (n, n)

    def __init__(
        self, mass_kg: ArrayLike, damping_N_s_per_m: ArrayLike, stiffness_N_per_m: ArrayLike
    ) -> None:
        parts = [
            np.atleast_2d(np.asarray(one, dtype=np.float64))
            for one in (mass_kg, damping_N_s_per_m, stiffness_N_per_m)
        ]
        shape = parts[0].shape
        if not (shape[0] == shape[1] <= MOST_AXES and all(one.shape == shape for one in parts)):
            refuse(f"mass, damping and stiffness must be numbers, or square of 1 to {MOST_AXES} axes alike")
        for name, one in zip(("mass_kg", "damping_N_s_per_m", "stiffness_N_per_m"), parts, strict=True):
            symmetric = np.isfinite(one).all() and np.array_equal(one, one.T)
            if not (symmetric and np.linalg.eigvalsh(one)[0] >= 0):
                msg = f"masses, dampings, stiffnesses: finite, symmetric and not negative, not {one.tolist()}"
                raise UsageError(msg)
            object.__setattr__(self, name, one)

    @property
    def axes(self) -> int:
        """Number of axes, n."""
        return len(self.mass_kg)

    def parameters(self) -> FloatArray:
        """Upper triangles of the three, row by row, shape (3 n (n + 1) / 2,)."""
        upper = np.triu_indices(self.axes)
        return np.concatenate([one[upper] for one in self.parts()])

    def parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mass, damping and stiffness."""
        return self.mass_kg, self.damping_N_s_per_m, self.stiffness_N_per_m


#: Table 3 [reading].
TABLE_3_OPERATOR = Mechanics(1.25, 2.0, 30.0)
TABLE_3_DEVICE = Mechanics(1.158, 115.4, 31.46)


@dataclass(frozen=True, slots=True)
class Signal:
    """An offset and a sine for each axis [N]."""

    #: As many as axes.
    offset_N: tuple[float, ...]
    amplitude_N: tuple[float, ...]
    frequency_Hz: tuple[float, ...]

    @classmethod
    def along(cls, offset: float, amplitude: float, frequency: float, *, axes: int = 1) -> Signal:
        """Along the first axis, nothing along the others."""
        rest = (0.0,) * (axes - 1)
        return cls((offset, *rest), (amplitude, *rest), (frequency, *rest))


#: Pushes of the hand along the first axis, which is into the tissue: offset, amplitude [N], frequency [Hz].
#: Assumed: the inputs of the paper's simulation are lost.
TASKS = {"sustained": (10.0, 10.0, 1.0), "free-contact": (2.0, 3.0, 0.5), "impacts": (2.0, 10.0, 0.5)}


#: Robust bound where none is given [N]: in variant A it covers the whole push of the hand, in B friction.
BOUND_A_N = 25.0
BOUND_B_N = 3.0
#: sigma's floor over the bound below which the robust term chatters; at 1.5 times it still does.
FLOOR_MARGIN = 3.0
#: Largest estimate over the true value: of inertia, so that a virtual mass of 1.5 times its bound bears it
#: (1.25 / 1.5 < 1); of damping and stiffness.  Assumed knowledge of device and hand.
LARGEST_INERTIA = 1.25
LARGEST_REST = 2.0
#: Sub-steps of tool, device and hand in a tick at least, and their length times the tool's frequency at most.
LEAST_SUBSTEPS = 20
LARGEST_ANGLE = 0.2
#: The tangent of a tissue is taken up to this share of its identified depth.
TANGENT_REACH = 1.5


@dataclass(frozen=True, slots=True)
class VirtualTool:
    """Tool between hand and tissue; 2 kg is assumed ("has been selected to maintain stability")."""

    mass_kg: float = 2.0
    damping_N_s_per_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of the controller, all assumed."""

    reference_rate_per_s: float = 50.0  # lambda of equation (17)
    damping_N_s_per_m: float = 100.0  # K_r of equation (20)
    disturbance_bound_N: float | None = None  # delta of equation (21); None is 25 N in variant A and 3 N in B
    #: sigma(0) [N m/s] and how fast it falls.
    sigma_start: float = 5.0
    sigma_rate_per_s: float = 0.5
    #: None is three times the bound below which the robust term chatters.
    sigma_floor: float | None = None
    adaptation: tuple[float, float, float] = (0.05, 5.0, 50.0)  # gamma of masses, dampings and stiffnesses
    projection: bool = True  # estimates stay within their bounds
    #: 1; 0 is the frozen controller, -1 is wrong on purpose and must never pass for right.
    adaptation_sign: int = 1
    saturation_N: float = math.inf  # largest control force; infinite without one


@dataclass(frozen=True, slots=True, eq=False)
class ControlSettings:
    """Hand, device, controller, virtual tool and tissue; UsageError where a number makes no sense."""

    tissue: Tissue
    stiffness_scale: float = 1.0  # factor on F_s and K; the paper takes 100 "to check the system stability"
    #: Force and travel at the device over those of the tissue, as in rendering.
    force_scale: float = 1.0
    motion_scale: float = 1.0
    #: "A": estimates device and hand, the robust term covers the push of the hand; "B": uses the measured
    #: force, estimates the device alone.
    variant: str = "B"
    #: "admittance": the virtual tool touches the tissue; "impedance": the device itself does.
    environment: str = "admittance"
    device: Mechanics = TABLE_3_DEVICE
    operator: Mechanics = TABLE_3_OPERATOR
    tool: VirtualTool = field(default_factory=VirtualTool)
    gains: Gains = field(default_factory=Gains)
    #: F* and d; None is the task "sustained", and nothing.
    push: Signal | None = None
    disturbance: Signal | None = None
    push_rise_s: float = 0.5  # time in which the push rises from 0
    #: Length of the run, and the controller's rate.
    seconds: float = 12.0
    rate_Hz: float = 1000.0
    #: Steps of the tool in a tick; None is as many as the stiffness asks for, 20 at least.
    substeps: int | None = None
    #: (p,): none is half of what is true, in every parameter (assumed).
    start_estimates: FloatArray | None = None
    sensor_noise_N: float = 0.0  # standard deviation of the force sensor's white noise
    seed: int = 0  # of that noise
    unchecked: bool = False  # run even below the bound of the virtual mass; for showing what happens there

    def __post_init__(self) -> None:
        for message in _problems(self):
            raise UsageError(message)

    @property
    def axes(self) -> int:
        """Axes of device and hand."""
        return self.device.axes

    def task(self, name: str) -> ControlSettings:
        """The same loop under another push, one of :data:`TASKS`."""
        return replace(self, push=Signal.along(*TASKS[name], axes=self.axes))

    def frozen(self) -> ControlSettings:
        """The same loop with estimates that stay where they start."""
        return replace(self, gains=replace(self.gains, adaptation_sign=0))

    def estimated_truth(self) -> FloatArray:
        """True values of the estimates, shape (p,): device and hand in variant A, the device in B."""
        device = self.device.parameters()
        return device + self.operator.parameters() if self.variant == "A" else device

    def estimate_bounds(self) -> FloatArray:
        """Bounds of the projection, shape (2, p); an entry beside a diagonal may have either sign."""
        rows, columns = np.triu_indices(self.axes)
        share = np.repeat([LARGEST_INERTIA, LARGEST_REST, LARGEST_REST], rows.size)
        high = share * np.abs(self.estimated_truth())
        return np.array([np.where(np.tile(rows != columns, 3), -high, 0.0), high])

    def adaptation_gains(self) -> FloatArray:
        """Diagonal of Gamma, shape (p,)."""
        return np.repeat(np.array(self.gains.adaptation), self.axes * (self.axes + 1) // 2)

    def disturbance_bound_N(self) -> float:
        """Bound of what the estimates don't cover, delta of equation (21) [N]."""
        given = self.gains.disturbance_bound_N
        return given if given is not None else BOUND_A_N if self.variant == "A" else BOUND_B_N

    def chatter_floor(self) -> float:
        """Smoothing sigma [N m/s] below which the sampled robust term chatters: delta^2 T / (2 M - Kr T).

        M is the smallest mass that the robust term may move: of device and hand in variant A; of the
        device in B, whose hand is fed back one sample late. Raises UsageError: K_r alone already
        overshoots in one sample.
        """
        device = self.device.mass_kg
        mass = device + self.operator.mass_kg if self.variant == "A" else device
        below = 2.0 * float(np.linalg.eigvalsh(mass)[0]) - self.gains.damping_N_s_per_m / self.rate_Hz
        if below <= 0.0:
            refuse(
                f"K_r of {self.gains.damping_N_s_per_m:g} N s/m overshoots within one sample of "
                f"{1e3 / self.rate_Hz:g} ms; lower it, or raise the rate"
            )
        return self.disturbance_bound_N() ** 2 / self.rate_Hz / below

    def sigma_floor(self) -> float:
        """Smallest sigma(t) of this loop [N m/s]."""
        if self.gains.sigma_floor is not None:
            return self.gains.sigma_floor
        return FLOOR_MARGIN * self.chatter_floor()

    def largest_tangent(self) -> float:
        """Largest stiffness of the tissue at the device [N/m], on one and a half times its depth."""
        model, theta = self.tissue.model, self.tissue.theta
        x = np.linspace(0.0, TANGENT_REACH * model.depth_mm, 61)
        tangent = model.static_slope(theta, x) + model.stiffness(theta, x).sum(axis=0)
        tangent_N_per_mm = float(np.max(tangent)) * self.stiffness_scale
        return 1e3 * tangent_N_per_mm * self.force_scale / self.motion_scale

    def tool_substeps(self) -> int:
        """Steps of the tool in a tick."""
        if self.substeps is not None:
            return self.substeps
        angle = math.sqrt(self.largest_tangent() / self.tool.mass_kg) / self.rate_Hz
        return max(LEAST_SUBSTEPS, math.ceil(angle / LARGEST_ANGLE))


def _problems(settings: ControlSettings) -> Iterator[str]:
    """Problems of the settings; only where there is no other before are the later ones looked for."""
    if settings.variant not in ("A", "B"):
        yield f"there is no variant {settings.variant!r}; give A or B"
    if settings.environment not in ("admittance", "impedance"):
        yield f"there is no {settings.environment!r} environment; give admittance or impedance"
    positive = {
        "the stiffness scale": settings.stiffness_scale,
        "the force scale": settings.force_scale,
        "the motion scale": settings.motion_scale,
        "the length of the run": settings.seconds,
        "the rate": settings.rate_Hz,
        "the virtual mass": settings.tool.mass_kg,
        "the number of sub-steps": 1.0 if settings.substeps is None else settings.substeps,
    }
    for name, value in positive.items():
        if not 0.0 < value < math.inf:
            yield f"{name} is {value:g}, must be above 0"
    if settings.device.axes != settings.operator.axes:
        yield f"the device has {settings.device.axes} axes and the hand {settings.operator.axes}"
    for name, signal in (("push", settings.push), ("disturbance", settings.disturbance)):
        parts = () if signal is None else astuple(signal)
        if any(len(part) != settings.axes for part in parts):
            yield f"the {name} needs {settings.axes} offsets, amplitudes and frequencies"
    if not np.linalg.eigvalsh(settings.device.mass_kg)[0] > 0.0:
        yield "the device needs a mass along every axis"
    size = settings.estimated_truth().size
    if settings.start_estimates is not None and np.shape(settings.start_estimates) != (size,):
        yield f"the first estimates are {size}: masses, dampings, stiffnesses"


#: Virtual mass over its bound that a loop should have.
MARGIN = 1.5
HALVINGS = 60


def turn_multiplier(settings: ControlSettings, virtual_mass_kg: float) -> float:
    """Factor by which one turn of the loop through the force sensor grows: below 1 it dies out.

    With true estimates; A: Mh M^-1 M / Mt; B: Mh M^-1 (Md / Mt - I).
    """
    device, hand = settings.device.mass_kg, settings.operator.mass_kg
    share = np.linalg.solve(device + hand, hand).T
    if settings.variant == "A":
        turn = share @ (device + hand) * (1.0 / virtual_mass_kg)
    else:
        turn = share @ (device / virtual_mass_kg - np.eye(len(device)))
    return float(np.abs(np.linalg.eigvals(turn)).max())


def virtual_mass_bound(settings: ControlSettings) -> float:
    """Virtual mass [kg] at which that factor is 1; 0 for a hand without mass."""
    device, hand = settings.device.mass_kg, settings.operator.mass_kg
    if not np.any(hand):
        return 0.0
    low, high = 0.0, float(np.linalg.eigvalsh(device + hand)[-1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if turn_multiplier(settings, middle) < 1.0:
            high = middle
        else:
            low = middle
    return high


def check_virtual_mass(settings: ControlSettings) -> float:
    """The bound [kg]; UsageError where the virtual mass lies at or below it."""
    bound = virtual_mass_bound(settings)
    if not settings.unchecked and settings.tool.mass_kg <= bound:
        hand = float(np.linalg.eigvalsh(settings.operator.mass_kg)[-1])
        msg = (
            f"a virtual mass of {settings.tool.mass_kg:.3g} kg is unstable: the sampled force feeds the "
            f"inertia of the hand ({hand:.3g} kg) back, which variant {settings.variant} bears from "
            f"{bound:.3g} kg on; take {MARGIN * bound:.3g} kg or more (--virtual-mass)"
        )
        if settings.variant == "A":
            msg += ", or variant B"
        raise UsageError(msg)
    return bound
