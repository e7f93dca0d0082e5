"""Before any force: whether this device can render this tissue, at which scale, and what will be felt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError, refuse
from tissueid.haptics.device import Capabilities
from tissueid.model.channels import loading_force
from tissueid.model.passivity import (
    DEFAULT_MOTION_SCALE,
    Scaling,
    largest_tangent,
    required_damping,
    scaling_for,
)
from tissueid.model.servo_law import servo_law
from tissueid.rendering.tissue_block import Tissue

#: A device's damping is a calibration value: only this share of it is counted on.
DAMPING_SHARE = 0.95
#: Shares by which a scale, and the one that is told, stay below the largest: both are borne, given back.
ROUNDING, ROUNDED_DOWN = 1e-9, 0.9995
#: Peak force at the device below which hardly anything is felt over friction [N].
SMALLEST_PEAK_N = 0.1
#: Stiffness beyond which a Falcon's own driver does not go [N/m].
LARGEST_STIFFNESS_N_PER_M = 3000.0
MM_PER_M = 1000.0
#: The servo runs at 1 kHz.
PERIOD_S = 0.001
#: Damping of a replayed motion, which no force moves, as far as a number can say it [N s/m].
MOST_DAMPING = 1e6
#: Limits of what can be asked for: outside, a typing error is likelier than a wish.
SCALE_RANGE = (1e-6, 10.0)
MOTION_RANGE = (0.1, 100.0)
#: Depths at which the share of clipped travel is looked for.
GRID = 501


@dataclass(frozen=True, slots=True)
class Demands:
    """Abilities of a device, as far as the check needs them."""

    clamp_N: float  # force clamp of the guard at this moment [N]
    damping_N_s_per_m: float
    delay_ticks: float
    travel_m: float = np.inf  # room along the normal behind the surface [m]
    known: str = "assumed, not measured on this unit"  # where damping and newton come from, in words

    def stability(self, needed_N_s_per_m: float) -> str:
        """Line on the damping that a rendering needs, and that the device has."""
        return (
            f"stability  needs {needed_N_s_per_m:.3g} N s/m of damping at {self.delay_ticks:g} ticks of "
            f"{1e3 * PERIOD_S:g} ms; the device has {self.damping_N_s_per_m:.3g} N s/m ({self.known})"
        )


def demands_of(capabilities: Capabilities) -> Demands:
    """Demands of the checks before force on a device; the room behind a surface is not known yet."""
    known = "measured on this unit" if capabilities.calibrated else "assumed, not measured on this unit"
    return Demands(
        clamp_N=capabilities.clamp_N,
        damping_N_s_per_m=capabilities.damping_N_s_per_m,
        delay_ticks=capabilities.delay_ticks,
        known=known if capabilities.hardware else "as simulated",
    )


@dataclass(frozen=True, slots=True)
class Precheck:
    """The scale that will be felt, and the numbers behind it."""

    scaling: Scaling
    required_damping_N_s_per_m: float  # at that scale
    demands: Demands
    wanted_force_scale: float  # before it was lowered
    #: Share of the identified depth, at the fastest identified speed, where the clamp bites.
    clipped_share: float
    depth_mm: float  # identified depth
    remarks: tuple[str, ...] = ()  # what the user should know; sentences

    @property
    def lowered(self) -> bool:
        """True where the scale was lowered for the sake of stability."""
        return self.scaling.force < self.wanted_force_scale

    @property
    def force_over(self) -> float:
        """N in "felt force = measured / N"."""
        return 1.0 / self.scaling.force

    @property
    def stiffness_over(self) -> float:
        """M in "felt stiffness = measured / M"."""
        return self.scaling.motion / self.scaling.force

    def lines(self) -> list[str]:
        """Lines printed before force is enabled."""
        scale, device = self.scaling, self.demands
        felt = (
            f"felt force = measured/{self.force_over:.4g}, "
            f"felt stiffness = measured/{self.stiffness_over:.4g}, motion x{scale.motion:g}"
        )
        limits = (
            f"up to {scale.device_stiffness_N_per_m:.0f} N/m and {scale.peak_force_N:.3g} N for "
            f"{self.depth_mm:g} mm of tissue ({self.depth_mm * scale.motion:.4g} mm of travel); clamp "
            f"{device.clamp_N:.3g} N, {100.0 * self.clipped_share:.3g} % of the depth clipped"
        )
        text = [f"scale      {felt}", f"device     {limits}"]
        text.append(device.stability(self.required_damping_N_s_per_m))
        if self.lowered:
            text.append(
                f"lowered    from measured/{1.0 / self.wanted_force_scale:.4g}, which would need "
                f"{self.required_damping_N_s_per_m * self.wanted_force_scale / scale.force:.3g} N s/m"
            )
        return text + [f"remark     {remark}" for remark in self.remarks]

    def as_json(self) -> dict[str, object]:
        """Numbers of :meth:`lines`, for logs and ``--json``."""
        return {
            "force_scale": self.scaling.force,
            "motion_scale": self.scaling.motion,
            "felt_force_is_measured_over": self.force_over,
            "felt_stiffness_is_measured_over": self.stiffness_over,
            "device_stiffness_N_per_m": self.scaling.device_stiffness_N_per_m,
            "peak_force_N": self.scaling.peak_force_N,
            "clamp_N": self.demands.clamp_N,
            "clipped_share_expected": self.clipped_share,
            "required_damping_N_s_per_m": self.required_damping_N_s_per_m,
            "device_damping_N_s_per_m": min(self.demands.damping_N_s_per_m, MOST_DAMPING),
            "delay_ticks": self.demands.delay_ticks,
            "period_s": PERIOD_S,
            "known": self.demands.known,
            "lowered_from_force_scale": self.wanted_force_scale if self.lowered else None,
            "remarks": list(self.remarks),
        }


def _fastest_force(tissue: Tissue, depth_mm: FloatArray) -> FloatArray:
    """Force at depths that are reached at the fastest identified speed [N of tissue]."""
    return loading_force(tissue.model, tissue.theta, depth_mm, speed_mm_s=tissue.speeds_mm_s[1])


def scaling_at(tissue: Tissue, *, force: float, motion: float) -> Scaling:
    """The numbers of a scale s_F, s_x that is given."""
    peak = _fastest_force(tissue, np.array([tissue.model.depth_mm]))
    tangent = largest_tangent(tissue.model, tissue.theta) * MM_PER_M
    return Scaling(
        force=force,
        motion=motion,
        device_stiffness_N_per_m=tangent * force / motion,
        peak_force_N=float(peak[0]) * force,
    )


def check_before_force(
    tissue: Tissue, demands: Demands, *, force_scale: float | None = None, motion_scale: float | None = None
) -> Precheck:
    """The largest scale that is stable, or the one asked for; DeviceError where none is felt stably."""
    motion = DEFAULT_MOTION_SCALE if motion_scale is None else motion_scale
    _must_lie("--motion-scale", motion, MOTION_RANGE)
    if force_scale is not None:
        _must_lie("--force-scale", force_scale, SCALE_RANGE)
    model, theta, fastest = tissue.model, tissue.theta, tissue.speeds_mm_s[1]
    try:
        if force_scale is None:
            wanted = scaling_for(model, theta, clamp_N=demands.clamp_N, fastest_mm_s=fastest, motion=motion)
        else:
            wanted = scaling_at(tissue, force=force_scale, motion=motion)
    except ValueError as error:
        raise DeviceError(f"no force scale: {error}; give --force-scale") from error
    need = required_damping(model, theta, wanted, period_s=PERIOD_S, delay_ticks=demands.delay_ticks)
    scaling = _affordable(tissue, wanted, need, demands, asked=force_scale is not None)
    force = _fastest_force(tissue, np.linspace(0.0, tissue.model.depth_mm, GRID))
    result = Precheck(
        scaling=scaling,
        required_damping_N_s_per_m=need * scaling.force / wanted.force,
        demands=demands,
        wanted_force_scale=wanted.force,
        clipped_share=float(np.mean(force * scaling.force > demands.clamp_N)),
        depth_mm=tissue.model.depth_mm,
    )
    return replace(result, remarks=_remarks(tissue, result))


def _must_lie(name: str, value: float, allowed: tuple[float, float]) -> None:
    if not allowed[0] <= value <= allowed[1]:
        refuse(f"{name} is {value:g}, must lie within {allowed[0]:g} and {allowed[1]:g}")


def _affordable(tissue: Tissue, wanted: Scaling, need: float, demands: Demands, *, asked: bool) -> Scaling:
    """The wanted scale, or the largest that the device's damping bears: the need is linear in it."""
    offered = DAMPING_SHARE * demands.damping_N_s_per_m
    if need <= offered:
        return wanted
    largest = wanted.force * offered / need * (1.0 - ROUNDING)
    numbers = (
        f"needs {need:.3g} N s/m of damping at {demands.delay_ticks:g} ticks, and {offered:.3g} N s/m of the "
        f"device's {demands.damping_N_s_per_m:.3g} may be counted on"
    )
    if asked:
        raise DeviceError(
            f"--force-scale {wanted.force:.4g} would be unstable: it {numbers}; the largest that fits at "
            f"motion scale {wanted.motion:g} is {ROUNDED_DOWN * largest:.4g} "
            f"(measured/{1.0 / max(largest, 1e-12):.4g}), or raise --motion-scale"
        )
    lowered = scaling_at(tissue, force=largest, motion=wanted.motion) if largest > 0.0 else wanted
    if not largest > 0.0 or lowered.peak_force_N < SMALLEST_PEAK_N:
        raise DeviceError(
            f"this tissue can't be felt on this device: the scale that fits its clamp {numbers}, and lowered "
            f"to that it would peak at {lowered.peak_force_N if largest > 0.0 else 0.0:.2g} N, under "
            f"{SMALLEST_PEAK_N:g} N; raise --motion-scale, or measure the device's damping and delay"
        )
    return lowered


