"""Sessions without a tissue: an installed force law, and guidance along a planned axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tissueid.haptics.device import HapticDevice
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure import MIDDLE_M
from tissueid.haptics.sim import carried
from tissueid.rendering.blind import check_pseudonym
from tissueid.rendering.guidance_block import Guidance, guidance_block
from tissueid.rendering.guidance_check import check_guidance
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.precheck import demands_of
from tissueid.rendering.session_plan import SessionPlan, session_head
from tissueid.rendering.surface import SURFACE_SIZE
from tissueid.rendering.tissue_block import free_air_block

#: Height above the entry point at which a simulated hand begins [m].
BEGIN_M = 0.03


def law_session(options: RenderOptions, choice: tuple[str, str], device: HapticDevice) -> SessionPlan:
    """A session with an installed force law: no tissue, no scale, no precheck."""
    block = np.concatenate([free_air_block(), PassivityLimits(on=options.control).block()])
    line = f"law        {options.environment}: nothing is known of its stability"
    return _plan(options, choice, device, block, (line,), environment=options.environment)


def guided_session(options: RenderOptions, choice: tuple[str, str], device: HapticDevice) -> SessionPlan:
    """A session with guidance along a planned axis.

    The passivity controller only watches: what the pull stored before the hand engaged would count as
    energy that was made.

    Raises DeviceError: nothing that could be felt is stable on this device.
    """
    scene = options.scene
    assert scene is not None  # noqa: S101 -- asked by the caller
    assert scene.guidance is not None  # noqa: S101 -- asked by the caller
    plan = _carried(scene.guidance, device, assumed="weight" in scene.assumed)
    guidance, check = check_guidance(plan, demands_of(device.capabilities))
    block = np.concatenate([guidance_block(guidance), PassivityLimits(on=False).block()])
    lines = (*scene.lines(), *_told_of(guidance), *check.lines())
    given = dict(options.device_options)
    if options.led:
        begin = np.array(guidance.entry_m) + BEGIN_M * guidance.unit_axis()
        given["limits"] = carried(GuardLimits.simulated())
        given["hand"] = Hand((0.0,), ((float(begin[0]), float(begin[1]), float(begin[2])),), (1.0,))
    return _plan(options, choice, device, block, lines, given=given, guided=True)


def _carried(guidance: Guidance, device: HapticDevice, *, assumed: bool) -> Guidance:
    """The plan with the weight that was measured on this unit, unless the scene knows better."""
    known = getattr(device, "calibration", None)
    stated = any(guidance.weight_N) or any(map(any, guidance.weight_slope_N_per_m))
    if (stated and not assumed) or known is None or not known.weight_measured:
        return guidance
    slope = np.array(known.weight_slope_N_per_m).reshape(3, 3)
    there = np.array(known.weight_N) + slope @ (np.array(guidance.entry_m) - np.array(MIDDLE_M))
    x, y, z = (float(value) for value in there)
    rows = tuple((float(a), float(b), float(c)) for a, b, c in slope)
    return replace(guidance, weight_N=(x, y, z), weight_slope_N_per_m=(rows[0], rows[1], rows[2]))


def _told_of(guidance: Guidance) -> tuple[str, ...]:
    pull, funnel = guidance.pull, guidance.funnel
    axial = "conservative" if pull.conservative else "as printed, which gives energy in a loop"
    stiffness = f"{pull.far_N_per_m:.3g} N/m far off, {pull.near_N_per_m:.3g} N/m at the entry"
    weight = float(np.linalg.norm(guidance.weight_N))
    carried = (f"weight     {weight:.2f} N carried at the entry, in contact too",) if weight > 0.0 else ()
    width = f"{funnel.kind}, {1e3 * funnel.radius_m:g} mm in radius at the entry"
    return (
        f"pull       {stiffness} over {1e3 * pull.reach_m:g} mm; {axial}",
        f"wall       {width}, {funnel.stiffness_N_per_m_n:.3g} N/m^{funnel.exponent:g}",
        *carried,
    )


def _plan(
    options: RenderOptions,
    choice: tuple[str, str],
    device: HapticDevice,
    block: Any,
    lines: tuple[str, ...],
    *,
    given: Mapping[str, Any] | None = None,
    environment: str | None = None,
    guided: bool = False,
) -> SessionPlan:
    pseudonym = None if options.pseudonym is None else check_pseudonym(options.pseudonym)
    plan = SessionPlan(
        device=choice[0],
        device_options=dict(options.device_options if given is None else given),
        why=choice[1],
        capabilities=device.capabilities,
        blocks=(block,),
        picked=(),
        check=None,
        order=None,
        head={},
        script=None,
        seconds=options.seconds,
        environment=environment,
        virtual=False,
        lines=(choice[1], *lines),
        led=options.led,
        guided=guided,
        pseudonym=pseudonym,
        scene=None if options.scene is None else options.scene.name,
    )
    return replace(plan, head=session_head(plan, np.zeros(SURFACE_SIZE), (None,)))
