"""The inference that is checked: from the recordings of one specimen to draws of everything that is quoted.

That of ``fit``, step by step and by the same functions, for contact points known up to their priors and a
model order that is fixed: sums, optimum, noise, whitening, target, sampler, redraw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, fit_candidate
from tissueid.fit.estimates import in_field_units
from tissueid.fit.logs import LogHandle, specimen_sums
from tissueid.fit.search import unbounded_covariance
from tissueid.fit.specimen import adjustments_of
from tissueid.fit.trials import Adjustment, model_force
from tissueid.fit.whitening import Whitened, optimum_of, whiten
from tissueid.fit.window import FittedLog
from tissueid.likelihood.knots import KnotSums, knot_sums
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import LogData
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.at_optimum import target_at
from tissueid.posterior.calibration import total_posterior
from tissueid.posterior.loose_noise import loose_noise
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.target import Redrawn
from tissueid.selfcheck.ranks import DRAWS
from tissueid.trial import Protocol as StatedProtocol
from tissueid.trial import Segmentation, Source, Trial

if TYPE_CHECKING:
    from tissueid.selfcheck.recording import ProtocolLog
    from tissueid.selfcheck.tissue import TissueCheck

__all__ = ["InMemoryLog", "Inferred", "in_memory", "infer"]

FloatArray = NDArray[np.float64]

#: Proposals of the exact sampler's pilot: for a few hundred draws a short one finds the bound.
PILOT = 2_048
#: Proposals for a draw after which that pilot was too short, and the usual one is taken.
SOON = 30
#: And those after which emcee is.
LATER = 100
#: Total draws behind a quoted interval: as many as a fit takes.
TOTAL_DRAWS = 4_000
#: Effective draws that are asked of emcee: its draws are correlated, and ranks want independent ones.
EMCEE_DRAWS = 4 * DRAWS
#: Largest standard deviation of ln tau that a first guess has.
WIDEST_GUESS = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Inferred:
    """Draws of one posterior.

    Attributes
    ----------
    theta : ndarray, shape (n, p)
    others : mapping
        ``sigma_N``, ``phi``, ``gain_sd`` and calibration nuisances -> ndarray of shape (n,), as far as they
        were sampled.
    detail : mapping
        Numbers of the sampler.
    source : ndarray of int, shape (n,), or None
        What each total draw was made from (:class:`tissueid.posterior.calibration.TotalPosterior`).
    """

    theta: FloatArray
    others: Mapping[str, FloatArray]
    detail: Mapping[str, float] = field(default_factory=dict)
    source: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class InMemoryLog(LogHandle):
    """A log whose fitted part is known: nothing is read, segmented or refined.

    Attributes
    ----------
    trial : Trial
    log : FittedLog
    """

    trial: Trial | None = None
    log: FittedLog | None = None

    def fitted(self) -> tuple[Trial, FittedLog]:
        """The trial and its fitted part."""
        assert self.trial is not None  # noqa: S101 -- in_memory gives both
        assert self.log is not None  # noqa: S101
        return self.trial, self.log


def _nothing_to_load() -> NoReturn:
    msg = "a simulated log lives in memory"
    raise RuntimeError(msg)


def in_memory(log: ProtocolLog, data: LogData) -> InMemoryLog:
    """The handle of one simulated log."""
    step = np.diff(data.time_s)
    speed = np.diff(data.depth_mm) / np.maximum(step, np.finfo(float).tiny)
    included = data.depth_mm[data.include]
    fitted = FittedLog(
        data=data,
        first=0,
        inserted=False,
        contact_sd_mm=log.contact_sd_mm,
        depth_mm=float(included.max()),
        step_s=float(np.median(step[step > 0.0])),
        speeds_mm_s=(float(speed[step > 0.0].max()),),
        has_hold=False,
        n_samples=int(data.include.sum()),
    )
    trial = Trial(
        log.name,
        data.time_s,
        data.depth_mm,
        data.force_N,
        StatedProtocol(),
        Source(path=log.name, recipe="simulated"),
    )
    return InMemoryLog(
        load=_nothing_to_load,
        segmentation=Segmentation(
            compression_sign=1, force_sign=1, contact=None, phases=(), force_noise_N=0.0
        ),
        facts=fitted.without_samples(),
        contact_sd_mm=log.contact_sd_mm,
        trial=trial,
        log=fitted,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fit under its noise, where it is linearised, and a guess of the sd of each ln tau."""

    whitened: Whitened
    optimum: Optimum
    model: KelvinVoigt
    theta: FloatArray
    adjustments: Sequence[Adjustment]
    log_tau_sd: FloatArray


