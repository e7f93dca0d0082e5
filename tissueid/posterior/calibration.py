"""The total posterior: tissue and instrument together, what the instrument is being known by its priors only.

Skew, filter and frame compliance bend the force in ways that relaxation imitates, by more than the noise:
the posterior of the tissue is taken over all of them (:mod:`tissueid.posterior.instrument`).  The gains of
the force and displacement channels are exact changes of scale: drawn from their priors, several pairs for
each draw of the rest since they cost nothing, they are divided out of it,

    a_k = a_k' g_x^k / g_f,   b_k = b_k' g_x^(k+1) / g_f,   c = c' g_f / g_x,

with the priors of tissue and frame taken at the values so scaled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.density_lanes import conditionals, log_ratios
from tissueid.likelihood.instrument_kernels import EFFECTS, INSTRUMENT
from tissueid.likelihood.knot_terms import log_terms
from tissueid.likelihood.knots import KnotSums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.passive_normal import draw_passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.carried import carried_draws, propagated_draws
from tissueid.posterior.channel_gains import CHANNELS, drawn_gains, scaled_by, static_of_logs
from tissueid.posterior.importance import Weighted, importance_sample, pooled
from tissueid.posterior.instrument import INSTRUMENT_NAMES, Behind
from tissueid.posterior.instrument_mode import instrument_mode
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.loose_noise import LooseNoise
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.target import Redrawn
from tissueid.priors import CalibrationPrior, Priors
from tissueid.processors import threads
from tissueid.uncertainty import PriorRow, SamplerReport

__all__ = [
    "NUISANCES",
    "TotalPosterior",
    "field_units",
    "total_posterior",
    "truncated_moments",
]

FloatArray = NDArray[np.float64]

#: Calibration nuisances, in the order of the draws.
NUISANCES = (*CHANNELS, *INSTRUMENT_NAMES)
#: Threads that evaluate points.
MAX_WORKERS = 2
#: Points a thread takes at a time, where there are several.
BATCH = 128
#: A spread of the gains below this is none.
SMALLEST_GAIN_SD = 1e-4
#: Pairs of gains that are tried for each draw that is returned.
PAIRS = 4
#: Draws the weights should be worth; a bound of a 95 % interval is then known to 0.07 sd.
WORTH = 1_000.0
#: Share of accepted proposals below which bounds are active: draws are then carried first, and need not be
#: worth more than this.
BOUNDED, ENOUGH = 0.5, 300.0


@dataclass(frozen=True, slots=True, eq=False)
class TotalPosterior:
    """Draws of tissue and instrument.

    Attributes
    ----------
    theta : ndarray, shape (n, p)
        Of the contact model, in the order of its ``parameter_names``; every one is passive.  Of equal weight.
    nuisances : ndarray, shape (n, 5)
        In the order of :data:`NUISANCES`.
    source : ndarray of int, shape (n,)
        The evaluated point that a draw comes from: draws of the same one differ by their gains only.
    names : tuple of str
        :data:`NUISANCES`.
    sampler : SamplerReport
        ``detail`` tells the draws they are worth and the shape of the weights' tail.
    priors : tuple of PriorRow
        A row a nuisance.
    behind : Behind
        The density, for the budget and the bootstrap.
    """

    theta: FloatArray
    nuisances: FloatArray
    source: NDArray[np.int64]
    names: tuple[str, ...]
    sampler: SamplerReport
    priors: tuple[PriorRow, ...]
    behind: Behind


def truncated_moments(prior: CalibrationPrior) -> tuple[float, float]:
    """Mean and standard deviation of a prior after its cut."""
    if prior.sd <= 0.0 or not math.isfinite(prior.lower):
        return prior.mean, prior.sd
    cut = (prior.lower - prior.mean) / prior.sd
    tail = 0.5 * math.erfc(cut / math.sqrt(2.0))
    hazard = math.exp(-0.5 * cut * cut) / math.sqrt(2.0 * math.pi) / tail
    return prior.mean + prior.sd * hazard, prior.sd * math.sqrt(1.0 + hazard * (cut - hazard))


def _evaluate(
    behind: Behind, free: NDArray[np.bool_], inner: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Density of points, theta drawn beside each from its conditional and divided out again."""
    points = np.tile(behind.mode, (inner.shape[0], 1))
    points[:, free] = inner
    n, p = points.shape[0], behind.theta.size
    mean, covariance = np.empty((n, p)), np.empty((n, p, p))
    prior = behind.log_priors(points)
    inside = np.isfinite(prior)
    mean[:] = behind.theta
    covariance[:] = np.eye(p)

    density, rows = behind.density(), np.flatnonzero(inside)
    _in_threads(lambda some: conditionals(density, points, some, mean, covariance), rows)
    inside &= np.isfinite(mean).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    mean[~inside], covariance[~inside] = behind.theta, np.eye(p)
    theta, _ = draw_passive(mean, covariance, behind.blocks, rng)
    out = np.full(n, -np.inf)
    rows = np.flatnonzero(inside)
    _in_threads(lambda some: log_ratios(density, points, some, theta, mean, covariance, out), rows)
    # far out, where next to nothing is known of theta, squares overflow: such a point has no density
    out[rows] += prior[rows]
    out[~np.isfinite(out)] = -np.inf
    return out, theta


