"""Mean and spread of what was measured, over the logs of a specimen, program by program.

Numbers are pooled within one program only (:mod:`tissueid.measured.spread`), and forces that still know
the ramp only where ramp times differ by no more than a factor of two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tissueid.documents.measured import Measured, MeasuredForce, MeasuredHold, MeasuredPush, Spread
from tissueid.measured.measuring import REFERENCE_S, TIMES_S
from tissueid.quantities import RAMP_TIMES, beyond_ramp, predicted_mean

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


#: Ramp times within this factor belong to one program.
SAME_PROGRAM = 2.0


def ramp_reason(time_s: float | None, ramp_times_s: Sequence[float], *, peak: bool = False) -> str:
    """Why numbers of several ramps may not be pooled or compared; empty where they may.

    ``time_s``: after the stop; ``None`` for a number of the ramp itself, such as the peak; ``peak``: whether
    the number is put over the peak, which any ramp changes.
    """
    if not ramp_times_s:
        return ""
    short, long = min(ramp_times_s), max(ramp_times_s)
    if long <= SAME_PROGRAM * short:
        return ""
    between = f"ramps of {short:.3g} to {long:.3g} s"
    if time_s is None or peak:
        return f"depends on the ramp, and there are {between}"
    if not beyond_ramp(time_s, long):
        return f"depends on the ramp before {RAMP_TIMES * long:.3g} s, and there are {between}"
    return ""


def _push_numbers() -> Iterator[tuple[str, str, Callable[[MeasuredPush], float | None]]]:
    yield "peak", "N", lambda push: push.peak.force_N
    yield "depth", "mm", lambda push: push.depth_mm
    yield "travel", "mm", lambda push: push.travel_mm
    yield "speed", "mm/s", lambda push: push.speed_mm_s
    yield "ramp_time", "s", lambda push: push.ramp_time_s
    yield "modulus_loading", "kPa", lambda push: None if push.modulus is None else push.modulus.loading_kPa
    yield "modulus_held", "kPa", lambda push: None if push.modulus is None else push.modulus.held_kPa


def _hold_numbers() -> Iterator[tuple[str, str, float, Callable[[MeasuredForce], float | None]]]:
    for time in TIMES_S:
        yield "force", "N", time, lambda one: one.after_stop_N
    for time in TIMES_S:
        if time != REFERENCE_S:
            yield "force_over_10s", "1", time, lambda one: one.over_10s
    for time in TIMES_S:
        yield "force_over_peak", "1", time, lambda one: one.over_peak


def spread(logs: Sequence[Measured]) -> tuple[Spread, ...]:
    """Mean and standard deviation between the logs of each program of every measured number.

    ``logs``: of one specimen.  Returns program after program; in each the first hold of each log, then the
    second, and so on; logs without a hold give their push.
    """
    rows: list[Spread] = []
    for program, members in enumerate(_programs(logs), 1):
        pushes = [log.push for log in members if log.push is not None and not log.holds]
        rows += _of_pushes((program, 0), pushes)
        for number in range(max((len(log.holds) for log in members), default=0)):
            holds = [log.holds[number] for log in members if len(log.holds) > number]
            held = [hold.push for hold in holds if hold.push is not None]
            place = (program, number + 1)
            rows += _of_pushes(place, held)
            rows += _of_holds(place, holds, [push.ramp_time_s for push in held])
        for number in range(max((len(log.loops) for log in members), default=0)):
            loops = [log.loops[number].area_mJ for log in members if len(log.loops) > number]
            rows.append(_row("loop_area", "mJ", (program, number + 1), None, loops, ()))
    return tuple(row for row in rows if row.count)


def _programs(logs: Sequence[Measured]) -> list[list[Measured]]:
    """Logs of each program: those with holds first, the deepest of them first; logs without a push last."""
    pushed = [(log, log.push) for log in logs if log.push is not None]
    found = [
        [pushed[i] for i in members]
        for members in programs([(push.speed_mm_s, _depth(push)) for _, push in pushed])
    ]
    found.sort(key=lambda own: (any(log.holds for log, _ in own), _depth(own[0][1])), reverse=True)
    rest = [log for log in logs if log.push is None]
    return [[log for log, _ in own] for own in found] + ([rest] if rest else [])


def _depth(push: MeasuredPush) -> float:
    return push.travel_mm if push.depth_mm is None else push.depth_mm


def _of_pushes(place: tuple[int, int], pushes: Sequence[MeasuredPush]) -> Iterator[Spread]:
    times = [push.ramp_time_s for push in pushes]
    for name, unit, value in _push_numbers():
        reason = ramp_reason(None, times) if unit in ("N", "kPa") else ""
        yield _row(name, unit, place, None, [value(push) for push in pushes], times, reason)


def _of_holds(
    place: tuple[int, int], holds: Sequence[MeasuredHold], times: Sequence[float]
) -> Iterator[Spread]:
    for name, unit, time, value in _hold_numbers():
        found = [hold.at(time) for hold in holds]
        reason = ramp_reason(time, times, peak=name == "force_over_peak")
        yield _row(
            name, unit, place, time, [None if one is None else value(one) for one in found], times, reason
        )
    singles = [None if hold.tau is None else hold.tau.single_s for hold in holds]
    yield _row("relaxation_time", "s", place, None, singles, times, ramp_reason(None, times))


def _row(
    name: str,
    unit: str,
    place: tuple[int, int],
    time_s: float | None,
    values: Sequence[float | None],
    ramp_times_s: Sequence[float],
    reason: str = "",
) -> Spread:
    known = [value for value in values if value is not None]
    pooled = bool(known) and not reason
    mean = float(np.mean(known)) if pooled else None
    sd = float(np.std(known, ddof=1)) if pooled and len(known) > 1 else None
    return Spread(
        name=name,
        unit=unit,
        program=place[0],
        hold=place[1],
        time_s=time_s,
        ramp_time_s=(min(ramp_times_s), max(ramp_times_s)) if ramp_times_s else None,
        count=len(known),
        mean=mean,
        sd=sd,
        reason=reason or None,
        prediction95=predicted_mean(mean, sd, len(known)),
    )
