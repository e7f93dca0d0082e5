"""Independent draws from a posterior by acceptance-rejection: the reference for the ensemble sampler.

One or two coordinates are covered by log-linear cells (:mod:`tissueid.posterior.cells`), more by a mixture
of Student-t densities (:mod:`tissueid.posterior.mixture`).  Proposals are accepted with probability target
over (bound x proposal).  The bound is the largest ratio that a pilot found; a larger one that turns up
later raises it, and the draws taken so far are thinned by the ratio of the bounds, which keeps
them exact.  The same ratios give the evidence, with its Monte-Carlo error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.posterior.cells import MAX_COORDINATES, cells
from tissueid.posterior.mixture import fitted_mixture
from tissueid.posterior.target import Target
from tissueid.uncertainty import SamplerReport

__all__ = ["ExactChain", "sample_exact"]

FloatArray = NDArray[np.float64]

#: Proposals of the pilot, and of a batch at least and at most.
PILOT = 8_192
BATCH, LARGEST_BATCH = 2_048, 65_536
#: The bound stands above the largest ratio seen by this factor.
MARGIN = 1.02
#: Proposals at most for a wanted draw.
PATIENCE = 500
#: Effective share of the importance weights below which the proposal misses something, as a second mode.
LEAST_EFFECTIVE = 0.01


class _Proposal(Protocol):
    def draw(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]: ...


@dataclass(frozen=True, slots=True, eq=False)
class ExactChain:
    """Independent draws.

    Attributes
    ----------
    names : tuple of str
        Sampled coordinates.
    points : ndarray, shape (n, d)
    log_density : ndarray, shape (n,)
    converged : bool
    reason : str
        What is lacking, where it has not converged.
    method : str
        ``cells`` or ``mixture``.
    acceptance : float
        Accepted proposals over all, after the pilot.
    log_evidence, log_evidence_se : float
        ln of the integral of the density, and its Monte-Carlo standard error.
    effective_share : float
        Effective sample size of the importance weights over their number.
    evaluations : int
        Points at which the density was asked for.
    raised : int
        How often the bound was.
    seed : int
    """

    names: tuple[str, ...]
    points: FloatArray
    log_density: FloatArray
    converged: bool
    reason: str
    method: str
    acceptance: float
    log_evidence: float
    log_evidence_se: float
    effective_share: float
    evaluations: int
    raised: int
    seed: int

    def report(self) -> SamplerReport:
        """The words of identification.json."""
        detail: dict[str, object] = {
            "method": self.method,
            "log_evidence": self.log_evidence,
            "log_evidence_se": self.log_evidence_se,
            "effective_share": self.effective_share,
            "evaluations": self.evaluations,
            "seed": self.seed,
        }
        if self.reason:
            detail["reason"] = self.reason
        return SamplerReport(
            name="exact",
            converged=self.converged,
            draws=self.points.shape[0],
            acceptance=self.acceptance,
            detail=detail,
        )


class _Asked:
    """A target that counts the points it was asked for."""

    def __init__(self, target: Target) -> None:
        self.names, self.mode, self.covariance = target.names, target.mode, target.covariance
        self.redraw = target.redraw
        self._density = target.log_density
        self.count = 0

    def log_density(self, points: FloatArray) -> FloatArray:
        """As the target's; NaN counts as no density."""
        self.count += points.shape[0]
        value = self._density(points)
        return np.where(np.isnan(value), -np.inf, value)


class _Weights:
    """Running sums of importance weights, free of overflow."""

    def __init__(self) -> None:
        self.top, self.n, self.first, self.second = -math.inf, 0, 0.0, 0.0

    def add(self, log_weight: FloatArray) -> None:
        """Count more proposals."""
        top = max(self.top, float(log_weight.max()))
        if math.isfinite(top):
            shrink = math.exp(self.top - top) if math.isfinite(self.top) else 0.0
            weight = np.exp(log_weight - top)
            self.first = self.first * shrink + float(weight.sum())
            self.second = self.second * shrink**2 + float((weight * weight).sum())
            self.top = top
        self.n += log_weight.size

    @property
    def effective_share(self) -> float:
        """(sum w)^2 / (n sum w^2)."""
        return self.first**2 / (self.n * self.second) if self.second > 0.0 else 0.0

    @property
    def log_mean(self) -> float:
        """Ln of the mean weight: the evidence."""
        return self.top + math.log(self.first / self.n)

    @property
    def log_mean_se(self) -> float:
        """Standard error of the ln of the mean weight."""
        return math.sqrt(max(1.0 / self.effective_share - 1.0, 0.0) / self.n)


