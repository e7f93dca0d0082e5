"""Logs of one program: one loading speed, and depths that contact alone makes differ."""

from __future__ import annotations

from collections.abc import Sequence

#: Speeds that differ by less than this factor are one setting of a machine.
SAME_SPEED = 1.12
#: Depths that differ by less than this factor are of one program: contact is found anew in every log.
SAME_DEPTH = 1.25


def clusters(values: Sequence[float], factor: float) -> list[list[int]]:
    """Places of values that lie within a factor of the least of their kind, in ascending order."""
    order = sorted(range(len(values)), key=lambda i: values[i])
    found: list[list[int]] = []
    for i in order:
        if found and values[i] <= factor * values[found[-1][0]]:
            found[-1].append(i)
        else:
            found.append([i])
    return found


def programs(pushes: Sequence[tuple[float, float]]) -> list[list[int]]:
    """Places of the logs of each program.

    ``pushes``: speed [mm/s] and depth [mm] of every log.
    """
    found = []
    for of_speed in clusters([speed for speed, _ in pushes], SAME_SPEED):
        depths = [pushes[i][1] for i in of_speed]
        found += [[of_speed[k] for k in of_depth] for of_depth in clusters(depths, SAME_DEPTH)]
    return found
