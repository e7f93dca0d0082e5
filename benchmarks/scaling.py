"""What a likelihood costs: one evaluation at growing N, and the one pass over the samples before it.

Three questions, one run:

* ``evaluation``: time of one log density of the posterior (all linear parameters, gains and contact points
  integrated) for the same protocol recorded at 100 Hz, 1 kHz and 10 kHz, N = 57,000 to 5,700,000.  The noise
  grows with the root of N, so that all three posteriors are equally wide: a narrow one needs fewer nodes in
  ln tau and is cheaper, which would flatter large N.
* ``build``: nanoseconds a sample and node of the pass that makes the sums, over the whole range of relaxation
  times and near one; white and AR(1) noise, K of degree 0 and 1; one rate, three rates, an irregular clock.
  One thread, and two threads over logs.  The peer does the same work in plain numpy: one
  ``scipy.signal.lfilter`` a node, then one matrix product a log (uniform clock only: lfilter knows no other).
* ``memory``: peak of a pass over 10 and over 100 logs that are made one after the other.

    python benchmarks/scaling.py [--json] [--part evaluation|build|memory] [--repeats 5]

Work of the pass: with n nodes and K of degree d a sample costs (2 d + 1) n^2 / 2 multiply-adds for white
noise, one small product for every power of x; for AR(1) noise m^2 / 2 for the differences of all
m = n (d + 1) + 5 columns and, for d = 1, three quarters of that for their means.  At 29 multiply-adds a
nanosecond, eight a step at 3.66 GHz, that is 3.2 and 8.1 ns a sample and node for n = 62, d = 1.
On a busy machine the processor time of one thread says more than the clock on the
wall: both are printed.  Ratios count; nanoseconds belong to one machine.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.fit.window import fitted_log
from tissueid.likelihood.basis import KernelBasis, kernel_basis
from tissueid.likelihood.chains import chain_breaks
from tissueid.likelihood.lag_sums import lag_sums
from tissueid.likelihood.sums import LogData, log_sums
from tissueid.posterior.at_optimum import posterior_target
from tissueid.priors import Priors
from tissueid.synth import as_trials, recipe, simulate
from tissueid.trial import Contact, Phase, Segmentation, Trial

SEED = 20260104
RATES_HZ = (100.0, 1000.0, 10_000.0)
POINTS = 256
LOGS = 6
LOG_SAMPLES = 48_000
STEP_S = 1e-3
#: Around one relaxation time [s], as far as a fit looks once it has found it.
NEAR = (0.021 * np.exp(-0.4), 0.021 * np.exp(0.4))
BARS = {"evaluation_ratio": 1.2, "white_ns": 6.0, "irregular_or_ar1_ns": 15.0, "memory_ratio": 1.05}


def handle(trial: Trial) -> LogHandle:
    """A log as the fit takes it; contact at the first sample, as simulated."""
    stop = trial.time_s.size
    ramp = Phase("ramp", 0, stop, float(trial.time_s[0]), float(trial.time_s[-1]), 1.0)
    segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.02), (ramp,), 1.0)
    log = fitted_log(trial, segmentation)
    return LogHandle(
        load=lambda: trial, segmentation=segmentation, facts=log.without_samples(), contact_sd_mm=0.02
    )


def evaluation(repeats: int) -> dict[str, object]:
    """Microseconds of one log density at every N, best of the repeats, processor time of one thread."""
    targets = []
    for rate in RATES_HZ:
        made = replace(recipe("paper-a-30-k1"), rate_Hz=rate, sigma_N=(rate / 1000.0) ** 0.5)
        trials = as_trials(simulate(made, rng=np.random.default_rng(SEED)), specimen="bench")
        handles = [handle(trial) for trial in trials]
        options = FitOptions(branches=1, stiffness_degree=1)
        target = posterior_target(fit_with_state("bench", handles, options=options), Priors())
        n = sum(trial.time_s.size for trial in trials)
        rng = np.random.default_rng(SEED)
        points = rng.multivariate_normal(target.mode, target.covariance, size=POINTS)
        target.log_density(points)
        targets.append((n, target, points))
    best = dict.fromkeys((n for n, _, _ in targets), np.inf)
    for _ in range(20 * repeats):
        for n, target, points in targets:
            start = time.thread_time()
            target.log_density(points)
            best[n] = min(best[n], (time.thread_time() - start) / POINTS * 1e6)
    us = list(best.values())
    return {
        "us": {str(n): value for n, value in best.items()},
        "ratio": max(us) / min(us),
        "largest_over_smallest_n": us[-1] / us[0],
        "coordinates": list(targets[0][1].names),
    }


def clock(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Time stamps of one log."""
    step = np.full(LOG_SAMPLES - 1, STEP_S)
    if kind == "three rates":
        third = LOG_SAMPLES // 3
        step[third : 2 * third] = 10.0 * STEP_S
        step[2 * third :] = 4.0 * STEP_S
    elif kind == "irregular":
        step = rng.uniform(0.5 * STEP_S, 1.5 * STEP_S, size=LOG_SAMPLES - 1)
    return np.concatenate([[0.0], np.cumsum(step)])


def log(kind: str, seed: int) -> LogData:
    """A ramp to 8 mm in a quarter of the record, and a hold."""
    rng = np.random.default_rng(seed)
    t = clock(kind, rng)
    depth = np.minimum(t / t[-1] * 32.0, 8.0) + rng.normal(scale=1e-4, size=t.size)
    depth -= depth[0]
    force = 20.0 * depth + rng.normal(size=t.size)
    # breaks in the chain of noise are looked for once a log, when it is read, not in every pass
    return LogData(
        t, depth, force, np.ones(t.size, dtype=bool), np.zeros(t.size, dtype=np.int64), chain_breaks(t)
    )


