"""Proper priors around a tissue, truths drawn from them, and the numbers that are checked.

A truth is drawn from the very priors that the inference is given: linear parameters from independent normals,
by rejection on the passive cone; relaxation times from log-normals in ascending order, other shapes from
log-normals within their bounds; noise, correlation,
spread of the gains and calibration likewise.  Only then is a rank uniform.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.model.base import ParameterSpec, branch_suffix
from tissueid.model.channels import ChannelModel, loading_force, minimum_on_unit
from tissueid.priors import CalibrationPrior, Priors, SpreadPrior

#: Depths, as fractions of the fitted one, at which the force is checked, from fastest to slowest speed.
FORCE_DEPTHS = (0.25, 0.5, 1.0)
#: Depth of a viscosity, as a fraction of the fitted one.
REFERENCE_DEPTH = 0.5
#: Draws after which a prior counts as one without passive tissue.
MOST_REJECTED = 100_000


@dataclass(frozen=True, slots=True)
class Widths:
    """Standard deviations of priors that are centred on a tissue."""

    #: Of each coefficient of F_s and K, as a fraction of its curve at full depth over the power of it.
    curve: float = 0.15
    ln_tau: float = 0.4
    ln_shape: float = 0.15  # of other shapes of a law
    ln_sigma: float = 0.3
    arctanh_phi: float = 0.4  # half width of the uniform prior of the correlation, in arctanh(phi)
    gain_sd: float = 0.05  # scale of the half-normal prior of the standard deviation of a log's ln gain


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Everything that decides one simulation, but for the noise itself."""

    theta: FloatArray  # (p,), of the contact model; passive
    gain: FloatArray  # (logs,)
    offset_mm: FloatArray  # (logs,), how much deeper each contact point is than the protocol has it
    #: ``phi`` is 0 for white noise, ``gain_sd`` where logs have no gains.
    sigma_N: float
    phi: float
    gain_sd: float
    #: Values of the nuisances; empty where the chain is perfect.
    calibration: Mapping[str, float] = field(default_factory=dict)


def _blocks(model: ChannelModel) -> list[slice]:
    """Positions in theta of the coefficients of F_s and of each K."""
    outside = [part.stiffness for part in model.parts if part.ratio is None]
    return [slice(0, len(model.static.coefficients)), *outside]


def _is_curve(model: ChannelModel, block: slice) -> bool:
    """True of coefficients of a polynomial, of which only the sum has to be positive."""
    return block.start > 0 or model.static.polynomial


def _other_shapes(model: ChannelModel) -> list[int]:
    """Places of shapes that are no times."""
    return [int(k) for k in np.setdiff1d(model.shape_places, model.time_places)]


def _stated_curve(names: tuple[str, ...], stated: Priors) -> dict[str, tuple[float, float]]:
    """Priors of one curve that a study states; empty where it states none."""
    known = {name: stated.linear[name] for name in names if name in stated.linear}
    if known and len(known) < len(names):
        missing = ", ".join(name for name in names if name not in known)
        message = (
            f"[priors] states {', '.join(known)} and not {missing}: a check draws truths from the "
            "priors, state all coefficients of a curve or none"
        )
        raise InputError(code="priors", message=message, path="study.toml")
    return known


def _centred_curve(
    model: ChannelModel, theta: FloatArray, block: slice, share: float
) -> dict[str, tuple[float, float]]:
    """Normal priors around one curve, as wide as a share of it at full depth."""
    sd = share * np.abs(theta[block])
    if _is_curve(model, block):
        powers = model.depth_mm ** np.arange(float(block.stop - block.start))
        sd = share * abs(float(theta[block] @ powers)) / powers
    pairs = zip(theta[block].tolist(), sd.tolist(), strict=True)
    return dict(zip(model.parameter_names[block], pairs, strict=True))


