"""The protocol of least machine time: enumerate pairs on a grid, then exchange, step by step.

Every indentation of the grid and every pair in several proportions is scaled to the fewest repeats that reach
the wants, or to what the budget allows.  The best are refined off the grid until nothing shortens them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.design.precision import Indentation, Ledger, Protocol, ramp_of

#: Speeds and depths as shares of the greatest, holds in longest relaxation times.
SPEED_SHARES = (1.0, 0.5, 0.2, 0.05, 0.01)
DEPTH_SHARES = (1.0, 0.6, 0.3)
HOLD_TIMES = (2.0, 5.0, 15.0, 50.0, 150.0)
#: Shortest and longest hold [s] that is planned; a ramp takes at most so much of the budget.
SHORTEST_HOLD_S, LONGEST_HOLD_S, RAMP_SHARE = 0.5, 3600.0, 0.1
#: An indentation shallower than this many contact standard deviations tells nothing.
SHALLOWEST_SD = 10.0
SPEED_STEP, HOLD_STEP, DEPTH_STEP = 2.0**0.5, 1.6, 0.125
#: A speed within this share of the greatest is the greatest.
NEAR_FASTEST = 0.95


def rounded(value: float) -> float:
    """A number to two significant digits, towards zero."""
    if value <= 0.0:
        return 0.0
    scale = 10.0 ** (np.floor(np.log10(value)) - 1)
    # a number that has these digits stays, in spite of its binary form
    return float(f"{np.floor(value / scale + 1e-9) * scale:.4g}")


def _holds(ledger: Ledger) -> list[float]:
    tau = ledger.tissues.longest_tau_s
    inside = np.clip(tau * np.array(HOLD_TIMES), SHORTEST_HOLD_S, LONGEST_HOLD_S)
    return [0.0, *sorted({rounded(float(hold)) for hold in inside})]


def shallowest(ledger: Ledger) -> float:
    """Depth [mm] below which an indentation tells nothing."""
    return max(SHALLOWEST_SD * ledger.machine.contact_sd_mm, 0.02 * ledger.asked.max_depth_mm)


def _allowed(ledger: Ledger, test: Indentation) -> bool:
    """True where machine, tissue and budget bear it."""
    machine = ledger.machine
    if not machine.min_speed_mm_min <= test.speed_mm_min <= machine.max_speed_mm_min:
        return False
    if not shallowest(ledger) <= test.depth_mm <= ledger.deepest(test.speed_mm_min):
        return False
    if test.hold_s > LONGEST_HOLD_S:
        return False
    return ramp_of(test, machine).seconds <= RAMP_SHARE * ledger.asked.budget_s


def _starts(ledger: Ledger) -> Iterator[tuple[float, float]]:
    machine = ledger.machine
    for share in SPEED_SHARES:
        speed = max(rounded(share * machine.max_speed_mm_min), machine.min_speed_mm_min)
        deepest = ledger.deepest(speed)
        for part in DEPTH_SHARES:
            depth = rounded(part * deepest)
            if depth > 0.0 and _allowed(ledger, Indentation(speed, depth)):
                yield speed, depth


def count_paths(ledger: Ledger) -> int:
    """Paths that :func:`learned_candidates` will simulate."""
    return len(set(_starts(ledger)))


def learned_candidates(ledger: Ledger) -> list[Indentation]:
    """The grid, with the information of every indentation computed."""
    holds = _holds(ledger)
    found = []
    for speed, depth in dict.fromkeys(_starts(ledger)):
        ledger.learn(speed, depth, holds)
        found += [Indentation(speed, depth, hold) for hold in holds]
    return found


def neighbours(ledger: Ledger, test: Indentation) -> list[Indentation]:
    """Indentations one step away in speed, depth or hold, as far as they are allowed."""
    machine, most = ledger.machine, ledger.asked.max_depth_mm
    speed, depth, hold = test.speed_mm_min, test.depth_mm, test.hold_s
    slowest, fastest = machine.min_speed_mm_min, machine.max_speed_mm_min
    speeds = [
        fastest if one > NEAR_FASTEST * fastest else max(rounded(one), slowest)
        for one in (speed * SPEED_STEP, speed * (1.0 / SPEED_STEP))
    ]
    depths = [rounded(min(depth + step * DEPTH_STEP * most, ledger.deepest(speed))) for step in (1.0, -1.0)]
    shortest = _holds(ledger)[1]
    holds = [rounded(hold * HOLD_STEP), rounded(hold / HOLD_STEP)] if hold > 0.0 else [shortest]
    if 0.0 < hold <= shortest:
        holds.append(0.0)
    around = [Indentation(one, depth, hold) for one in speeds]
    around += [Indentation(speed, one, hold) for one in depths]
    around += [
        Indentation(speed, depth, one) for one in holds if one >= min(SHORTEST_HOLD_S, hold) or one == 0.0
    ]
    return [one for one in dict.fromkeys(around) if one != test and _allowed(ledger, one)]


#: Repeats of the two indentations of a pair.
PROPORTIONS = ((1, 1), (1, 2), (2, 1), (1, 4), (4, 1))
#: Protocols of an enumeration that are kept, and of these the ones that are refined.
KEPT, REFINED = 40, 3
ROUNDS = 12
#: Share of machine time (or of what is missing to the wants) that an exchange must save.
SAVED = 0.005
#: Speeds that count as two, and a hold that counts, in longest relaxation times.
SPEEDS_APART, HOLD_NEEDED = 1.5, 3.0
#: Protocols that are looked at in one call of the linear algebra.
CHUNK = 512


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A protocol that was looked at."""

    protocol: Protocol  # repeats of each indentation
    seconds: float  # machine time of a specimen
    worst: float  # largest ratio of assured to wanted precision

    @property
    def rank(self) -> tuple[float, float]:
        """Those that reach the wants by time, then the others by precision."""
        return (0.0, self.seconds) if self.worst <= 1.0 else (self.worst, self.seconds)

    @property
    def logs(self) -> int:
        """Recordings."""
        return sum(self.protocol.values())


