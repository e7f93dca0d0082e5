"""Everything that is decided before any force: which tissue, device, scale, surface, order, log."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import refuse
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.hand import MM, MOST_HOLD_S, MOST_STROKES, S_PER_MIN, Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure import MIDDLE_M
from tissueid.haptics.registry import Choice, check_present, choose_device, device_class, environment_law
from tissueid.haptics.sim import DEFAULT_QUANTUM_M, carried
from tissueid.rendering.guidance import funnel_radius
from tissueid.rendering.guidance_block import Guidance, check_guidance, guidance_block
from tissueid.rendering.options import (
    Functional,
    Picked,
    RenderOptions,
    as_tissue,
    noticeable_ratio,
    parse_functional,
    pick_draw,
    pick_quantile,
    pick_specimen,
    preset_tissue,
)
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.precheck import Precheck, check_before_force, demands_of
from tissueid.rendering.scene import Scene
from tissueid.rendering.session_plan import (
    RAMP_S,
    BlindOrder,
    Script,
    SessionPlan,
    check_pseudonym,
    draw_order,
    read_script,
    session_head,
)
from tissueid.rendering.surface import SURFACE_SIZE, TOOL_RADIUS
from tissueid.rendering.tissue_block import (
    Surface,
    free_air_block,
    highest_touch,
    parse_surface,
    place_surface,
    surface_from,
    surface_remarks,
    tissue_block,
    travel_behind,
)
from tissueid.store.bundle import Bundle, load_bundle
from tissueid.store.files import sha256_of
from tissueid.store.session_log import read_session_log

#: Share of the identified depth that a simulated grip shows where no script was given.
DEMONSTRATED_DEPTH = 0.75
DEMONSTRATED_HOLD_S = 1.0
DEFAULT_PRESENTATIONS = 10
#: Height above the tissue at which a hand waits for a pointer [m].
REST_M = 0.005
#: Devices that a script can move, and that can run faster than time.
SIMULATED = "sim"


class _Asked(NamedTuple):
    """The user's wishes, the device and why it was taken; it is made, not opened."""

    options: RenderOptions
    choice: Choice
    device: HapticDevice
    given: dict[str, Any]  # arguments of the device's class


def plan_session(options: RenderOptions) -> SessionPlan:
    """Decide everything, or refuse with the way out: UsageError, BundleError, DeviceError."""
    if options.seconds is not None and not 0.0 < options.seconds < math.inf:
        refuse(f"--seconds is {options.seconds:g}, must be above 0 and finite")
    scene, guidance = options.scene, None if options.scene is None else options.scene.guidance
    if guidance is not None or options.environment is not None:
        _must_be_alone(options)
        asked = _asked(options)
        _must_fit(asked, None)
        if scene is not None and guidance is not None:
            return guided_session(asked, scene, guidance)
        # of an installed force law nothing is known: no tissue, no scale, no precheck
        block = np.concatenate([free_air_block(), PassivityLimits(on=options.control).block()])
        line = f"law        {options.environment}: nothing is known of its stability"
        return _without_tissue(asked, block, (line,), environment=options.environment)
    functional = parse_functional(options.of)
    picked, hashes = _tissues(options, functional)
    options, replayed = _replayed(options)
    asked = _asked(options)
    script = _script(asked, picked[0])
    _must_fit(asked, script)
    shape = parse_surface(options.surface)
    remarks = [one for each in picked for one in surface_remarks(each.tissue, shape, options.tip_radius_mm)]
    remarks += _beyond(script, picked)
    check, surface, radius_m = _scaled(asked, picked, shape)
    if replayed is not None:
        surface, radius_m = replayed
    check = replace(check, remarks=(*check.remarks, *dict.fromkeys(remarks)))
    order = _order(options, picked)
    blocks = _blocks(options, picked, check, surface, radius_m, order)
    given = asked.given
    touch_m, inward = highest_touch(surface.numbers(radius_m))
    carried_along = script or options.program
    if carried_along is not None:
        given["limits"] = replace(GuardLimits.simulated(), ramp_s=RAMP_S)
        given["hand"] = carried_along.hand(
            motion_scale=check.scaling.motion, surface_m=touch_m, inward=inward
        )
    led = options.led and script is None and asked.choice.name == SIMULATED
    if led:
        given |= _waiting_at(touch_m - REST_M * inward)
    of_scene = () if scene is None else scene.lines()
    return _planned(
        asked,
        (surface.numbers(radius_m), hashes),
        blocks=blocks,
        picked=picked,
        check=check,
        order=order,
        script=script,
        seconds=_seconds(options, script),
        virtual=options.virtual,
        lines=(asked.choice.why, *of_scene, *_lines(options, picked, check, functional)),
        led=led,
    )


