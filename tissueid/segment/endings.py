"""Load-unload loops, and ends of a test before or beside its plan: aborts, stops at a load, load control."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.flags import Flag
from tissueid.segment.motion import Path, Piece, corner_near, corners, slope_of
from tissueid.signal_noise import running_median
from tissueid.trial import Event, Phase, Protocol

#: Change from loop to loop below which tissue is preconditioned.
PRECONDITIONED_CHANGE = 0.02
#: Ratio from which speeds of loops are several: they differ as they should.
SEVERAL_SPEEDS = 1.5
#: Loops at the end whose changes count.
LAST_LOOPS = 3
#: Share of a loop's travel below its peak over which force is averaged by a straight line.
PEAK_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Loop:
    """One loop."""

    #: Depth and force at its turn, as recorded but for sign.
    peak_mm: float
    peak_N: float
    work_N_mm: float  # work lost in the loop, over the depths that all loops cover
    speed_mm_s: float  # mean


def loops_of(path: Path, phases: tuple[Phase, ...]) -> tuple[Loop, ...]:
    """Peaks and work of the loops among the phases."""
    cycles = [phase for phase in phases if phase.kind == "cycle" and phase.peak is not None]
    if not cycles:
        return ()
    paths = [path.depth_mm[phase.start : phase.stop] for phase in cycles]
    bottom = max(max(float(path[0]), float(path[-1])) for path in paths)
    peaks = np.array([float(path.max()) for path in paths])
    steps = [float(np.abs(np.diff(path)).max(initial=0.0)) for path in paths]
    # peaks that differ by less than what moves between two samples are one peak, sampled differently
    common = float(peaks.min()) if np.ptp(peaks) <= max(steps) else None
    return tuple(
        Loop(
            float(peak),
            _force_at(path, phase, float(peak) if common is None else common),
            _work(path, phase, bottom),
            phase.speed_mm_s,
        )
        for phase, peak in zip(cycles, peaks, strict=True)
    )


def _force_at(path: Path, phase: Phase, level_mm: float) -> float:
    """Force of the loading branch at a depth near its peak, from a straight line through its end."""
    assert phase.peak is not None  # noqa: S101  (the caller has looked)
    x, f = path.depth_mm[phase.start : phase.peak + 1], path.force_N[phase.start : phase.peak + 1]
    near = np.flatnonzero(x >= level_mm - PEAK_SHARE * float(np.ptp(x)))
    if near.size < 3:
        near = np.arange(max(x.size - 3, 0), x.size)
    slope, _ = slope_of(x[near], f[near])
    return float(f[near].mean() + slope * (level_mm - x[near].mean()))


def _work(path: Path, phase: Phase, bottom_mm: float) -> float:
    """Area of the loop above a depth [N mm]."""
    x = np.maximum(path.depth_mm[phase.start : phase.stop], bottom_mm)
    return float(np.trapezoid(path.force_N[phase.start : phase.stop], x))


def cycle_flags(loops: tuple[Loop, ...], *, before_test: bool, baseline_N: float) -> list[Flag]:
    """Their number, and the verdict on preconditioning."""
    if not loops:
        return []
    count = len(loops)
    flags = [Flag("cyclic", f"{count} load-unload loops", {"loops": count})]
    last = loops[-LAST_LOOPS:]
    speeds = [loop.speed_mm_s for loop in last]
    if len(last) < 2 or max(speeds) > SEVERAL_SPEEDS * min(speeds):
        return flags
    force = _change([loop.peak_N - baseline_N for loop in last])
    work = _change([loop.work_N_mm for loop in last])
    depth = float(np.ptp([loop.peak_mm for loop in last]))
    still = max(force, work) < PRECONDITIONED_CHANGE
    message = (
        f"peak force changes by {100 * force:.2g} %, work by {100 * work:.2g} % a loop over the last "
        f"{len(last)} of {count}"
    )
    values = {
        "loops": count,
        "peak_force_change": force,
        "work_change": work,
        "peak_depth_range_mm": depth,
        "before_test": before_test,
    }
    return [*flags, Flag("preconditioned" if still else "not_preconditioned", message, values)]


def _change(values: list[float]) -> float:
    """Largest relative change from one value to the next; 1 where there is nothing to compare with."""
    return max((abs(b / a - 1.0) if a > 0.0 else 1.0) for a, b in pairwise(values))


#: A ramp that ends this share short of the stated depth was aborted.
ABORT_SHARE = 0.05
#: A last ramp or loop this much shallower than each one before it was aborted.
EARLIER_SHARE = 0.9
#: Fewest earlier steps or loops to be measured against.
FEWEST_EARLIER = 2
#: Creep is slower than this share of its ramp.
CREEP_SPEED = 0.25
#: Creep covers more than this share of the travel of its ramp.
CREEP_SHARE = 0.002
#: Force stays within this share of its change over the ramp, or so many noise sd, while the load is held.
HELD_SHARE = 0.03
HELD_SD = 4.0
#: The same share where force alone tells its beginning.
LEVEL_SHARE = 0.005
#: Force changes less than this share of what so much travel took in the ramp.
HELD_YIELD = 0.25
#: Share of samples that must lie within.
HELD_MOST = 0.95
#: A machine stops at a stated force once it is read: the end of the ramp lies between these shares of it.
LIMIT_FROM, LIMIT_TO = 0.97, 1.1
FEWEST_AT_LIMIT = 5
#: Fewest samples of a held load.
FEWEST_HELD = 20
#: Samples of the reading in air after a pull, which exceeds so many noise sd and a share of the range.
PULL_SAMPLES, PULL_SD, PULL_SHARE = 5, 6.0, 0.01
#: Loops that turn at one force: fewest of them, and how many times more their depths let it vary.
FEWEST_TURNS = 3
TURN_RATIO = 3.0
#: Peak forces agree within this share of their mean, so many noise sd, or the force between two samples.
TURN_SHARE = 0.01
TURN_SD = 3.0
#: What an aborted ramp lacks, by the value that says so.
_WANTED = {
    "stated_mm": "of {:.4g} mm stated",
    "stated_hold_s": "without the {:.4g} s hold",
    "earlier_mm": "earlier ones after {:.4g} mm",
}


def pull_off(path: Path, *, surface_mm: float) -> list[Flag]:
    """Tissue that holds the tool as it leaves: the force falls below its reading in air, and comes back."""
    away = np.flatnonzero(path.depth_mm >= surface_mm)
    leaves = int(np.argmax(path.depth_mm))
    if away.size == 0 or path.force_N.size - int(away[-1]) < 2 * PULL_SAMPLES:
        return []
    calm = running_median(path.force_N)
    zero = float(np.median(path.force_N[-PULL_SAMPLES:]))
    pull = zero - float(calm[leaves:].min())
    if not pull > max(PULL_SD * path.noise_N, PULL_SHARE * float(np.ptp(path.force_N))):
        return []
    words = f"tissue pulls at the tool by up to {pull:.3g} N as it leaves: it adheres"
    return [Flag("adhesion", words, {"pull_N": pull})]


@dataclass(frozen=True, slots=True)
class Held(Piece):
    """A stretch in which the load is held while the tool creeps on; its direction is that of a standstill."""


def with_creep(path: Path, found: list[Piece]) -> list[Piece]:
    """Moves and standstills, of which none goes on through a held load."""
    for held in _held_loads(path, found):
        behind = [one for one in found if one.stop > held.stop]
        if behind and behind[0].direction == 0 and not _stays(path, held, behind[0]):
            continue  # of a crosshead that slowed down, and then relaxes
        for one in behind:
            if one.direction < 0 or not _stays(path, held, one):
                break
            held = replace(held, stop=one.stop)
        before = _before(held, found)
        if len(before) > 1 and before[-1].stop - before[-1].start < FEWEST_HELD:  # rest of a rounded corner
            before[-2:] = [replace(before[-2], stop=held.start)]
        after = [replace(one, start=max(one.start, held.stop)) for one in found if one.stop > held.stop]
        found = [*before, held, *after]
    ways = groupby(found, lambda one: one.direction >= 0)
    return [part for goes_in, way in ways for part in (_with_level_end(path, [*way]) if goes_in else way)]


def _before(held: Held, found: list[Piece]) -> list[Piece]:
    """Pieces before a held load, up to where it begins."""
    return [replace(one, stop=min(one.stop, held.start)) for one in found if one.start < held.start]


def _with_level_end(path: Path, way: list[Piece]) -> list[Piece]:
    """A way in that ends at one force, behind a ramp so slow that the path has no corner where it ends."""
    first, last = way[0], way[-1]
    if last.stop - first.start < 2 * FEWEST_HELD or any(isinstance(one, Held) for one in way):
        return way
    force = path.force_N[first.start : last.stop + 1]
    level = float(np.median(force[-FEWEST_HELD:]))
    within = max(LEVEL_SHARE * (level - float(force[0])), HELD_SD * path.noise_N)
    off = np.flatnonzero(np.abs(running_median(force)[:-FEWEST_HELD] - level) > within)
    held = Held(0, first.start + (int(off[-1]) + 1 if off.size else 0), last.stop)
    return [*_before(held, way), held] if _is_held(path, first.start, held) else way


def _stays(path: Path, held: Piece, after: Piece) -> bool:
    """True where the force of a held load stays at its level behind it."""
    level = float(np.median(path.force_N[held.start : held.stop + 1]))
    within = max(HELD_SHARE * abs(level), HELD_SD * path.noise_N)
    behind = path.force_N[max(after.start, held.stop) : after.stop + 1]
    return float(np.mean(np.abs(behind - level) <= within)) >= HELD_MOST


def _held_loads(path: Path, found: list[Piece]) -> list[Held]:
    """Stretches of level force behind a rise in which the tool sinks in, slower than it came."""
    force = running_median(path.force_N)
    within = max(HELD_SHARE * float(np.ptp(force)), HELD_SD * path.noise_N)
    knots = corners(path.time_s, force, tolerance=within).tolist()
    edges = np.array([one.start for one in found] + [path.time_s.size - 1])
    held: list[Held] = []
    rises: int | None = None
    for start, stop in pairwise(knots):
        if rises is not None and _is_held(path, rises, Piece(0, start, stop)):
            one = _placed(path, rises, Held(0, start, stop), edges)
            held += [one] if _is_held(path, rises, one) else []
        rising = force[stop] - force[start] > within
        if rising and rises is None:
            rises = start
        elif not rising and stop - start >= FEWEST_HELD:
            rises = None
    return held


def _placed(path: Path, rises: int, held: Held, edges: NDArray[np.intp]) -> Held:
    """A held load between its corners: the path, which slows down there, places them better."""
    reach = max(held.start - rises, FEWEST_HELD) // 4
    around = max(rises + 1, held.start - reach), min(held.stop - 1, held.start + reach)
    end = int(edges[np.argmin(np.abs(edges - held.stop))])
    return Held(
        0,
        corner_near(path, held.start, around, stands=(False, False)),
        end if abs(end - held.stop) <= reach else held.stop,
    )


def _is_held(path: Path, rises: int, slow: Piece) -> bool:
    """True where the load is held while the tool creeps, behind a rise from a sample on."""
    ramp = Piece(1, rises, slow.start)
    ramp_s, slow_s = ramp.took_s(path), slow.took_s(path)
    if slow.stop - slow.start < FEWEST_HELD or not (ramp_s > 0.0 and slow_s > 0.0):
        return False
    late = Piece(0, slow.start + (slow.stop - slow.start) // 10, slow.stop)  # behind a slow stop
    held = path.force_N[late.start : late.stop + 1]
    level = float(np.median(held))
    rise = level - float(np.median(path.force_N[rises : rises + 5]))
    within = max(HELD_SHARE * rise, HELD_SD * path.noise_N)
    constant = float(np.mean(np.abs(held - level) <= within)) >= HELD_MOST
    ramp_mm = ramp.travel_mm(path)
    creeps = late.travel_mm(path) > max(CREEP_SHARE * ramp_mm, path.tolerance_mm)
    slower = slow.travel_mm(path) / slow_s < CREEP_SPEED * ramp_mm / ramp_s
    fifth = max(held.size // 5, 1)
    change = abs(float(np.median(held[-fifth:]) - np.median(held[:fifth]))) + 2.0 * path.noise_N / fifth**0.5
    yields = change * ramp_mm < HELD_YIELD * rise * late.travel_mm(path)
    return rise > within and constant and creeps and slower and yields


def aborts(path: Path, phases: tuple[Phase, ...], protocol: Protocol) -> list[Event]:
    """At most one abort: of the ramp that should have gone deeper, or been held."""
    ramps = [phase for phase in phases if phase.kind == "ramp"]
    if not ramps:
        return []
    last = ramps[-1]
    end = last.stop - 1
    reached = float(path.depth_mm[end] - path.depth_mm[0])
    values: dict[str, float] = {"reached_mm": reached}
    held = any(phase.kind in ("hold", "creep") for phase in phases)
    cycles = [phase for phase in phases if phase.kind == "cycle"]
    stated, hold_s = protocol.depth_mm, protocol.hold_s
    short = bool(stated) and reached < (1.0 - ABORT_SHARE) * abs(stated or 0.0)
    if not held and not cycles and (short or hold_s):
        values |= {"stated_mm": abs(stated)} if stated and short else {}
        values |= {"stated_hold_s": hold_s} if hold_s else {}
        return [Event("abort", end, float(path.time_s[end]), values)]
    if phases[-1] is not last:
        return []
    # depths of the loops before a last ramp, or else the travels of the steps before it
    earlier = [float(path.depth_mm[p.peak] - path.depth_mm[0]) for p in phases if p.peak is not None] or [
        float(path.depth_mm[ramp.stop - 1] - path.depth_mm[ramp.start])
        for ramp, after in pairwise(phases)
        if ramp.kind == "ramp" and after.kind == "hold"
    ]
    own = float(path.depth_mm[end] - path.depth_mm[last.start]) if not cycles else reached
    if len(earlier) >= FEWEST_EARLIER and own < EARLIER_SHARE * min(earlier):
        values |= {"travel_mm": own, "earlier_mm": min(earlier)}
        return [Event("abort", end, float(path.time_s[end]), values)]
    return []


def load_limits(
    path: Path,
    phases: tuple[Phase, ...],
    loops: tuple[Loop, ...],
    *,
    zero: tuple[float, float],
    stated_N: float | None,
) -> list[Event]:
    """Moves that ended at a force."""
    contact_mm, baseline_N = zero
    events: list[Event] = []
    for before, after in pairwise(phases):
        if stated_N and before.kind == "ramp" and after.kind != "creep":
            events += _at_stated(path, before, stated_N, contact_mm)
        if after.kind == "creep":
            at = before.stop - 1
            values = {
                "force_N": float(np.median(path.force_N[after.start : after.stop])) - baseline_N,
                "depth_mm": float(path.depth_mm[at]) - contact_mm,
                "creep_mm": float(path.depth_mm[after.stop - 1] - path.depth_mm[at]),
            }
            events.append(Event("load_limit", at, float(path.time_s[at]), values))
    if len(loops) >= FEWEST_TURNS and _turn_at_force(path, phases, loops, baseline_N):
        at = next(phase.peak for phase in phases if phase.peak is not None)
        values = {
            "force_N": float(np.mean([loop.peak_N for loop in loops])) - baseline_N,
            "depth_mm": float(np.mean([loop.peak_mm for loop in loops])) - contact_mm,
            "turns": len(loops),
        }
        events.append(Event("load_limit", at, float(path.time_s[at]), values))
    return events


def _at_stated(path: Path, ramp: Phase, stated_N: float, contact_mm: float) -> list[Event]:
    """The end of a ramp at the stated limit, which the load cell reads with whatever its zero is."""
    at = ramp.stop - 1
    end = slice(max(ramp.start, at - max(FEWEST_AT_LIMIT, (at - ramp.start) // 20)), ramp.stop)
    reached = float(running_median(path.force_N[end]).max())
    if not LIMIT_FROM * stated_N <= reached <= LIMIT_TO * stated_N:
        return []
    values = {"force_N": reached, "depth_mm": float(path.depth_mm[at] - contact_mm), "limit_N": stated_N}
    return [Event("load_limit", at, float(path.time_s[at]), values)]


def _turn_at_force(path: Path, phases: tuple[Phase, ...], loops: tuple[Loop, ...], baseline_N: float) -> bool:
    """True where loops turn at one force and at several depths."""
    forces = np.array([loop.peak_N for loop in loops]) - baseline_N
    first = next(phase for phase in phases if phase.peak is not None)
    assert first.peak is not None  # noqa: S101  (chosen for it)
    way = slice(first.start, first.peak + 1)
    travel = float(path.depth_mm[first.peak] - path.depth_mm[first.start])
    slope = float(path.force_N[first.peak] - path.force_N[first.start]) / max(travel, 1e-300)
    # the turn lies between two samples
    sampled = slope * float(np.abs(np.diff(path.depth_mm[way])).max(initial=0.0))
    within = max(TURN_SHARE * float(forces.mean()), TURN_SD * path.noise_N, sampled)
    implied = slope * float(np.ptp([loop.peak_mm for loop in loops]))
    return float(np.ptp(forces)) <= within and implied > TURN_RATIO * within


def ending_flags(events: list[Event]) -> list[Flag]:
    """Flags of aborts and load limits."""
    flags: list[Flag] = []
    for event in events:
        values = dict(event.values)
        if event.kind == "abort":
            wanted = ", ".join(words.format(values[key]) for key, words in _WANTED.items() if key in values)
            ends = "after {travel_mm:.4g} mm" if "travel_mm" in values else "at {reached_mm:.4g} mm"
            message = f"the ramp ends {ends.format(**values)}, {wanted}"
            flags.append(Flag("aborted_ramp", message, values))
        elif event.kind == "load_limit":
            force = f"{values['force_N']:.4g} N"
            if "creep_mm" in values:
                crept = f"{force} are held while the tool creeps {values['creep_mm']:.3g} mm"
                limit = f"{crept}: load control, no relaxation hold"
            elif "limit_N" in values:
                limit = f"the ramp ends at {force}, the stated limit of {values['limit_N']:.4g} N"
            else:
                limit = f"{values['turns']} loops turn at {force}, not at one depth: a limit"
            flags.append(Flag("load_limit_stop", limit, values))
    return flags
