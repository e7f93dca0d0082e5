"""One test up to the rupture, or to the deepest point of a test that did not rupture.

The segmenter names the last sample before the force falls; the tissue broke between it and the next.  Depth,
force and work are taken at the middle of that interval, and its length over sqrt(12) is their uncertainty.
A test without a rupture is censored: whatever breaks the tissue had not been reached at its deepest point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.trial import Segmentation, Trial, contact_frame

#: Samples kept of a path: the branch state is exact for any number, its corners apart.
PATH_SAMPLES = 1500
#: Fewest samples from contact to the end.
FEWEST_SAMPLES = 6
#: The force at the end is read off a line through the samples from this share of the depth on.
LINE_FROM = 0.97
FEWEST_IN_LINE = 3


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTest:
    """Loading of the tissue until it broke or the test ended."""

    #: Of the recording.
    path: str
    sheet: str | None
    ruptured: bool  # false: censored
    #: (n,): from contact (depth 0) to the end, thinned.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    #: At the end; work from contact.
    force_N: float
    work_N_mm: float
    force_sd_N: float  # noise of the force
    step_mm: float  # depth between two samples at the end, 0 where the test is censored
    contact_sd_mm: float
    speed_mm_s: float  # over the second half of the depth
    residual: float | None  # share of the force that was left, where it ruptured

    @property
    def end_mm(self) -> float:
        """Depth at the end."""
        return float(self.depth_mm[-1])


def loaded_test(trial: Trial, segmentation: Segmentation) -> LoadedTest | None:
    """A test up to its first rupture, or to its deepest point.

    Returns ``None`` where there is no contact, or nothing of a loading.
    """
    if segmentation.contact is None:
        return None
    depth, force = contact_frame(trial, segmentation)
    event = next((one for one in segmentation.events if one.kind == "rupture"), None)
    last = int(np.argmax(depth)) if event is None else event.index
    first = _first_in_contact(depth, last, segmentation.contact.index)
    if last - first + 1 < FEWEST_SAMPLES or not depth[last] > 0.0:
        return None
    time, x, f = (values[first : last + 1] for values in (trial.time_s, depth, force))
    middle = min(int(np.searchsorted(x, 0.5 * x[-1])), x.size - 2)
    speed = float((x[-1] - x[middle]) / (time[-1] - time[middle])) if time[-1] > time[middle] else 0.0
    if not speed > 0.0:
        return None
    # from contact to the first sample after it, and from the last before a rupture half-way to the next
    work = float(np.trapezoid(f, x)) + 0.5 * float(f[0] * x[0])
    slope, peak = _end_line(x, f)
    step, residual = 0.0, None
    if event is not None:
        step = speed * float(trial.time_s[last + 1] - trial.time_s[last])
        half = 0.5 * step
        work += half * (peak + 0.5 * half * slope)
        peak += half * slope
        residual = min(max(1.0 - event.values["drop_N"] / event.values["force_before_N"], 0.0), 1.0)
    keep = np.unique(np.linspace(0, x.size - 1, min(x.size, PATH_SAMPLES)).astype(int))
    return LoadedTest(
        path=trial.source.path,
        sheet=trial.source.sheet,
        ruptured=event is not None,
        time_s=np.concatenate([[time[0] - x[0] / speed], time[keep], [time[-1] + 0.5 * step / speed]]),
        depth_mm=np.concatenate([[0.0], x[keep], [x[-1] + 0.5 * step]]),
        force_N=peak,
        work_N_mm=work,
        force_sd_N=segmentation.force_noise_N,
        step_mm=step,
        contact_sd_mm=segmentation.contact.sd_mm,
        speed_mm_s=speed,
        residual=residual,
    )


def _first_in_contact(depth_mm: FloatArray, last: int, start: int) -> int:
    """First sample of the contact that is below the surface."""
    below = np.flatnonzero(depth_mm[start : last + 1] > 0.0)
    return start + int(below[0]) if below.size else last


def _end_line(depth_mm: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Slope [N/mm] and value [N] at the end of a straight line through the last samples."""
    recent = max(int((depth_mm >= LINE_FROM * depth_mm[-1]).sum()), FEWEST_IN_LINE)
    x, f = depth_mm[-recent:] - depth_mm[-1], force_N[-recent:]
    if not np.ptp(x) > 0.0:
        return 0.0, float(f.mean())
    slope, value = np.polyfit(x, f, 1)
    return float(slope), float(value)
