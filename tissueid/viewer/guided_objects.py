"""Drawn parts of a guided axis: the axis, the funnel, the bone; from the block in a session's log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissueid.rendering import guidance as gd
from tissueid.rendering.environment import GUIDED
from tissueid.rendering.funnel import CONE, PRINTED_ONE_M

#: Height above the entry point up to which axis and funnel are drawn [m].
DRAWN_M = 0.04
#: Points of the funnel's profile.
POINTS = 40


def guided_objects(block: Sequence[float]) -> list[dict[str, Any]]:
    """Objects of a scene, in metres of the device's frame.

    ``block``: of the log's head: an environment that is a guided axis.  Returns ``axis`` (from the end of the
    drilling outward), ``funnel`` (points (r, z) of its profile about the axis) and, where there is one,
    ``bone``.
    """
    numbers = np.asarray(block, dtype=np.float64)[GUIDED : GUIDED + gd.GUIDANCE_SIZE]
    entry, axis = numbers[gd.ORIGIN : gd.ORIGIN + 3], numbers[gd.AXIS : gd.AXIS + 3]
    drilled_m = float(numbers[gd.DRILL_END])
    place = {"entry_m": entry.tolist(), "axis": axis.tolist()}
    objects: list[dict[str, Any]] = [
        {"kind": "axis", **place, "from_m": -drilled_m, "to_m": DRAWN_M},
        {"kind": "funnel", **place, "profile_m": _profile(numbers[gd.FUNNEL : gd.CONTACT])},
    ]
    radius_m = float(numbers[gd.RADIUS])
    if radius_m > 0.0:
        hole_m = float(numbers[gd.HOLE])
        objects.append(
            {"kind": "bone", **place, "radius_m": radius_m, "hole_radius_m": hole_m, "drill_m": drilled_m}
        )
    return objects


def _profile(funnel: np.ndarray) -> list[list[float]]:
    """Points (r, z) of the surface, from its lowest place that is felt."""
    kind, a, b, c = funnel
    if int(kind) == CONE:
        z = np.linspace(-PRINTED_ONE_M - b, DRAWN_M, POINTS)
        radius = a * (z + PRINTED_ONE_M + b) / c
    else:
        z = np.linspace(-b, DRAWN_M, POINTS)
        radius = a * np.sqrt(1.0 + ((z + b) / c) ** 2)
    return [[float(one), float(height)] for one, height in zip(radius, z, strict=True)]
