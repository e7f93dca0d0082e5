"""The posterior of a fitted specimen, from its sums to what is reported.

Composes the target, a sampler, the exact redraw, diagnostics, the total interval, the budget, the comparison
with other models and the check for misfit; each is a module of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.estimates import second_stage_static
from tissueid.fit.specimen import FittedSpecimen
from tissueid.fit.trials import model_force
from tissueid.likelihood.knots import KnotSums, knot_sums
from tissueid.likelihood.marginal import log_joints
from tissueid.likelihood.passive_normal import draw_passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.at_optimum import posterior_target
from tissueid.posterior.bands import predictive_bands
from tissueid.posterior.bootstrap import cluster_bootstrap
from tissueid.posterior.budget import uncertainty_budget
from tissueid.posterior.building import NotLinearError
from tissueid.posterior.calibration import BOUNDED, TotalPosterior, total_posterior
from tissueid.posterior.carried import carried_draws
from tissueid.posterior.coherence import coherent_share, outside, unsampled, withheld
from tissueid.posterior.comparison import compare_models, rows_of_choice
from tissueid.posterior.diagnostics import diagnose
from tissueid.posterior.instrument import Behind
from tissueid.posterior.loose_noise import LooseNoise, loose_noise
from tissueid.posterior.misfit import misfit_alarm
from tissueid.posterior.prior_rows import prior_rows
from tissueid.posterior.remarks import not_linear, posterior_flags
from tissueid.posterior.reported import interval95, reported_draws
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.stretched import stretched
from tissueid.posterior.target import Redrawn
from tissueid.posterior.theta_prior import log_theta_prior
from tissueid.posterior.total_intervals import total_intervals
from tissueid.priors import Priors
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import (
    BudgetRow,
    ComparisonRow,
    NoiseFit,
    ParameterUncertainty,
    Posterior,
    SamplerReport,
)

__all__ = ["SAMPLERS", "PosteriorOptions", "with_posterior"]

FloatArray = NDArray[np.float64]

SAMPLERS = ("emcee", "exact", "none")
#: Draws that a bundle and a report keep.
KEPT_DRAWS = 2000
#: Independent draws that a total interval must be worth: its ends are then good to a quarter of an sd.
LEAST_WORTH = 100.0
#: Points of a chain that are redrawn, for each effective draw that was asked for.
REDRAWN_EACH = 1.5
#: NRMSD of the value that is printed, at the most, over that of the optimum.
WORSE = 1.1
#: Share of the draws that exact effects of the logs must leave for linear ones to stand.
LINEAR = 0.5
#: Draws for which independent ones are prepared by a whole pilot, and its least share: a proposal need not be
#: better known than what is drawn from it.
WHOLE_PILOT = 4_000
LEAST_PILOT = 0.25
#: Chains that independent draws are laid out in, for the diagnostics.
EXACT_CHAINS = 4


@dataclass(frozen=True, slots=True)
class PosteriorOptions:
    """How a posterior is sampled.

    Attributes
    ----------
    sampler : str
        ``emcee``, ``exact`` or ``none``.
    draws : int
        Effective draws that are asked for.
    seed : int
    workers : int
        Threads that evaluate the density; the chain does not depend on it.
    compare : bool
        Work out evidence and held-out predictions of the models beside a chosen one; otherwise its choice by
        held-out data is all that is told.
    """

    sampler: str = "emcee"
    draws: int = 2_000
    seed: int = 0
    workers: int = 1
    compare: bool = False


def _with_static(fitted: FittedSpecimen, drawn: Redrawn, rng: np.random.Generator) -> Redrawn:
    """Logs with a curve each have no common one: a second stage draws it for each draw of K and tau."""
    whitened, optimum = fitted.whitened, fitted.optimum
    best, own, follows = second_stage_static(whitened.sums, whitened.solution)
    scale, size = optimum.scale, optimum.degree + 1
    moved = np.empty((drawn.theta.shape[0], follows.shape[1]))
    branches = optimum.branches
    for j in range(branches):
        first = STATIC_DEGREE + j * (size + 1)
        stiffness = drawn.theta[:, first : first + size] * scale ** np.arange(float(size))
        moved[:, j * size : (j + 1) * size] = stiffness - optimum.theta[j * size : (j + 1) * size]
        moved[:, branches * size + j] = np.log(drawn.theta[:, first + size]) - optimum.log_tau[j]
    mean = best + moved @ follows.T
    blocks = np.array([STATIC_DEGREE], dtype=np.int64)
    cov = np.broadcast_to(own, (mean.shape[0], *own.shape))
    static, _ = draw_passive(mean, np.ascontiguousarray(cov), blocks, rng)
    theta = drawn.theta.copy()
    theta[:, :STATIC_DEGREE] = static * scale ** -np.arange(1.0, STATIC_DEGREE + 1)
    return replace(drawn, theta=theta)


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A chain in the sampled coordinates, shape (chains, draws, d), its density, and how it came about."""

    chain: FloatArray
    report: SamplerReport
    log_density: FloatArray | None = None


