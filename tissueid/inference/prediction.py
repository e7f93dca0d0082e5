"""The next indentation: how far each parameter of another log may be from those that were seen.

Every log is fitted alone under the specimen's law, the machine where all of them put it.  What one log says
differs from the next by its site as much as by its noise: Student's t on the log scale over the logs, times
sqrt(1 + 1/n), is the 95 % prediction interval of one more.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.engine import Identified
from tissueid.inference.optimum import minimise
from tissueid.inference.prior import prior_rows
from tissueid.inference.reported import reported_draws
from tissueid.inference.system import Effects, Point, System
from tissueid.measures import predicted

#: Fewest logs, and steps of the fit of each.
FEWEST, STEPS = 3, 12


def _alone(identified: Identified, index: int) -> FloatArray:
    """Theta of one log under the specimen's law."""
    found, law = identified.optimum, identified.law.along((index,))
    system = System([identified.system.logs[index]], law, identified.system.depth_mm, Effects())
    at, effects = found.point, identified.system.effects
    contact = at.own[index, int(effects.gain)] if effects.contact else 0.0
    gain = float(np.exp(at.own[index, 0])) if effects.gain else 1.0
    start = Point(at.log_times, at.machine, gain * at.linear, np.array([[contact]]))
    one = minimise(
        system,
        start,
        lambda point: prior_rows(
            system, law, point, identified.scatter, identified.request.priors, machine=False
        ),
        machine=False,
        steps=STEPS,
    )
    return np.asarray(law.theta(one.point.log_times, one.point.linear)[0])


def next_indentation(identified: Identified) -> dict[str, tuple[float, float]]:
    """Prediction intervals of the reported parameters.

    Returns name -> interval; empty with fewer than three logs, and without parameters that no log determines.
    """
    logs = len(identified.system.logs)
    if logs < FEWEST:
        return {}
    theta = np.array([_alone(identified, i) for i in range(logs)])
    out = {}
    for name, values in reported_draws(identified.law.model(), theta).items():
        if (values > 0.0).all():
            ln = np.log(values)
            found = predicted(float(ln.mean()), float(ln.std(ddof=1)), logs)
            if found is not None:
                out[name] = found
    return out
