"""Evidence of a channel's levels: lost decimals, quantised force, coarse resolution, clipping.

A level is a value that occurs.  Where a channel is printed finer than it was measured, its values repeat
all over the recording; a smooth channel repeats its value where the machine stands still, and nowhere else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.flags import Flag

_FEW_LEVELS = 64
_SAMPLES_PER_LEVEL = 10
_REPEATED_SHARE = 0.8
_CLIPPED_RUN = 5
#: A clipped stretch is so many times longer than any other standstill of a force at work.
_CLIPPED_LONGER = 4
#: Share of the peak above which a force is at work.
_AT_WORK = 0.5
#: Rows from which whole numbers alone are worth a remark.
_WHOLE_FROM = 20
#: Steps over the test below which the resolution is said: a channel must be read to 1 % of its value to be
#: calibrated at all (ISO 7500-1 and ISO 9513, class 2, resolution at the lower limit of a range).
FEWEST_STEPS = 100
#: Rows from which the resolution of a channel can be told.
_RESOLUTION_FROM = 50
#: Places where a value repeats, as a share of all changes, from which repeating is the channel's nature.
_REPEATS_EVERYWHERE = 0.15
#: Second differences of white noise change their sign in 73 % of all places, those of a smooth curve hardly.
_NOISY_SHARE = 0.25
#: A noisy channel repeats its value in less than this share of all places.
_NOISY_REPEATS = 0.5
#: Differences between levels are whole steps within this share of a step (rounding of decimals).
_GRID_TOLERANCE = 0.01


def no_decimals(*channels: FloatArray) -> Flag | None:
    """Whole numbers in every row of every channel."""
    if channels[0].size < _WHOLE_FROM or any((values[:_WHOLE_FROM] % 1.0).any() for values in channels):
        return None
    if any((values % 1.0).any() for values in channels):
        return None
    return Flag(
        "no_decimals",
        f"time, displacement and force are whole numbers in all {channels[0].size} rows",
        {"count": int(channels[0].size)},
    )


def force_levels(displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """``quantised_force`` or ``clipped_force``, where one of them holds."""
    repeats: NDArray[np.bool_] = np.diff(force_N) == 0.0
    share = float(np.mean(repeats))
    levels = np.unique(force_N) if share >= _REPEATED_SHARE else np.empty(0)
    if not 1 < levels.size <= _FEW_LEVELS or force_N.size < _SAMPLES_PER_LEVEL * levels.size:
        return _clipped(displacement_mm, force_N, repeats)
    step = float(np.diff(levels).min())
    return Flag(
        "quantised_force",
        f"the force has {levels.size} levels, {step:.3g} N apart; {share:.0%} of samples repeat the last",
        {"levels": int(levels.size), "repeated_fraction": share, "step_N": step},
    )


def is_noisy(values: FloatArray) -> bool:
    """True where a channel varies from sample to sample as a measured one does, and a computed one does not.

    ``values`` (n,).
    """
    if values.size < _CLIPPED_RUN or float(np.mean(np.diff(values) == 0.0)) >= _NOISY_REPEATS:
        return False
    bend = np.diff(values, n=2)
    rounding = 1e-9 * float(np.ptp(values))
    turns = (bend[:-1] * bend[1:] < 0.0) & (np.abs(bend[1:]) > rounding)
    return float(np.mean(turns)) >= _NOISY_SHARE


def _runs(repeats: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples and lengths of the stretches in which a value stands."""
    starts = np.concatenate(([0], np.flatnonzero(~repeats) + 1))
    return starts, np.diff(np.concatenate((starts, [repeats.size + 1])))


def _clipped(displacement_mm: FloatArray, force_N: FloatArray, repeats: NDArray[np.bool_]) -> Flag | None:
    """The force stands at its largest value to the last digit, far longer than it stands anywhere else."""
    peak = float(max(force_N.max(), -force_N.min()))
    if peak == 0.0 or not repeats.any():
        return None
    starts, lengths = _runs(repeats)
    level = force_N[starts]
    # the zero of a load cell is set by hand: its two limits need not be equally far
    limits = [end for end in (float(force_N.max()), float(force_N.min())) if abs(end) >= _AT_WORK * peak]
    at_limit = np.isin(level, limits)
    usual = int(lengths[(np.abs(level) >= _AT_WORK * peak) & ~at_limit].max(initial=1))
    long = at_limit & (lengths >= max(_CLIPPED_RUN, _CLIPPED_LONGER * usual))
    if not long.any():
        return None
    first = int(np.argmax(np.where(long, lengths, 0)))
    start, count = int(starts[first]), int(lengths[first])
    total = int(lengths[level == level[first]].sum())
    moves = int(np.count_nonzero(np.diff(displacement_mm[start : start + count]))) >= _CLIPPED_RUN - 1
    # a computed force stands still in a hold; a measured one does not
    if not moves and not is_noisy(np.concatenate((force_N[:start], force_N[start + count :]))):
        return None
    while_moving = " while the tool moves" if moves else ""
    return Flag(
        "clipped_force",
        f"the force stands at {force_N[start]:g} N for {count} samples{while_moving}, elsewhere for {usual}",
        {"force_N": float(force_N[start]), "samples": count, "samples_in_all": total, "usual_samples": usual},
    )


def below_resolution(displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """A channel that goes through few of its own steps in the whole test."""
    found = []
    values: dict[str, float] = {}
    for name, key, unit, channel in (
        ("displacement", "displacement_mm", "mm", displacement_mm),
        ("force", "force_N", "N", force_N),
    ):
        step = resolution_step(channel)
        if step is None:
            continue
        steps = round(float(np.ptp(channel)) / step)
        found.append(f"{name} has {steps} steps of {step:.3g} {unit}")
        values |= {f"{name}_steps": float(steps), f"step_{key}": step}
    if not found:
        return None
    message = f"{', '.join(found)}; {FEWEST_STEPS} are needed"
    return Flag("below_resolution", message, values)


def resolution_step(values: FloatArray) -> float | None:
    """Step of a channel that has fewer than :data:`FEWEST_STEPS` of them; ``None`` for a finer channel.

    ``values`` (n,).
    """
    if (
        values.size < _RESOLUTION_FROM
        or np.unique(values[:: max(1, values.size // 2000)]).size > FEWEST_STEPS
    ):
        return None
    levels = np.unique(values)
    if not 2 < levels.size <= FEWEST_STEPS or values.size < 2 * levels.size:
        return None
    apart = np.diff(levels)
    step = float(apart.min())
    whole = apart / step
    if (
        levels[-1] - levels[0] >= FEWEST_STEPS * step
        or (np.abs(whole - np.rint(whole)) > _GRID_TOLERANCE).any()
    ):
        return None
    _, lengths = _runs(np.diff(values) == 0.0)
    # a ramp without noise goes through equally spaced values too, but never stands at them
    return step if float(np.mean(lengths > 1)) >= _REPEATS_EVERYWHERE else None