def _sample(
    target: SpecimenTarget,
    options: PosteriorOptions,
    checkpoint: Path | None,
    key: str,
    tick: Callable[[str], None],
) -> _Sampled:
    if options.sampler == "exact":
        from tissueid.posterior.exact import PILOT, sample_exact

        tick("drawing exactly")
        share = min(max(options.draws / WHOLE_PILOT, LEAST_PILOT), 1.0)
        exact = sample_exact(target, draws=options.draws, seed=options.seed, pilot=round(share * PILOT))
        draws = exact.points.shape[0] // EXACT_CHAINS * EXACT_CHAINS
        chain = exact.points[:draws].reshape(EXACT_CHAINS, -1, exact.points.shape[1])
        return _Sampled(chain, exact.report())
    from tissueid.posterior.ensemble import sample_ensemble

    found = sample_ensemble(
        target,
        draws=options.draws,
        seed=options.seed,
        workers=options.workers,
        checkpoint=checkpoint,
        key=key,
        progress=lambda steps, share: tick(f"sampling, {steps:,} steps, {100.0 * min(share, 1.0):.0f} %"),
    )
    walkers, steps = found.points.shape[:2]
    thin = max(walkers * steps // int(REDRAWN_EACH * options.draws), 1)
    return _Sampled(found.points[:, ::thin], found.report(), found.log_density[:, ::thin])


def _uncertainties(
    fit: SpecimenFit,
    draws: Mapping[str, FloatArray],
    shape: tuple[int, int],
    total: Mapping[str, tuple[float, float]] | None,
) -> dict[str, ParameterUncertainty]:
    """Mean, spread, intervals and diagnostics of each reported parameter."""
    names = [one.name for one in fit.parameters]
    found = diagnose({name: draws[name].reshape(shape) for name in names})
    central = interval95({name: draws[name] for name in names})
    return {
        name: ParameterUncertainty(
            mean=float(draws[name].mean()),
            sd=float(draws[name].std(ddof=1)),
            ci95=central[name],
            ci95_total=None if total is None else total[name],
            ess_bulk=found[name].ess_bulk,
            ess_tail=found[name].ess_tail,
            r_hat=found[name].r_hat,
        )
        for name in names
    }


def _with_uncertainty(
    parameters: Sequence[Estimate], found: Mapping[str, ParameterUncertainty]
) -> tuple[Estimate, ...]:
    return tuple(replace(one, uncertainty=found.get(one.name)) for one in parameters)


@dataclass(frozen=True, slots=True, eq=False)
class _Draws:
    """Draws of a specimen's posterior.

    Attributes
    ----------
    target : SpecimenTarget
        Priors, facts and effects.
    report : SamplerReport
    chain : ndarray, shape (chains, draws, d)
        Sampled coordinates.
    log_density : ndarray, shape (chains, draws), or None
    points : ndarray, shape (n, d)
        Sampled coordinates of what was drawn: the chain's, or of rows of it.
    drawn : Redrawn
    total : TotalPosterior or None
        ``None`` where there is no instrument to ask about, or its draws carry nothing.
    """

    target: SpecimenTarget
    report: SamplerReport
    chain: FloatArray
    log_density: FloatArray | None
    points: FloatArray
    drawn: Redrawn
    total: TotalPosterior | None


def _draws(
    fitted: FittedSpecimen,
    target: SpecimenTarget,
    options: PosteriorOptions,
    checkpoint: Path | None,
    key: str,
    instrument: bool,
    tick: Callable[[str], None],
) -> _Draws:
    """A chain, what was integrated drawn anew beside it, and the same behind an instrument."""
    sampled = _sample(target, options, checkpoint, key, tick)
    tick("drawing the tissue")
    points = sampled.chain.reshape(-1, sampled.chain.shape[2])
    rng = np.random.default_rng([options.seed, 1])
    drawn = target.redraw(points, rng)
    if fitted.fit.model.static_pooling == "per-log":
        drawn = _with_static(fitted, drawn, rng)
    total = _total(fitted, target, (drawn, points), options, tick) if instrument else None
    report = sampled.report
    if instrument and total is None:
        report = replace(report, detail={**report.detail, "total": {"converged": False, "worth": 0.0}})
    elif total is not None:
        # a few heavy draws have the look of a narrow interval: none is given then
        carried = total.sampler.converged and total.sampler.detail["worth"] >= LEAST_WORTH
        report = replace(report, detail={**report.detail, "total": _told_of(total) | {"converged": carried}})
        total = total if carried else None
    rows = np.arange(points.shape[0])
    if total is not None and drawn.acceptance < BOUNDED:
        rows = _without_curvature(total.behind, target, drawn, points, options.seed)
        drawn = drawn.some(rows)
    model, noise, whitened = fitted.tissue.model, fitted.whitened.noise, fitted.whitened
    if noise.samples_per_independent > whitened.tempering:
        factor = float(np.sqrt(noise.samples_per_independent / whitened.tempering))
        value, speed = fitted.tissue.theta, fitted.fit.speeds_mm_s[1]
        drawn = replace(drawn, theta=stretched(model, drawn.theta, value, factor, speed))
        if total is not None:
            total = replace(total, theta=stretched(model, total.theta, value, factor, speed))
    return _Draws(target, report, sampled.chain, sampled.log_density, points[rows], drawn, total)


def _without_curvature(
    behind: Behind, target: SpecimenTarget, drawn: Redrawn, points: FloatArray, seed: int
) -> NDArray[np.int64]:
    """Rows of draws, weighted where gains and contact points are not linear over them."""
    weighted, _ = carried_draws(behind, target, drawn, points)
    if not weighted.converged or weighted.size > LINEAR * points.shape[0]:
        return np.arange(points.shape[0])
    rng = np.random.default_rng([seed, 3])
    return np.asarray(rng.choice(points.shape[0], points.shape[0], p=weighted.weights))


def with_posterior(
    fitted: FittedSpecimen,
    *,
    priors: Priors,
    options: PosteriorOptions,
    checkpoint: Path | None = None,
    key: str = "",
    instrument: bool = True,
    tick: Callable[[str], None] | None = None,
) -> SpecimenFit:
    """The fit of a specimen with its posterior.

    Parameters
    ----------
    fitted : FittedSpecimen
    priors : Priors
    options : PosteriorOptions
    checkpoint : Path, optional
        File that the sampler can go on from after a kill.
    key : str
        Of everything the posterior depends on; a checkpoint with another key is not used.
    instrument : bool
        Give the total interval too; normalised recordings have no instrument to ask about.
    tick : callable, optional
        Told what is being done.
    """
    tick = tick or (lambda _: None)
    fit, noise = fitted.fit, fitted.whitened.noise
    if options.sampler == "none" or fitted.tissue.model.branches == 0:
        return fit
    try:
        target = posterior_target(fitted, priors)
    except NotLinearError as error:
        alarm = misfit_alarm(fitted.told.blocks, noise)
        return unsampled(fit, "draws agree with no point to linearise about", not_linear(error, alarm))
    draws = _draws(fitted, target, options, checkpoint, key, instrument, tick)
    return _assembled(fitted, priors, options, draws, instrument, tick)


def _assembled(
    fitted: FittedSpecimen,
    priors: Priors,
    options: PosteriorOptions,
    draws: _Draws,
    instrument: bool,
    tick: Callable[[str], None],
) -> SpecimenFit:
    """Intervals, budget, comparison and checks from draws, and a value that agrees with them."""
    model, drawn, total, target = fitted.tissue.model, draws.drawn, draws.total, draws.target
    noise = _sampled_noise(fitted, drawn)
    uncertainties = _uncertainties(
        fitted.fit,
        reported_draws(model, drawn.theta),
        draws.chain.shape[:2],
        None if total is None else _total_intervals(total, model),
    )
    if noise.discrepant:
        uncertainties = {name: _within_total(one) for name, one in uncertainties.items()}
    told = _coherent(fitted, draws, uncertainties)
    names, why = _incoherent(told.fit, uncertainties, draws, instrument=instrument)
    parameters, said = withheld(told.fit.parameters, names, why)
    tick("checks of the residuals")
    posterior = Posterior(
        sampler=draws.report,
        noise=noise,
        parameters=uncertainties,
        theta_names=fitted.fit.theta_names,
        draws=_kept(drawn.theta),
        log_prior=log_theta_prior(target, _kept(drawn.theta)),
        draws_total=None if total is None else _kept(total.theta),
        covariance=np.cov(drawn.theta, rowvar=False),
        chain_names=target.names,
        chain=draws.chain,
        log_density=draws.log_density,
        priors=(*prior_rows(target, draws.points, drawn), *(() if total is None else total.priors)),
        budget=_budget(fitted, target, total, options) if instrument else (),
        comparison=_compared(fitted, priors, options, tick),
        misfit=misfit_alarm(fitted.told.blocks, noise),
        bands=predictive_bands(
            model, told.fit.theta, told.fit.trials, told.adjustments, drawn, sigma_N=noise.sigma_N
        ),
    )
    return replace(
        told.fit,
        parameters=_with_uncertainty(parameters, uncertainties),
        posterior=posterior,
        flags=(*said, *told.fit.flags, *posterior_flags(posterior)),
    )


def _within_total(one: ParameterUncertainty) -> ParameterUncertainty:
    """The same with a total interval that holds the statistical one.

    Where bounds cut both, either is worked out from its own few draws, and the larger counts.
    """
    if one.ci95_total is None:
        return one
    (low, high), (first, last) = one.ci95, one.ci95_total
    return replace(one, ci95_total=(min(low, first), max(high, last)))


def _coherent(
    fitted: FittedSpecimen, draws: _Draws, found: Mapping[str, ParameterUncertainty]
) -> FittedSpecimen:
    """The fit as it is, or of the tissue on the way to the centre of its draws that agrees with them."""
    drawn, target = draws.drawn, draws.target
    level = log_joints(target.data, draws.points, drawn.linear) + target.log_prior(draws.points)
    share, tissue = coherent_share(fitted.tissue, drawn.theta, level, found)
    if share == 0.0:
        return fitted
    gain = np.exp(np.log(drawn.gain).mean(axis=0))
    offset = drawn.offset_mm.mean(axis=0)
    adjustments = [
        replace(
            one,
            gain=float(one.gain ** (1.0 - share) * gain[i] ** share),
            contact_offset_mm=float(one.contact_offset_mm + share * (offset[i] - one.contact_offset_mm)),
        )
        for i, one in enumerate(fitted.adjustments)
    ]
    moved = fitted.moved(tissue, adjustments)
    # a value that agrees with its draws and not with the recordings is none
    return moved if moved.fit.nrmsd.range <= WORSE * fitted.fit.nrmsd.range else fitted


def _incoherent(
    fit: SpecimenFit, found: Mapping[str, ParameterUncertainty], draws: _Draws, *, instrument: bool
) -> tuple[tuple[str, ...], str]:
    """Parameters whose intervals are withheld, and why."""
    every = tuple(one.name for one in fit.parameters if one.value is not None)
    if instrument and draws.total is None:
        return every, "no draws carry a machine that was not stated"
    return outside(fit.parameters, found), "the value lies outside it"


def _total_intervals(total: TotalPosterior, model: KelvinVoigt) -> dict[str, tuple[float, float]]:
    """The total interval of each reported parameter."""
    nuisances = dict(zip(total.names, total.nuisances.T, strict=True))
    return total_intervals(
        reported_draws(model, total.theta),
        nuisances,
        total.behind.priors.calibration,
        cluster=total.source,
    )


def _told_of(total: TotalPosterior) -> dict[str, object]:
    """How far the total interval's draws may be trusted."""
    return {"converged": total.sampler.converged, **total.sampler.detail}


def _compared(
    fitted: FittedSpecimen, priors: Priors, options: PosteriorOptions, tick: Callable[[str], None]
) -> tuple[ComparisonRow, ...]:
    """The chosen model beside others: as its choice saw them, or by evidence where that is asked for."""
    if not options.compare:
        return rows_of_choice(fitted.fit)
    tick("other models")
    return compare_models(
        fitted, priors, seed=options.seed, tick=lambda model: tick(f"other models, {model}")
    )


def _kept(theta: FloatArray) -> FloatArray:
    """The draws that a bundle and a report keep, spread over all."""
    return theta[np.linspace(0, theta.shape[0] - 1, min(KEPT_DRAWS, theta.shape[0])).astype(np.int64)]


def _sampled_noise(fitted: FittedSpecimen, drawn: Redrawn) -> NoiseFit:
    """The noise of the posterior; the sampled scale is that of the pre-filtered noise."""
    noise = fitted.whitened.noise
    theta, phi = noise.moving_average, float(np.mean(drawn.phi))
    sigma = float(np.mean(drawn.sigma_N)) * float(np.sqrt(1.0 - 2.0 * phi * theta + theta**2))
    return replace(noise, sigma_N=sigma, phi=phi)


def _open_noise(fitted: FittedSpecimen, target: SpecimenTarget) -> LooseNoise | None:
    """Scale and correlation of the noise as coordinates, where the logs leave them open."""
    noise, tissue = fitted.whitened.noise, fitted.tissue

    def knots_at(phi: float) -> list[KnotSums]:
        out = []
        for handle, adjustment in zip(fitted.handles, fitted.adjustments, strict=True):
            _, log = handle.fitted()
            residual = log.data.force_N - model_force(tissue.model, tissue.theta, log, adjustment)
            out.append(
                knot_sums(
                    log.data,
                    residual,
                    phi=phi,
                    reference_step_s=noise.reference_step_s,
                    moving_average=noise.moving_average,
                ).tempered(fitted.whitened.tempering)
            )
        return out

    count = sum(one.count for one in fitted.told.knots)
    return loose_noise(target, (target.data.ratio, target.data.links), count, knots_at)


def _total(
    fitted: FittedSpecimen,
    target: SpecimenTarget,
    alone: tuple[Redrawn, FloatArray],
    options: PosteriorOptions,
    tick: Callable[[str], None],
) -> TotalPosterior | None:
    """Tissue and instrument together; ``None`` where the arithmetic gives up on it."""
    tick("force channel, clock and frame")
    try:
        with np.errstate(over="raise", invalid="raise"):
            return total_posterior(
                fitted.told.knots,
                fitted.optimum,
                target.facts,
                target.model,
                target.priors,
                effects=target.effects,
                gain_sd=fitted.whitened.solution.noise.gain_sd,
                seed=options.seed,
                start=target.optimum,
                noise=_open_noise(fitted, target),
                alone=(target, *alone),
            )
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return None


def _budget(
    fitted: FittedSpecimen, target: SpecimenTarget, total: TotalPosterior | None, options: PosteriorOptions
) -> tuple[BudgetRow, ...]:
    """Sources of uncertainty, and the bootstrap over logs beside them."""
    bootstrap = cluster_bootstrap(
        fitted.told.knots,
        fitted.optimum,
        target.facts,
        target.model,
        target.priors,
        effects=target.effects,
        gain_sd=fitted.whitened.solution.noise.gain_sd,
        seed=options.seed,
    )
    sources = () if total is None else uncertainty_budget(total)
    return (*sources, *(() if bootstrap is None else bootstrap.rows))
