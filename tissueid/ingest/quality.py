"""Quality of a recording's numbers at first sight; nothing is removed.

Only what is cheap and certain is said, each with its numbers: time stamps (:mod:`.timestamps`), levels
(:mod:`.levels`), single samples (:mod:`.spikes`), the origin of the displacement (:mod:`.commanded`), the
load cell (:mod:`.cell_range`).
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import jump
from tissueid.ingest.cell_range import below_cell_range
from tissueid.ingest.commanded import commanded_displacement
from tissueid.ingest.levels import below_resolution, force_levels, no_decimals
from tissueid.ingest.spikes import spike
from tissueid.ingest.timestamps import event_rows, gap, zero_dt


def quality_flags(
    time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray, *, capacity_N: float | None = None
) -> tuple[Flag, ...]:
    """Flags of the samples, in the order in which they are best read.

    ``zero_dt``, ``event_rows``, ``gap``, ``quantised_force``, ``clipped_force``, ``below_resolution``,
    ``jump``, ``spike``, ``no_decimals``, ``commanded_displacement``, ``below_cell_range``.

    ``time_s``, ``displacement_mm``, ``force_N`` (n,): as recorded; ``capacity_N``: capacity of the load cell,
    where it is known [N].
    """
    dt = np.diff(time_s)
    found = (
        zero_dt(time_s, dt),
        event_rows(time_s, dt),
        gap(time_s, dt, force_N),
        jump(time_s, displacement_mm),
        force_levels(displacement_mm, force_N),
        below_resolution(displacement_mm, force_N),
        spike(time_s, displacement_mm, force_N),
        no_decimals(time_s, displacement_mm, force_N),
        commanded_displacement(time_s, displacement_mm, force_N),
        below_cell_range(force_N, capacity_N),
    )
    return tuple(flag for flag in found if flag is not None)
