"""Table 1 and Fig. 2: four relaxation tests, synthesised from the printed numbers and fitted again.

A hold that is fitted by itself, as the paper did, does not see whether the tissue relaxed, or the crosshead
settled and the load channel followed with its filter: the instrument alone may give a relaxation time.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from scipy.optimize import brentq, least_squares
from scipy.signal import lfilter

from tissueid.arrays import FloatArray
from tissueid.documents.reproduction import Figure, Item, Trace
from tissueid.reproduce.published import (
    SADEGHNEJAD,
    Kind,
    Ledger,
    Readings,
    Said,
    near,
    points,
    rounded,
    within_interval,
)
from tissueid.reproduce.recordings import Effort, fitted, read_back, relaxation_of
from tissueid.reproduce.speeds import (
    DEPTHS_MM,
    HOLD_SPEED_MM_MIN,
    branch_force,
    cubic_through_peaks,
    read_branch,
)
from tissueid.synth.recipe import Hold, Log, Move, Recipe
from tissueid.trial import Trial

#: Time constant of the load channel's filter [s]: common in test machines.
FILTER_S = 0.005
#: Window of the exponential after the corner, and its step [s].
WINDOW_S, STEP_S = 0.5, 1e-4
#: Largest overshoot that is looked for [mm]; more would be a machine in need of repair.
MOST_OVERSHOOT_MM = 0.5
#: Settling times that are looked for [s].
SETTLING_S = (1e-3, 0.5)


def settling_force(
    static: tuple[float, ...], depth_mm: float, overshoot_mm: float, settling_s: float
) -> tuple[FloatArray, FloatArray]:
    """Time [s] and filtered force [N] of an elastic tissue in a hold whose crosshead overshot."""
    time = np.arange(0.0, WINDOW_S, STEP_S)
    depth = depth_mm + overshoot_mm * np.exp(-time / settling_s)
    force = np.polynomial.polynomial.polyval(depth, [0.0, *static])
    kept = np.exp(-STEP_S / FILTER_S)
    filtered, _ = lfilter([1.0 - kept], [1.0, -kept], force, zi=[kept * force[0]])
    return time, filtered


def hold_exponential(time_s: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Amplitude [N] and time constant [s] of one exponential and a plateau: the hold by itself."""

    def residual(p: FloatArray) -> FloatArray:
        return np.asarray(p[0] + p[1] * np.exp(-time_s / np.exp(p[2])) - force_N)

    start = [force_N[-1], force_N[0] - force_N[-1], np.log(0.02)]
    found = least_squares(residual, start, x_scale=np.maximum(np.abs(start), 1.0)).x
    return float(found[1]), float(np.exp(found[2]))


def elastic_imitation(ledger: Ledger, readings: Readings, depth: int) -> str:
    """Overshoot and settling time of a crosshead that give a printed relaxation time without any branch."""
    key = f"table-1/tau-{depth}mm"
    branch = read_branch(ledger, readings, key)
    if readings.relaxation == "rate":
        return "not looked for: the time would be longer than the record"
    static = cubic_through_peaks(ledger, branch)
    drop = branch_force(branch, depth, HOLD_SPEED_MM_MIN)

    def height(overshoot: float) -> float:
        beyond = depth + overshoot
        return sum(a * (beyond**k - float(depth) ** k) for k, a in enumerate(static, start=1)) - drop

    if height(MOST_OVERSHOOT_MM) < 0.0:
        return f"not with an overshoot of {MOST_OVERSHOOT_MM} mm or less"
    overshoot = float(brentq(height, 0.0, MOST_OVERSHOOT_MM))

    def miss(ln_settling: float) -> float:
        found = hold_exponential(*settling_force(static, depth, overshoot, np.exp(ln_settling)))
        return found[1] - branch.tau_s

    low, high = np.log(SETTLING_S)
    if miss(low) * miss(high) > 0.0:
        return "no: no settling time gives it"
    settling = float(np.exp(brentq(miss, low, high, xtol=1e-3)))
    amplitude, tau = hold_exponential(*settling_force(static, depth, overshoot, settling))
    return (
        f"yes: an elastic tissue, {overshoot:.2f} mm of overshoot that settles within "
        f"{1e3 * settling:.0f} ms and a filter of {1e3 * FILTER_S:.0f} ms give {amplitude:.1f} N and "
        f"{tau:.4f} s when the hold is fitted by itself"
    )


#: Shape of the static curve of a test, scaled to its peak: softening, then hardening [N/mm, N/mm2, N/mm3].
SHAPE = (20.0, -1.2, 0.35)
#: White noise of the load cell [N]: what a spread of 1.7 % over four tests needs at 1 kHz.
SIGMA_N = 0.15
HOLD_S = 30.0
#: The largest of some hundred samples of noise lies as high above the peak [N].
PEAK_TOLERANCE_N = 0.5
#: Points of a drawn record.
DRAWN = 400


