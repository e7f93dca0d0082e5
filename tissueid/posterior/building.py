"""The density of a specimen built at its optimum, over a range of ln tau that is wide enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.lag_sums import LagSums
from tissueid.likelihood.linearise import Columns, Optimum, TauNodes, linear_columns, tau_nodes
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.joint_mode import joint_mode, towards
from tissueid.posterior.linear_priors import Facts, effect_prior, linear_prior
from tissueid.posterior.mass_surface import mass_surface
from tissueid.posterior.mode import WIDEST, too_short, with_mode
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors

__all__ = ["NotLinearError", "specimen_target"]

FloatArray = NDArray[np.float64]

#: Half width of the first range of ln tau around the optimum, in standard errors, and its least.
RANGE_SD = 9.0
NARROWEST = 0.15
#: Distance of the linear force at the mode from the model's below which the linearisation stands, in standard
#: deviations of the noise: no estimate is off by more of its own.
SAME_POINT = 0.1
#: Times it is linearised, the first included.
ROUNDS = 8


class NotLinearError(ArithmeticError):
    """No point of linearisation agrees with the mode that it leads to."""


def specimen_target(
    logs: Sequence[LagSums],
    basis: KernelBasis,
    optimum: Optimum,
    *,
    centred: Optimum,
    facts: Facts,
    priors: Priors,
    pooling: str,
    correlated: bool,
    start: FloatArray,
    start_sd: FloatArray,
) -> SpecimenTarget:
    """The posterior of a specimen, its mode found and its range of ln tau wide enough.

    Parameters
    ----------
    logs : sequence of LagSums
    basis : KernelBasis
    optimum : Optimum
        Where the specimen is linearised first; anew at the mode, where that lies elsewhere.
    centred : Optimum
        Whose residuals stand in the sums.
    facts : Facts
    priors : Priors
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    correlated : bool
        Sample phi.
    start, start_sd : ndarray, shape (d,)
        First guess of the coordinates and of their standard deviations.

    Raises
    ------
    NotLinearError
        However often it is linearised anew at its mode, the mode goes on elsewhere.
    """
    about, mode = optimum, start
    for _ in range(ROUNDS):
        target = _over_its_range(
            logs, basis, about, centred, facts, priors, _effects(pooling, facts), mode, start_sd,
            correlated=correlated,
        )  # fmt: skip
        there = joint_mode(target, logs, basis)
        if there.departure < SAME_POINT:
            return replace(target, surface=mass_surface(target))
        about, mode = towards(target, there.optimum, logs, basis, centred), target.mode
    msg = (
        "gains and contact points are linear about one point only, and the posterior's mode keeps "
        f"{there.departure:.2g} standard deviations of the noise away from any"
    )
    raise NotLinearError(msg)


def _over_its_range(
    logs: Sequence[LagSums],
    basis: KernelBasis,
    optimum: Optimum,
    centred: Optimum,
    facts: Facts,
    priors: Priors,
    effects: tuple[str, ...],
    start: FloatArray,
    start_sd: FloatArray,
    *,
    correlated: bool,
) -> SpecimenTarget:
    """The target linearised at one point, over a range of ln tau that holds it, its mode found."""
    low, high = facts.log_tau_bounds
    half = np.clip(RANGE_SD * start_sd[: optimum.branches], NARROWEST, WIDEST)
    while True:
        ends = np.array(
            [
                (max(low, tau - width), min(high, tau + width))
                for tau, width in zip(optimum.log_tau, half, strict=True)
            ]
        ).reshape(-1, 2)
        nodes = _nodes(ends, facts)
        few = _table([one.log_tau for one in nodes])
        columns = linear_columns(logs, basis, optimum, few, effects, centred=centred)
        built = _built(columns, nodes, optimum, facts, priors, effects, correlated=correlated)
        target = with_mode(built, start, start_sd)
        short = too_short(target, ends)
        if not short.any():
            return target
        half[short] *= 2.0


def _effects(pooling: str, facts: Facts) -> tuple[str, ...]:
    if pooling == "per-log":
        return ("static",)
    offset = ("offset",) if (facts.offset_sd_mm > 0.0).all() else ()
    return ("gain", *offset) if pooling == "partial" else offset


def _nodes(ends: FloatArray, facts: Facts) -> list[TauNodes]:
    """Nodes of ln tau for every branch, as many in each."""
    step, longest = math.exp(facts.log_tau_bounds[0]), math.exp(facts.log_tau_bounds[1])
    time = np.concatenate([[0.0], np.geomspace(step, longest, 120)])
    found = [tau_nodes(first, last, time) for first, last in ends]
    shape = max((one.mixing.shape[1] for one in found), default=0)
    found = [tau_nodes(first, last, time, shape=(0, shape)) for first, last in ends]
    most = max((one.log_tau.size for one in found), default=0)
    return [tau_nodes(first, last, time, shape=(most, shape)) for first, last in ends]


def _table(rows: list[FloatArray]) -> FloatArray:
    """One row a branch; without a branch there is none."""
    return np.ascontiguousarray(np.stack(rows)) if rows else np.zeros((0, 0))


def _stacked(nodes: Sequence[TauNodes]) -> FloatArray:
    """Mixing matrices of all branches, shape (branches, r, q)."""
    if not nodes:
        return np.zeros((0, 0, 0))
    return np.ascontiguousarray(np.stack([one.mixing for one in nodes]))


def _built(
    columns: Columns,
    nodes: Sequence[TauNodes],
    optimum: Optimum,
    facts: Facts,
    priors: Priors,
    effects: tuple[str, ...],
    *,
    correlated: bool,
) -> SpecimenTarget:
    """The target in given columns, its mode not yet found."""
    branches = optimum.branches
    model = KelvinVoigt(branches=branches, stiffness_degree=optimum.degree, depth_mm=optimum.scale)
    mean, precision, weak = linear_prior(priors, model, optimum, facts)
    blocks = np.array(
        [STATIC_DEGREE] * bool(optimum.static) + [optimum.degree + 1] * optimum.branches, dtype=np.int64
    )
    effect_mean, effect_sd = effect_prior(optimum, facts, effects)
    data = Linearised(
        branches=optimum.branches,
        degree=optimum.degree,
        static=optimum.static,
        shared=columns.shared,
        cross=columns.cross,
        own=columns.own,
        ratio=columns.ratio,
        links=columns.links,
        samples=float(columns.count),
        best=np.ascontiguousarray(optimum.theta),
        best_tau=np.ascontiguousarray(optimum.log_tau),
        nodes=_table([one.nodes for one in nodes]),
        barycentric=_table([one.barycentric for one in nodes]),
        mixing=_stacked(nodes),
        prior_mean=mean,
        prior_precision=precision,
        weak=weak,
        prior_log_mass=0.0,
        speed_mm_s=facts.speed_mm_s,
        depth_mm=facts.depth_mm,
        effect_precision=1.0 / effect_sd**2,
        effect_mean=effect_mean,
        phi=0.0,
        has_phi=correlated,
        has_gain="gain" in effects,
        blocks=blocks,
    )
    mass = log_passive_mass(mean, np.ascontiguousarray(np.linalg.inv(precision), dtype=np.float64), blocks)
    return SpecimenTarget(
        data=data._replace(prior_log_mass=float(mass)),
        optimum=optimum,
        model=model,
        priors=priors,
        facts=facts,
        effects=effects,
    )
