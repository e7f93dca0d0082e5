"""Proper priors around a tissue, truths drawn from them, and the recordings that a machine would make of one.

Truths come from the very priors that the inference is given: only then is a rank uniform.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from scipy.signal import lfilter, lfiltic

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.inference.reported import reported_draws
from tissueid.model.base import ContactPath, ParameterSpec, branch_suffix
from tissueid.model.channels import ChannelModel, loading_force, minimum_on_unit
from tissueid.model.states import branch_states
from tissueid.priors import CalibrationPrior, Priors, SpreadPrior
from tissueid.synth.simulate import Path, contact_path

#: Depths, as fractions of the fitted one, at which the force is checked, from fastest to slowest speed.
FORCE_DEPTHS = (0.25, 0.5, 1.0)
#: Scale of the half-normal prior of the standard deviation of a log's ln relaxation times, which a fit of
#: ``scaled`` logs lets differ.
TIME_SD = 0.02
#: Draws after which a prior counts as one without passive tissue.
MOST_REJECTED = 100_000

_Drawn = TypeVar("_Drawn", float, FloatArray)


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
    slower: FloatArray  # (logs,), relaxation times of each log over those of the tissue
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
    """Proper priors around a tissue; what is stated stays."""
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


def _first(draw: Callable[[], _Drawn], holds: Callable[[_Drawn], bool], refusal: str) -> _Drawn:
    """The first draw that holds; InputError where none does."""
    for _ in range(MOST_REJECTED):
        value = draw()
        if holds(value):
            return value
    raise InputError(code="priors", message=refusal, path="study.toml")


def _passive_block(
    mean: FloatArray, sd: FloatArray, powers: FloatArray | None, rng: np.random.Generator
) -> FloatArray:
    """A normal draw of one polynomial, or of coefficients without powers, on the passive cone."""
    return _first(
        lambda: np.asarray(mean + sd * rng.standard_normal(mean.size)),
        lambda draw: bool((draw.min() if powers is None else minimum_on_unit(draw * powers)) >= 0.0),
        f"the priors leave no passive tissue: {MOST_REJECTED} draws around "
        f"{', '.join(f'{m:.3g}' for m in mean)} gave a negative force or stiffness",
    )


def _log_normal(prior: SpreadPrior, rng: np.random.Generator) -> float:
    return prior.median * float(np.exp(prior.sd_ln * rng.standard_normal()))


def _bounded(prior: SpreadPrior, spec: ParameterSpec, rng: np.random.Generator) -> float:
    """A draw of a shape within its bounds."""
    return _first(
        lambda: _log_normal(prior, rng),
        lambda value: spec.lower <= value <= spec.upper,
        f"the prior of {spec.name} leaves nothing from {spec.lower:g} to {spec.upper:g}",
    )


def cut_normal(prior: CalibrationPrior, rng: np.random.Generator) -> float:
    """A draw of one calibration nuisance, drawn again until it is above its lower end."""
    for _ in range(MOST_REJECTED):
        value = prior.mean + prior.sd * float(rng.standard_normal())
        if value >= prior.lower:
            return value
    return prior.lower


def drawn_tissue(model: ChannelModel, priors: Priors, rng: np.random.Generator) -> FloatArray:
    """Theta of a passive tissue, its relaxation times ascending and its shapes within their bounds."""

    def draw() -> FloatArray:
        theta = np.zeros(len(model.parameter_names))
        for block in _blocks(model):
            known = np.array([priors.linear[name] for name in model.parameter_names[block]])
            powers = model.depth_mm ** np.arange(float(known.shape[0])) if _is_curve(model, block) else None
            theta[block] = _passive_block(known[:, 0], known[:, 1], powers, rng)
        theta[model.time_places] = _first(
            lambda: np.array([_log_normal(time, rng) for time in priors.relaxation_time_s if time]),
            lambda tau: bool((np.diff(tau) > 0.0).all()),
            "the priors of the relaxation times do not ascend: order them from fast to slow",
        )
        for k in _other_shapes(model):
            spec = model.parameters[k]
            theta[k] = _bounded(priors.shapes[spec.name], spec, rng)
        return theta

    return _first(
        draw,
        lambda theta: not model.inside or model.is_passive(theta),
        f"the priors leave no passive tissue: the static force sank in {MOST_REJECTED} draws",
    )


def force_points(depth_mm: float, speeds_mm_s: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Three (depth, speed) at which the force is checked: shallow and fast to deep and slow."""
    slow, fast = speeds_mm_s
    speeds = (fast, float(np.sqrt(slow * fast)), slow)
    return tuple((share * depth_mm, speed) for share, speed in zip(FORCE_DEPTHS, speeds, strict=True))


def numbers_of(
    model: ChannelModel, theta: FloatArray, points: tuple[tuple[float, float], ...]
) -> dict[str, FloatArray]:
    """Everything that is checked of a tissue, for many at once; ``theta`` (n, p)."""
    out = reported_draws(model, theta)
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
    for branch, time in enumerate(filter(None, priors.relaxation_time_s)):
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
    if pooling == "scaled":
        said["time_sd"] = f"half-normal, scale {TIME_SD:.3g}"
    if defects:
        for name, prior in priors.calibration.items():
            cut = f", not below {prior.lower:g}" if np.isfinite(prior.lower) else ""
            said[name] = f"normal, {prior.mean:g} ± {prior.sd:.3g}{cut}"
    return said


