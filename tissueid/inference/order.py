"""Do the logs of one specimen belong together?  Their gains among each other, by run, and by site.

The gain of a log is its force over that of the specimen's common tissue, fitted with partial pooling; it
is 1 for all logs where pooling leaves no gain, and nothing is said then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.flags import Flag
from tissueid.result import TrialFit

#: Standard deviation of ln gain beyond which logs differ much; repeats on one site stay below 5 %.
MUCH_SPREAD = 0.10
#: An order effect is said from so many logs, this chance of a slope that large without one, and this change.
FEWEST_RUNS = 4
CHANCE = 0.01
LEAST_CHANGE = 0.02
#: Least difference of a first test from the others.
FIRST_CHANGE = 0.05


def gain_spread(trials: Sequence[TrialFit]) -> list[Flag]:
    """``gain_spread`` where the logs of a specimen differ much in stiffness."""
    gains = np.array([trial.gain for trial in trials])
    if gains.size < 2 or (gains <= 0.0).any():
        return []
    spread = float(np.log(gains).std(ddof=1))
    if spread <= MUCH_SPREAD:
        return []
    low, high = int(gains.argmin()), int(gains.argmax())
    message = (
        f"stiffness differs by {100 * spread:.0f} % (sd) between logs, from {gains[low]:.2f} "
        f"({_name(trials[low])}) to {gains[high]:.2f} ({_name(trials[high])})"
    )
    values = {"sd_ln_gain": spread, "lowest": float(gains[low]), "highest": float(gains[high])}
    return [Flag("gain_spread", message, values)]


def order_effect(trials: Sequence[TrialFit], runs: Sequence[int | None]) -> list[Flag]:
    """``order_effect`` where stiffness follows the order of testing, or the first test differs from the rest.

    ``runs``: place of each in the order of testing; ``None`` where it was not stated.  Where none was, the
    order is that of the files.
    """
    stated = any(run is not None for run in runs)
    places = runs if stated else range(1, len(trials) + 1)
    known = sorted(
        (run, trial.gain)
        for run, trial in zip(places, trials, strict=True)
        if run is not None and trial.gain > 0.0
    )
    order = np.array([float(run) for run, _ in known])
    log_gain = np.log([gain for _, gain in known])
    if order.size < FEWEST_RUNS or np.ptp(order) == 0.0 or np.ptp(log_gain) == 0.0:
        return []
    what = "run" if stated else "file"
    return _first_apart(log_gain, what) or _trend(order, log_gain, what)


def _trend(order: NDArray[np.float64], log_gain: NDArray[np.float64], what: str) -> list[Flag]:
    """The flag of a slope over the order."""
    line = stats.linregress(order, log_gain)
    change = float(np.expm1(line.slope * np.ptp(order)))
    if line.pvalue >= CHANCE or abs(change) < LEAST_CHANGE:
        return []
    first, last = int(order.min()), int(order.max())
    message = (
        f"stiffness {'falls' if change < 0.0 else 'rises'} by {100 * abs(change):.1f} % from {what} {first} "
        f"to {what} {last} ({order.size} logs, p = {line.pvalue:.1g})"
    )
    values = {
        "change": change,
        "per_run": float(line.slope),
        "p": float(line.pvalue),
        "runs": int(order.size),
    }
    return [Flag("order_effect", message, values)]


def _first_apart(log_gain: NDArray[np.float64], what: str) -> list[Flag]:
    """The flag of a first test that differs from all others by far more than they do among each other."""
    rest = log_gain[1:]
    # the others may follow a line of their own
    line = np.polynomial.Polynomial.fit(np.arange(1.0, log_gain.size), rest, 1)
    spread = float(np.sqrt(((rest - rest.mean()) ** 2).sum() / max(rest.size - 1, 1)))
    apart = float(log_gain[0] - rest.mean())
    if abs(np.expm1(apart)) < FIRST_CHANGE or abs(log_gain[0] - float(line(0.0))) < np.log1p(FIRST_CHANGE):
        return []
    t = abs(apart) / max(spread * np.sqrt(1.0 + 1.0 / rest.size), 1e-12)
    p = float(2.0 * stats.t.sf(t, rest.size - 1))
    if p >= CHANCE:
        return []
    change = float(np.expm1(apart))
    message = (
        f"the first {what} is {100 * abs(change):.1f} % {'stiffer' if change > 0.0 else 'softer'} than the "
        f"other {rest.size} (p = {p:.1g})"
    )
    return [Flag("order_effect", message, {"change": change, "first": True, "p": p, "runs": log_gain.size})]


def repeated_sites(trials: Sequence[TrialFit], rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """``repeated_site`` where one site of the specimen was tested more than once.

    ``rows``: ``[[trial]]`` of each, empty where it has none.
    """
    tested: dict[str, list[float | None]] = {}
    for _, row in zip(trials, rows, strict=True):
        if row.get("site") is not None:
            tested.setdefault(str(row["site"]), []).append(row.get("rest_s"))
    again = {site: rests for site, rests in tested.items() if len(rests) > 1}
    if not again:
        return []
    first, rests_of_first = next(iter(again.items()))
    said = f"{first} was tested {len(rests_of_first)} times"
    if len(again) > 1:
        said += f", and {len(again) - 1} more site{'s' * (len(again) > 2)} repeatedly"
    stated = [rest for rests in again.values() for rest in rests if rest is not None]
    rest = f"rests from {min(stated):g} s" if stated else "rests not stated"
    values: dict[str, Any] = {"sites": list(again), "times": [len(rests) for rests in again.values()]}
    if stated:
        values["shortest_rest_s"] = min(stated)
    return [Flag("repeated_site", f"{said}; {rest}", values)]


def _name(trial: TrialFit) -> str:
    return trial.path if trial.sheet is None else f"{trial.path} [{trial.sheet}]"
