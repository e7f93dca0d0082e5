"""The indentations that a search starts from, and the neighbours of each.

Speeds, depths and holds lie on a grid that follows machine and tissue: speeds from the machine's greatest
downwards, depths as shares of what force and depth allow at that speed, holds as multiples of the longest
relaxation time.  Numbers are rounded to what a test sheet should say.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tissueid.design.indentation import Indentation, ramp_of
from tissueid.design.precision import Ledger

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


def rounded(value: float, digits: int = 2) -> float:
    """A number to so many significant digits, towards zero."""
    if value <= 0.0:
        return 0.0
    scale = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    # a number that has these digits stays, in spite of its binary form
    return float(f"{np.floor(value / scale + 1e-9) * scale:.{digits + 2}g}")


def _holds(ledger: Ledger) -> list[float]:
    tau = ledger.tissues.longest_tau_s
    inside = np.clip(tau * np.array(HOLD_TIMES), SHORTEST_HOLD_S, LONGEST_HOLD_S)
    return [0.0, *sorted({rounded(float(hold)) for hold in inside})]


def _allowed(ledger: Ledger, test: Indentation) -> bool:
    """True where machine, tissue and budget bear it."""
    machine = ledger.chain.machine
    if not machine.min_speed_mm_min <= test.speed_mm_min <= machine.max_speed_mm_min:
        return False
    shallowest = max(SHALLOWEST_SD * machine.contact_sd_mm, 0.02 * ledger.asked.max_depth_mm)
    if not shallowest <= test.depth_mm <= ledger.deepest(test.speed_mm_min):
        return False
    if test.hold_s > LONGEST_HOLD_S:
        return False
    return ramp_of(test, machine).seconds <= RAMP_SHARE * ledger.asked.budget_s


def _starts(ledger: Ledger) -> Iterator[tuple[float, float]]:
    machine = ledger.chain.machine
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


def _snapped(speed: float, slowest: float, fastest: float) -> float:
    """A speed of the sheet: one near the machine's greatest is the greatest."""
    return fastest if speed > NEAR_FASTEST * fastest else max(rounded(speed), slowest)


def neighbours(ledger: Ledger, test: Indentation) -> list[Indentation]:
    """Indentations one step away in speed, depth or hold, as far as they are allowed."""
    machine, most = ledger.chain.machine, ledger.asked.max_depth_mm
    speed, depth, hold = test.speed_mm_min, test.depth_mm, test.hold_s
    ends = (machine.min_speed_mm_min, machine.max_speed_mm_min)
    speeds = [_snapped(speed * step, *ends) for step in (SPEED_STEP, 1.0 / SPEED_STEP)]
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
