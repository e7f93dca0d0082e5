"""The flat block of an environment, written from an identified tissue, its scale and a surface.

On a curved surface two spheres touch with 1/R = 1/r_tip + 1/R_surface and Hertz's stiffness falls by sqrt(R /
r_tip).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import TipGeometry
from tissueid.errors import BundleError, UsageError, printable
from tissueid.haptics.device import Capabilities
from tissueid.haptics.hand import MM, NUMBER
from tissueid.model.channels import ChannelModel
from tissueid.model.servo_law import servo_law
from tissueid.rendering import environment as env
from tissueid.rendering import surface as srf
from tissueid.rupture_law import RuptureLaw

Vector = tuple[float, float, float]

#: Middle of a Falcon's workspace [m, device frame], and the direction out of it toward the user.
WORKSPACE_CENTRE_M: Vector = (0.0, 0.0, 0.130)
TOWARD_USER: Vector = (0.0, 0.0, 1.0)
UNIT_TOLERANCE = 1e-9


#: Criteria of rupture as the environment knows them.
RUPTURE_KINDS = {
    "work": env.RUPTURE_WORK,
    "weighted-force": env.RUPTURE_FORCE,
    "stored-energy": env.RUPTURE_STORED,
    "depth": env.RUPTURE_DEPTH,
}


@dataclass(frozen=True, slots=True)
class Plane:
    """Half space below a plane; ValueError where the normal has no direction, or a number is not finite."""

    point_m: Vector = WORKSPACE_CENTRE_M  # a point on the plane
    normal: Vector = TOWARD_USER  # out of the tissue; made a unit vector

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not (np.isfinite(self.point_m).all() and np.isfinite(length) and length > UNIT_TOLERANCE):
            msg = f"a plane needs a point and a normal with a direction, got {self.point_m} and {self.normal}"
            raise ValueError(msg)

    def numbers(self, tool_radius_m: float) -> FloatArray:
        """The block of :mod:`tissueid.rendering.surface`."""
        normal = np.asarray(self.normal, dtype=np.float64)
        normal = normal / np.linalg.norm(normal)
        return np.array([srf.PLANE, *self.point_m, *normal, 0.0, 0.0, 0.0, tool_radius_m])


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball; ValueError where the radius is not positive, or a number is not finite."""

    centre_m: Vector
    radius_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.centre_m).all() and 0.0 < self.radius_m < np.inf):
            msg = f"a sphere needs a centre and a radius above 0, got {self.centre_m} and {self.radius_m}"
            raise ValueError(msg)

    def numbers(self, tool_radius_m: float) -> FloatArray:
        """The block of :mod:`tissueid.rendering.surface`."""
        size = (self.radius_m, 0.0, 0.0)
        return np.array([srf.SPHERE, *self.centre_m, *TOWARD_USER, *size, tool_radius_m])


@dataclass(frozen=True, slots=True)
class Box:
    """A block with faces along the axes; ValueError where a half width is not positive and finite."""

    centre_m: Vector
    half_widths_m: Vector

    def __post_init__(self) -> None:
        widths = np.asarray(self.half_widths_m)
        if not (np.isfinite(self.centre_m).all() and np.isfinite(widths).all() and (widths > 0.0).all()):
            raise ValueError(
                f"a box needs a centre and half widths above 0, got {self.centre_m} and {self.half_widths_m}"
            )

    def numbers(self, tool_radius_m: float) -> FloatArray:
        """The block of :mod:`tissueid.rendering.surface`."""
        return np.array([srf.BOX, *self.centre_m, *TOWARD_USER, *self.half_widths_m, tool_radius_m])


Surface = Plane | Sphere | Box


