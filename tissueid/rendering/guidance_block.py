"""The numbers of a guided axis, with a default for all that the paper does not print, and their stability.

Behind its filter the damping of pull and wall is a branch like a tissue's: ``K tau`` times the filtered
velocity is a stiffness ``K tau / t_f`` that relaxes in t_f, and drilled bone a spring that relaxes in R / k.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.model.impact import pack_impact
from tissueid.model.passivity import damping_bound
from tissueid.model.restitution import Variant, damping_factor
from tissueid.rendering import environment as env
from tissueid.rendering import guidance as gd
from tissueid.rendering.precheck import DAMPING_SHARE, PERIOD_S, Demands
from tissueid.rendering.tissue_block import UNIT_TOLERANCE, Vector, free_air_block

# Pires et al. print the form of the contact law, the form of the surface and tau = 0.05 s.  All other numbers
# below are assumed, forces such that a device of which nothing was measured renders them stably.


@dataclass(frozen=True, slots=True)
class Funnel:
    """The guiding surface and its contact law."""

    #: {"hyperboloid", "cone"}: how the printed equation is read (:mod:`tissueid.rendering.guidance`).
    kind: Literal["hyperboloid", "cone"] = "hyperboloid"
    #: Radius at the entry point [m], depth of the throat below it [m] (the apex of a cone lies a printed 1 mm
    #: deeper), growth of the radius with the height.  The radius of a cone follows from the other two.
    radius_m: float = 0.004
    offset_m: float = 0.006
    slope: float = 0.35
    #: k [N/m^n] and n.
    stiffness_N_per_m_n: float = 400.0
    exponent: float = 1.5
    restitution: float = 0.9  # e
    law: Variant = "flores"  # {"flores", "exact"}
    slowest_m_s: float = 0.05  # floor of the speed at contact [m/s]

    def numbers(self) -> FloatArray:
        """Block of the funnel, shape (FUNNEL_SIZE,); ValueError where no surface has these numbers."""
        if self.kind == "cone":
            if not (self.slope > 0.0 and self.offset_m >= 0.0):
                msg = f"a cone needs a slope above 0 and an offset from 0, got {self.slope}, {self.offset_m}"
                raise ValueError(msg)
            return np.array([gd.CONE, self.slope, self.offset_m, 1.0])
        return np.array([gd.HYPERBOLOID, *gd.hyperboloid_constants(self.radius_m, self.offset_m, self.slope)])


@dataclass(frozen=True, slots=True)
class Pull:
    """The impedance that pulls to the axis."""

    #: K far above the entry point, and at it [N/m].
    far_N_per_m: float = 10.0
    near_N_per_m: float = 75.0
    reach_m: float = 0.02  # height L over which it rises [m]
    tau_s: float = 0.05  # b / K [s]; printed
    filter_s: float = 0.05  # of the velocity [s]
    conservative: bool = True  # with the axial force; without it the paper's variant


@dataclass(frozen=True, slots=True)
class Bone:
    """The femoral head."""

    radius_m: float = 0.024  # 0 for none
    stiffness_N_per_m: float = 200.0
    hole_radius_m: float = 0.003  # within it the tip drills
    resistance_N_s_per_m: float = 300.0  # pressing force over feed
    drill_depth_m: float = 0.02  # at which the wire is through


@dataclass(frozen=True, slots=True)
class Guidance:
    """A planned axis and everything that guides to it; ValueError where a number is out of its range."""

    entry_m: Vector  # entry point [m, device frame]
    axis: Vector = (0.0, 0.0, 1.0)  # out of the bone; made a unit vector
    funnel: Funnel = field(default_factory=Funnel)
    pull: Pull = field(default_factory=Pull)
    bone: Bone = field(default_factory=Bone)
    weight_N: Vector = (0.0, 0.0, 0.0)  # force that carries the tool at the entry point [N]
    #: Its change with the position: a row a component of the force.
    weight_slope_N_per_m: tuple[Vector, Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        if not np.isfinite(self.numbers()).all():
            raise ValueError(f"every number of a guided axis must be finite: {self}")
        pull, bone = self.pull, self.bone
        if not (0.0 <= pull.far_N_per_m <= pull.near_N_per_m and pull.reach_m > 0.0):
            raise ValueError(f"the pull must rise toward the entry over a reach above 0, got {pull}")
        if not (pull.tau_s >= 0.0 and pull.filter_s >= 0.0):
            raise ValueError(f"times can't be negative, got {pull}")
        if bone.radius_m > 0.0 and not (
            bone.stiffness_N_per_m > 0.0
            and bone.resistance_N_s_per_m > 0.0
            and 0.0 <= bone.hole_radius_m < bone.radius_m
            and bone.drill_depth_m >= 0.0
        ):
            msg = f"a bone needs stiffness and resistance above 0 and a hole narrower than itself, got {bone}"
            raise ValueError(msg)

    def unit_axis(self) -> FloatArray:
        """Unit vector out of the bone, shape (3,); ValueError where the axis has no direction."""
        axis = np.asarray(self.axis, dtype=np.float64)
        length = float(np.linalg.norm(axis))
        if not (np.isfinite(length) and length > UNIT_TOLERANCE):
            raise ValueError(f"an axis needs a direction, got {self.axis}")
        return np.asarray(axis / length)

    def numbers(self) -> FloatArray:
        """The block of :mod:`tissueid.rendering.guidance`, shape (GUIDANCE_SIZE,)."""
        out = np.empty(gd.GUIDANCE_SIZE)
        out[gd.ORIGIN : gd.ORIGIN + 3] = self.entry_m
        out[gd.AXIS : gd.AXIS + 3] = self.unit_axis()
        out[gd.FUNNEL : gd.CONTACT] = self.funnel.numbers()
        funnel, pull, bone = self.funnel, self.pull, self.bone
        # fields of pull and bone stand in the block's order
        pack_impact(
            # the law steps in millimetres
            funnel.stiffness_N_per_m_n * gd.M_TO_MM**-funnel.exponent,
            funnel.exponent,
            damping_factor(funnel.restitution, funnel.law),
            out,
            gd.CONTACT,
            slowest_mm_s=funnel.slowest_m_s * gd.M_TO_MM,
            filter_s=pull.filter_s,
            hysteresis_mm=0.2,
        )
        out[gd.PULL : gd.WEIGHT] = astuple(pull)
        out[gd.WEIGHT : gd.WEIGHT_SLOPE] = self.weight_N
        out[gd.WEIGHT_SLOPE : gd.BONE] = np.ravel(self.weight_slope_N_per_m)
        out[gd.BONE :] = astuple(bone)
        return out


def guidance_block(plan: Guidance, *, label: int = 0) -> FloatArray:
    """The block of an environment that is this guidance, shape (ENVIRONMENT_SIZE,)."""
    block = free_air_block(label=label)
    block[env.KIND] = env.GUIDANCE
    # nothing is scaled: forces and motion are the device's own
    block[env.FORCE_SCALE] = block[env.MOTION_SCALE] = 1.0
    block[env.GUIDED : env.GUIDED + gd.GUIDANCE_SIZE] = plan.numbers()
    return block


#: Penetrations of the wall that are examined [m].
DEEPEST_M = 0.010
DEPTHS = 25
#: Largest pull below which nobody is guided [N/m]: 0.2 N at 10 mm.
LEAST_N_PER_M = 20.0
#: Halvings in the search for the largest strength.
HALVINGS = 30
#: Below this a filter is none [s].
SHORTEST_FILTER_S = 1e-6


@dataclass(frozen=True, slots=True)
class GuidanceCheck:
    """Result of the check."""

    #: Factor on every force of the plan but the weight; 1 where the device bears it as planned.
    strength: float
    #: That the plan would need, and that it needs at this strength.
    planned_damping_N_s_per_m: float
    required_damping_N_s_per_m: float
    demands: Demands

    def lines(self) -> list[str]:
        """Lines printed before force is enabled."""
        text = [self.demands.stability(self.required_damping_N_s_per_m)]
        if self.strength < 1.0:
            text.append(
                f"weakened   to {self.strength:.3g} of the plan, which would need "
                f"{self.planned_damping_N_s_per_m:.3g} N s/m"
            )
        return text


def weaker(plan: Guidance, strength: float) -> Guidance:
    """A plan with all forces but the weight times a factor; feed and times stay."""

    def times(part: Any, *names: str) -> Any:
        return replace(part, **{name: strength * getattr(part, name) for name in names})

    return replace(
        plan,
        funnel=times(plan.funnel, "stiffness_N_per_m_n"),
        pull=times(plan.pull, "far_N_per_m", "near_N_per_m"),
        bone=times(plan.bone, "stiffness_N_per_m", "resistance_N_s_per_m"),
    )


def needed_damping(plan: Guidance, demands: Demands) -> float:
    """Device damping [N s/m] that renders a plan passively: of pull and wall, and of the bone."""

    def bound(slope: float, stiffness: float, tau: float) -> float:
        timing = {"period_s": PERIOD_S, "delay_ticks": demands.delay_ticks}
        return damping_bound(slope, np.array([stiffness]), np.array([tau]), **timing)

    pull, funnel, bone = plan.pull, plan.funnel, plan.bone
    filter_s = max(pull.filter_s, SHORTEST_FILTER_S)
    depth = DEEPEST_M * np.arange(1, DEPTHS + 1) / DEPTHS
    elastic = funnel.stiffness_N_per_m_n * depth**funnel.exponent
    # beyond the clamp the force is constant; the last depth before it counts
    felt = elastic <= max(demands.clamp_N, float(elastic[0]))
    chi = damping_factor(funnel.restitution, funnel.law)
    slope = funnel.exponent * elastic[felt] / depth[felt]
    resistance = elastic[felt] * chi / funnel.slowest_m_s
    walls = [
        bound(pull.near_N_per_m + k, (pull.near_N_per_m * pull.tau_s + c) / filter_s, filter_s)
        for k, c in zip(slope, resistance, strict=True)
    ]
    drilling = 0.0
    if bone.radius_m > 0.0:
        drilling = bound(0.0, bone.stiffness_N_per_m, bone.resistance_N_s_per_m / bone.stiffness_N_per_m)
    return max(*walls, drilling)


def check_guidance(plan: Guidance, demands: Demands) -> tuple[Guidance, GuidanceCheck]:
    """The plan, made weaker until this device can render it; DeviceError where it could not be felt."""
    offered = DAMPING_SHARE * demands.damping_N_s_per_m
    planned = needed_damping(plan, demands)
    if planned <= offered:
        return plan, GuidanceCheck(1.0, planned, planned, demands)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if needed_damping(weaker(plan, middle), demands) <= offered:
            low = middle
        else:
            high = middle
    if low * plan.pull.near_N_per_m < min(LEAST_N_PER_M, plan.pull.near_N_per_m):
        raise DeviceError(
            f"this guidance can't be rendered on this device: it needs {planned:.3g} N s/m of damping at "
            f"{demands.delay_ticks:g} ticks, the device has {demands.damping_N_s_per_m:.3g}, and weakened to "
            f"that its pull would be {low * plan.pull.near_N_per_m:.2g} N/m, under {LEAST_N_PER_M:g}; "
            "measure the device's damping and delay (tissueid devices calibrate-damping, test), or soften it"
        )
    lowered = weaker(plan, low)
    return lowered, GuidanceCheck(low, planned, needed_damping(lowered, demands), demands)