def fitted_at_optimum(check: TissueCheck, handles: Sequence[LogHandle]) -> Fitted:
    """The steps of a fit whose model and contact points are given."""

    def silent(_message: str) -> None:
        return None

    candidate = Candidate(check.model.branches, check.model.stiffness_degree, check.pooling)
    sums = specimen_sums(handles, candidate.degree, silent, cut=False)
    first = fit_candidate(sums, candidate)
    model, theta, _, _, _ = in_field_units(sums, first)
    adjustments = adjustments_of(sums, first, (model, theta), handles)
    whitened = whiten(handles, sums, first, model, theta, adjustments, silent, noise=check.noise_model)
    solution = whitened.solution
    model, theta, _, _, _ = in_field_units(whitened.sums, solution)
    adjustments = adjustments_of(whitened.sums, solution, (model, theta), handles)
    inverse, _ = unbounded_covariance(solution.evaluation, solution.objective.blocks)
    variance = np.diag(inverse)[solution.evaluation.theta.size :] * solution.noise.sigma2
    known = np.isfinite(variance) & (variance > 0.0)
    sd = np.where(known, np.sqrt(np.where(known, variance, 1.0)), WIDEST_GUESS)
    return Fitted(
        whitened=whitened,
        optimum=optimum_of(solution, adjustments, whitened.sums.depth_mm),
        model=model,
        theta=theta,
        adjustments=adjustments,
        log_tau_sd=np.minimum(sd, WIDEST_GUESS),
    )


def _points(check: TissueCheck, target: SpecimenTarget, seed: int) -> tuple[FloatArray, dict[str, float]]:
    """Draws of the sampled coordinates, shape (n, d)."""
    if check.sampler == "exact":
        from tissueid.posterior.exact import sample_exact

        exact = sample_exact(target, draws=DRAWS, seed=seed, pilot=PILOT, max_proposals=SOON * DRAWS)
        if not exact.converged:
            exact = sample_exact(target, draws=DRAWS, seed=seed + 1, max_proposals=LATER * DRAWS)
        if exact.converged:
            return exact.points, {"acceptance": exact.acceptance, "by_emcee": 0.0}
    # a posterior that the exact sampler's proposals do not cover is left to the default one
    from tissueid.posterior.ensemble import sample_ensemble

    chain = sample_ensemble(target, draws=EMCEE_DRAWS, seed=seed)
    report = chain.report()
    if not report.converged:
        msg = f"the sampler did not converge: {report.detail.get('reason', '')}"
        raise ArithmeticError(msg)
    points = chain.points.reshape(-1, chain.points.shape[-1])
    return points, {"acceptance": report.acceptance, "by_emcee": 1.0}


def _others(
    check: TissueCheck, target: SpecimenTarget, points: FloatArray, drawn: Redrawn
) -> dict[str, FloatArray]:
    """Sampled scales in the units they are quoted in."""
    # beside white noise sigma is that of the filtered columns, and the share of white is plugged in
    out = {} if check.noise_model == "white+ar1" else {"sigma_N": drawn.sigma_N}
    if "arctanh_phi" in target.names:
        out["phi"] = drawn.phi
    if "ln_gain_sd" in target.names:
        out["gain_sd"] = np.exp(points[:, target.names.index("ln_gain_sd")])
    return out


def infer(check: TissueCheck, data: Sequence[LogData], rng: np.random.Generator) -> Inferred:
    """Draws of the posterior of one simulated specimen.

    Parameters
    ----------
    check : TissueCheck
    data : sequence of LogData
        In the order of ``check.logs``.
    rng : Generator

    Raises
    ------
    ArithmeticError
        The sampler did not converge.
    """
    handles = [in_memory(log, one) for log, one in zip(check.logs, data, strict=True)]
    fitted = fitted_at_optimum(check, handles)
    force = max(float(np.abs(one.force_N[one.include]).max()) for one in data)
    target = target_at(
        fitted.whitened,
        fitted.optimum,
        handles,
        check.priors,
        log_tau_sd=fitted.log_tau_sd,
        force_N=force,
    )
    seed = int(rng.integers(2**31))
    if check.defects:
        return _total(check, fitted, target, data, seed)
    points, detail = _points(check, target, seed)
    drawn = target.redraw(points, rng)
    return Inferred(
        theta=drawn.theta,
        others=_others(check, target, points, drawn),
        detail={**detail, "passive": drawn.acceptance},
    )


def _total(
    check: TissueCheck, fitted: Fitted, target: SpecimenTarget, data: Sequence[LogData], seed: int
) -> Inferred:
    """Tissue and instrument together."""
    noise = fitted.whitened.noise
    residuals = [
        one.force_N - model_force(fitted.model, fitted.theta, in_memory(handle, one).fitted()[1], adjustment)
        for one, handle, adjustment in zip(data, check.logs, fitted.adjustments, strict=True)
    ]

    def knots_at(phi: float) -> list[KnotSums]:
        return [
            knot_sums(
                one,
                left,
                phi=phi,
                reference_step_s=noise.reference_step_s,
                moving_average=noise.moving_average,
            ).tempered(fitted.whitened.tempering)
            for one, left in zip(data, residuals, strict=True)
        ]

    knots = knots_at(noise.phi)
    links = (target.data.ratio, target.data.links)
    found = total_posterior(
        knots,
        fitted.optimum,
        target.facts,
        target.model,
        check.priors,
        effects=target.effects,
        gain_sd=fitted.whitened.solution.noise.gain_sd,
        seed=seed,
        draws=TOTAL_DRAWS,
        start=target.optimum,
        noise=loose_noise(target, links, sum(one.count for one in knots), knots_at),
    )
    worth = float(found.sampler.detail["worth"])
    return Inferred(
        theta=found.theta,
        others={name: found.nuisances[:, k] for k, name in enumerate(found.names)},
        source=found.source,
        detail={"worth": worth, "converged": float(found.sampler.converged)},
    )
