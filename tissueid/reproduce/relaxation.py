"""Table 1 and Fig. 2: four relaxation tests, synthesised from the printed numbers and fitted again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.reproduce.instrument import elastic_imitation
from tissueid.reproduce.items import Figure, Item, Kind, Trace, near, rounded, within_interval
from tissueid.reproduce.published import PUBLISHED, SADEGHNEJAD, Ledger, Published
from tissueid.reproduce.readings import Readings
from tissueid.reproduce.recordings import Effort, fitted, interval_of, read_back
from tissueid.reproduce.tissue import DEPTHS_MM, HOLD_SPEED_MM_MIN, branch_force, read_branch
from tissueid.synth.recipe import Hold, Log, Move, Recipe
from tissueid.trial import Trial

#: Shape of the static curve of a test, scaled to its peak: softening, then hardening [N/mm, N/mm2, N/mm3].
SHAPE = (20.0, -1.2, 0.35)
#: White noise of the load cell [N]: what a spread of 1.7 % over four tests needs at 1 kHz.
SIGMA_N = 0.15
HOLD_S = 30.0
#: The largest of some hundred samples of noise lies as high above the peak [N].
PEAK_TOLERANCE_N = 0.5
#: Points of a drawn record.
DRAWN = 400


def relaxation_tests(
    readings: Readings, effort: Effort, numbers: Mapping[str, Published] = PUBLISHED
) -> tuple[list[Item], Figure]:
    """Rows of Table 1, and Fig. 2.

    ``numbers``: published numbers.
    """
    items: list[Item] = []
    traces: list[Trace] = []
    for depth in DEPTHS_MM:
        effort.progress(f"Table 1: relaxation at {depth} mm")
        ledger = Ledger(SADEGHNEJAD, numbers)
        recipe = _recipe(ledger, readings, depth, effort.rate_Hz)
        if recipe is None:
            items += _impossible(ledger, depth)
            continue
        trials = read_back(recipe, seed=effort.seed + depth)
        items += _rows(ledger, readings, effort, depth, trials)
        traces.append(_trace(depth, trials[0]))
    items.append(_mean(numbers))
    items.append(_share_left(readings, numbers))
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
    value = fit.parameter("relaxation_time_s").value
    interval = interval_of(fit, "relaxation_time_s")
    if readings.relaxation == "rate":
        value = None if value is None else 1.0 / value
        interval = None if interval is None else (1.0 / interval[1], 1.0 / interval[0])
    imitation = elastic_imitation(ledger.branch(), readings, depth)
    return [
        ledger.item(
            f"table-1/peak-{depth}mm",
            float(trials[0].force_N.max()),
            judge=near(PEAK_TOLERANCE_N, "N"),
            instrument="no: a force, not a time",
        ),
        ledger.item(
            f"table-1/tau-{depth}mm",
            value,
            interval=interval,
            judge=within_interval(),
            instrument=imitation,
        ),
    ]


def _impossible(ledger: Ledger, depth: int) -> list[Item]:
    note = "under these readings the branch alone exceeds the printed peak: they contradict the table"
    return [ledger.item(f"table-1/{name}-{depth}mm", None, note=note) for name in ("peak", "tau")]


def _mean(numbers: Mapping[str, Published]) -> Item:
    """Table 2's relaxation time from Table 1's."""
    ledger = Ledger(SADEGHNEJAD, numbers)
    mean = float(np.mean([ledger.printed(f"table-1/tau-{depth}mm") for depth in DEPTHS_MM]))
    return ledger.item(
        "table-2/mean-of-table-1",
        mean,
        against="table-2/tau",
        words="Relaxation time of Table 2 as the mean of Table 1's",
        judge=rounded(3),
    )


def _share_left(readings: Readings, numbers: Mapping[str, Published]) -> Item:
    """Share of the deepest test that can relax at all."""
    ledger = Ledger(SADEGHNEJAD, numbers)
    branch = read_branch(ledger, readings)
    force = branch_force(branch, DEPTHS_MM[-1], HOLD_SPEED_MM_MIN)
    over = f"95 % of it are over {3.0 * branch.tau_s:.3g} s after the ramp"
    return ledger.item(
        "figure-2/drop-8mm",
        force,
        words="Force that relaxes after the ramp to 8 mm",
        unit="N",
        where="Fig. 2",
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
    return Trace(
        f"{depth} mm",
        tuple(round(float(t), 5) for t in trial.time_s[kept]),
        tuple(round(float(f), 4) for f in trial.force_N[kept]),
    )


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
        tuple(traces),
    )
