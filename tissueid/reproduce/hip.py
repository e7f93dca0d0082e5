"""Paper B: restitution of the contact law, and the two forces of its Fig. 4, by the servo's own kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, cast

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.reproduction import Figure, Item, Trace
from tissueid.model.impact import IMPACT_SIZE, IMPACT_STATE, impact_step, pack_impact
from tissueid.model.restitution import damping_factor
from tissueid.rendering import guidance as gd
from tissueid.rendering.guidance_block import Bone, Funnel, Guidance, Pull
from tissueid.reproduce.published import PIRES, Ledger, Readings, Said, near, points

RESTITUTIONS = (0.3, 0.5, 0.7, 0.9)
#: A free mass [kg] at this speed [mm/s] on a Hertz contact [N/mm^1.5], in steps [s] that converge to 1 %.
MASS_KG, SPEED_MM_S, STIFFNESS, EXPONENT, STEP_S = 0.6, 200.0, 600.0, 1.5, 2e-6
MOST_STEPS = 1_000_000
#: Heights above the entry point [mm] and radial errors [mm] of the sweep.
HEIGHTS_MM = (40.0, 20.0, 10.0, 0.0)
MOST_ERROR_MM, SWEEP = 20.0, 201
#: A sweep as slow as this shows the springs and not the damper [s a step].
SLOW_STEP_S = 10.0


def restitutions() -> list[Item]:
    """Speed after a drop over that before it, under the law as printed."""
    items = []
    for asked in RESTITUTIONS:
        ledger = Ledger(PIRES, "Equation (1)")
        ledger.read("8 (1 - e) / (5 e) multiplies v / v0, the speed at contact")
        mass = ledger.assume(
            f"a free mass of {MASS_KG} kg at {SPEED_MM_S:g} mm/s on {STIFFNESS:g} N/mm^{EXPONENT}", MASS_KG
        )
        items.append(
            ledger.item(
                f"restitution/{asked}",
                _after_drop(damping_factor(asked), mass),
                said=Said(f"Restitution reached where e = {asked} is asked for"),
                note="below what is asked for: the factor as printed holds for e near 1; mass, stiffness and "
                "speed do not enter",
            )
        )
    return items


def _after_drop(chi: float, mass_kg: float) -> float:
    """Speed of a free mass after the contact over that before it, by velocity Verlet."""
    law, memory = np.empty(IMPACT_SIZE), np.zeros(IMPACT_STATE)
    pack_impact(STIFFNESS, EXPONENT, chi, law, 0, slowest_mm_s=1.0)
    depth, speed, force = -2.0 * SPEED_MM_S * STEP_S, SPEED_MM_S, 0.0
    # N over kg in mm/s2: a thousand, halved by the rule
    push = 500.0 / mass_kg * STEP_S
    for _ in range(MOST_STEPS):
        depth += STEP_S * (speed - push * force)
        after = impact_step(law, 0, memory, 0, depth, STEP_S)
        speed -= push * (force + after)
        force = after
        if depth < 0.0 and speed < 0.0:
            break
    return -speed / SPEED_MM_S


def guidance_forces(readings: Readings) -> tuple[list[Item], Figure]:
    """Fig. 4: force of the impedance and of the surface against radial error, at four heights."""
    ledger = Ledger(PIRES, "Fig. 4")
    ledger.read(readings.words("surface"))
    kind = cast("Literal['hyperboloid', 'cone']", readings.surface)
    plan = ledger.assume(
        "surface, stiffness and reach of the guidance: those of the scene hip-resurfacing, without bone",
        Guidance(entry_m=(0.0, 0.0, 0.0), funnel=Funnel(kind=kind), bone=Bone(radius_m=0.0)),
    )
    error = np.linspace(0.0, MOST_ERROR_MM, SWEEP)
    swept = {
        height: _pushed(plan, [(1e-3 * one, 0.0, 1e-3 * height) for one in error], SLOW_STEP_S)
        for height in HEIGHTS_MM
    }
    traces = []
    for name, column in (("impedance", 0), ("surface", 1)):
        for height in HEIGHTS_MM:
            style: Literal["line", "dash"] = "line" if column == 0 else "dash"
            force = points(swept[height][:, column], 5)
            traces.append(Trace(f"{name}, {height:g} mm", tuple(error.tolist()), force, style, None))
    slopes = [float(swept[height][1, 0] / (1e-3 * error[1])) for height in HEIGHTS_MM]
    # the free side of the surface, by its closed form
    wide_m = gd.funnel_radius(plan.funnel.numbers(), 1e-3 * np.array(HEIGHTS_MM))
    inside = max(
        float(pushed[1e-3 * error < radius_m, 1].max(initial=0.0))
        for radius_m, pushed in zip(wide_m, swept.values(), strict=True)
    )
    at_axis = max(float(pushed[0, 0]) for pushed in swept.values())
    items = [*_guidance_claims(ledger, at_axis, slopes, inside), _time_constant()]
    words = (
        "Impedance and surface force against radial error",
        f"Shape only, stiffness and surface are not printed. {readings.words('surface').capitalize()}.",
    )
    axes = ("Radial error [mm]", "Force [N]")
    return items, ledger.figure("paper-b-figure-4", "assumed", words, axes, traces)


def _guidance_claims(ledger: Ledger, at_axis: float, slopes: list[float], inside: float) -> list[Item]:
    """Sentences about Fig. 4: largest forces on the axis and within the surface [N], slopes [N/m]."""
    zero: tuple[str, Callable[[float], bool]] = ("zero", lambda value: value == 0.0)
    positive: tuple[str, Callable[[float], bool]] = ("greater than zero", lambda value: value > 0.0)
    axis = "No impedance force without a radial error: largest force on the axis"
    rise = "The stiffness rises as the axial displacement falls: least rise from height to height"
    free = "No contact, no force of the surface: largest force within it"
    claims = (
        ("nothing-on-the-axis", axis, "N", at_axis, zero),
        ("steeper", rise, "N/m", float(np.diff(slopes).min()), positive),
        ("free-inside", free, "N", inside, zero),
    )
    return [
        ledger.claim(f"guidance/{key}", Said(words, unit), value, holds, rule)
        for key, words, unit, value, (rule, holds) in claims
    ]


def _pushed(plan: Guidance, positions_m: Sequence[tuple[float, float, float]], step_s: float) -> FloatArray:
    """Forces of pull and wall at positions that follow each other, shape (positions, 2) [N]."""
    block, memory = plan.numbers(), np.zeros(gd.GUIDANCE_MEMORY)
    force, said = np.zeros(3), np.zeros(gd.SAID_SIZE)
    found = np.empty((len(positions_m), 2))
    for k, position in enumerate(positions_m):
        gd.guidance_step(block, 0, memory, np.array(position), step_s, force, said, 0)
        found[k] = said[gd.SAID_PULL_N], said[gd.SAID_WALL_N]
    return found


def _time_constant() -> Item:
    """Damping over stiffness of the pull, from its force at rest and in steady motion."""
    ledger = Ledger(PIRES, "Fig. 4")
    plan = Guidance(
        entry_m=(0.0, 0.0, 0.0),
        pull=Pull(tau_s=ledger.printed("guidance/tau"), filter_s=0.0),
        bone=Bone(radius_m=0.0),
    )
    # off by two millimetres within the surface, and out at 10 mm/s
    at_rest, moving = _pushed(plan, [(2e-3, 0.0, 0.02), (2.01e-3, 0.0, 0.02)], 1e-3)[:, 0]
    stiffness = at_rest / 2e-3
    return ledger.item("guidance/tau", float((moving / stiffness - 2.01e-3) / 0.01), judge=near(1e-6, "s"))