def _planned(asked: _Asked, of_log: tuple[FloatArray, tuple[str | None, ...]], **decided: Any) -> SessionPlan:
    """A plan of what was decided, with the head of its log, which has the surface and hashes of bundles."""
    options, choice, device, given = asked
    scene = None if options.scene is None else options.scene.name
    plan = SessionPlan(choice.name, choice.why, device.capabilities, given, scene=scene, **decided)
    return replace(plan, head=session_head(plan, *of_log))


def _waiting_at(place_m: FloatArray) -> dict[str, Any]:
    """Limits and hand of the simulated device where a pointer leads it from a place."""
    x, y, z = place_m.tolist()
    # a hand that is led may rest while the tissue relaxes: its encoders then stand still in good health
    return {"limits": carried(GuardLimits.simulated()), "hand": Hand((0.0,), ((x, y, z),), (1.0,))}


def _tissues(
    options: RenderOptions, functional: Functional
) -> tuple[tuple[Picked, ...], tuple[str | None, ...]]:
    """The tissue, and the one it is compared with; the content hashes of their bundles."""
    if (options.bundle is None) == (options.preset is None):
        refuse("give a bundle, or --preset, and not both: tissueid render bundle.h5")
    if options.preset is not None:
        if (options.draw, options.quantile, options.draw_specimen) != (None, None, None):
            refuse("--draw, --quantile and --draw-specimen choose among a bundle's draws; a preset has none")
        first = Picked(preset_tissue(options.preset), None, f"preset {options.preset}")
        bundle, own = None, None
    else:
        assert options.bundle is not None  # noqa: S101 -- one of the two is given
        bundle, own = load_bundle(options.bundle), sha256_of(options.bundle)
        first = _pick(bundle, options.draw, options.quantile, functional, options.draw_specimen)
    compared = (options.against, options.against_draw, options.against_quantile)
    if all(one is None for one in compared):
        return (first,), (own,)
    other = bundle if options.against is None else load_bundle(options.against)
    if other is None:
        refuse("--against-draw and --against-quantile choose from a bundle; give one, or --against BUNDLE")
    second = _pick(other, options.against_draw, options.against_quantile, functional)
    return (first, second), (own, own if options.against is None else sha256_of(options.against))


def _pick(
    bundle: Bundle,
    draw: int | None,
    quantile: float | None,
    functional: Functional,
    specimen: str | None = None,
) -> Picked:
    if [draw, quantile, specimen].count(None) < 2:
        refuse("give one of --draw, --quantile and --draw-specimen")
    if specimen is not None:
        return pick_specimen(bundle, specimen)
    if draw is not None:
        return pick_draw(bundle, draw)
    if quantile is not None:
        return pick_quantile(bundle, quantile, functional)
    why = "the typical tissue of the population" if bundle.is_population else "theta of the bundle"
    return Picked(as_tissue(bundle), None, why)


def _asked(options: RenderOptions) -> _Asked:
    """The options with their device; a log whose motion is rendered again is one."""
    log = {} if options.replay is None else {"log": options.replay}
    found, given = choose_device("replay" if log else options.device), {**options.device_options, **log}
    check_present(found.name, given.get("port"))
    return _Asked(options, found, device_class(found.name)(**given), given)


def _seconds(options: RenderOptions, script: Script | None) -> float | None:
    """Length of the session: what was said, no longer than the script that was asked for."""
    if options.program is not None:
        return options.program.duration_s
    if script is None or (options.script is None and options.seconds is not None):
        return options.seconds
    return min(script.duration_s, options.seconds or script.duration_s)


def _script(asked: _Asked, first: Picked) -> Script | None:
    """Script of the user; a simulated grip that nobody moves shows three quarters of the depth, repeated."""
    options = asked.options
    if options.script is not None:
        return read_script(options.script)
    if asked.choice.name != SIMULATED or options.bridge or options.led or options.program is not None:
        return None
    depth, speed = DEMONSTRATED_DEPTH * first.tissue.model.depth_mm, S_PER_MIN * first.tissue.speeds_mm_s[1]

    def push(hold_s: float) -> str:
        return (
            f"indent {depth:.3g} mm at {speed:.4g} mm/min; hold {hold_s:.6g} s; retract at {speed:.4g} mm/min"
        )

    once = read_script(push(DEMONSTRATED_HOLD_S))
    if options.seconds is None or options.seconds <= once.duration_s:
        return once
    strokes_s = sum(stroke.duration_s for stroke in once.strokes)
    times = 1 + math.ceil((options.seconds - once.duration_s) / strokes_s)
    # a hand goes through so many strokes: in a longer session each push is held for longer
    most = MOST_STROKES // len(once.strokes)
    if times <= most:
        return read_script("; ".join([push(DEMONSTRATED_HOLD_S)] * times))
    hold_s = DEMONSTRATED_HOLD_S + (options.seconds - once.duration_s) / most - strokes_s * (most - 1) / most
    return read_script("; ".join([push(min(hold_s, MOST_HOLD_S))] * most))


