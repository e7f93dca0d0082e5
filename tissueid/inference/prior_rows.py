"""Priors beside posteriors, for the report; and the prior density of tissues, for populations."""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import PriorRow
from tissueid.inference.prior import bernstein, time_bounds
from tissueid.inference.system import MACHINE
from tissueid.inference.target import SpecimenTarget
from tissueid.priors import WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior

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


def _power_sd(powers: int, power: int) -> float:
    """Standard deviation of a coefficient of u^power where Bernstein coefficients have one of 1."""
    return float(np.linalg.norm(np.linalg.inv(bernstein(powers))[power]))


def _largest(target: SpecimenTarget, tau_s: FloatArray) -> FloatArray:
    """Largest state of a branch over the largest depth, by its relaxation time."""
    return np.asarray(np.exp(np.interp(np.log(tau_s), target._ln_tau, target._ln_state)))  # noqa: SLF001


def _linear(target: SpecimenTarget, theta: FloatArray) -> list[PriorRow]:
    """Coefficients of F_s and K."""
    law, priors, point = target.law, target.priors, target.optimum.point
    specs = {spec.name: (k, spec) for k, spec in enumerate(law.model().parameters)}
    spread, rows = WEAK_FACTOR * target.force, []
    field = law.field(point.log_times[None])[0]
    states = law.largest_states(point.log_times, target.system.path(target.system.travel))
    for block in law.blocks:
        for power, at in enumerate(range(block.at.start, block.at.stop)):
            k, spec = specs[law.linear_names[at]]
            if spec.name in priors.linear:
                mean, sd = priors.linear[spec.name]
                words = f"normal, {mean:.4g} ± {sd:.3g} {spec.unit}, cut to the passive set"
                rows.append(_row(spec.name, words, True, theta[:, k], sd))
                continue
            state = states[block.branch] if block.branch >= 0 else 1.0
            wide = _power_sd(block.size, power) if block.polynomial else 1.0
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
    """Every prior of a specimen, its posterior and the shrinkage between them.

    ``vectors`` (n, size); ``theta`` (n, p); ``gains`` (n, 2): of force and displacement, where there is a
    machine.
    """
    priors, places = target.priors, target.places
    rows = _linear(target, theta)
    low, high = time_bounds(target.system)
    for j in range(target.law.counts[0]):
        name = f"ln_relaxation_time_{j + 1}"
        if j < len(priors.relaxation_time_s):
            one = priors.relaxation_time_s[j]
            words = f"log-normal, median {one.median:.4g} s, sd {one.sd_ln:.3g} in ln"
            rows.append(_row(name, words, True, vectors[:, j], one.sd_ln))
        else:
            words = f"uniform in ln tau from {math.exp(low):.3g} s to {math.exp(high):.3g} s"
            rows.append(_row(name, words, False, vectors[:, j], (high - low) / math.sqrt(12.0)))
    for j, shape in enumerate(target.law.shapes[target.law.counts[0] :], target.law.counts[0]):
        given = priors.shapes.get(shape.spec.name)
        if given is not None:
            words = f"log-normal, median {given.median:.4g} {shape.spec.unit}, sd {given.sd_ln:.3g} in ln"
            rows.append(_row(f"ln_{shape.spec.name}", words, True, vectors[:, j], given.sd_ln))
            continue
        ends = math.log(shape.spec.lower), math.log(shape.spec.upper)
        words = f"uniform in its logarithm from {shape.spec.lower:g} to {shape.spec.upper:g}"
        sd = (ends[1] - ends[0]) / math.sqrt(12.0)
        rows.append(_row(f"ln_{shape.spec.name}", words, False, vectors[:, j], sd))
    sigma, stated = vectors[:, places["ln_sigma"]], priors.sigma_N
    if stated is None:
        rows.append(_row("ln_sigma", "uniform in ln sigma", False, sigma, LOG_SIGMA_RANGE / 12**0.5))
    else:
        words = f"log-normal, median {stated.median:.4g} N, sd {stated.sd_ln:.3g} in ln"
        rows.append(_row("ln_sigma", words, True, sigma, stated.sd_ln))
    if "ln_gain_sd" in places:
        words, scale = f"half-normal, scale {priors.gain_sd:.3g}", priors.gain_sd * HALF_NORMAL_SD
        own = np.exp(vectors[:, places["ln_gain_sd"]])
        rows.append(_row("gain_sd", words, priors.gain_sd != Priors().gain_sd, own, scale))
    if gains is not None:
        for k, name in enumerate(("force_gain", "displacement_gain")):
            words, sd = _machine_words(priors.calibration[name])
            rows.append(_row(name, words, priors.calibration[name].stated, gains[:, k], sd))
        for k, name in enumerate(MACHINE):
            words, sd = _machine_words(priors.calibration[name])
            rows.append(
                _row(name, words, priors.calibration[name].stated, vectors[:, target.law.times + k], sd)
            )
    return tuple(rows)


def log_theta_prior(target: SpecimenTarget, theta: FloatArray) -> FloatArray:
    """Ln of the prior density of tissues, up to a constant of the specimen.

    The density is that of theta itself, in the units of the contact model and in shapes rather than their
    logarithms.

    ``theta`` (n, p).  Returns (n,).
    """
    law, priors, model = target.law, target.priors, target.law.model()
    largest = law.largest_states(target.optimum.point.log_times, target.system.path(target.system.travel))
    logs = np.log(theta[:, model.shape_places])[:, np.argsort(law._order)]  # noqa: SLF001
    field = law.field(logs)
    linear = theta[:, model.linear_places] / field
    value = law.ln_volume(logs, priors.linear) - logs.sum(axis=1) - np.log(field).sum(axis=1)
    spread, exponential = WEAK_FACTOR * target.force, law.relaxation.branches > 0
    for one in law.blocks:
        # the largest state follows the time of an exponential; of other laws it is a constant
        follows = one.branch >= 0 and exponential
        state = _largest(target, np.exp(logs[:, one.branch])) if follows else np.ones(len(theta))
        if one.branch >= 0 and not exponential:
            state = state * largest[one.branch]
        rows = bernstein(one.size) if one.polynomial else np.eye(one.size)
        value -= 0.5 * ((linear[:, one.at] @ rows.T) ** 2).sum(axis=1) * (state / spread) ** 2
        value += one.size * np.log(state)
    for j, given in _stated_shapes(target):
        value -= 0.5 * ((logs[:, j] - math.log(given.median)) / given.sd_ln) ** 2
    for name, (mean, sd) in priors.linear.items():
        if name in model.parameter_names:
            value -= 0.5 * ((theta[:, model.parameter_names.index(name)] - mean) / sd) ** 2
    return np.asarray(value)


def _stated_shapes(target: SpecimenTarget) -> list[tuple[int, SpreadPrior]]:
    """Priors that a study states of shapes, by their place among the engine's."""
    times, priors = target.law.counts[0], target.priors
    out = list(enumerate(priors.relaxation_time_s[:times]))
    for j, shape in enumerate(target.law.shapes[times:], times):
        if shape.spec.name in priors.shapes:
            out.append((j, priors.shapes[shape.spec.name]))
    return out