def sample_exact(
    target: Target,
    *,
    draws: int = 10_000,
    seed: int,
    max_proposals: int | None = None,
    pilot: int = PILOT,
) -> ExactChain:
    """Draw independently from a posterior.

    Parameters
    ----------
    target : Target
        Its density is asked for at thousands of points at a time.
    draws : int
    seed : int
        At least 0; all random numbers follow from it.
    max_proposals : int, optional
        After the pilot; by default :data:`PATIENCE` for each draw.
    pilot : int
        Proposals that find the bound; fewer are enough for few draws.

    Returns
    -------
    ExactChain
        Also where fewer draws than wanted were accepted, or the proposal covers the posterior badly:
        ``converged`` and ``reason`` say so.

    Raises
    ------
    ValueError
        The target has no finite density near its mode.
    """
    rng = np.random.default_rng([seed, 2])
    asked = _Asked(target)
    if not np.isfinite(asked.log_density(np.atleast_2d(target.mode))[0]):
        msg = "the posterior has no density at its mode"
        raise ValueError(msg)
    proposal: _Proposal
    few = target.mode.size <= MAX_COORDINATES
    proposal = cells(asked) if few else fitted_mixture(asked, rng, share=pilot / PILOT)
    weights = _Weights()
    _, _, log_weight = _proposed(asked, proposal, pilot, rng)
    weights.add(log_weight)
    most = PATIENCE * draws if max_proposals is None else max_proposals
    points, density, proposed, raised = _accepted(asked, proposal, weights, draws, most, rng)
    reason = ""
    if points.shape[0] < draws:
        reason = f"{points.shape[0]:,} of {draws:,} draws after {proposed:,} proposals"
    elif weights.effective_share < LEAST_EFFECTIVE:
        reason = (
            f"the proposal is worth {100.0 * weights.effective_share:.2g} % of its draws: "
            "the posterior may have parts that it hardly reaches"
        )
    return ExactChain(
        names=target.names,
        points=points[:draws],
        log_density=density[:draws],
        converged=not reason,
        reason=reason,
        method="cells" if few else "mixture",
        acceptance=min(points.shape[0] / max(proposed, 1), 1.0),
        log_evidence=weights.log_mean,
        log_evidence_se=weights.log_mean_se,
        effective_share=weights.effective_share,
        evaluations=asked.count,
        raised=raised,
        seed=seed,
    )


def _proposed(
    target: Target, proposal: _Proposal, n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points, their log density, and the ln of its ratio to the proposal's."""
    points, log_proposal = proposal.draw(n, rng)
    density = target.log_density(points)
    return points, density, density - log_proposal


def _accepted(
    target: Target,
    proposal: _Proposal,
    weights: _Weights,
    draws: int,
    most: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, int, int]:
    """Accepted points, their log density, proposals made, and how often the bound was raised."""
    bound = weights.top + math.log(MARGIN)
    points = np.empty((0, target.mode.size))
    density = np.empty(0)
    proposed, raised = 0, 0
    while points.shape[0] < draws and proposed < most:
        rate = max(points.shape[0], 1) / proposed if proposed else math.exp(weights.log_mean - bound)
        wanted = int(1.05 * (draws - points.shape[0]) / rate) + 64
        n = min(max(wanted, BATCH), LARGEST_BATCH, most - proposed)
        new, value, log_weight = _proposed(target, proposal, n, rng)
        weights.add(log_weight)
        proposed += n
        if weights.top > bound:
            higher = weights.top + math.log(MARGIN)
            kept = rng.random(points.shape[0]) < math.exp(bound - higher)
            points, density, bound = points[kept], density[kept], higher
            raised += 1
        taken = np.log1p(-rng.random(n)) < log_weight - bound
        points = np.concatenate([points, new[taken]])
        density = np.concatenate([density, value[taken]])
    return points, density, proposed, raised
