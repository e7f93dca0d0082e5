"""Surfaces that a spherical tool tip touches: how deep, and which way is out (compiled).

The tip penetrates by its radius less its centre's distance from the surface: edges of a box are felt rounded.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel, tick_part

#: The normal is that of a plane; the size is the radius of a sphere, or the half widths of a box.
PLANE, SPHERE, BOX = range(3)
#: Numbers that describe a surface: kind, point[3], normal[3], size[3], radius of the tip.
SURFACE_SIZE = 11
KIND, POINT, NORMAL, SIZE, TOOL_RADIUS = 0, 1, 4, 7, 10
#: Numbers that a touch remembers: the face of a box it came in by, and the normal it wrote.
TOUCH_SIZE = 4
FACE, OUTWARD = 0, 1

#: Distance from a centre below which the direction out of it has no digits [m].
AT_CENTRE_M = 1e-9
#: Faces of a box are 1 to 6: toward +x, -x, +y, -y, +z, -z.
NO_FACE = 0.0


@tick_part
def touch(surface: FloatArray, at: int, position: FloatArray, memory: FloatArray, first: int) -> float:
    """Depth [m] of the tool tip in a surface, negative in air; the face and the normal out go to ``memory``.

    The tip stays with the face of a box by which it came in as long as its centre is inside, or a push
    through the middle would turn the force around.
    """
    kind = int(surface[at + KIND])
    if kind == SPHERE:
        distance = _from_sphere(surface, at, position, memory, first)
    elif kind == BOX:
        distance = _from_box(surface, at, position, memory, first)
    else:
        distance = 0.0
        for i in range(3):
            out = surface[at + NORMAL + i]
            memory[first + OUTWARD + i] = out
            distance += (position[i] - surface[at + POINT + i]) * out
    return float(surface[at + TOOL_RADIUS] - distance)


@tick_kernel
def _from_sphere(surface: FloatArray, at: int, position: FloatArray, memory: FloatArray, first: int) -> float:
    """Distance of a point from a sphere [m], negative inside; direction out of it."""
    square = 0.0
    for i in range(3):
        out = position[i] - surface[at + POINT + i]
        memory[first + OUTWARD + i] = out
        square += out * out
    distance = math.sqrt(square)
    for i in range(3):
        # at the very centre every direction leads out: take the surface's own
        if distance > AT_CENTRE_M:
            memory[first + OUTWARD + i] /= distance
        else:
            memory[first + OUTWARD + i] = surface[at + NORMAL + i]
    return float(distance - surface[at + SIZE])


@tick_kernel
def _from_box(surface: FloatArray, at: int, position: FloatArray, memory: FloatArray, first: int) -> float:
    """Distance of a point from a box [m], negative inside; direction out of the face that counts."""
    outside = 0.0
    nearest = -np.inf
    nearest_face = NO_FACE
    for i in range(3):
        offset = position[i] - surface[at + POINT + i]
        beyond = abs(offset) - surface[at + SIZE + i]
        out = 0.0
        if beyond > 0.0:
            outside += beyond * beyond
            out = math.copysign(beyond, offset)
        memory[first + OUTWARD + i] = out
        if beyond > nearest:
            nearest = beyond
            nearest_face = 2.0 * i + (1.0 if offset >= 0.0 else 2.0)
    if outside > 0.0:
        distance = math.sqrt(outside)
        for i in range(3):
            memory[first + OUTWARD + i] /= distance
        memory[first + FACE] = nearest_face
        return distance
    if memory[first + FACE] == NO_FACE:
        memory[first + FACE] = nearest_face
    face = int(memory[first + FACE]) - 1
    axis = face // 2
    sign = 1.0 if face % 2 == 0 else -1.0
    memory[first + OUTWARD + axis] = sign
    return float(sign * (position[axis] - surface[at + POINT + axis]) - surface[at + SIZE + axis])
