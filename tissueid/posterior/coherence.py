"""Whether a value and its intervals speak of one thing, and the tissue that does where they don't.

A value is printed with an interval only where it lies inside both of its intervals.  The optimum may not: at
a corner of what is passive, whose neighbourhood has next to no volume, few draws are near it.  The tissue
that is printed then is the first on the way from the optimum to the centre of the best draws that lies inside
every interval: passive, as coefficients and viscosities of both ends are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.estimates import TissueEstimate
from tissueid.flags import Flag
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.reported import reported_draws
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import ParameterUncertainty

__all__ = ["at_theta", "coherent_share", "outside", "unsampled", "withheld"]

FloatArray = NDArray[np.float64]

#: Shares of the way to the centre that are tried, and what a value that was moved keeps from the ends of its
#: intervals, as a share of their width.
SHARES = tuple(float(share) for share in np.linspace(0.025, 1.0, 40))
MARGIN = 0.02
#: Symbols named in one sentence.
LONGEST_LIST = 3
#: Share of the draws that are the best, and fewest of them.
BEST_SHARE, FEWEST = 0.05, 10


def _central(model: KelvinVoigt, draws: FloatArray) -> FloatArray:
    """Centre of draws of theta, shape (n, p): of coefficients of F_s, of viscosities, and of ln tau."""
    centre = draws.mean(axis=0)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        tau = float(np.exp(np.log(draws[:, last]).mean()))
        centre[first:last] = (draws[:, first:last] * draws[:, last : last + 1]).mean(axis=0) / tau
        centre[last] = tau
    return np.asarray(centre)


def _between(model: KelvinVoigt, near: FloatArray, far: FloatArray, share: float) -> FloatArray:
    """Theta on the way from one to another, both passive: it is as well."""
    out = near + share * (far - near)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        tau = float(near[last] ** (1.0 - share) * far[last] ** share)
        viscosity = near[first:last] * near[last] * (1.0 - share) + far[first:last] * far[last] * share
        out[first:last], out[last] = viscosity / tau, tau
    return np.asarray(out)


def _best(
    tissue: TissueEstimate,
    draws: FloatArray,
    log_density: FloatArray,
    found: Mapping[str, ParameterUncertainty],
) -> FloatArray:
    """Draws of highest density among those inside every interval; of all, where none is."""
    inside = np.ones(draws.shape[0], dtype=np.bool_)
    values = reported_draws(tissue.model, draws)
    for one in tissue.parameters:
        if one.value is not None and one.name in found:
            for interval in (found[one.name].ci95, found[one.name].ci95_total):
                if interval is not None:
                    spare = 2.0 * MARGIN * (interval[1] - interval[0])
                    inside &= values[one.name] >= interval[0] + spare
                    inside &= values[one.name] <= interval[1] - spare
    rows = np.flatnonzero(inside) if inside.sum() >= FEWEST else np.arange(draws.shape[0])
    count = max(int(BEST_SHARE * rows.size), FEWEST)
    return draws[rows[np.argsort(log_density[rows])[-count:]]]


def coherent_share(
    tissue: TissueEstimate,
    draws: FloatArray,
    log_density: FloatArray,
    found: Mapping[str, ParameterUncertainty],
) -> tuple[float, TissueEstimate]:
    """How far from the optimum towards the centre of the best draws every value lies inside its intervals.

    Parameters
    ----------
    tissue : TissueEstimate
        At the optimum.
    draws : ndarray, shape (n, p)
        Of theta.
    log_density : ndarray, shape (n,)
        Of theta together with what was sampled.
    found : mapping
        Name -> intervals.

    Returns
    -------
    share : float
        0 at the optimum, 1 at the centre, also where it is not inside either.
    tissue : TissueEstimate
        There.
    """
    if not outside(tissue.parameters, found):
        return 0.0, tissue
    centre = _central(tissue.model, _best(tissue, draws, log_density, found))
    for share in SHARES:
        moved = at_theta(tissue, _between(tissue.model, tissue.theta, centre, share))
        if not outside(moved.parameters, found, margin=MARGIN):
            break
    return share, moved


def at_theta(tissue: TissueEstimate, theta: FloatArray) -> TissueEstimate:
    """The same tissue with its values at another theta; verdicts and standard errors stay."""
    values = {name: float(one[0]) for name, one in reported_draws(tissue.model, theta[None]).items()}
    return replace(
        tissue, theta=theta, parameters=tuple(_moved(one, values[one.name]) for one in tissue.parameters)
    )


def _moved(one: Estimate, value: float) -> Estimate:
    detail = {**one.detail, "estimate": value, "optimum": one.detail.get("estimate")}
    return replace(one, value=value if one.identified else None, detail=detail)


def _inside(value: float, interval: tuple[float, float] | None, margin: float) -> bool:
    if interval is None:
        return False
    spare = margin * (interval[1] - interval[0])
    return interval[0] + spare <= value <= interval[1] - spare


def outside(
    parameters: tuple[Estimate, ...], found: Mapping[str, ParameterUncertainty], *, margin: float = 0.0
) -> tuple[str, ...]:
    """Identified parameters whose value lies outside an interval of theirs, or whose intervals part.

    Parameters
    ----------
    parameters : tuple of Estimate
    found : mapping
        Name -> intervals; a total interval that is missing where others have one counts as outside.
    margin : float
        Share of an interval's width that the value must keep from its ends.
    """
    totals = any(one.ci95_total is not None for one in found.values())
    out = []
    for one in parameters:
        if one.value is None or one.name not in found:
            continue
        own = found[one.name]
        good = _inside(one.value, own.ci95, margin)
        if totals or own.ci95_total is not None:
            good &= _inside(one.value, own.ci95_total, margin)
        if not good:
            out.append(one.name)
    return tuple(out)


def withheld(
    parameters: tuple[Estimate, ...], names: tuple[str, ...], why: str
) -> tuple[tuple[Estimate, ...], tuple[Flag, ...]]:
    """Parameters without the intervals that can't be believed, which are then not identified.

    Parameters
    ----------
    parameters : tuple of Estimate
    names : tuple of str
        Of those without.
    why : str
        Ends the sentence.
    """
    if not names:
        return parameters, ()
    held = [one.symbol for one in parameters if one.name in names]
    symbols = ", ".join(held) if len(held) <= LONGEST_LIST else f"{held[0]} and {len(held) - 1} more"
    kept = tuple(
        replace(one, identified=False, detail={**one.detail, "withheld": why}) if one.name in names else one
        for one in parameters
    )
    flag = Flag(
        "interval_withheld",
        f"no interval for {symbols} ({len(held)} of {len(parameters)}): {why}",
        {"names": list(names)},
    )
    return kept, (flag,)


def unsampled(fit: SpecimenFit, why: str, flags: tuple[Flag, ...]) -> SpecimenFit:
    """A fit without a posterior: its values stand without intervals, and none is called identified.

    Parameters
    ----------
    fit : SpecimenFit
    why : str
        Ends the sentence "no interval is given".
    flags : tuple of Flag
        What is said of it.
    """
    names = tuple(one.name for one in fit.parameters if one.value is not None)
    parameters, _ = withheld(fit.parameters, names, why)
    return replace(fit, parameters=parameters, flags=(*fit.flags, *flags))