#: Force is sampled so many times finer than recorded where filter, skew or frame act between samples.
OVERSAMPLED = 8
#: Change of the tip's depth, relative to the deepest, that ends its iteration, and most rounds.
SETTLED = 1e-12
MOST_ROUNDS = 500
#: Steps that differ by less, relative to the longest, are one.
SAME_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolLog:
    """Motion of the tool in one log of a protocol."""

    name: str
    #: (n,): as recorded, both 0 at the expected contact and negative in air before it.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    contact_sd_mm: float  # standard deviation of the depth at which the tool meets the tissue


def noise(
    time_s: FloatArray,
    *,
    sigma_N: float,
    phi: float,
    reference_step_s: float,
    white_share: float,
    rng: np.random.Generator,
) -> FloatArray:
    """White noise plus a stationary AR(1), exact on unequal steps [N]; ``phi`` is over a reference step."""
    draws = rng.standard_normal(time_s.size)
    if phi == 0.0:
        return np.asarray(sigma_N * draws)
    step = np.diff(time_s)
    rho = phi ** (step / reference_step_s)
    draws[1:] *= np.sqrt(1.0 - rho**2)
    if step.size and np.ptp(step) <= SAME_STEP * step.max():
        out = lfilter([1.0], [1.0, -float(rho[0])], draws)
    else:
        out = draws.copy()
        for i in range(1, out.size):
            out[i] += rho[i - 1] * out[i - 1]
    if white_share > 0.0:
        out = np.sqrt(1.0 - white_share) * out + np.sqrt(white_share) * rng.standard_normal(out.size)
    return np.asarray(sigma_N * out)


def tip_depth(
    model: ChannelModel, theta: FloatArray, time_s: FloatArray, depth_mm: FloatArray, give: float
) -> FloatArray:
    """Depth of the tip behind a compliance: ``x_tip = x - c F(x_tip)``, solved for the whole path at once.

    Each round takes the step of a tissue as stiff as this one can be, so that it can't overshoot.
    """
    if give == 0.0:
        return depth_mm
    grid = np.linspace(0.0, model.depth_mm, 65)
    slope = np.abs(np.gradient(model.static_force(theta, grid), grid)).max()
    stiff = slope + np.abs(model.stiffness(theta, grid)).sum(axis=0).max()
    varying = (
        np.abs(np.gradient(model.stiffness(theta, grid), grid, axis=1)).sum(axis=0).max() * model.depth_mm
    )
    tip: FloatArray = depth_mm / (1.0 + give * stiff)
    for _ in range(MOST_ROUNDS):
        error = tip + give * model.force(theta, ContactPath(time_s, tip)) - depth_mm
        tip = tip - error / (1.0 + give * (stiff + varying))
        if np.abs(error).max() <= SETTLED * model.depth_mm:
            break
    return tip


def recorded_force(
    model: ChannelModel,
    theta: FloatArray,
    log: ProtocolLog,
    *,
    gain: float,
    offset_mm: float,
    calibration: Mapping[str, float],
) -> FloatArray:
    """Force without noise as the machine records it [N], 0 in air.

    ``gain``, ``offset_mm``: factor of all forces of the log, and how much deeper than expected the tool meets
    the tissue; ``calibration``: ``force_gain`` and ``displacement_gain`` (recorded over true), ``skew_s``
    (force later than displacement), ``force_filter_s`` (first-order low-pass), ``frame_compliance_mm_per_N``;
    what is missing is perfect.
    """
    give = calibration.get("frame_compliance_mm_per_N", 0.0)
    skew, filter_s = calibration.get("skew_s", 0.0), calibration.get("force_filter_s", 0.0)
    time, depth = log.time_s, log.depth_mm / calibration.get("displacement_gain", 1.0)
    if skew != 0.0 or filter_s > 0.0 or give > 0.0:
        samples = np.arange(time.size)
        time = np.interp(np.arange((time.size - 1) * OVERSAMPLED + 1) / OVERSAMPLED, samples, time)
        depth = np.interp(time, log.time_s, depth)
    touched = contact_path(Path(time, depth), offset_mm)
    # the force that bends the frame is the log's own, gain and all
    scaled = theta.copy()
    scaled[model.linear_places] *= gain
    tip = tip_depth(model, scaled, touched.time_s, touched.value_mm, give)
    force = np.interp(time, touched.time_s, model.force(scaled, ContactPath(touched.time_s, tip)))
    # tissue pushes and does not pull
    force = low_pass(time, np.maximum(force, 0.0), filter_s)
    return np.asarray(calibration.get("force_gain", 1.0) * np.interp(log.time_s - skew, time, force))


def low_pass(time_s: FloatArray, force_N: FloatArray, filter_s: float) -> FloatArray:
    """First-order low-pass, exact for a force that is linear between samples."""
    if filter_s == 0.0:
        return force_N
    step = np.diff(time_s)
    ratio = step / filter_s
    decay = np.exp(-ratio)
    # of a ramp over one step the mean lag is (1 - decay) / ratio of its rise
    share = np.where(ratio > 0.0, -np.expm1(-ratio) / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    if step.size and np.ptp(step) <= SAME_STEP * step.max():
        a, s = float(decay[0]), float(share[0])
        weights = [1.0 - s, s - a]
        start = lfiltic(weights, [1.0, -a], [force_N[0]], [force_N[0]])
        rest, _ = lfilter(weights, [1.0, -a], force_N[1:], zi=start)
        return np.concatenate([force_N[:1], rest])
    # what a branch of that time has not relaxed is what the filter lags behind
    return np.asarray(force_N - branch_states(time_s, force_N, np.array([filter_s]))[0])