def centred_priors(
    model: ChannelModel,
    theta: FloatArray,
    *,
    sigma_N: float,
    phi: float,
    stated: Priors | None = None,
    widths: Widths | None = None,
) -> Priors:
    """Proper priors around a tissue; what is stated stays.

    ``theta`` (p,): the tissue in the middle; ``sigma_N``, ``phi``: of its noise; ``phi`` 0 for white noise;
    ``stated``: of a study.  A curve of which one coefficient is stated needs all of them.  Raises InputError:
    a curve is stated in part.
    """
    stated, widths = stated or Priors(), widths or Widths()
    linear: dict[str, tuple[float, float]] = {}
    for block in _blocks(model):
        linear |= _stated_curve(model.parameter_names[block], stated) or _centred_curve(
            model, theta, block, widths.curve
        )
    around = tuple(SpreadPrior(float(theta[k]), widths.ln_tau) for k in model.time_places)
    times = (*stated.relaxation_time_s, *around[len(stated.relaxation_time_s) :])[: len(around)]
    shapes = {
        model.parameter_names[k]: SpreadPrior(float(theta[k]), widths.ln_shape) for k in _other_shapes(model)
    }
    narrow = (0.0, 1.0)
    if phi > 0.0:
        a = float(np.arctanh(phi))
        narrow = (float(np.tanh(max(a - widths.arctanh_phi, 0.0))), float(np.tanh(a + widths.arctanh_phi)))
    default = Priors()
    return replace(
        stated,
        linear=linear,
        relaxation_time_s=times,
        shapes={**shapes, **{name: one for name, one in stated.shapes.items() if name in shapes}},
        sigma_N=stated.sigma_N or SpreadPrior(median=sigma_N, sd_ln=widths.ln_sigma),
        phi=narrow if stated.phi == default.phi else stated.phi,
        gain_sd=widths.gain_sd if stated.gain_sd == default.gain_sd else stated.gain_sd,
    )


def _passive_block(
    mean: FloatArray, sd: FloatArray, powers: FloatArray | None, rng: np.random.Generator
) -> FloatArray:
    """A normal draw of one polynomial, or of coefficients without powers, by rejection on the cone."""
    for _ in range(MOST_REJECTED):
        draw = mean + sd * rng.standard_normal(mean.size)
        if (draw.min() if powers is None else minimum_on_unit(draw * powers)) >= 0.0:
            return np.asarray(draw)
    message = (
        f"the priors leave no passive tissue: {MOST_REJECTED} draws around "
        f"{', '.join(f'{m:.3g}' for m in mean)} gave a negative force or stiffness"
    )
    raise InputError(code="priors", message=message, path="study.toml")


def _ascending(times: tuple[SpreadPrior, ...], rng: np.random.Generator) -> FloatArray:
    """Relaxation times, drawn again until they ascend."""
    for _ in range(MOST_REJECTED):
        tau = np.array([time.median * np.exp(time.sd_ln * rng.standard_normal()) for time in times])
        if (np.diff(tau) > 0.0).all():
            return tau
    message = "the priors of the relaxation times do not ascend: order them from fast to slow"
    raise InputError(code="priors", message=message, path="study.toml")


def _cut_normal(prior: CalibrationPrior, rng: np.random.Generator) -> float:
    """A draw of one calibration nuisance, drawn again until it is above its lower end."""
    for _ in range(MOST_REJECTED):
        value = prior.mean + prior.sd * float(rng.standard_normal())
        if value >= prior.lower:
            return value
    return prior.lower


def _bounded(prior: SpreadPrior, spec: ParameterSpec, rng: np.random.Generator) -> float:
    """A log-normal draw of a shape, drawn again until it is within its bounds."""
    for _ in range(MOST_REJECTED):
        value = prior.median * float(np.exp(prior.sd_ln * rng.standard_normal()))
        if spec.lower <= value <= spec.upper:
            return value
    message = f"the prior of {spec.name} leaves nothing from {spec.lower:g} to {spec.upper:g}"
    raise InputError(code="priors", message=message, path="study.toml")


def _drawn_tissue(model: ChannelModel, priors: Priors, rng: np.random.Generator) -> FloatArray:
    """Theta of a passive tissue."""
    for _ in range(MOST_REJECTED):
        theta = np.zeros(len(model.parameter_names))
        for block in _blocks(model):
            known = np.array([priors.linear[name] for name in model.parameter_names[block]])
            powers = model.depth_mm ** np.arange(float(known.shape[0])) if _is_curve(model, block) else None
            theta[block] = _passive_block(known[:, 0], known[:, 1], powers, rng)
        theta[model.time_places] = _ascending(priors.relaxation_time_s, rng)
        for k in _other_shapes(model):
            spec = model.parameters[k]
            theta[k] = _bounded(priors.shapes[spec.name], spec, rng)
        if not model.inside or model.is_passive(theta):
            return theta
    message = f"the priors leave no passive tissue: the static force sank in {MOST_REJECTED} draws"
    raise InputError(code="priors", message=message, path="study.toml")


