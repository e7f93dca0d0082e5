"""The posterior of a fitted specimen, from draws to what is reported.

The total interval is of the draws as they are, the statistical one with the machine at its posterior mean;
the printed value is the median.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.identification import SamplerReport
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.diagnostics import diagnose
from tissueid.inference.engine import Identified, refit
from tissueid.inference.estimates import MAX_WIDTH, TIME, VISCOSITY, without_exchanged
from tissueid.inference.optimum import ON_WALL, nearest_inside, root_of
from tissueid.inference.reported import (
    CENTRAL_95,
    GAINS,
    interval95,
    least_stiffness,
    log_theta_prior,
    next_indentation,
    predictive_bands,
    prior_table,
    reported_draws,
    uncertainty_budget,
)
from tissueid.inference.residual_blocks import misfit_alarm, sandwich_covariance
from tissueid.inference.sampling import Sampled, sample
from tissueid.inference.specimen import FittedSpecimen
from tissueid.inference.system import MACHINE, Point
from tissueid.inference.target import NormalTarget, SpecimenTarget, Target
from tissueid.inference.verdict import outside, posterior_flags, reaching, unidentified, withheld
from tissueid.model.base import scaled_theta
from tissueid.model.channels import ChannelModel
from tissueid.priors import Priors
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import ParameterUncertainty, Posterior

Ends = dict[str, tuple[float, float]]
#: Draws that a bundle and a report keep.
KEPT_DRAWS = 2000
#: NRMSD of the centre at the most over that of the optimum.
WORSE = 1.1
#: Widest total interval of ln viscosity that counts as identified where its time is not: a factor of seven.
MAX_WIDTH_VISCOSITY = 2.0
#: An effect that can't be negative may be none where the low end of its draws is within this of their median.
NONE_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class PosteriorOptions:
    """Options of a posterior's sampling.

    Attributes
    ----------
    sampler : str
        ``emcee`` or ``none``.
    draws : int
        Effective draws that are asked for.
    seed : int
    """

    sampler: str = "emcee"
    draws: int = 2_000
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Draws of a specimen."""

    vectors: FloatArray  # (n, size), coordinates of the target
    total: FloatArray  # (n, p), theta with the machine open
    statistical: FloatArray  # (n, p), with the machine at its mean
    gains: FloatArray  # (n, 2), force and displacement gain


def _passive(law: ChannelLaw, linear: FloatArray, optimum: FloatArray) -> FloatArray:
    """Linear parameters (n, p) at the nearest passive ones by their covariance; ``optimum`` where none is."""
    cone, out = law.cone, linear.copy()
    bad = (linear @ cone.T < -ON_WALL * np.abs(linear).max()).any(axis=1)
    if bad.any():
        root = root_of(np.atleast_2d(np.cov(linear.T)))
        steps = np.linalg.solve(root, (linear[bad] - optimum).T).T
        inside = nearest_inside(steps, cone @ root, -cone @ optimum)
        out[bad] = optimum + np.where(np.isfinite(inside), inside, 0.0) @ root.T
    return out


def _theta_of(target: SpecimenTarget, vectors: FloatArray) -> FloatArray:
    """Theta of vectors, every one of them passive."""
    law, shared = target.law, target.shared(vectors)
    linear = _passive(law, shared[:, law.times + len(MACHINE) :], target.optimum.point.linear)
    return law.theta(shared[:, : law.times], linear)


def _at_mean_machine(target: SpecimenTarget, vectors: FloatArray) -> FloatArray:
    """The same draws with the machine at its mean, the other coordinates following it linearly."""
    at = target.machine_places
    if at.size == 0:
        return vectors
    machine = vectors[:, at] - vectors[:, at].mean(axis=0)
    scale = np.maximum(machine.std(axis=0), 1e-300)
    others = np.setdiff1d(np.arange(vectors.shape[1]), at)
    centred = vectors[:, others] - vectors[:, others].mean(axis=0)
    slope, *_ = np.linalg.lstsq(machine / scale, centred, rcond=1e-6)
    out = vectors.copy()
    out[:, others] -= (machine / scale) @ slope
    out[:, at] = vectors[:, at].mean(axis=0)
    return out