def surface_from(numbers: FloatArray) -> Surface:
    """The surface behind the numbers that it wrote; ValueError where they describe none."""
    point = (float(numbers[1]), float(numbers[2]), float(numbers[3]))
    size = (float(numbers[7]), float(numbers[8]), float(numbers[9]))
    if numbers[0] == srf.SPHERE:
        return Sphere(point, size[0])
    if numbers[0] == srf.BOX:
        return Box(point, size)
    return Plane(point, (float(numbers[4]), float(numbers[5]), float(numbers[6])))


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """One identified tissue, as a renderer needs it."""

    model: ChannelModel
    theta: FloatArray  # (p,)
    speeds_mm_s: tuple[float, float]  # slowest and fastest identified speed [mm/s]
    tip_radius_mm: float | None = None  # of the tip it was identified with
    tip: TipGeometry | None = None  # shape of that tip, where it was stated
    name: str = ""  # for print; empty where it must not be told
    rupture: RuptureLaw | None = None  # when it breaks


def tissue_block(
    tissue: Tissue,
    surface: Surface,
    *,
    force_scale: float,
    motion_scale: float,
    tool_radius_m: float = 0.0,
    label: int = 0,
) -> FloatArray:
    """Write the block of a tissue behind a surface, shape (ENVIRONMENT_SIZE,).

    Raises ValueError: a number is not finite, a scale is not positive, or the tissue is not passive.
    """
    numbers = (force_scale, motion_scale)
    if not (np.isfinite(numbers).all() and min(numbers) > 0.0 and 0.0 <= tool_radius_m < np.inf):
        msg = f"scales must be above 0 and the tip's radius finite, got {numbers} and {tool_radius_m}"
        raise ValueError(msg)
    if not tissue.model.is_passive(tissue.theta):
        raise ValueError("the tissue is not passive (F_s or K negative somewhere): it can't be rendered")
    block = free_air_block(label=label)
    block[env.KIND] = env.TISSUE
    block[env.FORCE_SCALE] = force_scale
    block[env.MOTION_SCALE] = motion_scale
    block[env.DEPTH_MM] = tissue.model.depth_mm
    block[env.FASTEST_MM_S] = tissue.speeds_mm_s[1]
    if tissue.rupture is not None:
        block[env.RUPTURE_KIND] = RUPTURE_KINDS[tissue.rupture.criterion]
        block[env.RUPTURE_VALUE] = tissue.rupture.threshold
        block[env.RUPTURE_RESIDUAL] = tissue.rupture.residual
        block[env.RUPTURE_WEIGHT] = tissue.rupture.weight
    block[env.SURFACE : env.SURFACE + srf.SURFACE_SIZE] = surface.numbers(tool_radius_m)
    servo_law(tissue.model, tissue.theta).pack(block, env.LAW)
    return block


def free_air_block(*, label: int = 0) -> FloatArray:
    """Write the block of nothing: no force anywhere, shape (ENVIRONMENT_SIZE,)."""
    block = np.zeros(env.ENVIRONMENT_SIZE)
    block[env.VERSION] = env.BLOCK_VERSION
    block[env.KIND] = env.FREE_AIR
    block[env.LABEL] = label
    return block


#: Tips that differ by less are the same [share].
SAME_TIP = 0.01
#: Loss of stiffness by curvature that is remarked, and that is refused.
REMARKED_LOSS = 0.02
REFUSED_LOSS = 0.25
#: A surface must be this many depths large, or the tool comes out on the other side.
SMALLEST_DEPTHS = 2.0
#: An edge nearer than this many tip radii (or depths, where the tip is not known) is felt.
EDGE_DISTANCE = 3.0

_SPHERE = re.compile(rf"sphere\s+{NUMBER}\s*mm")
_BOX = re.compile(rf"box\s+{NUMBER}\s*x\s*{NUMBER}\s*x\s*{NUMBER}\s*mm")

#: A surface in tissue units: kind, and sizes [mm]: radius, or full widths.
Shape = tuple[str, tuple[float, ...]]


def parse_surface(text: str) -> Shape:
    """Read ``plane``, ``sphere R mm`` or ``box X x Y x Z mm``, in tissue millimetres; else UsageError."""
    line = " ".join(text.split())
    if line == "plane":
        return "plane", ()
    for kind, pattern in (("sphere", _SPHERE), ("box", _BOX)):
        found = pattern.fullmatch(line)
        if found is not None and all(float(size) > 0.0 for size in found.groups()):
            return kind, tuple(float(size) for size in found.groups())
    raise UsageError(f"--surface {printable(text)!r}: write 'plane', 'sphere 60 mm' or 'box 60 x 60 x 40 mm'")


