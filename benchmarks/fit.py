"""Time and memory of a fit against lmfit on the samples, both in the same run.

The peer is what a careful notebook does: ``lmfit.minimize(leastsq)`` with numerical derivatives on a
vectorised numpy model (recursion by ``scipy.signal.lfilter``).  Same data (paper-a-30-k1 at 1 kHz,
N = 571,614), same model (one branch, K of degree 1, one static curve, white noise, no machine).  Ours is
timed from the samples to all that a fit says, the second pass over the logs for residuals and measured
numbers included, and needs no start.  Both relaxation times are given, and their difference in our standard
errors.

    python benchmarks/fit.py [--pairs 3] [--json]

The peer's work is (parameters + 1) evaluations of the model an iteration, each several passes over the
samples.  Ratios count; seconds belong to one machine.
"""

from __future__ import annotations

import json
import multiprocessing
import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import lmfit
import numpy as np
from harness import command_line, peak_MB
from scipy.signal import lfilter

from tissueid.inference.logs import LogHandle
from tissueid.inference.specimen import FitOptions, fit_with_state
from tissueid.inference.window import fitted_log
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.synth import as_trials, recipe, simulate
from tissueid.trial import Contact, Phase, Segmentation, Source, Trial

SEED = 20260101
START_TAU = 0.04
DEPTH = 8.0
FTOL = XTOL = 1e-8
STATIC_START = (15.0, 0.0, 0.2)
STIFFNESS_START = (50.0, 5.0)
OPTIONS = FitOptions(branches=1, stiffness_degree=1, static="shared", noise="white")


def logs() -> list[Trial]:
    """The 30 logs."""
    return as_trials(simulate(recipe("paper-a-30-k1"), rng=np.random.default_rng(SEED)), specimen="bench")


def handles(trials: list[Trial]) -> list[LogHandle]:
    """The logs as the fit takes them; contact at the first sample, as simulated."""
    out = []
    for trial in trials:
        stop = trial.time_s.size
        ramp = Phase("ramp", 0, stop, float(trial.time_s[0]), float(trial.time_s[-1]), 1.0)
        segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.02), (ramp,), 1.0)
        log = fitted_log(trial, segmentation)
        out.append(
            LogHandle(
                load=lambda trial=trial: trial,
                segmentation=segmentation,
                facts=log.without_samples(),
                contact_sd_mm=0.02,
            )
        )
    return out


def ours(trials: list[Trial]) -> tuple[float, float]:
    """Relaxation time [s] and its standard error."""
    fit = fit_with_state("bench", handles(trials), options=OPTIONS, machine=False).fit
    detail = fit.parameter("relaxation_time_s").detail
    return float(detail["estimate"]), float(detail["estimate_stderr"])


def peer(trials: list[Trial]) -> float:
    """Relaxation time [s] of lmfit on the samples, derivatives by differences."""
    x = np.concatenate([t.displacement_mm for t in trials])
    y = np.concatenate([t.force_N for t in trials])
    steps = [np.diff(t.displacement_mm, prepend=t.displacement_mm[0]) for t in trials]

    def residual(parameters: lmfit.Parameters) -> np.ndarray:
        p = {key: value.value for key, value in parameters.items()}
        tau = np.exp(p["ln_tau"])
        a = np.exp(-1e-3 / tau)
        phi = (1 - a) * tau / 1e-3
        s = np.concatenate([lfilter([phi], [1.0, -a], dx) for dx in steps])
        return x * (p["a1"] + x * (p["a2"] + x * p["a3"])) + (p["b0"] + p["b1"] * x) * s - y

    parameters = lmfit.Parameters()
    for k, value in enumerate(STATIC_START, 1):
        parameters.add(f"a{k}", value=value)
    parameters.add("b0", value=STIFFNESS_START[0])
    parameters.add("b1", value=STIFFNESS_START[1])
    parameters.add("ln_tau", value=np.log(START_TAU))
    found = lmfit.minimize(residual, parameters, method="leastsq", ftol=FTOL, xtol=XTOL, calc_covar=False)
    return float(np.exp(found.params["ln_tau"].value))


def compare(trials: list[Trial], pairs: int) -> dict[str, float]:
    """Median of interleaved pairs."""
    times: list[tuple[float, float]] = []
    for _ in range(pairs):
        start = time.perf_counter()
        mine, error = ours(trials)
        middle = time.perf_counter()
        theirs = peer(trials)
        times.append((middle - start, time.perf_counter() - middle))
    return {
        "ours_s": statistics.median(a for a, _ in times),
        "lmfit_s": statistics.median(b for _, b in times),
        "ratio": statistics.median(a / b for a, b in times),
        "relaxation_time_s": mine,
        "lmfit_relaxation_time_s": theirs,
        "difference_sd": (mine - theirs) / error,
    }


def _peak(folder: str, count: int) -> tuple[int, int]:
    """Fit ``count`` logs of a folder, each loaded when needed; report the peak memory."""
    names = [str(Path(folder) / f"{i:03d}.npy") for i in range(count)]

    def load(source: Source) -> Trial:
        time_s, displacement, force = np.load(source.path)
        return Trial(
            specimen="bench", time_s=time_s, displacement_mm=displacement, force_N=force, source=source
        )

    options = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=1))
    found = identify((load(Source(path=name)) for name in names), options=options, reload=load)
    return round(2**20 * peak_MB()), found.specimens[0].n_samples


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
            with ProcessPoolExecutor(1, mp_context=context) as pool:
                peak, n = pool.submit(_peak, folder, count).result()
            out[f"peak_bytes_N_{n}"] = peak
    small, large = out.values()
    return out | {"ratio": large / small}


def main() -> int:
    """Run, print, and say whether the bars were met."""
    parser = command_line(__doc__)
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--memory", action="store_true", help="memory only")
    options = parser.parse_args()
    if options.memory:
        print(json.dumps(memory(), indent=2))
        return 0
    trials = logs()
    result = {
        "n": sum(t.time_s.size for t in trials),
        "fit": compare(trials, options.pairs),
        "memory": memory(),
        "bars": {"memory": 1.3},
    }
    if options.json:
        print(json.dumps(result, indent=2))
        return 0
    one = result["fit"]
    print(
        f"fit      ours {one['ours_s']:.3f} s, lmfit on samples {one['lmfit_s']:.3f} s, "
        f"ratio {one['ratio']:.3f}, relaxation times differ by {one['difference_sd']:.2g} standard errors"
    )
    print(f"memory   {result['memory']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
