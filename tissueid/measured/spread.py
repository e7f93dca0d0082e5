"""Mean and spread of what was measured, program by program, and two sides beside each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from tissueid.documents import plain
from tissueid.documents.contrast import MeasuredNumber, Side
from tissueid.documents.measured import Measured, MeasuredHold, MeasuredPush, Spread
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


class Pushed(NamedTuple):
    """Speed and depth of a push, and the force and time at which it ended where they are known."""

    speed_mm_s: float
    depth_mm: float
    peak_N: float = float("nan")
    ramp_time_s: float = float("nan")


def programs(pushes: Sequence[Pushed]) -> list[list[int]]:
    """Places of the logs of each program: pushed to one load at whatever depth, else by speed and depth."""
    to_load = _to_one_load(pushes)
    found = [*to_load]
    left = sorted(set(range(len(pushes))).difference(*to_load))
    for of_speed in clusters([pushes[i].speed_mm_s for i in left], SAME_SPEED):
        own = [left[k] for k in of_speed]
        of_depth = clusters([pushes[i].depth_mm for i in own], SAME_DEPTH)
        found += [[own[k] for k in members] for members in of_depth]
    return found


def _to_one_load(pushes: Sequence[Pushed]) -> list[list[int]]:
    """Places of logs that stopped at one force though their depths differ, ramps of about one length."""
    known = [i for i, push in enumerate(pushes) if push.peak_N > 0.0 and push.ramp_time_s > 0.0]
    found = []
    for of_peak in clusters([pushes[i].peak_N for i in known], SAME_LOAD):
        own = [known[k] for k in of_peak]
        for of_ramp in clusters([pushes[i].ramp_time_s for i in own], SAME_PROGRAM):
            members = [own[k] for k in of_ramp]
            depths = [pushes[i].depth_mm for i in members]
            if len(members) >= FEWEST_TO_LOAD and max(depths) > SAME_DEPTH * min(depths):
                found.append(members)
    return found


#: Ramp times within this factor belong to one program.
SAME_PROGRAM = 2.0
#: Peaks within this factor are one load that ended a push, and logs from which so much is no accident.
SAME_LOAD, FEWEST_TO_LOAD = 1.05, 3


def ramp_reason(time_s: float | None, ramp_times_s: Sequence[float], *, peak: bool = False) -> str:
    """Why numbers of several ramps may not be pooled or compared; empty where they may."""
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


#: Numbers that differ by less of their mean do so by how they were computed.
ROUNDING = 1e-12
#: Numbers of a push, each with its unit.
_PUSH_NUMBERS: tuple[tuple[str, str, Callable[[MeasuredPush], float | None]], ...] = (
    ("peak", "N", lambda push: push.peak.force_N),
    ("depth", "mm", lambda push: push.depth_mm),
    ("travel", "mm", lambda push: push.travel_mm),
    ("speed", "mm/s", lambda push: push.speed_mm_s),
    ("ramp_time", "s", lambda push: push.ramp_time_s),
    ("modulus_loading", "kPa", lambda push: None if push.modulus is None else push.modulus.loading_kPa),
    ("modulus_held", "kPa", lambda push: None if push.modulus is None else push.modulus.held_kPa),
)
#: Numbers of a hold at each of its times, with unit and attribute.
_HOLD_NUMBERS = (
    ("force", "N", "after_stop_N"),
    ("force_over_10s", "1", "over_10s"),
    ("force_over_peak", "1", "over_peak"),
)


def spread(measured: Sequence[Measured]) -> tuple[Spread, ...]:
    """Mean and standard deviation between the logs of each program of every number before a rupture."""
    whole = [tuple(hold for hold in log.holds if not hold.after_rupture) for log in measured]
    logs = [structs.replace(log, holds=holds) for log, holds in zip(measured, whole, strict=True)]
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
    told = [Pushed(one.speed_mm_s, _depth(one), one.peak.force_N, one.ramp_time_s) for _, one in pushed]
    found = [[pushed[i] for i in members] for members in programs(told)]
    found.sort(key=lambda own: (any(log.holds for log, _ in own), _depth(own[0][1])), reverse=True)
    rest = [log for log in logs if log.push is None]
    return [[log for log, _ in own] for own in found] + ([rest] if rest else [])


def _depth(push: MeasuredPush) -> float:
    return push.travel_mm if push.depth_mm is None else push.depth_mm


def _of_pushes(place: tuple[int, int], pushes: Sequence[MeasuredPush]) -> Iterator[Spread]:
    times = [push.ramp_time_s for push in pushes]
    for name, unit, value in _PUSH_NUMBERS:
        reason = ramp_reason(None, times) if unit in ("N", "kPa") else ""
        yield _row(name, unit, place, None, [value(push) for push in pushes], times, reason)
    known = [{one.depth_mm: one.force_N for one in push.forces} for push in pushes]
    for depth in sorted(set[float]().union(*known)):
        values = [of_push.get(depth) for of_push in known]
        row = _row("force_at_depth", "N", place, None, values, times, ramp_reason(None, times))
        # a depth that some logs did not reach, or none may be pooled at, is no number of the program
        if row.mean is not None and None not in values:
            yield structs.replace(row, depth_mm=depth)


def _of_holds(
    place: tuple[int, int], holds: Sequence[MeasuredHold], times: Sequence[float]
) -> Iterator[Spread]:
    for (name, unit, attribute), time in product(_HOLD_NUMBERS, TIMES_S):
        if name == "force_over_10s" and time == REFERENCE_S:
            continue
        values = [getattr(hold.at(time), attribute, None) for hold in holds]
        reason = ramp_reason(time, times, peak=name == "force_over_peak")
        yield _row(name, unit, place, time, values, times, reason)
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
    if sd and mean and sd < ROUNDING * abs(mean):
        sd = 0.0
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


#: Numbers that say what was done to the tissue, whatever it answered.
_OF_THE_PROGRAM = ("depth", "travel", "speed", "ramp_time")
#: Depths within this share are equal.
EQUAL_DEPTH = 0.1


def measured_pairs(sides: Sequence[tuple[str, Sequence[Spread]]]) -> list[dict[str, Any]]:
    """All pairs of sides, each with every number that both have."""
    return [
        {"one": one[0], "other": other[0], "numbers": plain(_numbers(one[1], other[1]))}
        for one, other in combinations(sides, 2)
    ]


def _key(row: Spread) -> tuple[str, int, float | None]:
    return row.name, row.hold, row.at


def _numbers(one: Sequence[Spread], other: Sequence[Spread]) -> list[MeasuredNumber]:
    rows: list[MeasuredNumber] = []
    for own, its in _matched(_by_program(one), _by_program(other)):
        found = {_key(row): row for row in its}
        depths = [{row.hold: row.mean for row in every if row.name == "depth"} for every in (own, its)]
        rows += [_number(row, found[_key(row)], depths) for row in own if _key(row) in found]
    return rows


def _by_program(rows: Sequence[Spread]) -> list[list[Spread]]:
    numbers = dict.fromkeys(row.program for row in rows)
    return [[row for row in rows if row.program == number] for number in numbers]


def _matched(
    one: Sequence[list[Spread]], other: Sequence[list[Spread]]
) -> Iterator[tuple[list[Spread], list[Spread]]]:
    """Programs of both sides that ran alike; where each side has one, these, whatever they are."""
    if len(one) == len(other) == 1:
        yield one[0], other[0]
        return
    for own, its in product(one, other):
        pushes = [_push(own), _push(its)]
        if None not in pushes and len(programs([push for push in pushes if push is not None])) == 1:
            yield own, its


def _push(rows: Sequence[Spread]) -> Pushed | None:
    """Mean speed and depth of a program."""
    means = {row.name: row.mean for row in rows if row.hold <= 1 and row.mean is not None}
    depth = means.get("depth", means.get("travel"))
    return None if depth is None or "speed" not in means else Pushed(means["speed"], depth)


def _number(one: Spread, other: Spread, depths: Sequence[Mapping[int, float | None]]) -> MeasuredNumber:
    reason = one.reason or other.reason or _reason(one, other, depths)
    ratio = None
    if not reason and one.mean and other.mean is not None:
        ratio = other.mean / one.mean
    return MeasuredNumber(
        name=one.name,
        unit=one.unit,
        program=one.program,
        hold=one.hold,
        time_s=one.time_s,
        depth_mm=one.depth_mm,
        one=Side(one.mean, one.sd, one.count, one.ramp_time_s),
        other=Side(other.mean, other.sd, other.count, other.ramp_time_s),
        ratio=ratio,
        reason=reason or None,
    )


def _reason(one: Spread, other: Spread, depths: Sequence[Mapping[int, float | None]]) -> str:
    """Why two numbers are not compared; empty where they are."""
    if one.name in _OF_THE_PROGRAM or one.name == "loop_area":
        return ""
    times = [*(one.ramp_time_s or ()), *(other.ramp_time_s or ())]
    reason = ramp_reason(one.time_s, times, peak=one.name == "force_over_peak")
    if reason:
        return reason
    deep = [found.get(one.hold) for found in depths]
    whole = one.unit == "N" and one.depth_mm is None
    if whole and deep[0] and deep[1] and abs(deep[1] - deep[0]) > EQUAL_DEPTH * abs(deep[0]):
        return f"forces at {deep[0]:.3g} and {deep[1]:.3g} mm of depth"
    return ""