def place_surface(
    shape: Shape, device: Capabilities, *, depth_mm: float, motion_scale: float, tool_radius_m: float
) -> Surface:
    """Put a surface into a device's workspace, so that the identified depth lies around its middle."""
    middle = [0.5 * (low + high) for low, high in device.workspace_m]
    half_m = 0.5 * (device.workspace_m[2][1] - device.workspace_m[2][0])
    touch_m = middle[2] + min(0.5 * depth_mm * MM * motion_scale, half_m)
    top_m = touch_m - tool_radius_m
    kind, sizes = shape
    if kind == "sphere":
        radius_m = sizes[0] * MM * motion_scale
        return Sphere((middle[0], middle[1], top_m - radius_m), radius_m)
    if kind == "box":
        x, y, z = (0.5 * size * MM * motion_scale for size in sizes)
        return Box((middle[0], middle[1], top_m - z), (x, y, z))
    return Plane((middle[0], middle[1], top_m))


def travel_behind(surface: Surface, device: Capabilities, *, tool_radius_m: float) -> float:
    """Room of the device behind the highest point of a surface, along z [m]."""
    numbers = surface.numbers(tool_radius_m)
    return float(numbers[srf.POINT + 2] + _height_m(numbers) + tool_radius_m - device.workspace_m[2][0])


def highest_touch(numbers: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre of the tip on the highest point of a surface [m], and the unit vector into it, of its block."""
    inward = -numbers[srf.NORMAL : srf.SIZE]
    return numbers[srf.POINT : srf.NORMAL] - (_height_m(numbers) + numbers[srf.TOOL_RADIUS]) * inward, inward


def _height_m(numbers: FloatArray) -> float:
    """Distance from the point of a surface's block to its highest one: a radius, a half width, or none."""
    return float(numbers[srf.SIZE + (2 if numbers[0] == srf.BOX else 0)])


def surface_remarks(tissue: Tissue, shape: Shape, tip_radius_mm: float | None) -> list[str]:
    """Remarks on tip and curvature; BundleError for another tip, or a surface too curved or too small."""
    remarks, known = [], tissue.tip_radius_mm
    # a cone that was stated has no radius
    if known is None and tissue.tip is None:
        remarks.append(
            "the bundle does not say with which tip it was identified: what is felt is that tip's force"
        )
    elif known is not None and tip_radius_mm is not None and abs(tip_radius_mm - known) > SAME_TIP * known:
        raise BundleError(
            f"the tissue was identified with a tip of {known:g} mm radius: its law does not hold for "
            f"{tip_radius_mm:g} mm; leave --tip-radius out, or fit recordings made with that tip"
        )
    depth = tissue.model.depth_mm
    kind, sizes = shape
    if kind == "plane":
        return remarks
    if min(sizes) < SMALLEST_DEPTHS * depth:
        raise BundleError(
            f"a {kind} of {min(sizes):g} mm is too small for a tissue identified to {depth:.3g} mm; "
            f"make it at least {SMALLEST_DEPTHS * depth:.3g} mm"
        )
    length = known or tip_radius_mm or depth
    if kind == "sphere":
        loss = 1.0 - math.sqrt(sizes[0] / (sizes[0] + length))
        if loss > REFUSED_LOSS:
            raise BundleError(
                f"on a sphere of {sizes[0]:g} mm the contact would be {100.0 * loss:.0f} % softer (Hertz) "
                "than on the flat specimen it was identified on; choose a larger one"
            )
        if loss > REMARKED_LOSS:
            remarks.append(
                f"identified on a flat specimen: on a sphere of {sizes[0]:g} mm real tissue would be about "
                f"{100.0 * loss:.0f} % softer (Hertz)"
            )
    elif 0.5 * min(sizes[:2]) < EDGE_DISTANCE * length:
        remarks.append("identified far from edges: near the edges of the box real tissue would be softer")
    return remarks
