"""Effective draws a second of samplers on one posterior, all in the same run.

The posterior: paper-a-30-k1 at 1 kHz (N = 571,614), one branch, K of degree 1, one static curve for all logs,
white noise: 7 parameters (3 of F_s, 2 of K, ln tau, ln sigma).  Two factors make tissueid fast, and are
listed apart: the *sums* (a density costs the same at any N) and the *sampler* (effective draws for
an evaluation of the density, the linear parameters being integrated and drawn anew).

    python benchmarks/posterior.py [--json] [--draws 10000] [--clock wall|cpu]

What is slow is timed on few steps: a step of ``lmfit.Minimizer.emcee`` (64 walkers) and of raw emcee on the
samples, a leapfrog step of NUTS on the samples (one gradient).  Their effective draws follow from the
autocorrelation time, or from the draws for a leapfrog step, that the same sampler has on the sums: the
posterior is the same.  numpyro and jax are in benchmarks/requirements.txt; NUTS is left out without them.
NUTS starts at the mean and gets coordinates whitened by the posterior's covariance; its warm-up is not
counted.
Ratios count; seconds belong to one machine.
"""

from __future__ import annotations

import argparse
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
from fit import DEPTH, handles, logs
from scipy.signal import lfilter

from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.posterior.at_optimum import posterior_target
from tissueid.posterior.diagnostics import diagnose
from tissueid.posterior.ensemble import sample_ensemble
from tissueid.posterior.exact import sample_exact
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors
from tissueid.trial import Trial

SEED = 20260404
WALKERS = 64
STEP_S = 1e-3
#: Steps that the slow samplers are timed on; steps and burn-in of the stretch move on the sums.
TIMED_STEPS = 3
STRETCH_STEPS, STRETCH_BURN = 12_000, 2_000
NUTS_WARM_UP, NUTS_DRAWS = 500, 10_000
TIMED_GRADIENTS = 10
REPEATS = 3
Clock = Callable[[], float]
CLOCKS: dict[str, Clock] = {"wall": time.perf_counter, "cpu": time.process_time}
BARS = {"emcee": 1_500.0, "exact": 30_000.0}
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


class OnSums:
    """The same likelihood from the sums, for any array module (numpy, jax.numpy) and many points."""

    def __init__(self, target: SpecimenTarget, np_=np) -> None:
        data = target.data
        self.np = np_
        # white noise: chain starts and all later samples
        self.gram = np_.asarray(data.shared[0] + data.shared[1::3].sum(axis=0))
        self.nodes, self.weights = np_.asarray(data.nodes[0]), np_.asarray(data.barycentric[0])
        self.best, self.count = np_.asarray(data.best), data.samples
        self.mixing = np_.asarray(data.mixing[0])
        self.there = self._at(np_.asarray(data.best_tau[:1] + 1e-12))[0]

    def _at(self, log_tau):
        part = self.weights / (log_tau[:, None] - self.nodes)
        return part / part.sum(axis=1, keepdims=True) @ self.mixing.T

    def log_density(self, p):
        """Ln of the likelihood at points of shape (n, 7)."""
        here = self._at(p[:, 5])
        columns = [self.best[:3] - p[:, :3]]
        columns += [self.best[k] * self.there - p[:, k : k + 1] * here for k in (3, 4)]
        v = self.np.concatenate([*columns, self.np.ones((p.shape[0], 1))], axis=1)
        squares = ((v @ self.gram) * v).sum(axis=1)
        constant = p[:, 6] + 0.5 * math.log(2 * math.pi)
        return -self.count * constant - 0.5 * squares * self.np.exp(-2 * p[:, 6])


def seven(target: SpecimenTarget, points: np.ndarray, seed: int) -> np.ndarray:
    """The 7 parameters for sampled points of shape (n, 2), the linear ones drawn anew."""
    drawn = target.redraw(points, np.random.default_rng(seed))
    unit = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    return np.column_stack([drawn.theta[:, :5] * unit, points])


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