def draw_truth(
    model: ChannelModel,
    priors: Priors,
    *,
    offset_sd_mm: FloatArray,
    pooling: str,
    correlated: bool,
    defects: bool,
    rng: np.random.Generator,
) -> Truth:
    """Draw one truth from priors that are proper (:func:`centred_priors`).

    ``offset_sd_mm`` (logs,): prior of each contact point; 0 where it is known; ``pooling``: all but
    ``shared`` give each log a gain; ``correlated``: noise with phi, or white; ``defects``: draw calibration
    nuisances as well.
    """
    assert priors.sigma_N is not None  # noqa: S101 -- centred_priors filled it
    theta = _drawn_tissue(model, priors, rng)
    sigma = priors.sigma_N.median * float(np.exp(priors.sigma_N.sd_ln * rng.standard_normal()))
    phi = float(rng.uniform(*priors.phi)) if correlated else 0.0
    spread = abs(priors.gain_sd * float(rng.standard_normal())) if pooling != "shared" else 0.0
    logs = offset_sd_mm.size
    calibration: dict[str, float] = {}
    if defects:
        calibration = {name: _cut_normal(prior, rng) for name, prior in priors.calibration.items()}
    return Truth(
        theta=theta,
        gain=np.exp(spread * rng.standard_normal(logs)),
        offset_mm=offset_sd_mm * rng.standard_normal(logs),
        sigma_N=sigma,
        phi=phi,
        gain_sd=spread,
        calibration=calibration,
    )


def force_points(depth_mm: float, speeds_mm_s: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Three (depth, speed) at which the force is checked: shallow and fast to deep and slow."""
    slow, fast = speeds_mm_s
    speeds = (fast, float(np.sqrt(slow * fast)), slow)
    return tuple((share * depth_mm, speed) for share, speed in zip(FORCE_DEPTHS, speeds, strict=True))


def numbers_of(
    model: ChannelModel,
    theta: FloatArray,
    points: tuple[tuple[float, float], ...],
) -> dict[str, FloatArray]:
    """Everything that is checked of a tissue, for many at once.

    ``theta`` (n, p); ``points``: (depth, speed) [mm, mm/s], reached at constant speed from rest.  Returns
    name -> ndarray of shape (n,): parameters, viscosity of each branch at half depth, and ``force_N at x mm,
    v mm/s``.
    """
    out: dict[str, FloatArray] = {name: theta[:, k] for k, name in enumerate(model.parameter_names)}
    if model.viscous:
        for branch, (part, time) in enumerate(zip(model.parts, model.time_places, strict=True)):
            powers = (REFERENCE_DEPTH * model.depth_mm) ** np.arange(float(model.stiffness_law.powers))
            viscosity = (theta[:, part.stiffness] @ powers) * theta[:, time]
            out[f"viscosity_N_s_per_mm{branch_suffix(branch)}"] = viscosity
    for depth, speed in points:
        forces = [loading_force(model, one, np.array([depth]), speed_mm_s=speed)[0] for one in theta]
        out[f"force_N at {depth:.3g} mm, {speed:.3g} mm/s"] = np.array(forces)
    return out


def prior_words(priors: Priors, *, correlated: bool, pooling: str, defects: bool) -> dict[str, str]:
    """Every prior that truths are drawn from, in words with its numbers."""
    said = {
        name: f"normal, {mean:.4g} ± {sd:.3g}, cut to the passive set"
        for name, (mean, sd) in priors.linear.items()
    }
    for branch, time in enumerate(priors.relaxation_time_s):
        said[f"relaxation_time_s{branch_suffix(branch)}"] = (
            f"log-normal, median {time.median:.4g}, sd of ln {time.sd_ln:.3g}"
        )
    for name, one in priors.shapes.items():
        said[name] = f"log-normal, median {one.median:.4g}, sd of ln {one.sd_ln:.3g}, cut to its bounds"
    if priors.sigma_N is not None:
        said["sigma_N"] = (
            f"log-normal, median {priors.sigma_N.median:.4g}, sd of ln {priors.sigma_N.sd_ln:.3g}"
        )
    if correlated:
        said["phi"] = f"uniform, {priors.phi[0]:.4g} to {priors.phi[1]:.4g}"
    if pooling != "shared":
        said["gain_sd"] = f"half-normal, scale {priors.gain_sd:.3g}"
    if defects:
        for name, prior in priors.calibration.items():
            cut = f", not below {prior.lower:g}" if np.isfinite(prior.lower) else ""
            said[name] = f"normal, {prior.mean:g} ± {prior.sd:.3g}{cut}"
    return said
