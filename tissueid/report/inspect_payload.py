"""The curves of a recording as it was made, thinned for drawing: extremes, edges and corners are kept.

A recording is thinned as soon as it was segmented, so that a folder of large files needs the memory of one.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.trial import Segmentation, Trial

#: Samples of one recording that are kept for drawing at the most.
MOST_OF_ONE = 8_000
_KEPT_A_BUCKET = 4
#: Samples on each side of a corner or event that are kept as they are.
_AROUND = 6


@dataclass(frozen=True, slots=True)
class DrawnRecording:
    """Drawn part of a recording."""

    #: (m,): as recorded, thinned.
    time_s: FloatArray
    displacement_mm: FloatArray  # (m,)
    force_N: FloatArray  # (m,)
    fixed: NDArray[np.bool_]  # (m,), samples that further thinning must keep
    phases: tuple[tuple[str, int, int], ...]  # kind, first and last drawn sample of each phase
    marks: dict[str, Any]  # contact, corners and events, in the words of the page's script


def kept_samples(
    displacement_mm: FloatArray, force_N: FloatArray, most: int, *, fixed: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Indices that keep the shape: in every stretch the extremes of both channels, the ends, and ``fixed``.

    ``displacement_mm``, ``force_N`` (n,); ``most``: samples to keep, beside the fixed ones; ``fixed``:
    samples that are kept whatever happens.  Returns ascending.
    """
    size = force_N.size
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max(most // _KEPT_A_BUCKET, 1) + 1).astype(int)
    keep = {0, size - 1, *fixed.tolist()}
    for start, stop in pairwise(edges.tolist()):
        for values in (force_N[start:stop], displacement_mm[start:stop]):
            keep.update((start + int(values.argmin()), start + int(values.argmax())))
    return np.array(sorted(keep), dtype=np.intp)


def _around(indices: Iterable[int], size: int) -> NDArray[np.intp]:
    near = np.array([i + k for i in indices for k in range(-_AROUND, _AROUND + 1)], dtype=np.intp)
    return np.unique(near[(near >= 0) & (near < size)])


def drawn_recording(trial: Trial, segmentation: Segmentation) -> DrawnRecording:
    """Thin a recording for drawing."""
    force, x, size = trial.force_N, trial.displacement_mm, trial.time_s.size
    contact = segmentation.contact
    sharp = [corner.index for corner in segmentation.corners]
    sharp += [event.index for event in segmentation.events]
    edges = [0, size - 1, int(np.argmax(force)), int(np.argmin(force))]
    edges += [edge for phase in segmentation.phases for edge in (phase.start, phase.stop - 1)]
    edges += [phase.peak for phase in segmentation.phases if phase.peak is not None]
    if contact is not None:
        edges.append(min(contact.index, size - 1))
    fixed = np.union1d(_around(sharp[: MOST_OF_ONE // 20], size), np.array(edges, dtype=np.intp))
    index = kept_samples(x, force, MOST_OF_ONE, fixed=fixed)
    places = np.searchsorted(index, [(phase.start, phase.stop - 1) for phase in segmentation.phases])
    phases = tuple(
        (phase.kind, int(first), int(last))
        for phase, (first, last) in zip(segmentation.phases, places.reshape(-1, 2), strict=True)
    )
    return DrawnRecording(
        trial.time_s[index],
        x[index],
        force[index],
        np.isin(index, fixed),
        phases,
        _marks(trial, segmentation),
    )


def _marks(trial: Trial, segmentation: Segmentation) -> dict[str, Any]:
    contact = segmentation.contact
    return {
        "sign": segmentation.compression_sign,
        "contact": None
        if contact is None
        else {
            "x": contact.displacement_mm,
            "sd": contact.sd_mm,
            "base": contact.baseline_N if contact.in_record else None,
            "t": _contact_times(trial, segmentation),
        },
        "corners": [
            {"t": corner.time_s, "x": float(trial.displacement_mm[corner.index]), "s": corner.duration_s}
            for corner in segmentation.corners
        ],
        "events": [
            {
                "kind": event.kind.replace("_", " "),
                "t": event.time_s,
                "x": float(trial.displacement_mm[event.index]),
                "f": float(trial.force_N[event.index]),
            }
            for event in segmentation.events
        ],
    }


def _contact_times(trial: Trial, segmentation: Segmentation) -> list[float] | None:
    """Times at which the tool passed contact, contact - sd and contact + sd; ``None`` outside the record."""
    contact = segmentation.contact
    if contact is None or not contact.in_record:
        return None
    moving = [phase for phase in segmentation.phases if phase.start <= contact.index < phase.stop]
    if not moving:
        return None
    # from the approach before to the end of the ramp: the sd may reach into either
    first = max(0, min(phase.start for phase in moving) - 1)
    before = [
        phase for phase in segmentation.phases if phase.kind == "approach" and phase.stop - 1 == first + 1
    ]
    span = slice(before[0].start if before else first, max(phase.stop for phase in moving))
    depth = segmentation.compression_sign * (trial.displacement_mm[span] - contact.displacement_mm)
    deepest = np.maximum.accumulate(depth)
    reached = [int(np.searchsorted(deepest, level)) for level in (0.0, -contact.sd_mm, contact.sd_mm)]
    times = trial.time_s[span]
    return [float(times[min(i, times.size - 1)]) for i in reached]


def _base64(values: NDArray[Any], kind: str = "<f4") -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def packed_recording(drawn: DrawnRecording, most: int) -> dict[str, Any]:
    """A recording as the page carries it, thinned once more where it has to share.

    ``most``: samples beside the fixed ones.  Returns base64 ``t, x, f`` (float32; ``t`` from ``t0`` seconds),
    ``phases`` and the marks.
    """
    index = kept_samples(drawn.displacement_mm, drawn.force_N, most, fixed=np.flatnonzero(drawn.fixed))
    start = float(drawn.time_s[0])
    phases = [
        [kind, int(np.searchsorted(index, first)), int(np.searchsorted(index, last))]
        for kind, first, last in drawn.phases
    ]
    return {
        "t0": start,
        "t": _base64(drawn.time_s[index] - start),
        "x": _base64(drawn.displacement_mm[index]),
        "f": _base64(drawn.force_N[index]),
        "phases": phases,
        **drawn.marks,
    }
