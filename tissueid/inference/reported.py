"""From draws to reported values, bands, shares of sources, the next indentation, and priors beside them.

Shares are variances in a linear dependence on the sources; the next indentation is Student's t over the logs,
each fitted alone, times sqrt(1 + 1/n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.identification import BudgetRow, PriorRow, Source
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.engine import Identified
from tissueid.inference.estimates import REFERENCE_DEPTH
from tissueid.inference.optimum import minimise
from tissueid.inference.prior import prior_rows, stated_shapes, time_bounds
from tissueid.inference.system import MACHINE, Effects, Point, System
from tissueid.inference.target import SpecimenTarget
from tissueid.model.base import ContactPath, branch_suffix
from tissueid.model.channels import ChannelModel, minimum_on_unit
from tissueid.priors import WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior
from tissueid.quantities import predicted
from tissueid.result import SpecimenFit
from tissueid.trial import Trial, contact_frame

if TYPE_CHECKING:
    from tissueid.inference.logs import LogHandle
    from tissueid.inference.specimen import FittedSpecimen
    from tissueid.inference.window import FittedLog

#: Ends of the central 95 % interval, and the end of the one that begins at an active bound.
CENTRAL_95, FROM_BOUND_95 = (0.025, 0.975), 0.95
#: Lower end of the central interval over the median below which positive draws are densest at their bound:
#: of a normal that is cut where its density is that of the upper end (0.12).
CROWDED = 0.1
#: Curves that are simulated, their seed, and quantiles of one standard deviation about the median.
CURVES, SEED, ONE_SD = 400, 5, (0.1587, 0.8413)


def reported_draws(model: ChannelModel, theta: FloatArray) -> dict[str, FloatArray]:
    """Theta (n, p) by name, each (n,) in its unit, and the viscosities, at half depth where K varies."""
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
    """95 % intervals: central, or of highest density from an active bound of 0, which times do not have."""
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
        partial(prior_rows, system, identified.scatter, identified.request.priors, machine=False),
        noise=found.noise.memory,
        machine=False,
        steps=STEPS,
    )
    return np.asarray(law.theta(one.point.log_times, one.point.linear)[0])


def next_indentation(identified: Identified) -> dict[str, tuple[float, float]]:
    """Prediction intervals of parameters that every log determines; none with fewer than three logs."""
    logs = len(identified.system.logs)
    if logs < FEWEST:
        return {}
    theta = np.array([_alone(identified, i) for i in range(logs)])
    out = {}
    for name, values in reported_draws(identified.model, theta).items():
        if (values > 0.0).all():
            ln = np.log(values)
            found = predicted(float(ln.mean()), float(ln.std(ddof=1)), logs)
            if found is not None:
                out[name] = found
    return out


TOTAL: Source = "total"
#: Gains of the channels among the priors.
GAINS = ("force_gain", "displacement_gain")
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
    """Standard deviation by source of every reported parameter, of draws with the machine open."""
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
    """The 95 % predictive band of every trial: low, middle, high [N] at its curve, (3, m)."""
    system = target.system
    force = target.forces(vectors[evenly(len(vectors), BAND_DRAWS)])
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


#: Standard deviation of a half-normal in its scale, and range of ln sigma.
HALF_NORMAL_SD, LOG_SIGMA_RANGE = math.sqrt(1.0 - 2.0 / math.pi), 12.0 * math.log(10.0)


def _row(name: str, words: str, stated: bool, draws: FloatArray, prior_sd: float) -> PriorRow:
    after = float(draws.std(ddof=1))
    return PriorRow(
        name=name,
        prior=words,
        stated=stated,
        posterior_mean=float(draws.mean()),
        posterior_sd=after,
        shrinkage=max(1.0 - after / prior_sd, 0.0) if prior_sd > 0.0 else 0.0,
    )


def _row_in_ln(
    name: str, given: SpreadPrior | None, unit: str, draws: FloatArray, free: tuple[str, float]
) -> PriorRow:
    """A coordinate that is a logarithm; ``free``: words and width of its prior where none is stated."""
    if given is None:
        return _row(name, free[0], False, draws, free[1] / math.sqrt(12.0))
    words = f"log-normal, median {given.median:.4g} {unit}, sd {given.sd_ln:.3g} in ln"
    return _row(name, words, True, draws, given.sd_ln)


def _linear(target: SpecimenTarget, theta: FloatArray) -> list[PriorRow]:
    """Coefficients of F_s and K."""
    law, priors, point = target.law, target.priors, target.optimum.point
    specs = {spec.name: (k, spec) for k, spec in enumerate(law.model().parameters)}
    spread, rows = WEAK_FACTOR * target.force, []
    field = law.field(point.log_times[None])[0]
    states = law.largest_states(point.log_times, target.system.path(target.system.travel))
    for block in law.blocks:
        # of each power's coefficient where those of Bernstein's polynomials have a standard deviation of 1
        powers = np.linalg.inv(block.bernstein)
        for power, at in enumerate(range(block.at.start, block.at.stop)):
            k, spec = specs[law.linear_names[at]]
            if spec.name in priors.linear:
                mean, sd = priors.linear[spec.name]
                words = f"normal, {mean:.4g} ± {sd:.3g} {spec.unit}, cut to the passive set"
                rows.append(_row(spec.name, words, True, theta[:, k], sd))
                continue
            state = states[block.branch] if block.branch >= 0 else 1.0
            wide = float(np.linalg.norm(powers[power]))
            words = f"weak: every part of the curve up to some {spread:.3g} N, cut to the passive set"
            rows.append(_row(spec.name, words, False, theta[:, k], float(spread / state * field[at] * wide)))
    return rows


def _machine_words(one: CalibrationPrior) -> tuple[str, float]:
    """A prior of the machine in words, and its standard deviation."""
    if one.lower == one.mean:
        return f"half-normal from {one.lower:g}, scale {one.sd:.3g}", one.sd * HALF_NORMAL_SD
    cut = f", not below {one.lower:g}" if math.isfinite(one.lower) else ""
    return f"normal, {one.mean:.4g} ± {one.sd:.3g}{cut}", one.sd


def prior_table(
    target: SpecimenTarget, vectors: FloatArray, theta: FloatArray, gains: FloatArray | None
) -> tuple[PriorRow, ...]:
    """Every prior of a specimen, its posterior and the shrinkage between them."""
    priors, places = target.priors, target.places
    rows, (low, high) = _linear(target, theta), time_bounds(target.system)
    stated = stated_shapes(target.law, priors)
    for j, shape in enumerate(target.law.shapes):
        name, unit, ends = shape.spec.name, shape.spec.unit, (shape.spec.lower, shape.spec.upper)
        if j < target.law.counts[0]:
            name, unit, width = f"relaxation_time_{j + 1}", "s", high - low
            words = f"uniform in ln tau from {math.exp(low):.3g} s to {math.exp(high):.3g} s"
        else:
            width = math.log(ends[1]) - math.log(ends[0])
            words = f"uniform in its logarithm from {ends[0]:g} to {ends[1]:g}"
        rows.append(_row_in_ln(f"ln_{name}", stated.get(j), unit, vectors[:, j], (words, width)))
    sigma = vectors[:, places["ln_sigma"]]
    rows.append(_row_in_ln("ln_sigma", priors.sigma_N, "N", sigma, ("uniform in ln sigma", LOG_SIGMA_RANGE)))
    if "ln_gain_sd" in places:
        words, scale = f"half-normal, scale {priors.gain_sd:.3g}", priors.gain_sd * HALF_NORMAL_SD
        own = np.exp(vectors[:, places["ln_gain_sd"]])
        rows.append(_row("gain_sd", words, priors.gain_sd != Priors().gain_sd, own, scale))
    if gains is not None:
        drawn = np.column_stack([gains, vectors[:, target.law.times :][:, : len(MACHINE)]])
        for name, own in zip((*GAINS, *MACHINE), drawn.T, strict=True):
            words, sd = _machine_words(priors.calibration[name])
            rows.append(_row(name, words, priors.calibration[name].stated, own, sd))
    return tuple(rows)


def least_stiffness(law: ChannelLaw, theta: FloatArray) -> FloatArray:
    """Smallest F_s/x and K_j within the depth of rows of theta, (n, polynomials)."""
    linear = theta[:, law.model().linear_places]
    sizes = [(one.at, law.depth_mm ** np.arange(one.size)) for one in law.blocks if one.polynomial]
    return np.array([minimum_on_unit(linear[:, at] * by) for at, by in sizes]).T.reshape(len(theta), -1)


def log_theta_prior(target: SpecimenTarget, theta: FloatArray) -> FloatArray:
    """Ln of the prior density of rows of theta, (n, p) -> (n,), up to a constant of the specimen."""
    law, priors, model = target.law, target.priors, target.law.model()
    largest = law.largest_states(target.optimum.point.log_times, target.system.path(target.system.travel))
    logs = np.log(theta[:, model.shape_places])[:, np.argsort(law._order)]  # noqa: SLF001
    field = law.field(logs)
    linear = theta[:, model.linear_places] / field
    value = law.ln_volume(logs, priors.linear) - logs.sum(axis=1) - np.log(field).sum(axis=1)
    spread, exponential = WEAK_FACTOR * target.force, law.relaxation.branches > 0
    for one in law.blocks:
        # the largest state of a branch follows the time of an exponential; of other laws it is a constant
        state = np.ones(len(theta))
        if one.branch >= 0 and exponential:
            tau_s = np.exp(logs[:, one.branch])
            state = np.exp(np.interp(np.log(tau_s), target._ln_tau, target._ln_state))  # noqa: SLF001
        elif one.branch >= 0:
            state = state * largest[one.branch]
        value -= 0.5 * ((linear[:, one.at] @ one.bernstein.T) ** 2).sum(axis=1) * (state / spread) ** 2
        value += one.size * np.log(state)
    for j, given in stated_shapes(law, priors).items():
        value -= 0.5 * ((logs[:, j] - math.log(given.median)) / given.sd_ln) ** 2
    for name, (mean, sd) in priors.linear.items():
        if name in model.parameter_names:
            value -= 0.5 * ((theta[:, model.parameter_names.index(name)] - mean) / sd) ** 2
    return np.asarray(value)


def half_width(
    fitted: FittedSpecimen, handle: LogHandle, log: FittedLog, draws: FloatArray, level: float
) -> FloatArray:
    """Half width of the band that holds the whole force of a log that is not of the fit, (n,) [N].

    The spread of simulated curves at each sample, as many times as 95 % of them stay within at every sample
    (Montiel Olea & Plagborg-Moller 2019, doi 10.1002/jae.2656).
    ``draws`` (m, p): tissues of the posterior, which have the error of the mean.  Gains and relaxation times
    spread as those of the fit's logs do (Student's t of their logarithms; none with one log), contact by its
    sd.
    """
    rng, data = np.random.default_rng(SEED), log.data
    theta = draws[evenly(len(draws), CURVES)]
    shift = rng.normal(0.0, handle.contact_sd_mm, len(theta))
    own, effects = fitted.identified.optimum.point.own, fitted.identified.system.effects

    def spreading(at: int) -> FloatArray:
        return np.asarray(np.exp(own[:, at].std(ddof=1) * rng.standard_t(len(own) - 1, len(theta))))

    gain = spreading(0) if effects.gain else np.ones(len(theta))
    slower = spreading(effects.time_at) if effects.time else np.ones(len(theta))
    model, curves = fitted.tissue.model, np.empty((len(theta), data.time_s.size))
    for k, off in enumerate(shift):
        path = ContactPath(data.time_s / slower[k], np.maximum(data.depth_mm - off, 0.0), data.speed_ratio)
        curves[k] = gain[k] * model.force(theta[k], path)
    sigma = fitted.noise.sigma_N
    # a law misses all along alike, noise at each sample anew
    left = sigma * rng.standard_normal((len(curves), 1 if fitted.noise.discrepant else data.time_s.size))
    low, high = np.quantile(curves, ONE_SD, axis=0)
    sd_N = np.maximum(np.hypot(0.5 * (high - low), sigma), 1e-300)
    away = np.abs(curves - np.median(curves, axis=0) + left) / sd_N
    return np.asarray(float(np.quantile(away.max(axis=1), level)) * sd_N)


def at_samples(trial: Trial, handle: LogHandle, log: FittedLog, values: FloatArray) -> FloatArray:
    """Values at the samples of a log as values at those of its recording: 0 in air, NaN after it."""
    values = values[int(log.inserted) :]
    depth, _ = contact_frame(trial, handle.segmentation)
    out = np.full(trial.time_s.size, np.nan)
    out[: log.first] = 0.0
    out[log.first : log.first + values.size] = values
    out[: log.first][depth[: log.first] > log.depth_mm] = np.nan
    return out
