"""Effective draws a second of our sampler and of emcee on the samples, on one posterior, in the same run.

The posterior: paper-a-30-k1 at 1 kHz (N = 571,614), one branch, K of degree 1, one static curve for all logs,
white noise, no machine: 7 parameters (3 of F_s, 2 of K, ln tau, ln sigma).  What is slow is timed on few
steps: a step of ``lmfit.Minimizer.emcee`` (64 walkers) and of raw emcee on the samples.  Their effective
draws follow from the autocorrelation time that the same moves have on the blocks of the fit: the posterior is
the same, which is said as the distance of its means from lmfit's optimum on the samples, in standard
deviations.

    python benchmarks/posterior.py [--json] [--draws 2000] [--clock wall|cpu]

Ours is timed from the optimum to the draws, whitening included.  Its effective draws are the least of the
chain that is kept, as a result quotes them; those of the importance sampling before it are listed beside.
Ratios count; seconds belong to one machine.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
import time
import warnings
from collections.abc import Callable

import emcee
import lmfit
import numpy as np
from fit import DEPTH, OPTIONS, handles, logs
from harness import command_line
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from tissueid.inference.diagnostics import diagnose
from tissueid.inference.engine import Identified
from tissueid.inference.sampling import sample
from tissueid.inference.specimen import fit_with_state
from tissueid.inference.target import SpecimenTarget
from tissueid.trial import Trial

SEED = 20260404
WALKERS = 64
STEP_S = 1e-3
#: Steps that the slow samplers are timed on; steps and burn-in of the stretch move on the blocks.
TIMED_STEPS = 3
STRETCH_STEPS, STRETCH_BURN = 4_000, 500
REPEATS = 3
Clock = Callable[[], float]
CLOCKS: dict[str, Clock] = {"wall": time.perf_counter, "cpu": time.process_time}
BARS = {"emcee": 1_500.0}
NAMES = ("a1", "a2", "a3", "b0", "b1", "ln_tau", "ln_sigma")


class Direct:
    """The likelihood on the samples, by a vectorised recursion; theta by powers of u = x / depth."""

    def __init__(self, trials: list[Trial]) -> None:
        x = np.concatenate([t.displacement_mm for t in trials]) / DEPTH
        self.u, self.static = x, x[:, None] ** np.arange(1, 4)
        self.y = np.concatenate([t.force_N for t in trials])
        self.steps = [np.diff(t.displacement_mm, prepend=t.displacement_mm[0]) for t in trials]

    def residual(self, p: np.ndarray) -> np.ndarray:
        """Model less force [N]."""
        tau = math.exp(p[5])
        a = math.exp(-STEP_S / tau)
        s = np.concatenate([lfilter([(1 - a) * tau / STEP_S], [1.0, -a], dx) for dx in self.steps])
        return self.static @ p[:3] + (p[3] + p[4] * self.u) * s - self.y

    def log_density(self, p: np.ndarray) -> float:
        """Ln of the likelihood; flat priors."""
        r = self.residual(p)
        return -r.size * (p[6] + 0.5 * math.log(2 * math.pi)) - 0.5 * float(r @ r) * math.exp(-2 * p[6])


def seven(target: SpecimenTarget, z: np.ndarray) -> np.ndarray:
    """The 7 parameters of points of shape (n, 7)."""
    vectors = target.vectors(z)
    shared = target.shared(vectors)
    theta = target.law.theta(shared[:, :1], shared[:, 4:])
    unit = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    sigma = vectors[:, target.places["ln_sigma"]]
    return np.column_stack([theta[:, :5] * unit, np.log(theta[:, 5]), sigma])


def least_ess(chains: np.ndarray) -> float:
    """Smallest bulk effective sample size of any parameter; chains of shape (chains, draws, 7)."""
    found = diagnose({name: chains[:, :, k] for k, name in enumerate(NAMES)})
    return min(one.ess_bulk for one in found.values())


def timed(function: Callable[[], object], clock: Clock, repeats: int = REPEATS) -> float:
    """Median time of calls, after one that is not counted."""
    function()
    times = []
    for _ in range(repeats):
        start = clock()
        function()
        times.append(clock() - start)
    return statistics.median(times)


def own_sampler(found: Identified, draws: int, clock: Clock) -> dict[str, float]:
    """Effective draws a second from the optimum to the chain, the median of repeats."""
    rows = []
    for repeat in range(REPEATS):
        start = clock()
        target = SpecimenTarget(found, machine=False)
        chain = sample(target, draws=draws, seed=repeat)
        points = seven(target, chain.chain.reshape(-1, target.size))
        spent = clock() - start
        ess = least_ess(points.reshape(*chain.chain.shape[:2], 7))
        evaluations = chain.detail["proposals"] + chain.chain.shape[0] * chain.chain.shape[1]
        rows.append(
            {
                "seconds": spent,
                "ess": ess,
                "ess_per_s": ess / spent,
                "ess_per_evaluation": ess / evaluations,
                "importance_ess": chain.detail["effective_draws"],
                "converged": chain.converged,
            }
        )
    return sorted(rows, key=lambda row: row["ess_per_s"])[REPEATS // 2]


def stretch_time(target: SpecimenTarget, z: np.ndarray) -> float:
    """Longest autocorrelation time of the stretch move [steps], measured on the blocks."""
    sampler = emcee.EnsembleSampler(WALKERS, target.size, target.densities, vectorize=True)
    sampler.random_state = np.random.RandomState(SEED).get_state()
    sampler.run_mcmc(z[:WALKERS], STRETCH_STEPS)
    return float(sampler.get_autocorr_time(discard=STRETCH_BURN, tol=0).max())


def _lmfit(direct: Direct, cloud: np.ndarray) -> lmfit.Minimizer:
    """Parameters at the mean of a cloud, and the residual on the samples."""
    parameters = lmfit.Parameters()
    for name, value in zip(NAMES[:6], cloud.mean(axis=0), strict=False):
        parameters.add(name, value=value)

    def residual(p: lmfit.Parameters) -> np.ndarray:
        return direct.residual([p[name].value for name in NAMES[:6]])

    return lmfit.Minimizer(residual, parameters)


def lmfit_step(direct: Direct, cloud: np.ndarray, clock: Clock) -> float:
    """Seconds of one step of lmfit.Minimizer.emcee: a long run less a short one."""
    minimizer = _lmfit(direct, cloud)
    minimizer.params.add("__lnsigma", value=float(cloud[:, 6].mean()), min=-5.0, max=5.0)

    def run(steps: int) -> float:
        start = clock()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            minimizer.emcee(
                steps=steps, nwalkers=WALKERS, pos=cloud[:WALKERS], is_weighted=False, progress=False
            )
        return clock() - start

    short = run(1)
    return (run(1 + TIMED_STEPS) - short) / TIMED_STEPS


def raw_step(direct: Direct, cloud: np.ndarray, clock: Clock) -> float:
    """Seconds of one step of emcee on the vectorised likelihood of the samples."""
    sampler = emcee.EnsembleSampler(WALKERS, 7, direct.log_density)
    state = sampler.run_mcmc(cloud[:WALKERS], 1)
    start = clock()
    sampler.run_mcmc(state, TIMED_STEPS)
    return (clock() - start) / TIMED_STEPS


def from_samples(direct: Direct, cloud: np.ndarray) -> float:
    """Largest distance of a mean of the draws from lmfit's optimum on the samples [sd of the draws]."""
    found = _lmfit(direct, cloud).minimize(method="leastsq")
    optimum = np.array([found.params[name].value for name in NAMES[:6]])
    return float(np.abs((cloud.mean(axis=0)[:6] - optimum) / cloud.std(axis=0)[:6]).max())