def tissueid_samplers(target: SpecimenTarget, draws: int, clock: Clock) -> dict[str, dict[str, float]]:
    """Effective draws a second of both samplers, the redraw of the linear parameters included."""
    out: dict[str, list[dict[str, float]]] = {"emcee": [], "exact": []}
    for repeat in range(REPEATS + 1):
        start = clock()
        chain = sample_ensemble(target, draws=draws, seed=repeat)
        parameters = seven(target, chain.points.reshape(-1, 2), repeat)
        spent = clock() - start
        ess = least_ess(parameters.reshape(*chain.points.shape[:2], 7))
        evaluations = chain.points.shape[0] * chain.steps
        row = {
            "seconds": spent,
            "ess": ess,
            "ess_per_s": ess / spent,
            "ess_per_evaluation": ess / evaluations,
        }
        out["emcee"].append(row)
        start = clock()
        exact = sample_exact(target, draws=draws, seed=repeat)
        seven(target, exact.points, repeat)
        spent = clock() - start
        row = {"seconds": spent, "ess": draws, "ess_per_s": draws / spent, "acceptance": exact.acceptance}
        out["exact"].append(row | {"ess_per_evaluation": draws / exact.evaluations})
    # the first compiles
    return {k: sorted(rows[1:], key=lambda row: row["ess_per_s"])[REPEATS // 2] for k, rows in out.items()}


def walkers(cloud: np.ndarray) -> np.ndarray:
    """Starts: draws of the posterior."""
    return cloud[:WALKERS]


def stretch_time(sums: OnSums, cloud: np.ndarray) -> float:
    """Longest autocorrelation time of the stretch move [steps], measured on the sums."""
    sampler = emcee.EnsembleSampler(WALKERS, 7, sums.log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(SEED).get_state()
    sampler.run_mcmc(walkers(cloud), STRETCH_STEPS)
    return float(sampler.get_autocorr_time(discard=STRETCH_BURN, tol=0).max())


def lmfit_step(direct: Direct, cloud: np.ndarray, clock: Clock) -> float:
    """Seconds of one step of lmfit.Minimizer.emcee: a long run less a short one."""
    parameters = lmfit.Parameters()
    for name, value in zip(NAMES[:6], cloud.mean(axis=0), strict=False):
        parameters.add(name, value=value)
    parameters.add("__lnsigma", value=float(cloud[:, 6].mean()), min=-5.0, max=5.0)

    def residual(p: lmfit.Parameters) -> np.ndarray:
        return direct.residual([p[name].value for name in NAMES[:6]])

    def run(steps: int) -> float:
        start = clock()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            lmfit.Minimizer(residual, parameters).emcee(
                steps=steps, nwalkers=WALKERS, pos=walkers(cloud), is_weighted=False, progress=False
            )
        return clock() - start

    short = run(1)
    return (run(1 + TIMED_STEPS) - short) / TIMED_STEPS


def raw_step(direct: Direct, cloud: np.ndarray, clock: Clock) -> float:
    """Seconds of one step of emcee on the vectorised likelihood of the samples."""
    sampler = emcee.EnsembleSampler(WALKERS, 7, direct.log_density)
    state = sampler.run_mcmc(walkers(cloud), 1)
    start = clock()
    sampler.run_mcmc(state, TIMED_STEPS)
    return (clock() - start) / TIMED_STEPS


def direct_in_jax(trials: list[Trial]):
    """The likelihood on the samples for jax: one scan along time with the logs side by side.

    The state's derivative by ln tau runs along in the same scan, four times faster than scanning back.
    """
    import jax
    import jax.numpy as jnp

    sizes = [t.time_s.size for t in trials]
    padded = np.zeros((max(sizes), len(trials)))
    for i, t in enumerate(trials):
        padded[: sizes[i], i] = np.diff(t.displacement_mm, prepend=t.displacement_mm[0])
    rows = jnp.asarray(np.concatenate([np.arange(n) for n in sizes]))
    log = jnp.asarray(np.repeat(np.arange(len(trials)), sizes))
    dx = jnp.asarray(padded)
    u = jnp.asarray(np.concatenate([t.displacement_mm for t in trials]) / DEPTH)
    y = jnp.asarray(np.concatenate([t.force_N for t in trials]))

    def scanned(log_tau):
        tau = jnp.exp(log_tau)
        a = jnp.exp(-STEP_S / tau)
        gain = (1 - a) * tau / STEP_S

        def step(s, d):
            s = a * s + gain * d
            return s, s

        return jax.lax.scan(step, jnp.zeros(len(trials)), dx)[1][rows, log]

    states = jax.custom_vjp(scanned)
    states.defvjp(
        lambda log_tau: jax.jvp(scanned, (log_tau,), (1.0,)),
        lambda slope, back: ((slope * back).sum(),),
    )

    def log_density(p):
        force = u * (p[0] + u * (p[1] + u * p[2])) + (p[3] + p[4] * u) * states(p[5])
        squares = ((force - y) ** 2).sum()
        return -u.size * (p[6] + 0.5 * math.log(2 * math.pi)) - 0.5 * squares * jnp.exp(-2 * p[6])

    return log_density


def nuts(
    target: SpecimenTarget, trials: list[Trial], cloud: np.ndarray, clock: Clock
) -> dict[str, dict[str, float]]:
    """NUTS of numpyro on the sums, and its gradient on the samples."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from numpyro.infer import MCMC, NUTS

    sums = OnSums(target, jnp)
    mean, root = jnp.asarray(cloud.mean(axis=0)), jnp.asarray(np.linalg.cholesky(np.cov(cloud.T)))

    def potential(density):
        return lambda z: -density(mean + root @ z)

    on_sums = potential(lambda p: sums.log_density(p[None, :])[0])
    chain = MCMC(
        NUTS(potential_fn=on_sums, dense_mass=False),
        num_warmup=NUTS_WARM_UP,
        num_samples=NUTS_DRAWS,
        progress_bar=False,
    )
    key = jax.random.PRNGKey(SEED)
    chain.warmup(key, init_params=jnp.zeros(7))
    chain.run(key, extra_fields=("num_steps",))  # compiles
    start = clock()
    chain.post_warmup_state = chain.last_state
    chain.run(key, extra_fields=("num_steps",))
    draws = np.asarray(chain.get_samples())
    spent = clock() - start
    leapfrogs = int(np.asarray(chain.get_extra_fields()["num_steps"]).sum())
    ess = least_ess(draws.reshape(1, NUTS_DRAWS, 7))
    out = {
        "nuts_sums": {
            "seconds": spent,
            "ess": ess,
            "ess_per_s": ess / spent,
            "ess_per_evaluation": ess / leapfrogs,
        }
    }
    # a leapfrog step is one gradient; whatever else the sampler does is not counted against it
    gradient = jax.jit(jax.value_and_grad(potential(direct_in_jax(trials))))
    leapfrog = timed(lambda: jax.block_until_ready(gradient(jnp.zeros(7))), clock, TIMED_GRADIENTS)
    out["nuts_direct"] = {
        "leapfrog_s": leapfrog,
        "timed_leapfrogs": TIMED_GRADIENTS,
        "ess_per_evaluation": ess / leapfrogs,
        "ess_per_s": ess / leapfrogs / leapfrog,
    }
    return out


def compare(draws: int, clock: Clock) -> dict[str, object]:
    """Everything."""
    trials = logs()
    start = clock()
    options = FitOptions(branches=1, stiffness_degree=1, static="shared", noise="white")
    target = posterior_target(fit_with_state("bench", handles(trials), options=options), Priors())
    setup = clock() - start
    rows = tissueid_samplers(target, draws, clock)
    cloud = seven(target, sample_exact(target, draws=4_000, seed=SEED).points, SEED)
    direct, sums = Direct(trials), OnSums(target)
    some = np.mean(cloud, axis=0)
    far = cloud[np.argmax(((cloud - some) ** 2 / cloud.var(axis=0)).sum(axis=1))]
    difference = sums.log_density(np.stack([some, far]))
    difference = float(np.ptp(difference - [direct.log_density(some), direct.log_density(far)]))
    points = cloud[:, 5:]
    likelihood = {
        "direct_s": timed(lambda: direct.log_density(some), clock),
        "sums_s": timed(lambda: target.log_density(points), clock) / points.shape[0],
        "largest_difference": difference,
    }
    tau = stretch_time(sums, cloud)
    step = lmfit_step(direct, cloud, clock)
    rows["lmfit_emcee"] = {"step_s": step, "ess_per_s": WALKERS / (tau * step)}
    step = raw_step(direct, cloud, clock)
    rows["raw_emcee"] = {"step_s": step, "ess_per_s": WALKERS / (tau * step)}
    for name in ("lmfit_emcee", "raw_emcee"):
        rows[name] |= {
            "timed_steps": TIMED_STEPS,
            "autocorrelation_steps": tau,
            "ess_per_evaluation": 1 / tau,
        }
    skipped = ""
    try:
        rows |= nuts(target, trials, cloud, clock)
    except ImportError as error:
        skipped = f"NUTS is left out: {error}; pip install -r benchmarks/requirements.txt"
    base = rows["lmfit_emcee"]["ess_per_s"]
    names = ("emcee", "exact", "nuts_direct", "nuts_sums")
    return {
        "n": int(direct.y.size),
        "parameters": 7,
        "draws": draws,
        "clock": next(name for name, one in CLOCKS.items() if one is clock),
        "setup_s": setup,
        "samplers": rows,
        "likelihood": likelihood,
        "ratio_to_lmfit_emcee": {k: rows[k]["ess_per_s"] / base for k in names if k in rows},
        "ratio_raw_emcee": rows["raw_emcee"]["ess_per_s"] / base,
        "factors": {
            "sums": likelihood["direct_s"] / likelihood["sums_s"],
            "sampler": {k: rows[k]["ess_per_evaluation"] * tau for k in names if k in rows},
        },
        "bars": BARS,
        "skipped": skipped,
    }


def main() -> int:
    """Run, print, and say whether the bars were met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="cpu where the machine is busy")
    parser.add_argument("--json", action="store_true")
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
            bar = f" (bar {BARS[name]:,.0f})" if name in BARS else ""
            print(f"{name:12} {ratio:12,.0f} times lmfit.Minimizer.emcee{bar}")
        print(f"factors      {result['factors']}")
        if result["skipped"]:
            print(result["skipped"])
    met = all(result["ratio_to_lmfit_emcee"][name] >= bar for name, bar in BARS.items())
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