def _draws(target: SpecimenTarget, sampled: Sampled, priors: Priors, seed: int) -> Draws:
    """Draws as vectors and as tissues."""
    z, central = sampled.chain.reshape(-1, sampled.chain.shape[2]), sampled.at_mean_machine
    known = sampled.vectors
    vectors = target.vectors(z) if known is None else known.reshape(len(z), -1)
    inner = _at_mean_machine(target, vectors) if central is None else target.vectors(central)
    inner = target.following(inner, z)
    gains = np.ones((len(vectors), 2))
    total, statistical = _theta_of(target, vectors), _theta_of(target, inner)
    if target.open:
        rng, gained = np.random.default_rng([seed, 5]), [priors.calibration[name] for name in GAINS]
        for k, one in enumerate(gained):
            gains[:, k] = np.maximum(one.mean + one.sd * rng.standard_normal(len(vectors)), 0.05)
        specs, means = target.law.model().parameters, np.array([[one.mean] for one in gained])
        total, statistical = scaled_theta(specs, total, *gains.T), scaled_theta(specs, statistical, *means)
    return Draws(vectors, total, statistical, gains)


def _of_both(draws: Draws, other: Draws, model: ChannelModel, seed: int) -> Draws:
    """Draws half of which are of another start that is as likely, as far as those are passive."""
    taken = np.random.default_rng([seed, 11]).random(len(draws.total)) < 0.5
    taken &= model.passive(other.total) & model.passive(other.statistical)
    total, statistical = draws.total.copy(), draws.statistical.copy()
    total[taken], statistical[taken] = other.total[taken], other.statistical[taken]
    return replace(draws, total=total, statistical=statistical)