def _replayed(options: RenderOptions) -> tuple[RenderOptions, tuple[Surface, float] | None]:
    """A replay takes scale, surface and length from its log, where nothing else was asked for."""
    if options.replay is None:
        return options, None
    log = read_session_log(options.replay)
    scale, times = log.head["scale"], log.records["time_s"]
    if scale is None or times.size < 2:
        refuse(f"{options.replay}: the log of a force law of its own, or an empty one, can't be replayed")
    numbers = np.array(log.head["surface"])
    options = replace(
        options,
        force_scale=options.force_scale or scale["force_scale"],
        motion_scale=options.motion_scale or scale["motion_scale"],
        seconds=options.seconds or float(times[-1] - times[0]),
    )
    return options, (surface_from(numbers), float(numbers[TOOL_RADIUS]))


def _beyond(script: Script | None, picked: tuple[Picked, ...]) -> list[str]:
    """Remark on a script that goes deeper than was identified."""
    known_mm = min(each.tissue.model.depth_mm for each in picked)
    if script is None or script.depth_mm <= known_mm + 1e-6:
        return []
    words = f"the script goes {script.depth_mm:g} mm deep, the tissue is identified to {known_mm:.3g} mm"
    return [f"{words}: beyond, its force is continued, not measured"]


def _must_fit(asked: _Asked, script: Script | None) -> None:
    """Options that belong to a simulated device."""
    options, name = asked.options, asked.choice.name
    simulated = name == SIMULATED
    if script is not None and not simulated:
        way_out = "add --device sim" if options.replay is None else "leave --script or --replay out"
        refuse(f"--script moves a simulated grip, and the device is {name}; {way_out}")
    led_by_nobody = script is None and options.program is None
    if options.virtual and (not simulated or led_by_nobody):
        refuse("--virtual runs a script on the simulated device faster than time; add --device sim --script")


def _scaled(
    asked: _Asked, picked: tuple[Picked, ...], shape: tuple[str, Any]
) -> tuple[Precheck, Surface, float]:
    """One scale for all tissues: the smallest that any of them needs; the surface at that scale."""
    options, capabilities = asked.options, asked.device.capabilities
    scales = {"force_scale": options.force_scale, "motion_scale": options.motion_scale}
    demands = demands_of(capabilities)
    checks = []
    for each in picked:
        scale = check_before_force(each.tissue, demands, **scales).scaling.motion
        radius_m = (each.tissue.tip_radius_mm or options.tip_radius_mm or 0.0) * MM * scale
        depth_mm = each.tissue.model.depth_mm
        surface = place_surface(
            shape, capabilities, depth_mm=depth_mm, motion_scale=scale, tool_radius_m=radius_m
        )
        travel_m = travel_behind(surface, capabilities, tool_radius_m=radius_m)
        check = check_before_force(each.tissue, replace(demands, travel_m=travel_m), **scales)
        checks.append((check, surface, radius_m))
    return min(checks, key=lambda one: one[0].scaling.force)


def _order(options: RenderOptions, picked: tuple[Picked, ...]) -> BlindOrder | None:
    if not options.blind:
        if options.presentations is not None or options.pseudonym is not None:
            refuse("--presentations and --pseudonym belong to --blind")
        return None
    count = DEFAULT_PRESENTATIONS if options.presentations is None else options.presentations
    pseudonym = check_pseudonym(options.pseudonym)
    return draw_order(len(picked), count, pseudonym=pseudonym, seed=options.seed)


def _blocks(
    options: RenderOptions,
    picked: tuple[Picked, ...],
    check: Precheck,
    surface: Surface,
    radius_m: float,
    order: BlindOrder | None,
) -> tuple[FloatArray, ...]:
    """A block for each presentation: the tissues themselves, or the blind order of them."""
    control = PassivityLimits(
        on=options.control,
        count_m=DEFAULT_QUANTUM_M,
        stiffness_N_per_m=check.scaling.device_stiffness_N_per_m,
    ).block()
    presented = range(len(picked)) if order is None else order.tissues
    scales = {"force_scale": check.scaling.force, "motion_scale": check.scaling.motion}
    blocks = []
    for label, tissue in enumerate(presented, 0 if order is None else 1):
        felt = tissue_block(picked[tissue].tissue, surface, **scales, tool_radius_m=radius_m, label=label)
        blocks.append(np.concatenate([felt, control]))
    return tuple(blocks)