def _in_threads(work, rows: NDArray[np.int64]) -> None:  # type: ignore[no-untyped-def]
    """Share rows among threads; each row's result depends on itself alone."""
    workers = threads(MAX_WORKERS)
    if workers == 1 or rows.size <= BATCH:
        work(rows)
        return
    batches = [rows[k : k + BATCH] for k in range(0, rows.size, BATCH)]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, batches))


def field_units(behind: Behind, theta: FloatArray, log_tau: FloatArray) -> FloatArray:
    """Coefficients by powers of u and ln tau -> theta of the contact model, shape (n, p)."""
    scale, size, static = behind.optimum.scale, behind.optimum.degree + 1, behind.optimum.static
    out = np.zeros((theta.shape[0], STATIC_DEGREE + behind.branches * behind.model.block))
    if static:
        out[:, :STATIC_DEGREE] = theta[:, :STATIC_DEGREE] * scale ** -np.arange(1.0, STATIC_DEGREE + 1)
    for j in range(behind.branches):
        first = STATIC_DEGREE + j * behind.model.block
        block = theta[:, static + j * size : static + (j + 1) * size]
        out[:, first : first + size] = block * scale ** -np.arange(float(size))
        out[:, first + size] = np.exp(log_tau[:, j])
    return out


def _softmax(level: FloatArray) -> FloatArray:
    """Weights ``exp(level)`` of sum one, the same for all where none is finite."""
    top = level.max()
    if not math.isfinite(top):
        return np.full(level.size, 1.0 / level.size)
    out = np.exp(level - top)
    return np.asarray(out / out.sum())


def _prior_rows(priors: Priors, nuisances: FloatArray) -> tuple[PriorRow, ...]:
    """Each nuisance's prior beside its posterior."""
    rows = []
    for name, draws in zip(NUISANCES, nuisances.T, strict=True):
        prior = priors.calibration[name]
        _, sd = truncated_moments(prior)
        words = f"normal {prior.mean:g} ± {prior.sd:g}"
        if math.isfinite(prior.lower):
            words += f", not below {prior.lower:g}"
        after = float(draws.std())
        shrinkage = 1.0 - after / sd if sd > 0.0 else 0.0
        rows.append(PriorRow(name, words, prior.stated, float(draws.mean()), after, shrinkage))
    return tuple(rows)


def _weighted_draws(behind: Behind, rng: np.random.Generator) -> tuple[Weighted, FloatArray]:
    """Weighted draws of what is not known exactly, and the points in all coordinates, shape (n, d)."""
    free = behind.free
    found = importance_sample(
        lambda inner, generator: _evaluate(behind, free, inner, generator),
        behind.mode[free],
        _laplace(behind)[np.ix_(free, free)],
        behind.cuts[0][free],
        behind.cuts[1][free],
        rng,
        size=WORTH,
    )
    points = np.tile(behind.mode, (found.points.shape[0], 1))
    points[:, free] = found.points
    return found, points


def _best(
    behind: Behind, target: SpecimenTarget, drawn: Redrawn, points: FloatArray, rng: np.random.Generator
) -> tuple[Weighted, FloatArray]:
    """Carried draws where bounds are active and these are worth enough, draws anew, or both together.

    Where neither can be weighted, an instrument of the prior is propagated through the draws.
    """
    if drawn.acceptance >= BOUNDED:
        return _weighted_draws(behind, rng)
    first, places = carried_draws(behind, target, drawn, points, rng)
    if first.converged and first.size >= ENOUGH:
        return first, places
    second, others = _weighted_draws(behind, rng)
    both = pooled([first, second])
    if both.converged:
        return both, np.vstack([places, others])
    return propagated_draws(behind, drawn, points, rng)