def peer_build(data: LogData, basis: KernelBasis, degree: int, *, correlated: bool) -> np.ndarray:
    """The Gram matrices in plain numpy: a filter a node, a product a log."""
    x = data.depth_mm
    dx = np.diff(x, prepend=x[0])
    columns = [np.ones_like(x), x, x**2, x**3]
    states = []
    for tau in basis.tau_s:
        a = np.exp(-STEP_S / tau)
        states.append(lfilter([-np.expm1(-STEP_S / tau) * tau / STEP_S], [1.0, -a], dx))
    columns += [s * x**power for power in range(degree + 1) for s in states]
    z = np.column_stack([*columns, data.force_N])
    if not correlated:
        return z.T @ z
    change = np.diff(z, axis=0)
    return np.stack([z[1:].T @ z[1:], z[:-1].T @ z[:-1], change.T @ change])


def timed(run: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Best seconds on the wall and of this thread's processor time."""
    wall = cpu = np.inf
    for _ in range(repeats):
        first, mine = time.perf_counter(), time.thread_time()
        run()
        wall, cpu = min(wall, time.perf_counter() - first), min(cpu, time.thread_time() - mine)
    return wall, cpu


def build(repeats: int) -> list[dict[str, object]]:
    """Nanoseconds a sample and node of every kind of pass."""
    rows = []
    for kind, near in (("uniform", False), ("three rates", False), ("irregular", False), ("uniform", True)):
        logs = [log(kind, seed) for seed in range(LOGS)]
        longest = max(float(one.time_s[-1]) for one in logs)
        log_range = (float(np.log(NEAR[0])), float(np.log(NEAR[1]))) if near else None
        basis = kernel_basis(step_s=STEP_S, length_s=longest, log_range=log_range)
        cells = LOGS * LOG_SAMPLES * basis.tau_s.size / 1e9
        for correlated in (False, True):
            for degree in (0, 1):

                def ours(
                    data: LogData, *, basis: KernelBasis = basis, degree: int = degree, lag: bool = correlated
                ) -> object:
                    if lag:
                        return lag_sums(data, basis, degree=degree, reference_step_s=STEP_S)
                    return log_sums(data, basis, degree=degree)

                def two_threads(ours: Callable[[LogData], object] = ours, logs: list[LogData] = logs) -> None:
                    with ThreadPoolExecutor(2) as pool:
                        list(pool.map(ours, logs))

                ours(logs[0])
                wall, cpu = timed(lambda ours=ours, logs=logs: [ours(one) for one in logs], repeats)
                row = {
                    "clock": kind,
                    "range": "near one tau" if near else "whole",
                    "noise": "ar1" if correlated else "white",
                    "degree": degree,
                    "nodes": basis.tau_s.size,
                    "ns": wall / cells,
                    "cpu_ns": cpu / cells,
                    "two_threads_ns": timed(two_threads, repeats)[0] / cells,
                    "bar_ns": BARS[
                        "irregular_or_ar1_ns" if correlated or kind == "irregular" else "white_ns"
                    ],
                }
                if kind == "uniform":
                    theirs = timed(
                        lambda b=basis, d=degree, c=correlated, one=logs[0]: peer_build(
                            one, b, d, correlated=c
                        ),
                        max(repeats // 2, 1),
                    )
                    row["numpy_ns"] = theirs[0] * LOGS / cells
                    row["numpy_cpu_ns"] = theirs[1] * LOGS / cells
                rows.append(row)
    return rows


def memory() -> dict[str, float]:
    """Peak bytes of a pass over logs that are made one after the other."""
    basis = kernel_basis(step_s=STEP_S, length_s=LOG_SAMPLES * STEP_S)
    lag_sums(log("uniform", 0), basis, degree=1, reference_step_s=STEP_S)
    peaks = {}
    for count in (10, 100):
        tracemalloc.start()
        total = None
        for seed in range(count):
            sums = lag_sums(log("uniform", seed), basis, degree=1, reference_step_s=STEP_S)
            total = sums if total is None else total.merged(sums)
        peaks[count] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return {
        "peak_bytes_10_logs": peaks[10],
        "peak_bytes_100_logs": peaks[100],
        "ratio": peaks[100] / peaks[10],
        "samples_of_100_logs": 100 * LOG_SAMPLES,
    }


def main() -> int:
    """Run, print, and say what the bars are."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("evaluation", "build", "memory"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result: dict[str, object] = {"bars": BARS}
    # one BLAS thread, as in a fit: its threads would meet after every chunk
    with threadpool_limits(limits=1, user_api="blas"):
        if options.part in (None, "evaluation"):
            result["evaluation"] = evaluation(options.repeats)
        if options.part in (None, "build"):
            result["build"] = build(options.repeats)
        if options.part in (None, "memory"):
            result["memory"] = memory()
    if options.json:
        print(json.dumps(result, indent=2))
        return 0
    for key, value in result.items():
        if key == "build":
            for row in value:
                print(
                    f"{row['clock']:12} {row['range']:12} {row['noise']:6} degree {row['degree']}, "
                    f"{row['nodes']} nodes: "
                    f"{row['ns']:6.2f} ns a sample and node (processor {row['cpu_ns']:.2f}), two threads "
                    f"{row['two_threads_ns']:.2f}, bar {row['bar_ns']:.0f}"
                    + (f", numpy {row['numpy_ns']:.1f}" if "numpy_ns" in row else "")
                )
        else:
            print(key, json.dumps(value))
    return 0


if __name__ == "__main__":
    sys.exit(main())