def _lines(
    options: RenderOptions, picked: tuple[Picked, ...], check: Precheck, functional: Functional
) -> list[str]:
    """Printed lines: nothing that gives a blind comparison away."""
    text = []
    for tissue, why in () if options.blind else ((each.tissue, each.why) for each in picked):
        text.append(f"tissue     {tissue.name}: {why}")
        law = tissue.rupture
        if law is not None:
            text.append(
                f"rupture    at a {law.criterion.replace('-', ' ')} of {law.threshold:.4g} {law.unit} "
                f"(median of its tests; a criterion is a reading); {100.0 * law.residual:.0f} % of the force "
                "is left"
            )
    if len(picked) > 1:
        one, other, ratio = noticeable_ratio(
            picked[0].tissue, picked[1].tissue, functional, force_scale=check.scaling.force
        )
        forces = "" if options.blind else f"{one:.3g} against {other:.3g} N at the device, "
        text.append(
            f"contrast   {functional}: {forces}{ratio:.2g} times the just-noticeable difference"
            + ("; hardly anybody would tell them apart" if ratio < 1.0 else "")
        )
    return text + check.lines()


def _must_be_alone(options: RenderOptions) -> None:
    """A force law takes the place of everything that belongs to a tissue."""
    given = (options.bundle, options.preset, options.script, options.replay)
    if options.blind or any(one is not None for one in given):
        word = "--environment" if options.environment is not None else "a scene with guidance"
        refuse(
            f"{word} takes the place of a tissue: leave bundle, --preset, --blind, --replay and --script out"
        )
    if options.environment is not None:
        environment_law(options.environment)


#: Height above the entry point at which a simulated hand begins [m].
BEGIN_M = 0.03


def guided_session(asked: _Asked, scene: Scene, guidance: Guidance) -> SessionPlan:
    """A session with guidance along a planned axis; DeviceError where none that could be felt is stable.

    The passivity controller only watches: what the pull stored before the hand engaged would count as
    energy that was made.
    """
    plan = _carried(guidance, asked.device, assumed="weight" in scene.assumed)
    guidance, check = check_guidance(plan, demands_of(asked.device.capabilities))
    block = np.concatenate([guidance_block(guidance), PassivityLimits(on=False).block()])
    lines = (*scene.lines(), *_told_of(guidance), *check.lines())
    if asked.options.led:
        asked.given.update(_waiting_at(np.array(guidance.entry_m) + BEGIN_M * guidance.unit_axis()))
    return _without_tissue(asked, block, lines, guided=True)


def _carried(guidance: Guidance, device: HapticDevice, *, assumed: bool) -> Guidance:
    """The plan with the weight that was measured on this unit, unless the scene knows better."""
    known = getattr(device, "calibration", None)
    stated = any(guidance.weight_N) or any(map(any, guidance.weight_slope_N_per_m))
    if (stated and not assumed) or known is None or not known.weight_measured:
        return guidance
    slope = np.array(known.weight_slope_N_per_m).reshape(3, 3)
    there = np.array(known.weight_N) + slope @ (np.array(guidance.entry_m) - np.array(MIDDLE_M))
    x, y, z = map(tuple, slope.tolist())
    return replace(guidance, weight_N=tuple(there.tolist()), weight_slope_N_per_m=(x, y, z))


def _told_of(guidance: Guidance) -> tuple[str, ...]:
    pull, funnel = guidance.pull, guidance.funnel
    axial = "conservative" if pull.conservative else "as printed, which gives energy in a loop"
    stiffness = f"{pull.far_N_per_m:.3g} N/m far off, {pull.near_N_per_m:.3g} N/m at the entry"
    weight = float(np.linalg.norm(guidance.weight_N))
    carried = (f"weight     {weight:.2f} N carried at the entry, in contact too",) if weight > 0.0 else ()
    radius_mm = 1e3 * float(funnel_radius(funnel.numbers(), np.zeros(1))[0])
    width = f"{funnel.kind}, {radius_mm:.3g} mm in radius at the entry"
    return (
        f"pull       {stiffness} over {1e3 * pull.reach_m:g} mm; {axial}",
        f"wall       {width}, {funnel.stiffness_N_per_m_n:.3g} N/m^{funnel.exponent:g}",
        *carried,
    )


def _without_tissue(asked: _Asked, block: FloatArray, lines: tuple[str, ...], **decided: Any) -> SessionPlan:
    options = asked.options
    return _planned(
        asked,
        (np.zeros(SURFACE_SIZE), (None,)),
        blocks=(block,),
        seconds=options.seconds,
        lines=(asked.choice.why, *lines),
        led=options.led,
        pseudonym=None if options.pseudonym is None else check_pseudonym(options.pseudonym),
        **decided,
    )
