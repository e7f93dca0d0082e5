"""Surface and tip of a rendering: where they lie at the device, and whether the fitted law is meant for them.

A law was identified with one tip on a flat specimen.  On a curved surface the contact of two spheres has
the effective radius ``1/R = 1/r_tip + 1/R_surface``, so that Hertz's stiffness falls by ``sqrt(R / r_tip)``:
up to 2 % nothing is said, up to 25 % it is remarked, beyond that the surface is refused.  Another tip than
the one identified with is refused: the law knows nothing of it.
"""

from __future__ import annotations

import math
import re

from tissueid.errors import BundleError, UsageError, printable
from tissueid.haptics.device import Capabilities
from tissueid.rendering.tissue_block import Box, Plane, Sphere, Surface, Tissue

MM = 1e-3
#: Tips that differ by less are the same [share].
SAME_TIP = 0.01
#: Loss of stiffness by curvature that is remarked, and that is refused.
REMARKED_LOSS = 0.02
REFUSED_LOSS = 0.25
#: A surface must be this many depths large, or the tool comes out on the other side.
SMALLEST_DEPTHS = 2.0
#: An edge nearer than this many tip radii (or depths, where the tip is not known) is felt.
EDGE_DISTANCE = 3.0

_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_SPHERE = re.compile(rf"sphere\s+{_NUMBER}\s*mm")
_BOX = re.compile(rf"box\s+{_NUMBER}\s*x\s*{_NUMBER}\s*x\s*{_NUMBER}\s*mm")

#: A surface in tissue units: kind, and sizes [mm]: radius, or full widths.
Shape = tuple[str, tuple[float, ...]]


def parse_surface(text: str) -> Shape:
    """Read ``plane``, ``sphere R mm`` or ``box X x Y x Z mm``, in tissue millimetres.

    Raises UsageError: it is none of them, or has no size.
    """
    line = " ".join(text.split())
    if line == "plane":
        return "plane", ()
    for kind, pattern in (("sphere", _SPHERE), ("box", _BOX)):
        found = pattern.fullmatch(line)
        if found is not None and all(float(size) > 0.0 for size in found.groups()):
            return kind, tuple(float(size) for size in found.groups())
    msg = f"--surface {printable(text)!r}: write 'plane', 'sphere 60 mm' or 'box 60 x 60 x 40 mm'"
    raise UsageError(msg)


def place_surface(
    shape: Shape, device: Capabilities, *, depth_mm: float, motion_scale: float, tool_radius_m: float
) -> Surface:
    """Put a surface into a device's workspace, so that the identified depth lies around its middle.

    ``shape``: :func:`parse_surface`; ``depth_mm``: identified depth; ``motion_scale``: s_x;
    ``tool_radius_m``: the tip touches where its centre is this far above the surface.
    """
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
    if isinstance(surface, Plane):
        top_m = surface.point_m[2]
    elif isinstance(surface, Sphere):
        top_m = surface.centre_m[2] + surface.radius_m
    else:
        top_m = surface.centre_m[2] + surface.half_widths_m[2]
    return top_m + tool_radius_m - device.workspace_m[2][0]


def surface_remarks(tissue: Tissue, shape: Shape, tip_radius_mm: float | None) -> list[str]:
    """Remarks on tip and curvature; what the law can't be meant for is refused.

    ``shape``: :func:`parse_surface`; ``tip_radius_mm``: the tip asked for; None for the identified one.
    Raises BundleError: another tip, or a surface too curved or too small for the identified depth.
    """
    remarks = _tip_remarks(tissue, tip_radius_mm)
    depth = tissue.model.depth_mm
    kind, sizes = shape
    if kind == "plane":
        return remarks
    if min(sizes) < SMALLEST_DEPTHS * depth:
        msg = (
            f"a {kind} of {min(sizes):g} mm is too small for a tissue identified to {depth:.3g} mm; "
            f"make it at least {SMALLEST_DEPTHS * depth:.3g} mm"
        )
        raise BundleError(msg)
    length = tissue.tip_radius_mm or tip_radius_mm or depth
    if kind == "sphere":
        loss = 1.0 - math.sqrt(sizes[0] / (sizes[0] + length))
        if loss > REFUSED_LOSS:
            msg = (
                f"on a sphere of {sizes[0]:g} mm the contact would be {100.0 * loss:.0f} % softer (Hertz) "
                "than on the flat specimen it was identified on; choose a larger one"
            )
            raise BundleError(msg)
        if loss > REMARKED_LOSS:
            remarks.append(
                f"identified on a flat specimen: on a sphere of {sizes[0]:g} mm real tissue would be about "
                f"{100.0 * loss:.0f} % softer (Hertz)"
            )
    elif 0.5 * min(sizes[:2]) < EDGE_DISTANCE * length:
        remarks.append("identified far from edges: near the edges of the box real tissue would be softer")
    return remarks


def _tip_remarks(tissue: Tissue, tip_radius_mm: float | None) -> list[str]:
    known = tissue.tip_radius_mm
    if known is None and tissue.tip is not None:
        # of a cone: it has no radius
        return []
    if known is None:
        return ["the bundle does not say with which tip it was identified: what is felt is that tip's force"]
    if tip_radius_mm is not None and abs(tip_radius_mm - known) > SAME_TIP * known:
        msg = (
            f"the tissue was identified with a tip of {known:g} mm radius: its law does not hold for "
            f"{tip_radius_mm:g} mm; leave --tip-radius out, or fit recordings made with that tip"
        )
        raise BundleError(msg)
    return []