def compare(draws: int, clock: Clock) -> dict[str, object]:
    """Everything."""
    trials = logs()
    start = clock()
    found = fit_with_state("bench", handles(trials), options=OPTIONS, machine=False).identified
    setup = clock() - start
    with threadpool_limits(limits=1, user_api="blas"):
        rows = {"emcee": own_sampler(found, draws, clock)}
        target = SpecimenTarget(found, machine=False)
        chain = sample(target, draws=draws, seed=SEED).chain
        z = np.random.default_rng(SEED).permutation(chain.reshape(-1, target.size))
        cloud, direct = seven(target, z), Direct(trials)
        likelihood = {
            "direct_s": timed(lambda: direct.log_density(cloud[0]), clock),
            "blocks_s": timed(lambda: target.densities(z), clock) / len(z),
            "means_from_samples_sd": from_samples(direct, cloud),
        }
        tau = stretch_time(target, z)
        for name, step in (
            ("lmfit_emcee", lmfit_step(direct, cloud, clock)),
            ("raw_emcee", raw_step(direct, cloud, clock)),
        ):
            rows[name] = {
                "step_s": step,
                "ess_per_s": WALKERS / (tau * step),
                "timed_steps": TIMED_STEPS,
                "autocorrelation_steps": tau,
                "ess_per_evaluation": 1 / tau,
            }
    base = rows["lmfit_emcee"]["ess_per_s"]
    return {
        "n": int(direct.y.size),
        "parameters": 7,
        "draws": draws,
        "clock": next(name for name, one in CLOCKS.items() if one is clock),
        "fit_s": setup,
        "samplers": rows,
        "likelihood": likelihood,
        "ratio_to_lmfit_emcee": {"emcee": rows["emcee"]["ess_per_s"] / base},
        "ratio_by_importance": rows["emcee"]["importance_ess"] / rows["emcee"]["seconds"] / base,
        "ratio_raw_emcee": rows["raw_emcee"]["ess_per_s"] / base,
        "factors": {
            "blocks": likelihood["direct_s"] / likelihood["blocks_s"],
            "sampler": rows["emcee"]["ess_per_evaluation"] * tau,
        },
        "bars": BARS,
    }


def main() -> int:
    """Run, print, and say whether the bars were met."""
    parser = command_line(__doc__)
    parser.add_argument("--draws", type=int, default=2_000)
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="cpu where the machine is busy")
    options = parser.parse_args()
    result = compare(options.draws, CLOCKS[options.clock])
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        for name, row in result["samplers"].items():
            print(
                f"{name:12} {row['ess_per_s']:12.1f} effective draws a second, "
                f"{row['ess_per_evaluation']:.3f} for an evaluation"
            )
        for name, ratio in result["ratio_to_lmfit_emcee"].items():
            print(f"{name:12} {ratio:12,.0f} times lmfit.Minimizer.emcee (bar {BARS[name]:,.0f})")
        print(f"factors      {result['factors']}")
    met = all(result["ratio_to_lmfit_emcee"][name] >= bar for name, bar in BARS.items())
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
