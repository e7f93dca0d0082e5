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
from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FittedSpecimen
from tissueid.fit.whitening import Whitened
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.passive_normal import draw_passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.posterior.bands import predictive_bands
from tissueid.posterior.bootstrap import cluster_bootstrap
from tissueid.posterior.budget import uncertainty_budget
from tissueid.posterior.calibration import TotalPosterior, total_posterior
from tissueid.posterior.diagnostics import diagnose
from tissueid.posterior.misfit import misfit_alarm
from tissueid.posterior.prior_rows import prior_rows
from tissueid.posterior.remarks import posterior_flags
from tissueid.posterior.reported import interval95, reported_draws
from tissueid.posterior.specimen_target import Facts, SpecimenTarget, specimen_target
from tissueid.posterior.target import Redrawn
from tissueid.priors import Priors
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import BudgetRow, NoiseFit, ParameterUncertainty, Posterior, SamplerReport

__all__ = ["SAMPLERS", "PosteriorOptions", "posterior_target", "target_at", "with_posterior"]

FloatArray = NDArray[np.float64]

SAMPLERS = ("emcee", "exact", "none")
#: Draws that a bundle and a report keep.
KEPT_DRAWS = 2000
#: Chains that independent draws are laid out in, for the diagnostics.
EXACT_CHAINS = 4
#: First guess of the standard deviation of the ln of the gains' spread, times the root of the logs.
GAIN_GUESS = 0.8
#: Nearest a start may be to an end of its prior, as a fraction of the range.
EDGE = 0.02


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
    """

    sampler: str = "emcee"
    draws: int = 10_000
    seed: int = 0
    workers: int = 1


def _facts(
    whitened: Whitened, optimum: Optimum, handles: Sequence[LogHandle], *, force_N: float, offsets: bool
) -> Facts:
    """What the priors need to know of the logs."""
    speeds = [
        (speed, one.facts.depth_mm) for one in handles for speed in one.facts.speeds_mm_s if speed > 0.0
    ]
    sd = np.array([one.contact_sd_mm for one in handles])
    floor = whitened.sums.offset_sd_mm[: len(handles)]
    return Facts(
        force_N=force_N,
        speed_mm_s=np.array([speed for speed, _ in speeds] or [1.0]),
        depth_mm=np.array([depth for _, depth in speeds] or [optimum.scale]),
        log_tau_bounds=whitened.sums.log_tau_bounds,
        offset_sd_mm=np.maximum(sd, floor) if offsets else np.zeros(len(handles)),
        offset_mean_mm=np.array([-one.contact_shift_mm for one in handles]),
    )


def posterior_target(fitted: FittedSpecimen, priors: Priors) -> SpecimenTarget:
    """The density that is sampled for a fitted specimen.

    Parameters
    ----------
    fitted : FittedSpecimen
    priors : Priors
    """
    return target_at(
        fitted.whitened,
        fitted.optimum,
        fitted.handles,
        priors,
        log_tau_sd=np.array([interval.width for interval in fitted.tissue.intervals]) / 4.0,
        force_N=max(float(np.abs(trial.curve.force_N).max()) for trial in fitted.told.trials),
    )


def target_at(
    whitened: Whitened,
    optimum: Optimum,
    handles: Sequence[LogHandle],
    priors: Priors,
    *,
    log_tau_sd: FloatArray,
    force_N: float,
) -> SpecimenTarget:
    """The density that is sampled at an optimum.

    Parameters
    ----------
    whitened : Whitened
    optimum : Optimum
    handles : sequence of LogHandle
    priors : Priors
    log_tau_sd : ndarray, shape (branches,)
        First guess of the standard deviation of each ln tau.
    force_N : float
        Largest measured force.
    """
    solution = whitened.solution
    pooling = solution.candidate.pooling
    correlated = whitened.noise.model != "white"
    count = sum(one.count for one in whitened.lags)
    sigma2, phi = solution.noise.sigma2, whitened.noise.phi
    start = [*solution.evaluation.log_tau, 0.5 * np.log(sigma2)]
    sd = [*np.clip(log_tau_sd, 1e-5, 1.5), 1.0 / np.sqrt(2.0 * count)]
    if correlated:
        # an estimate outside its stated prior is no place to start from
        low, high = priors.phi
        edge = EDGE * (high - low) if high < 1.0 else 1e-9
        phi = float(np.clip(phi, low + edge, high - edge))
        start.append(np.arctanh(phi))
        sd.append(1.0 / np.sqrt(count * max(1.0 - phi * phi, 1e-6)))
    if pooling == "partial":
        start.append(np.log(max(solution.noise.gain_sd, 1e-4)))
        sd.append(GAIN_GUESS / np.sqrt(len(handles)))
    single = len(handles) == 1 and pooling == "shared"
    offsets = pooling == "partial" or single
    return specimen_target(
        whitened.lags,
        whitened.sums.basis,
        optimum,
        centred=whitened.centred,
        facts=_facts(whitened, optimum, handles, force_N=force_N, offsets=offsets),
        priors=priors,
        pooling=pooling,
        correlated=correlated,
        start=np.array(start),
        start_sd=np.array(sd),
    )


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
        from tissueid.posterior.exact import sample_exact

        tick("drawing exactly")
        exact = sample_exact(target, draws=options.draws, seed=options.seed)
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
    return _Sampled(found.points, found.report(), found.log_density)


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
    fit, model = fitted.fit, fitted.tissue.model
    if options.sampler == "none" or model.branches == 0:
        return fit
    target = posterior_target(fitted, priors)
    sampled = _sample(target, options, checkpoint, key, tick)
    tick("drawing the tissue")
    shape = sampled.chain.shape[:2]
    points = sampled.chain.reshape(-1, sampled.chain.shape[2])
    rng = np.random.default_rng([options.seed, 1])
    drawn = target.redraw(points, rng)
    if fit.model.static_pooling == "per-log":
        drawn = _with_static(fitted, drawn, rng)
    noise = _sampled_noise(fitted, drawn)
    total = _total(fitted, target, options, tick) if instrument else None
    report = sampled.report
    if total is not None:
        report = replace(report, detail={**report.detail, "total": _told_of(total)})
        # a few heavy draws have the look of a narrow interval: none is given then
        total = total if total.sampler.converged else None
    uncertainties = _uncertainties(
        fit,
        reported_draws(model, drawn.theta),
        shape,
        None if total is None else interval95(reported_draws(model, total.theta)),
    )
    tick("checks of the residuals")
    misfit = misfit_alarm(fitted.told.blocks, noise)
    posterior = Posterior(
        sampler=report,
        noise=noise,
        parameters=uncertainties,
        theta_names=fit.theta_names,
        draws=_kept(drawn.theta),
        draws_total=None if total is None else _kept(total.theta),
        covariance=np.cov(drawn.theta, rowvar=False),
        chain_names=target.names,
        chain=sampled.chain,
        log_density=sampled.log_density,
        priors=(*prior_rows(target, points, drawn), *(() if total is None else total.priors)),
        budget=_budget(fitted, target, total, options) if instrument else (),
        misfit=misfit,
        bands=predictive_bands(
            model, fit.theta, fit.trials, fitted.adjustments, drawn, sigma_N=noise.sigma_N
        ),
    )
    return replace(
        fit,
        parameters=_with_uncertainty(fit.parameters, uncertainties),
        posterior=posterior,
        flags=(*fit.flags, *posterior_flags(posterior)),
    )


def _told_of(total: TotalPosterior) -> dict[str, object]:
    """How far the total interval's draws may be trusted."""
    return {"converged": total.sampler.converged, **total.sampler.detail}


def _kept(theta: FloatArray) -> FloatArray:
    """The draws that a bundle and a report keep, spread over all."""
    return theta[np.linspace(0, theta.shape[0] - 1, min(KEPT_DRAWS, theta.shape[0])).astype(np.int64)]


def _sampled_noise(fitted: FittedSpecimen, drawn: Redrawn) -> NoiseFit:
    """The noise of the posterior; the sampled scale is that of the pre-filtered noise."""
    noise = fitted.whitened.noise
    theta, phi = noise.moving_average, float(np.mean(drawn.phi))
    sigma = float(np.mean(drawn.sigma_N)) * float(np.sqrt(1.0 - 2.0 * phi * theta + theta**2))
    return replace(noise, sigma_N=sigma, phi=phi)


def _total(
    fitted: FittedSpecimen,
    target: SpecimenTarget,
    options: PosteriorOptions,
    tick: Callable[[str], None],
) -> TotalPosterior:
    """Tissue and instrument together."""
    tick("force channel, clock and frame")
    return total_posterior(
        fitted.told.knots,
        fitted.optimum,
        target.facts,
        target.model,
        target.priors,
        effects=target.effects,
        gain_sd=fitted.whitened.solution.noise.gain_sd,
        seed=options.seed,
    )


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