def _sampled(
    identified: Identified,
    options: PosteriorOptions,
    machine: bool,
    checkpoint: Path | None,
    key: str,
    tick: Callable[[str], None],
) -> tuple[SpecimenTarget, Sampled]:
    """The target of a fit and its chain."""
    target = SpecimenTarget(identified, machine=machine)

    def walked(density: Target) -> Sampled:
        return sample(
            density,
            draws=options.draws,
            seed=options.seed,
            checkpoint=checkpoint,
            key=f"{key} {type(density).__name__}",
            progress=lambda steps, share: tick(f"sampling, {steps:,} points, {100.0 * share:.0f} %"),
        )

    def bounded(density: NormalTarget) -> Sampled:
        found = walked(density)
        # all of them: every second step would be one half of the sequence's strata
        drawn = found.chain.reshape(-1, found.chain.shape[2])
        inside = density.passive(drawn)
        central = density.at_mean_machine(drawn, inside)
        return replace(found, chain=inside.reshape(found.chain.shape), at_mean_machine=central)

    if identified.discrepant:
        return target, bounded(NormalTarget(target, sandwich_covariance(target)[0]))
    try:
        return target, walked(target)
    except ArithmeticError as error:
        # draws of the normal beside the optimum, within the passive set, and the reason
        found = bounded(NormalTarget(target, target.root @ target.root.T))
        detail = {**found.detail, "reason": str(error), "density": "normal"}
        return target, replace(found, converged=False, detail=detail)


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

    ``checkpoint``: file to go on from after a kill, used with the same ``key``; ``instrument``: give the
    total interval.
    """
    tick = tick or (lambda _: None)
    if options.sampler == "none" or fitted.identified.law.branches == 0 or not fitted.identified.quotable:
        return fitted.fit
    with threadpool_limits(limits=1, user_api="blas"):
        walked = partial(_sampled, options=options, machine=instrument, checkpoint=checkpoint, tick=tick)
        target, sampled = walked(fitted.identified, key=key)
        tick("the tissue's centre")
        draws = _draws(target, sampled, priors, options.seed)
        if fitted.identified.other is not None:
            also = _draws(*walked(fitted.identified.other, key=f"{key} other"), priors, options.seed)
            draws = _of_both(draws, also, fitted.tissue.model, options.seed)
        centred = _centred(fitted, target, draws)
        return _assembled(centred, target, sampled, draws, instrument=instrument)


def _centred(fitted: FittedSpecimen, target: SpecimenTarget, draws: Draws) -> FittedSpecimen:
    """The fit moved to one passive vector in the middle of its draws, which every curve is drawn from."""
    t = target.law.times
    middle = np.median(draws.vectors, axis=0)
    start, places = target.optimum.point, target.places
    times, machine = middle[:t], middle[t : t + len(MACHINE)] if target.open else start.machine
    own = middle[places["contact"]].reshape(1, 1) if "contact" in places else start.own
    point = Point(times, machine, start.linear, own)
    found = refit(fitted.identified, machine=False, start=point, steps=6, held=np.arange(t)).point
    moved = fitted.moved(found)
    return moved if moved.bare.nrmsd.range <= WORSE * fitted.bare.nrmsd.range else fitted


def without_faults(effects: FloatArray, total: Mapping[str, FloatArray]) -> Iterator[dict[str, FloatArray]]:
    """Draws moved to where effects (n, k) that can't be negative are none: each alone, then all.

    A machine without fault, or a K of none, is the edge of its prior, which central intervals leave out.
    Draws follow the effects by a cubic, in the logarithm where they are well above zero.
    """
    least, usual = np.quantile(effects, (CENTRAL_95[0], 0.5), axis=0)
    effects = effects[:, least < NONE_SHARE * usual]
    k, scaled = effects.shape[1], effects / np.maximum(effects.std(axis=0), 1e-300)
    powers = np.hstack([scaled, scaled**2, scaled**3])

    def moved(values: FloatArray, gone: list[int]) -> FloatArray:
        low, middle = np.quantile(values, (CENTRAL_95[0], 0.5))
        positive = bool(values.min() > 0.0 and low > NONE_SHARE * middle)
        followed = np.log(values) if positive else values
        slope = np.linalg.lstsq(powers - powers.mean(axis=0), followed - followed.mean(), rcond=1e-9)[0]
        left = followed - powers[:, gone] @ slope[gone]
        out = np.exp(left) if positive else left
        return np.asarray(np.maximum(out, 0.0) if values.min() >= 0.0 else out)

    for none in [[j] for j in range(k)] + ([list(range(k))] if k > 1 else []):
        gone = [j + k * power for j in none for power in range(3)]
        yield {name: moved(values, gone) for name, values in total.items()}


def _widest(draws: Mapping[str, FloatArray], names: Sequence[str], effects: FloatArray, least: Ends) -> Ends:
    """The least intervals; those named with these of draws, and of draws where effects (n, k) are none."""
    every = [least, interval95(draws), *map(interval95, without_faults(effects, draws))]
    return least | {
        name: (min(one[name][0] for one in every), max(one[name][1] for one in every)) for name in names
    }


def _uncertainties(
    target: SpecimenTarget,
    draws: Draws,
    statistical: Mapping[str, FloatArray],
    total: Mapping[str, FloatArray] | None,
    shape: tuple[int, int],
) -> dict[str, ParameterUncertainty]:
    """Mean, spread, intervals and diagnostics of each reported parameter."""
    base, law = statistical if total is None else total, target.law
    found = diagnose({name: one.reshape(shape) for name, one in base.items()})
    # tissue that only just is passive is an edge as well, but not for times
    least, machine = least_stiffness(law, draws.statistical), draws.vectors[:, target.cut_places]
    rest = [name for name in base if not name.startswith(TIME)]
    central = wide = _widest(statistical, rest, least, interval95(statistical))
    if total is not None:
        effects = np.hstack([machine, least_stiffness(law, draws.total)])
        wide = _widest(total, rest, effects, _widest(total, list(base), machine, central))
    return {
        name: ParameterUncertainty(
            mean=float(one.mean()),
            sd=float(one.std(ddof=1)),
            ci95=central[name],
            ci95_total=None if total is None else wide[name],
            **asdict(found[name]),
        )
        for name, one in base.items()
    }


def _with_medians(
    parameters: tuple[Estimate, ...], medians: Mapping[str, float], found: Mapping[str, ParameterUncertainty]
) -> tuple[Estimate, ...]:
    """Values are medians of the draws; what is identified is judged by their intervals.

    Polynomials always are; times where the interval is closed and narrow in the logarithm; viscosities
    where theirs is narrow or the time is known.
    """
    out: list[Estimate] = []
    times: dict[str, bool] = {}
    for one in parameters:
        value, own = medians[one.name], found[one.name]
        low, high = own.ci95 if own.ci95_total is None else own.ci95_total
        width = float(np.log(high / low)) if low > 0.0 else float("inf")
        if one.name.startswith(TIME):
            known = width <= MAX_WIDTH and not (one.detail.get("open_low") or one.detail.get("open_high"))
            times[one.name.removeprefix(TIME)] = known
        elif one.name.startswith(("static", "stiffness")):
            known = True
        else:
            timed = one.name.startswith(VISCOSITY) and times.get(one.name.removeprefix(VISCOSITY), False)
            known = width <= MAX_WIDTH_VISCOSITY or timed
        detail = {**one.detail, "mode": one.detail.get("estimate"), "estimate": value}
        detail["width_ln"] = width if np.isfinite(width) else None
        told = (value, own.sd) if known else (None, None)
        out.append(replace(one, value=told[0], stderr=told[1], identified=known, detail=detail))
    return without_exchanged(out)


def _assembled(
    fitted: FittedSpecimen, target: SpecimenTarget, sampled: Sampled, draws: Draws, *, instrument: bool
) -> SpecimenFit:
    """Values, intervals, budget and checks from draws."""
    model, fit, noise = fitted.tissue.model, fitted.bare, fitted.noise
    statistical = reported_draws(model, draws.statistical)
    total = reported_draws(model, draws.total) if instrument else None
    names = [one.name for one in fit.parameters]
    walkers, steps = sampled.chain.shape[:2]
    every = _uncertainties(target, draws, statistical, total, (walkers, steps))
    later = next_indentation(fitted.identified)
    found = {name: replace(every[name], prediction95=later.get(name)) for name in names}
    medians = {name: float(np.median(statistical[name])) for name in names}
    named = {one.name: (one.symbol, medians[one.name]) for one in fit.parameters}
    found, apart = reaching(named, found, len(fit.trials))
    if (bent := fitted.identified.bent) is not None:
        # relaxation times do not rest on the constancy of K
        for name, one in reported_draws(bent.model, bent.theta).items():
            if name in found and not name.startswith(TIME):
                found[name] = found[name].holding(float(one.min()), float(one.max()))
    parameters = _with_medians(fit.parameters, medians, found)
    parameters, said = withheld(parameters, outside(parameters, found), "the value lies outside it")
    parameters = tuple(replace(one, uncertainty=found.get(one.name)) for one in parameters)
    detail = {"density": "generalised" if fitted.identified.discrepant else "exact", **sampled.detail}
    detail["total"] = {"converged": True, "worth": sampled.detail["effective_draws"]}
    report = SamplerReport("emcee", sampled.converged, walkers * steps, sampled.acceptance, detail)
    posterior = Posterior(
        sampler=report,
        noise=noise,
        parameters=found,
        theta_names=fit.theta_names,
        draws=_kept(draws.statistical),
        log_prior=log_theta_prior(target, _kept(draws.statistical)),
        draws_total=_kept(draws.total) if instrument else None,
        covariance=np.cov(draws.statistical, rowvar=False),
        chain_names=tuple(np.array(target.names)[target.free].tolist()),
        chain=draws.vectors[:, target.free].reshape(walkers, steps, -1),
        log_density=sampled.log_density,
        priors=prior_table(target, draws.vectors, draws.statistical, draws.gains if instrument else None),
        budget=uncertainty_budget(target, draws.vectors, draws.gains, total) if total is not None else (),
        misfit=misfit_alarm(fitted.told.blocks, noise),
        bands=predictive_bands(fit, target, draws.vectors, sigma_N=noise.sigma_N),
    )
    kept = [flag for flag in fit.flags if flag.code != "not_identified"]
    spread = np.cov(draws.total if instrument else draws.statistical, rowvar=False)
    flags = (*said, *apart, *unidentified(parameters), *kept, *posterior_flags(posterior))
    told = replace(fit, parameters=parameters, posterior=posterior, flags=flags)
    return fitted.quoting(told, replace(fitted.tissue, covariance=np.atleast_2d(spread)))


def _kept(theta: FloatArray) -> FloatArray:
    """The draws that a bundle and a report keep, spread over all."""
    return theta[evenly(len(theta), KEPT_DRAWS)]
