"""Whether a value and its intervals speak of one thing, and the one tissue that does where they don't.

A value is printed with an interval only where it lies inside both of its intervals.  Where the optimum does
not, as at a corner of what is passive, whose neighbourhood has next to no volume, the centre of the draws
takes its place: the mean of the coefficients of F_s and of the viscosities K tau, with the mean of ln tau,
is passive as every draw is.
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
from tissueid.result import Estimate
from tissueid.uncertainty import ParameterUncertainty

__all__ = ["at_centre", "central_theta", "outside", "withheld"]

FloatArray = NDArray[np.float64]


def central_theta(model: KelvinVoigt, draws: FloatArray) -> FloatArray:
    """Centre of passive draws of theta, shape (n, p): passive itself."""
    centre = draws.mean(axis=0)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        tau = float(np.exp(np.log(draws[:, last]).mean()))
        centre[first:last] = (draws[:, first:last] * draws[:, last : last + 1]).mean(axis=0) / tau
        centre[last] = tau
    return np.asarray(centre)


def at_centre(tissue: TissueEstimate, theta: FloatArray) -> TissueEstimate:
    """The same tissue with its values at another theta; verdicts and standard errors stay."""
    values = {name: float(one[0]) for name, one in reported_draws(tissue.model, theta[None]).items()}
    return replace(
        tissue, theta=theta, parameters=tuple(_moved(one, values[one.name]) for one in tissue.parameters)
    )


def _moved(one: Estimate, value: float) -> Estimate:
    detail = {**one.detail, "estimate": value, "optimum": one.detail.get("estimate")}
    return replace(one, value=value if one.identified else None, detail=detail)


def _inside(value: float, interval: tuple[float, float] | None) -> bool:
    return interval is not None and interval[0] <= value <= interval[1]


def outside(parameters: tuple[Estimate, ...], found: Mapping[str, ParameterUncertainty]) -> tuple[str, ...]:
    """Identified parameters whose value lies outside an interval of theirs, or whose intervals part.

    Parameters
    ----------
    parameters : tuple of Estimate
    found : mapping
        Name -> intervals; a total interval that is missing where others have one counts as outside.
    """
    totals = any(one.ci95_total is not None for one in found.values())
    out = []
    for one in parameters:
        if one.value is None or one.name not in found:
            continue
        own = found[one.name]
        good = _inside(one.value, own.ci95)
        if totals or own.ci95_total is not None:
            good &= _inside(one.value, own.ci95_total)
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
    symbols = ", ".join(one.symbol for one in parameters if one.name in names)
    kept = tuple(
        replace(one, identified=False, detail={**one.detail, "withheld": why}) if one.name in names else one
        for one in parameters
    )
    flag = Flag(
        "interval_withheld",
        f"no interval is given for {symbols}: {why}; more logs, or --branches 1, may do",
        {"names": list(names)},
    )
    return kept, (flag,)
