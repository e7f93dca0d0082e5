"""From draws of the contact model to reported values, bands, shares of sources and the next indentation.

The next indentation: how far each parameter of another log may be from those that were seen.
Every log is fitted alone under the specimen's law, the machine where all of them put it.  What one log says
differs from the next by its site as much as by its noise: Student's t on the log scale over the logs, times
sqrt(1 + 1/n), is the 95 % prediction interval of one more.

Uncertainty budget of a reported parameter by source, read off the draws.
Parameters depend on the machine's coordinates, on the gains of its channels and on a single log's contact
almost linearly over the posterior: each source's share is its variance in that linear dependence, and noise
(with the scatter between logs) is what remains.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import BudgetRow, Source
from tissueid.inference.engine import Identified
from tissueid.inference.estimates import REFERENCE_DEPTH
from tissueid.inference.optimum import minimise
from tissueid.inference.prior import prior_rows
from tissueid.inference.system import Effects, Point, System
from tissueid.inference.target import SpecimenTarget
from tissueid.model.base import branch_suffix
from tissueid.model.channels import ChannelModel
from tissueid.quantities import predicted
from tissueid.result import SpecimenFit

#: Ends of the central 95 % interval, and the end of the one that begins at an active bound.
CENTRAL_95, FROM_BOUND_95 = (0.025, 0.975), 0.95
#: Lower end of the central interval over the median below which positive draws are densest at their bound:
#: of a normal that is cut where its density is that of the upper end (0.12).
CROWDED = 0.1


def reported_draws(model: ChannelModel, theta: FloatArray) -> dict[str, FloatArray]:
    """Every reported parameter of each draw: theta by name, and the viscosities.

    ``theta`` (n, p).  Returns name -> ndarray, shape (n,), in the parameter's unit; viscosity at half depth
    where K varies.
    """
    out: dict[str, FloatArray] = {name: theta[:, k] for k, name in enumerate(model.parameter_names)}
    if not model.viscous:
        return out
    powers = (REFERENCE_DEPTH * model.depth_mm) ** np.arange(float(model.stiffness_degree + 1))
    for branch in range(model.branches):
        last = model.parameter_names.index(f"relaxation_time_s{branch_suffix(branch)}")
        stiffness = theta[:, last - powers.size : last] @ powers
        out[f"viscosity_N_s_per_mm{branch_suffix(branch)}"] = stiffness * theta[:, last]
    return out


def interval95(draws: Mapping[str, FloatArray]) -> dict[str, tuple[float, float]]:
    """The 95 % interval of each parameter's draws: central, or of highest density from an active bound of 0.

    Relaxation times have no bound at 0.
    """
    out = {}
    for name, values in draws.items():
        low, middle, high = np.quantile(values, (CENTRAL_95[0], 0.5, CENTRAL_95[1]))
        bounded = not name.startswith("relaxation_time") and float(values.min()) >= 0.0
        if bounded and low < CROWDED * middle:
            low, high = 0.0, np.quantile(values, FROM_BOUND_95)
        out[name] = (float(low), float(high))
    return out


#: Fewest logs, and steps of the fit of each.
FEWEST, STEPS = 3, 12


def _alone(identified: Identified, index: int) -> FloatArray:
    """Theta of one log under the specimen's law."""
    found, law = identified.optimum, identified.law.along((index,))
    system = System([identified.system.logs[index]], law, identified.system.depth_mm, Effects())
    at, effects = found.point, identified.system.effects
    contact = at.own[index, int(effects.gain)]
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


TOTAL: Source = "total"
#: Names of the machine's coordinates as sources.
SOURCES: Mapping[str, Source] = {
    "frame_compliance_mm_per_N": "frame",
    "skew_s": "time skew",
    "force_filter_s": "force filter",
    "contact": "contact points",
}


def uncertainty_budget(
    target: SpecimenTarget, vectors: FloatArray, gains: FloatArray, draws: Mapping[str, FloatArray]
) -> tuple[BudgetRow, ...]:
    """Standard deviation by source of every reported parameter.

    ``vectors`` (n, size); ``gains`` (n, 2); ``draws``: reported parameter -> draws with the machine open.
    """
    columns = [gains[:, 0], gains[:, 1]]
    names: list[Source] = ["force gain", "displacement gain"]
    for k, name in enumerate(target.names):
        if name in SOURCES and target.free[k]:
            columns.append(vectors[:, k])
            names.append(SOURCES[name])
    matrix = np.column_stack(columns)
    matrix = matrix - matrix.mean(axis=0)
    spread = np.maximum(matrix.std(axis=0), 1e-300)
    rows = []
    for parameter, values in draws.items():
        centred = values - values.mean()
        variance = float(np.mean(centred**2))
        slope, *_ = np.linalg.lstsq(matrix / spread, centred, rcond=1e-8)
        parts = np.minimum(slope**2, variance)
        left = max(variance - float(parts.sum()), 0.0)
        shares: list[tuple[Source, float]] = [("noise", left)]
        shares += [(name, float(part)) for name, part in zip(names, parts, strict=True)]
        whole = sum(part for _, part in shares) or 1.0
        rows += [BudgetRow(parameter, name, float(np.sqrt(part)), part / whole) for name, part in shares]
        rows.append(BudgetRow(parameter, TOTAL, float(np.sqrt(variance)), None))
    return tuple(rows)


#: Draws that a band is made of.
BAND_DRAWS = 120
TWO_SIDED_95 = 1.959963984540054


def predictive_bands(
    fit: SpecimenFit, target: SpecimenTarget, vectors: FloatArray, *, sigma_N: float
) -> dict[tuple[str, str | None], FloatArray]:
    """The 95 % predictive band of every trial.

    ``vectors`` (n, size): draws, machine and contact with them: what they share moves no force; ``sigma_N``:
    standard deviation of the noise [N].  Returns (path, sheet) -> ndarray, shape (3, m): low, middle, high
    [N] at the samples of the trial's curve.
    """
    system = target.system
    rows = np.linspace(0, len(vectors) - 1, min(len(vectors), BAND_DRAWS)).astype(np.int64)
    force = target.forces(vectors[rows])
    change = force - np.median(force, axis=0)
    bands = {}
    for i, trial in enumerate(fit.trials):
        mine, curve = system.log == i, trial.curve
        own = change[:, mine]
        if len(fit.trials) > 1:
            # logs differ in level: their own gain takes up what all depths share
            base = np.median(force[:, mine], axis=0)
            own = own - ((own @ base) / max(float(base @ base), 1e-300))[:, None] * base
        # a few draws far out would be the whole of a variance
        sd = np.subtract(*np.quantile(own, [0.84, 0.16], axis=0)) / 2.0
        since = system.mid[mine] - system.logs[i].time_s[0]
        spread = np.interp(curve.time_s, since - since[0], sd)
        half = TWO_SIDED_95 * np.sqrt(spread**2 + sigma_N**2)
        bands[trial.path, trial.sheet] = np.stack([curve.model_N - half, curve.model_N, curve.model_N + half])
    return bands