def _remarks(tissue: Tissue, check: Precheck) -> tuple[str, ...]:
    found = []
    scaling, demands = check.scaling, check.demands
    travel_mm = tissue.model.depth_mm * scaling.motion
    if demands.travel_m * MM_PER_M < travel_mm:
        found.append(
            f"the device has {demands.travel_m * MM_PER_M:.3g} mm of travel behind the surface, the "
            f"identified depth needs {travel_mm:.3g}: the deepest part can't be reached; lower --motion-scale"
        )
    if scaling.device_stiffness_N_per_m > LARGEST_STIFFNESS_N_PER_M:
        found.append(
            f"{scaling.device_stiffness_N_per_m:.0f} N/m is stiffer than the {LARGEST_STIFFNESS_N_PER_M:.0f} "
            "N/m that such devices are driven with"
        )
    depth = np.linspace(0.0, tissue.model.depth_mm, GRID)
    relaxing = _fastest_force(tissue, depth) - tissue.model.static_force(tissue.theta, depth)
    viscous = float(relaxing.max()) * scaling.force
    if viscous < SMALLEST_PEAK_N:
        found.append(
            f"the relaxing part of the force is at most {viscous:.2g} N at the fastest identified speed: "
            "it is hardly felt"
        )
    slowest = servo_law(tissue.model, tissue.theta).slowest_mm_s
    if slowest > tissue.speeds_mm_s[0]:
        found.append(
            f"a contact that begins below {slowest:g} mm/s is damped as one that began at it; recordings "
            f"began at {tissue.speeds_mm_s[0]:.3g} mm/s"
        )
    return tuple(found)