def _tells_apart(ledger: Ledger, speeds: FloatArray, holds: FloatArray) -> NDArray[np.bool_]:
    """True where speeds or a hold, along the first axis, tell the branch from the static force.

    Ramps of one speed do not.
    """
    apart = speeds.max(axis=0) >= SPEEDS_APART * speeds.min(axis=0)
    return np.asarray(apart | (holds.max(axis=0) >= HOLD_NEEDED * ledger.tissues.longest_tau_s))


def _programs(tests: Iterable[Indentation]) -> FloatArray:
    """Speeds and holds of some indentations, shape (2, n)."""
    return np.array([(one.speed_mm_min, one.hold_s) for one in tests]).T


def _looked_at(ledger: Ledger, protocol: Protocol) -> Found:
    protocol = {test: count for test, count in sorted(protocol.items()) if count}
    return Found(protocol, ledger.duration(protocol), float(ledger.precision(protocol).worst))


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Units of one or two indentations that fit the budget."""

    pairs: NDArray[np.int64]  # (n, 4), both indentations, and the repeats of each in a unit
    #: (n,): units that the repeats demand, and that budget and number of logs allow.
    least: FloatArray
    most: FloatArray  # (n,)
    seconds: FloatArray  # (n,), machine time of a unit


def _table(ledger: Ledger, tests: Sequence[Indentation]) -> _Table:
    """Every indentation and every pair in several proportions that fits and tells the branch apart."""
    asked = ledger.asked
    singles = [(i, i, 1, 0) for i in range(len(tests))]
    apart = [(i, j, a, b) for i, j in combinations(range(len(tests)), 2) for a, b in PROPORTIONS]
    pairs = np.array([*singles, *apart])
    i, j, a, b = pairs.T
    lengths = np.array([ledger.seconds(one) for one in tests])
    fewest = np.where(b > 0, np.minimum(a, b), a)
    least = np.ceil(asked.repeats / fewest)
    logs, seconds = a + b, a * lengths[i] + b * lengths[j]
    room = asked.budget_s - asked.setup_s + asked.recovery_s
    most = np.floor(np.minimum(asked.max_logs / logs, room / seconds + 1e-9))
    fits = _tells_apart(ledger, *_programs(tests)[:, [i, j]]) & (most >= least)
    return _Table(pairs[fits], least[fits], most[fits], seconds[fits])


def enumerated(ledger: Ledger) -> tuple[list[Found], int]:
    """The best single indentations and pairs of the grid at their fewest repeats, and how many were seen."""
    tests = learned_candidates(ledger)
    if not tests:
        return [], 0
    table = _table(ledger, tests)
    if not table.pairs.size:
        return [], 0
    info = np.stack([ledger.information(test) for test in tests])
    needed, worst = _fewest(ledger, info, table)
    order = np.lexsort((needed * table.seconds, np.where(worst <= 1.0, 0.0, worst)))[:KEPT]
    out = []
    for k in order:
        i, j, a, b = (int(value) for value in table.pairs[k])
        protocol: dict[Indentation, int] = {tests[i]: a * int(needed[k])}
        if b:
            protocol[tests[j]] = protocol.get(tests[j], 0) + b * int(needed[k])
        out.append(_looked_at(ledger, protocol))
    return out, int(table.pairs.shape[0])


def _fewest(ledger: Ledger, info: FloatArray, table: _Table) -> tuple[FloatArray, FloatArray]:
    """Fewest units that reach the wants, and the worst ratio there; the most units where none do.

    All rows are bisected at once.  A row is left as soon as it can't be among the :data:`KEPT` shortest.
    """

    def worst_at(rows: NDArray[np.int64], units: FloatArray) -> FloatArray:
        out = np.empty(units.size)
        for first in range(0, units.size, CHUNK):
            part = slice(first, first + CHUNK)
            i, j, a, b = table.pairs[rows[part]].T
            ones, others = ((units[part] * count)[:, None, None, None] for count in (a, b))
            out[part] = ledger.precision_of(ones * info[i] + others * info[j]).worst
        return out

    low, high = table.least.copy(), table.most.copy()
    worst = worst_at(np.arange(high.size), high)
    reaches = worst <= 1.0
    active = reaches & (low < high)
    while active.any():
        rows = np.flatnonzero(active)
        middle = np.floor(0.5 * (low + high))[rows]
        found = worst_at(rows, middle)
        enough = found <= 1.0
        high[rows[enough]], worst[rows[enough]] = middle[enough], found[enough]
        low[rows[~enough]] = middle[~enough] + 1.0
        times = (high * table.seconds)[reaches]
        longest = np.partition(times, min(KEPT, times.size) - 1)[min(KEPT, times.size) - 1]
        active = reaches & (low < high) & (low * table.seconds <= longest)
    return high, worst


def balanced(ledger: Ledger, tests: Sequence[Indentation], start: Protocol) -> Found:
    """The fewest repeats that reach the wants: logs are added where they help most, then the longest go."""
    asked = ledger.asked
    counts = {test: max(start.get(test, 0), asked.repeats) for test in tests}
    now = _looked_at(ledger, counts)
    told = _tells_apart(ledger, *_programs(now.protocol))
    if now.logs > asked.max_logs or now.seconds > asked.budget_s or not told:
        return replace(now, worst=np.inf)
    while now.worst > 1.0:
        options = []
        for test in tests:
            more = _looked_at(ledger, {**now.protocol, test: now.protocol.get(test, 0) + 1})
            if more.logs <= asked.max_logs and more.seconds <= asked.budget_s:
                # a number that stays open is no nearer
                gain = np.log(now.worst) - np.log(more.worst) if np.isfinite(more.worst) else 0.0
                options.append((gain / ledger.seconds(test), more))
        if not options:
            break
        gain, best = max(options, key=lambda pair: pair[0])
        if gain <= 0.0:
            break
        now = best
    return _trimmed(ledger, now) if now.worst <= 1.0 else now


def _trimmed(ledger: Ledger, now: Found) -> Found:
    """Without the logs that are not needed."""
    shorter = True
    while shorter:
        shorter = False
        for test in sorted(now.protocol, key=ledger.seconds, reverse=True):
            if now.protocol[test] > ledger.asked.repeats:
                less = _looked_at(ledger, {**now.protocol, test: now.protocol[test] - 1})
                if less.worst <= 1.0:
                    now, shorter = less, True
                    break
    return now


def _variants(ledger: Ledger, now: Found, grid: Sequence[Indentation]) -> list[tuple[Indentation, ...]]:
    """Sets of indentations one exchange away."""
    tests = tuple(now.protocol)
    out = [tuple(one for one in tests if one != test) for test in tests if len(tests) > 1]
    for test in tests:
        rest = tuple(one for one in tests if one != test)
        out += [(*rest, near) for near in neighbours(ledger, test) if near not in rest]
    out += [(*tests, new) for new in grid if new not in tests]
    return out


def refined(ledger: Ledger, starts: Sequence[Found]) -> list[Found]:
    """Exchange from each start until nothing shortens the protocol; also what was passed on the way."""
    passed = []
    for start in starts:
        now = balanced(ledger, tuple(start.protocol), start.protocol)
        now = min((now, start), key=lambda one: one.rank)
        for _ in range(ROUNDS):
            grid = [test for other in starts for test in other.protocol]
            options = [
                balanced(ledger, tests, _carried(now, tests))
                for tests in _variants(ledger, now, list(dict.fromkeys(grid)))
            ]
            best = min(options, key=lambda one: one.rank, default=now)
            if not _shorter(best, now) or best.seconds > ledger.asked.budget_s:
                break
            passed.append(now)
            now = best
        passed.append(now)
    return passed


def _shorter(one: Found, other: Found) -> bool:
    """True where an exchange is worth it: a further indentation must save more than another depth."""
    share = SAVED * (1 + max(len(one.protocol) - len(other.protocol), 0))
    if one.worst <= 1.0 and other.worst <= 1.0:
        return one.seconds < (1.0 - share) * other.seconds
    return one.worst <= 1.0 or (other.worst > 1.0 and one.worst < (1.0 - share) * other.worst)


def _carried(now: Found, tests: Sequence[Indentation]) -> dict[Indentation, int]:
    """Counts of the old set; an indentation that took another's place takes its count."""
    gone = [count for test, count in now.protocol.items() if test not in tests]
    out = {test: now.protocol[test] for test in tests if test in now.protocol}
    for test in tests:
        if test not in out and gone:
            out[test] = gone.pop(0)
    return out
