"""Time and memory of a fit against lmfit on the samples, both in the same run.

The peer is what a careful notebook does: ``lmfit.minimize(leastsq)`` with numerical derivatives on a
vectorised numpy model (recursion by ``scipy.signal.lfilter``).  Same data (paper-a-30-k1 at 1 kHz,
N = 571,614), same model (one branch, K of degree 1), same start, same tolerance; both must end at the
same sum of squares to 1e-6.  Ours is timed from the samples: one pass for the sums, then lmfit on the
compressed residual.

    python benchmarks/fit.py [--pairs 3] [--json]

Work: the pass is samples x columns^2 multiply-adds (about 130 columns: 10 Gflop at N = 571,614); the
peer's is (parameters + 1) evaluations of the model an iteration, each several passes over the samples.
Ratios count; seconds belong to one machine.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import lmfit
import numpy as np
from scipy.signal import lfilter

from tissueid.fit.lm import levenberg_marquardt
from tissueid.fit.specimen import FitOptions
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.objective import PooledObjective, per_log_gram, shared_gram
from tissueid.likelihood.sums import LogData, log_sums
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.synth import as_trials, recipe, simulate
from tissueid.trial import Source, Trial

SEED = 20260101
START_TAU = 0.04
DEPTH = 8.0
FTOL = XTOL = 1e-8
STATIC_START = (15.0, 0.0, 0.2)
STIFFNESS_START = (50.0, 5.0)
SAME_OPTIMUM = 1e-6


def logs() -> list[Trial]:
    """The 30 logs."""
    return as_trials(simulate(recipe("paper-a-30-k1"), rng=np.random.default_rng(SEED)), specimen="bench")


def ours(trials: list[Trial], *, static: bool) -> float:
    """Sum of squares reached by the compressed fit."""
    step = 1e-3
    basis = kernel_basis(step_s=step, length_s=max(float(t.time_s[-1]) for t in trials))
    sums = []
    for trial in trials:
        n = trial.time_s.size
        data = LogData(
            trial.time_s, trial.displacement_mm, trial.force_N, np.ones(n, bool), np.zeros(n, np.int64)
        )
        sums.append(log_sums(data, basis, degree=1).gram[0])
    gram = np.stack(sums)
    pooled = shared_gram(gram.sum(axis=0)) if static else per_log_gram(gram, np.arange(len(gram)))
    objective = PooledObjective(
        gram=pooled, basis=basis, scale=DEPTH, branches=1, degree=1, columns_degree=1, static=static
    )
    bounds = (float(np.log(step / 5)), float(np.log(480.0)))
    start = objective.evaluate(np.array([np.log(START_TAU)]))
    static_u = np.array(STATIC_START) * DEPTH ** np.arange(1, 4)
    stiffness_u = np.array(STIFFNESS_START) * DEPTH ** np.arange(2)
    theta = np.concatenate([static_u, stiffness_u]) if static else stiffness_u
    return levenberg_marquardt(objective, replace(start, theta=theta), bounds).value


def peer(trials: list[Trial], *, static: bool) -> float:
    """Sum of squares reached by lmfit on the samples, derivatives by differences."""
    x = np.concatenate([t.displacement_mm for t in trials])
    y = np.concatenate([t.force_N for t in trials])
    sizes = [t.time_s.size for t in trials]
    edges = np.concatenate([[0], np.cumsum(sizes)])
    steps = [np.diff(t.displacement_mm, prepend=t.displacement_mm[0]) for t in trials]
    log = np.repeat(np.arange(len(trials)), sizes)

    def residual(parameters: lmfit.Parameters) -> np.ndarray:
        p = {key: value.value for key, value in parameters.items()}
        tau = np.exp(p["ln_tau"])
        a = np.exp(-1e-3 / tau)
        phi = (1 - a) * tau / 1e-3
        s = np.concatenate([lfilter([phi], [1.0, -a], dx) for dx in steps])
        if static:
            rest = x * (p["a1"] + x * (p["a2"] + x * p["a3"]))
        else:
            c = np.array([[p[f"a{k}_{i}"] for k in range(4)] for i in range(len(trials))])
            rest = np.empty_like(x)
            for i in range(len(trials)):
                part = slice(edges[i], edges[i + 1])
                rest[part] = np.polynomial.polynomial.polyval(x[part], c[i])
        return rest + (p["b0"] + p["b1"] * x) * s - y

    parameters = lmfit.Parameters()
    if static:
        for k, value in enumerate(STATIC_START, 1):
            parameters.add(f"a{k}", value=value)
    else:
        for i in range(len(trials)):
            for k, value in enumerate((0.0, *STATIC_START)):
                parameters.add(f"a{k}_{i}", value=value)
    parameters.add("b0", value=STIFFNESS_START[0])
    parameters.add("b1", value=STIFFNESS_START[1])
    parameters.add("ln_tau", value=np.log(START_TAU))
    del log
    found = lmfit.minimize(residual, parameters, method="leastsq", ftol=FTOL, xtol=XTOL, calc_covar=False)
    return float(found.chisqr)


def compare(trials: list[Trial], *, static: bool, pairs: int) -> dict[str, float]:
    """Median of interleaved pairs."""
    ours(trials[:2], static=static)
    times: list[tuple[float, float]] = []
    for _ in range(pairs):
        start = time.perf_counter()
        mine = ours(trials, static=static)
        middle = time.perf_counter()
        theirs = peer(trials, static=static)
        times.append((middle - start, time.perf_counter() - middle))
    difference = mine / theirs - 1.0
    return {
        "ours_s": statistics.median(a for a, _ in times),
        "lmfit_s": statistics.median(b for _, b in times),
        "ratio": statistics.median(a / b for a, b in times),
        "relative_difference_of_optimum": difference,
        "same_optimum": abs(difference) <= SAME_OPTIMUM,
    }


def _peak(folder: str, count: int, queue: multiprocessing.Queue) -> None:
    """Fit ``count`` logs of a folder, each loaded when needed; report the peak memory."""
    names = [str(Path(folder) / f"{i:03d}.npy") for i in range(count)]

    def load(source: Source) -> Trial:
        time_s, displacement, force = np.load(source.path)
        return Trial(
            specimen="bench", time_s=time_s, displacement_mm=displacement, force_N=force, source=source
        )

    options = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=1))
    found = identify((load(Source(path=name)) for name in names), options=options, reload=load)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    queue.put((peak, found.specimens[0].n_samples))


def memory() -> dict[str, float]:
    """Peak memory of a fit at ten times the samples, each in a process of its own."""
    context = multiprocessing.get_context("spawn")
    out: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        rng = np.random.default_rng(SEED)
        for repeat in range(10):
            for i, log in enumerate(simulate(recipe("paper-a-30-k1"), rng=rng)):
                samples = np.stack([log.time_s, log.displacement_mm, log.force_N])
                np.save(Path(folder) / f"{30 * repeat + i:03d}.npy", samples)
        for count in (30, 300):
            queue = context.Queue()
            process = context.Process(target=_peak, args=(folder, count, queue))
            process.start()
            peak, n = queue.get()
            process.join()
            out[f"peak_bytes_N_{n}"] = peak
    small, large = out.values()
    return out | {"ratio": large / small}


def main() -> int:
    """Run, print, and say whether the bars were met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    trials = logs()
    result = {
        "n": sum(t.time_s.size for t in trials),
        "shared": compare(trials, static=True, pairs=options.pairs),
        "per_log": compare(trials, static=False, pairs=1),
        "memory": memory(),
        "bars": {"shared": 1 / 3, "per_log": 1 / 10, "memory": 1.3},
    }
    if options.json:
        print(json.dumps(result, indent=2))
        return 0
    for name in ("shared", "per_log"):
        one = result[name]
        print(
            f"{name:8} ours {one['ours_s']:.3f} s, lmfit on samples {one['lmfit_s']:.3f} s, "
            f"ratio {one['ratio']:.3f} (bar {result['bars'][name]:.3f}), "
            f"optimum differs by {one['relative_difference_of_optimum']:.1e}"
        )
    print(f"memory   {result['memory']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
