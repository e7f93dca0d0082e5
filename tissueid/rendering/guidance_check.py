"""Check of a guided axis before any force: the damping that a device needs.

Behind its filter the damping of pull and wall is a branch like a tissue's: ``K tau`` times the filtered
velocity is a stiffness ``K tau / t_f`` that relaxes in t_f, and the drilled bone is a spring that relaxes in
R / k.  So the bound of :func:`tissueid.model.passivity.damping_bound` holds for all of them, linearised: the
pull at the entry, where it is stiffest, together with the wall at every penetration up to the clamp; and
the bone by itself, whose force is along the axis.

What a device can't bear is made weaker as a whole, so that the parts keep their proportions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.errors import DeviceError
from tissueid.model.impact import damping_factor
from tissueid.model.passivity import damping_bound
from tissueid.rendering.guidance_block import Guidance
from tissueid.rendering.precheck import DAMPING_SHARE, Demands

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
        device = self.demands
        stability = (
            f"needs {self.required_damping_N_s_per_m:.3g} N s/m of damping at {device.delay_ticks:g} ticks "
            f"of {1e3 * device.period_s:g} ms; the device has {device.damping_N_s_per_m:.3g} N s/m "
            f"({device.known})"
        )
        text = [f"stability  {stability}"]
        if self.strength < 1.0:
            text.append(
                f"weakened   to {self.strength:.3g} of the plan, which would need "
                f"{self.planned_damping_N_s_per_m:.3g} N s/m"
            )
        return text


def weaker(plan: Guidance, strength: float) -> Guidance:
    """A plan with all forces but the weight times a factor; feed and times stay."""
    return replace(
        plan,
        funnel=replace(plan.funnel, stiffness_N_per_m_n=strength * plan.funnel.stiffness_N_per_m_n),
        pull=replace(
            plan.pull,
            far_N_per_m=strength * plan.pull.far_N_per_m,
            near_N_per_m=strength * plan.pull.near_N_per_m,
        ),
        bone=replace(
            plan.bone,
            stiffness_N_per_m=strength * plan.bone.stiffness_N_per_m,
            resistance_N_s_per_m=strength * plan.bone.resistance_N_s_per_m,
        ),
    )


def needed_damping(plan: Guidance, demands: Demands) -> float:
    """Device damping [N s/m] that renders a plan passively.

    ``demands``: clamp, period and delay of the device.
    """

    def bound(slope: float, stiffness: float, tau: float) -> float:
        return damping_bound(
            slope,
            np.array([stiffness]),
            np.array([tau]),
            period_s=demands.period_s,
            delay_ticks=demands.delay_ticks,
        )

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
    """The plan as this device can render it.

    Returns the plan, weaker where it has to be, and the numbers.  Raises DeviceError: nothing that could be
    felt is stable on this device.
    """
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
        msg = (
            f"this guidance can't be rendered on this device: it needs {planned:.3g} N s/m of damping at "
            f"{demands.delay_ticks:g} ticks, the device has {demands.damping_N_s_per_m:.3g}, and weakened to "
            f"that its pull would be {low * plan.pull.near_N_per_m:.2g} N/m, under {LEAST_N_PER_M:g}; "
            "measure the device's damping and delay (tissueid devices calibrate-damping, test), or soften it"
        )
        raise DeviceError(msg)
    lowered = weaker(plan, low)
    return lowered, GuidanceCheck(low, planned, needed_damping(lowered, demands), demands)