def relaxation_tests(readings: Readings, effort: Effort) -> tuple[list[Item], Figure]:
    """Rows of Table 1, and Fig. 2."""
    items: list[Item] = []
    traces: list[Trace] = []
    for depth in DEPTHS_MM:
        effort.progress(f"Table 1: relaxation at {depth} mm")
        ledger = Ledger(SADEGHNEJAD, "Table 1")
        recipe = _recipe(ledger, readings, depth, effort.rate_Hz)
        if recipe is None:
            items += _impossible(ledger, depth)
            continue
        trials = read_back(recipe, seed=effort.seed + depth)
        items += _rows(ledger, readings, effort, depth, trials)
        traces.append(_trace(depth, trials[0]))
    items.append(_mean())
    items.append(_share_left(readings))
    return items, _figure(traces)


def _recipe(ledger: Ledger, readings: Readings, depth: int, rate_Hz: float) -> Recipe | None:
    """One test whose force peaks at the printed value; ``None`` where the branch alone exceeds it."""
    branch = read_branch(ledger, readings, f"table-1/tau-{depth}mm")
    rest = ledger.printed(f"table-1/peak-{depth}mm") - branch_force(branch, depth, HOLD_SPEED_MM_MIN)
    if rest <= 0.0:
        return None
    shape = ledger.assume("shape of the static curve of a test: 20 x - 1.2 x^2 + 0.35 x^3, scaled", SHAPE)
    scale = rest / sum(a * depth**power for power, a in enumerate(shape, start=1))
    return Recipe(
        f"relaxation-{depth}mm",
        (Log(f"hold-{depth}", (Move(float(depth), HOLD_SPEED_MM_MIN), Hold(HOLD_S))),),
        rate_Hz=ledger.assume(f"sampled at {rate_Hz:g} Hz", rate_Hz),
        static=tuple(scale * a for a in shape),
        branches=(branch,),
        sigma_N=ledger.assume(f"white noise of {SIGMA_N} N", SIGMA_N),
        specimen=f"test at {depth} mm",
    )


def _rows(ledger: Ledger, readings: Readings, effort: Effort, depth: int, trials: list[Trial]) -> list[Item]:
    degree = 0 if readings.stiffness == "constant" else 1
    (fit,) = fitted(trials, effort, stiffness_degree=degree)
    value, interval = relaxation_of(fit, readings)
    imitation = elastic_imitation(ledger.branch(), readings, depth)
    return [
        replace(
            ledger.item(
                f"table-1/peak-{depth}mm", float(trials[0].force_N.max()), judge=near(PEAK_TOLERANCE_N, "N")
            ),
            instrument="no: a force, not a time",
        ),
        replace(
            ledger.item(f"table-1/tau-{depth}mm", value, interval=interval, judge=within_interval()),
            instrument=imitation,
        ),
    ]


def _impossible(ledger: Ledger, depth: int) -> list[Item]:
    note = "under these readings the branch alone exceeds the printed peak: they contradict the table"
    return [ledger.item(f"table-1/{name}-{depth}mm", None, note=note) for name in ("peak", "tau")]


def _mean() -> Item:
    """Table 2's relaxation time from Table 1's."""
    ledger = Ledger(SADEGHNEJAD, "Table 2")
    mean = float(np.mean([ledger.printed(f"table-1/tau-{depth}mm") for depth in DEPTHS_MM]))
    return ledger.item(
        "table-2/mean-of-table-1",
        mean,
        against="table-2/tau",
        said=Said("Relaxation time of Table 2 as the mean of Table 1's"),
        judge=rounded(3),
    )


def _share_left(readings: Readings) -> Item:
    """Share of the deepest test that can relax at all."""
    ledger = Ledger(SADEGHNEJAD, "Fig. 2")
    branch = read_branch(ledger, readings)
    force = branch_force(branch, DEPTHS_MM[-1], HOLD_SPEED_MM_MIN)
    over = f"95 % of it are over {3.0 * branch.tau_s:.3g} s after the ramp"
    return ledger.item(
        "figure-2/drop-8mm",
        force,
        said=Said("Force that relaxes after the ramp to 8 mm", "N"),
        note=f"{over}: a curve that falls over 30 s needs a second, slower branch"
        if readings.relaxation == "time"
        else over,
    )


def _trace(depth: int, trial: Trial) -> Trace:
    """A record thinned so that its corner stays."""
    corner = int(np.argmax(trial.force_N))
    fine = np.arange(max(corner - DRAWN // 4, 0), min(corner + DRAWN // 4, trial.time_s.size))
    coarse = np.linspace(0, trial.time_s.size - 1, DRAWN // 2).astype(int)
    kept = np.union1d(fine, coarse)
    return Trace(f"{depth} mm", points(trial.time_s[kept], 5), points(trial.force_N[kept]), "line", None)


def _figure(traces: list[Trace]) -> Figure:
    return Figure(
        "figure-2",
        SADEGHNEJAD,
        "Fig. 2",
        "Force against time, four depths",
        Kind.ROUND_TRIP if traces else Kind.NOT_REPRODUCIBLE,
        "Synthesised so that each peak is the printed one. With the branch of Table 2 all that relaxes is "
        "over some 60 ms after the ramp; the recordings of the paper are not published.",
        "Time [s]",
        "Force [N]",
        x_log=False,
        drawing=None,
        traces=tuple(traces),
    )