def _resampled(weights: FloatArray, draws: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Systematic resampling, in random order: each is drawn within one of its share."""
    picks = np.searchsorted(np.cumsum(weights), (np.arange(draws) + rng.random()) / draws)
    return rng.permutation(np.minimum(picks, weights.size - 1))


def total_posterior(
    knots: Sequence[KnotSums],
    optimum: Optimum,
    facts: Facts,
    model: KelvinVoigt,
    priors: Priors,
    *,
    effects: tuple[str, ...],
    gain_sd: float,
    seed: int,
    draws: int = 4_000,
    start: Optimum | None = None,
    noise: LooseNoise | None = None,
    alone: tuple[SpecimenTarget, Redrawn, FloatArray] | None = None,
) -> TotalPosterior:
    """Draw tissue and instrument.

    Parameters
    ----------
    knots : sequence of KnotSums
        Of every log, about ``optimum``.
    optimum : Optimum
        The fit, which knows of no instrument.
    facts : Facts
    model : KelvinVoigt
    priors : Priors
        ``calibration`` from :func:`tissueid.posterior.calibration_priors.calibration_priors`.
    effects : tuple of str
        Of every log: ``gain`` and ``offset``, some of them, or ``static``.
    gain_sd : float
        Estimate of the spread of ln gain between logs (not looked at without gains).
    seed : int
    draws : int
        To return.
    start : Optimum, optional
        Where to look for the mode first, if not at ``optimum``.
    noise : LooseNoise, optional
        Scale and correlation of the noise as coordinates, where they are open.
    alone : tuple, optional
        The posterior without an instrument, its draws and their sampled coordinates, to be carried to one
        (:mod:`tissueid.posterior.carried`) where drawing anew is worth little.

    Returns
    -------
    TotalPosterior
    """
    rng = np.random.default_rng(seed)
    data = packed(knots, optimum, effects)
    count = sum(one.count for one in knots)
    behind = instrument_mode(
        data,
        optimum,
        facts,
        model,
        priors,
        effects,
        count=count,
        gain_sd=max(gain_sd, SMALLEST_GAIN_SD),
        start=start,
        noise=noise,
    )
    found, points = _weighted_draws(behind, rng) if alone is None else _best(behind, *alone, rng)
    tried = _resampled(found.weights, PAIRS * draws, rng)
    gains = drawn_gains(behind, tried.size, rng)
    theta, compliance, more = scaled_by(behind, points[tried], found.extra[tried], gains)
    weights = _softmax(more)
    picks = _resampled(weights, draws, rng)
    source, gains = tried[picks], gains.some(picks)
    instrument = points[source, behind.branches : behind.branches + INSTRUMENT]
    instrument[:, -1] = compliance[picks]
    reported = field_units(behind, theta[picks], points[source, : behind.branches])
    if "static" in effects:
        reported[:, :STATIC_DEGREE] = static_of_logs(behind, points, found.extra, source, gains, rng)
    # draws of one point are no more than one: they share all but their gains
    worth = min(1.0 / float((np.bincount(tried, weights=weights) ** 2).sum()), found.size)
    nuisances = np.column_stack([gains.force, gains.displacement, instrument])
    return TotalPosterior(
        theta=reported,
        nuisances=nuisances,
        source=source,
        names=NUISANCES,
        sampler=SamplerReport(
            name="propagation" if found.propagated else "importance",
            converged=found.converged,
            draws=draws,
            acceptance=worth / points.shape[0],
            detail={
                "worth": worth,
                "evaluated": points.shape[0],
                "tail_shape": found.shape,
                "seed": seed,
            },
        ),
        priors=_prior_rows(priors, nuisances),
        behind=behind,
    )


def _laplace(behind: Behind) -> FloatArray:
    """Covariance of the coordinates at the mode, theta integrated."""
    p, d = behind.theta.size, behind.mode.size
    inner = behind.branches + INSTRUMENT
    curvature = behind.curvature
    schur = curvature[p:, p:] + curvature[p:, :p] @ behind.slope[:, :inner]
    out = np.zeros((d, d))
    known = np.flatnonzero(behind.free[:inner])
    part = schur[np.ix_(known, known)]
    unit = 1.0 / np.sqrt(np.maximum(np.diag(part), 1e-300))
    values, vectors = np.linalg.eigh(part * unit * unit[:, None])
    inverse = (vectors / np.maximum(values, 1e-10)) @ vectors.T * unit * unit[:, None]
    out[np.ix_(known, known)] = inverse
    if "gain" in behind.effects:
        # the spread of n gains is known to 1 / sqrt(2 n) of itself, and no better than single gains are
        logs = behind.data.gamma.size
        tau, instrument, gain_sd = behind.split(behind.mode)
        gram = log_terms(behind.data, behind.theta, tau, instrument, EFFECTS)[0][:, 0, 0]
        single = float(np.median(behind.sigma2 / np.maximum(gram, 1e-300)))
        out[inner, inner] = gain_sd**2 / max(2.0 * logs - 2.0, 1.0) + 4.0 * single
    if behind.noise is not None:
        first = d - behind.noise.mode.size
        out[first:, first:] = behind.noise.covariance
    return out
