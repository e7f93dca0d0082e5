"""From an optimum to reported parameters, each with its standard error, its profile and its verdict.

Viscosity eta = K tau comes first: a ramp determines K tau v long before K and tau (correlated by -0.99).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.engine import Identified, refit
from tissueid.inference.optimum import Optimum, covariance_of, free_of
from tissueid.inference.prior import time_bounds
from tissueid.model.base import ParameterSpec, branch_suffix
from tissueid.model.channels import ChannelModel, DampedModel
from tissueid.result import Estimate

#: 95 % point of chi-square with one degree of freedom, and the rise a curve is followed to.
LEVEL_95, LARGEST_RISE = 3.841458820694124, 15.0
#: Points on each side, steps of the fit at each, and the least and largest reach in ln tau.
POINTS, STEPS, LEAST_REACH, MOST_REACH = 5, 3, 1e-3, 4.0
#: Times the reach may be doubled, and digits of a curve.
DOUBLINGS, DIGITS = 4, 6


@dataclass(frozen=True, slots=True)
class ProfileInterval:
    """95 % profile-likelihood interval of one ln tau."""

    low: float  # ends in ln(tau / s); the bound of the search where open
    high: float
    open_low: bool  # true where the likelihood never falls far enough before the bound
    open_high: bool

    @property
    def width(self) -> float:
        """Width in ln tau."""
        return self.high - self.low

    @property
    def closed(self) -> bool:
        """Both ends lie within the range of search."""
        return not (self.open_low or self.open_high)


def _held(identified: Identified, branch: int, value: float, start: Optimum) -> Optimum:
    """The optimum with one ln tau held, the machine where it is."""
    times = start.point.log_times.copy()
    times[branch] = value
    at, held = replace(start.point, log_times=times), np.array([branch])
    noise = identified.optimum.noise
    return refit(identified, machine=False, start=at, steps=STEPS, held=held, noise=noise)


def profile(identified: Identified, branch: int) -> tuple[ProfileInterval, dict[str, list[float]]]:
    """Profile of one relaxation time.

    Returns its interval, and ``tau_s``, ``rise`` (of the deviance) and ``stiffness_N_per_mm``, ascending
    in tau.
    """
    optimum, law = identified.optimum, identified.law
    centre = float(optimum.point.log_times[branch])
    bounds = time_bounds(identified.system)
    sd = float(np.sqrt(optimum.covariance[branch, branch]))
    depth = (0.5 if law.degree else 1.0) ** np.arange(law.degree + 1.0)

    def stiffness(found: Optimum) -> float:
        if law.inside:
            ratio = np.exp(found.point.log_times[law.ratio_place(branch)])
            return float(ratio * found.point.linear[: law.static_size].sum()) / law.depth_mm
        block = next(one for one in law.blocks if one.branch == branch)
        return float(found.point.linear[block.at] @ depth) / law.depth_mm

    here = _held(identified, branch, centre, optimum)
    base = here.normal.objective
    rows = [(centre, 0.0, stiffness(here))]
    reach = float(np.clip(np.sqrt(LARGEST_RISE) * min(sd, 10.0), LEAST_REACH, MOST_REACH))
    for sign, end in ((-1.0, bounds[0]), (1.0, bounds[1])):
        step, last, at, rise = reach / POINTS, optimum, centre, 0.0
        for count in range(POINTS * (1 + DOUBLINGS)):
            if rise >= LARGEST_RISE or abs(at - end) < 1e-9:
                break
            step *= 1.0 if count < POINTS else 1.3
            at = float(np.clip(at + sign * step, *bounds))
            last = _held(identified, branch, at, last)
            if last.normal.objective - base >= LARGEST_RISE:
                # a bound rests on it: it may have ended in another valley than the optimum's
                last = min(last, _held(identified, branch, at, optimum), key=lambda one: one.normal.objective)
            rise = max(last.normal.objective - base, 0.0)
            rows.append((at, rise, stiffness(last)))
    rows.sort()
    place, height, stiff = np.array(rows).T
    low, open_low = _crossing(place, height, centre, -1)
    high, open_high = _crossing(place, height, centre, 1)
    columns = {"tau_s": np.exp(place), "rise": height, "stiffness_N_per_mm": stiff}
    curve = {
        name: [float(f"{value:.{DIGITS}g}") for value in values.tolist()] for name, values in columns.items()
    }
    return ProfileInterval(low, high, open_low, open_high), curve


def _crossing(place: FloatArray, height: FloatArray, centre: float, sign: int) -> tuple[float, bool]:
    """Last crossing of the 95 % level on one side; the last place, open, where it ends below."""
    order = np.argsort(sign * place)
    order = order[sign * (place[order] - centre) >= 0.0]
    x, y = place[order], np.sqrt(height[order])
    level = np.sqrt(LEVEL_95)
    k = int(np.flatnonzero(y < level)[-1]) + 1
    if k == y.size:
        return float(x[-1]), True
    share = (level - y[k - 1]) / max(y[k] - y[k - 1], 1e-300)
    return float(x[k - 1] + share * (x[k] - x[k - 1])), False


#: Widest 95 % interval in the logarithm that counts as identified.
MAX_WIDTH = 1.0
#: Widest 95 % intervals that count as identified: of a restitution, and of an exponent (1 flat, 2 a cone).
MAX_DAMPING_WIDTH, MAX_EXPONENT_WIDTH = 0.25, 0.5
#: Distance from the ends of its range at which an exponent lies on them.
NEAR_END = 1e-3
#: Share of the speed at contact below which a sample is slow; with fewer, static force and damping are one.
SLOW, FEWEST_SLOW = 0.5, 0.02
#: A standard error below this is the rounding of none.
BOUND_ROUNDING = 1e-12
#: Names of a branch's time and viscosity, before its number.
TIME, VISCOSITY = "relaxation_time_s", "viscosity_N_s_per_mm"
#: Fractions of the fitted depth at which viscosity is quoted where K varies, and a curve is judged.
REFERENCE_DEPTH, CURVE_DEPTHS = 0.5, (0.25, 0.5, 0.75, 1.0)


def width_of(estimate: float, stderr: float) -> float:
    """Width of the 95 % interval of the logarithm of a positive estimate, from its standard error."""
    if not (np.isfinite(stderr) and estimate > 0.0):
        return float("inf")
    return 2.0 * float(np.sqrt(LEVEL_95)) * stderr / estimate


@dataclass(frozen=True, slots=True, eq=False)
class TissueEstimate:
    """A tissue in the parameters of its contact model."""

    model: ChannelModel
    theta: FloatArray  # in the order of ``model.parameter_names``, units of the field
    covariance: FloatArray
    parameters: tuple[Estimate, ...]
    intervals: tuple[ProfileInterval, ...]  # of ln tau, a branch each
    bounded: bool  # true where a passivity bound is active


def _estimate(spec: ParameterSpec, number: float, stderr: float, verdict: tuple[bool, float]) -> Estimate:
    """A parameter with its verdict: identified or not, and the width of its interval."""
    identified, width = verdict
    # across an active bound the covariance is zero: that is no knowledge of the parameter
    at_bound = stderr <= BOUND_ROUNDING * max(abs(number), 1.0)
    finite = bool(np.isfinite(stderr)) and not at_bound
    return Estimate(
        name=spec.name,
        symbol=spec.symbol,
        unit=spec.unit,
        value=number if identified else None,
        stderr=stderr if identified and finite else None,
        identified=identified,
        detail={
            "estimate": number,
            "estimate_stderr": stderr if finite else None,
            "width_ln": width if np.isfinite(width) else None,
            "at_bound": at_bound,
        },
    )


def _verdict_of(estimate: float, stderr: float) -> tuple[bool, float]:
    """Test if the 95 % interval of a logarithm is narrow enough, with its width."""
    return (width := width_of(estimate, stderr)) <= MAX_WIDTH, width


class _Fitted(NamedTuple):
    """A model with its parameters and their covariance."""

    model: ChannelModel
    theta: FloatArray
    covariance: FloatArray

    def estimate(self, k: int, verdict: tuple[bool, float] | None = None) -> Estimate:
        """One parameter, by its own interval where there is no verdict."""
        value, stderr = float(self.theta[k]), float(np.sqrt(max(self.covariance[k, k], 0.0)))
        return _estimate(self.model.parameters[k], value, stderr, verdict or _verdict_of(value, stderr))


def _curve_verdict(
    fitted: _Fitted, at: Sequence[int], curve: Callable[[FloatArray], FloatArray]
) -> tuple[bool, float]:
    """Test if a curve's widest 95 % interval is narrower than the curve is high."""
    _, theta, covariance = fitted
    # a curve may start soft: an interval relative to its own height there would condemn it
    height, slopes = curve(theta), []
    for k in at:
        step = 1e-6 * max(abs(float(theta[k])), float(np.sqrt(max(covariance[k, k], 0.0))), 1e-12)
        moved = theta.copy()
        moved[k] += step
        # a shape that nothing determines leaves the numbers: no width is finite then
        with np.errstate(over="ignore", invalid="ignore"):
            slopes.append((curve(moved) - height) / step)
    basis, block = np.array(slopes).T, covariance[np.ix_(at, at)]
    with np.errstate(over="ignore", invalid="ignore"):
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, block, basis), 0.0))
    return _verdict_of(float(height.max()), float(spread.max()))


def _alike(fitted: _Fitted, at: Sequence[int], curve: Callable[[FloatArray], FloatArray]) -> list[Estimate]:
    """Parameters of one curve, with one verdict."""
    verdict = _curve_verdict(fitted, at, curve)
    return [fitted.estimate(k, verdict) for k in at]


def _time_estimate(
    fitted: _Fitted, k: int, interval: ProfileInterval, curve: dict[str, list[float]]
) -> Estimate:
    """tau, with the wider of its profile interval and, of several branches, that of its standard error."""
    tau, stderr = float(fitted.theta[k]), float(np.sqrt(max(fitted.covariance[k, k], 0.0)))
    several = fitted.model.branches > 1
    width = max(interval.width, width_of(tau, stderr)) if several else interval.width
    plain = fitted.estimate(k, (interval.closed and width <= MAX_WIDTH, width))
    detail = dict(plain.detail) | {
        "profile_ci95": [float(np.exp(interval.low)), float(np.exp(interval.high))],
        "open_low": interval.open_low,
        "open_high": interval.open_high,
        "profile": curve,
    }
    return replace(plain, detail=detail)


def _branch_estimates(
    fitted: _Fitted, branch: int, profiled: tuple[ProfileInterval, dict[str, list[float]]] | None
) -> list[Estimate]:
    """Stiffness or ratio, relaxation time, further shapes and viscosity of one branch."""
    model, part = fitted.model, fitted.model.parts[branch]
    curve = list(range(part.stiffness.start, part.stiffness.stop))
    depths = np.array(CURVE_DEPTHS) * model.depth_mm
    estimates = []
    if curve:
        estimates += _alike(fitted, curve, lambda theta: model.stiffness(theta, depths)[branch])
    # a ratio stands between, where there is one; the first shape is the time
    for k in range(part.stiffness.stop, part.shapes.stop):
        timed = profiled if k == part.shapes.start else None
        estimates.append(fitted.estimate(k) if timed is None else _time_estimate(fitted, k, *timed))
    if model.viscous:
        estimates.append(_viscosity(fitted, curve, branch))
    return estimates


def _viscosity(fitted: _Fitted, curve: list[int], branch: int) -> Estimate:
    """K tau of a branch, at half depth where K varies."""
    model, theta, covariance = fitted
    suffix, place = branch_suffix(branch), curve[-1] + 1
    powers = np.arange(float(len(curve)))
    reference = (REFERENCE_DEPTH * model.depth_mm) ** powers if len(curve) > 1 else np.ones(1)
    stiffness, tau = float(theta[curve] @ reference), float(theta[place])
    slope = np.concatenate([reference * tau, [stiffness]])
    block = covariance[np.ix_([*curve, place], [*curve, place])]
    used = np.where(np.outer(slope, slope) != 0.0, block, 0.0)
    eta, eta_stderr = stiffness * tau, float(np.sqrt(max(slope @ used @ slope, 0.0)))
    symbol = "eta" if branch == 0 else f"eta{branch + 1}"
    spec = ParameterSpec(f"{VISCOSITY}{suffix}", symbol, "N s/mm", 0.0, np.inf, "viscosity K tau")
    return _estimate(spec, eta, eta_stderr, _verdict_of(eta, eta_stderr))


def _damped(fitted: _Fitted, static: list[Estimate], *, confounded: bool) -> list[Estimate]:
    """Static parameters and that of the damping; numbers without a unit are judged by their own width."""
    theta, stderr = fitted.theta, np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    out = []
    for k, spec in enumerate(fitted.model.parameters):
        last, width = k == theta.size - 1, 2.0 * float(np.sqrt(LEVEL_95) * stderr[k])
        if spec.unit == "1":
            narrow = width <= (MAX_DAMPING_WIDTH if last else MAX_EXPONENT_WIDTH)
            # an exponent at the end of its range: the law does not describe this
            ended = not last and min(theta[k] - spec.lower, spec.upper - theta[k]) < NEAR_END
            verdict = (narrow and not ended and not (last and confounded), width)
            out.append(fitted.estimate(k, verdict))
        elif confounded:
            out.append(replace(static[k], value=None, stderr=None, identified=False))
        else:
            out.append(static[k])
    return out


def without_exchanged(parameters: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Parameters without the values that the end of the search decides.

    Of a branch slower than its search the data know K / tau and F_s + K x: any longer time serves as well,
    with a larger K, a larger viscosity and a smaller F_s, up to the degree of K x.
    """
    taken: set[str] = set()
    names = [one.name for one in parameters]
    for slow in parameters:
        # open on both sides there is no relaxation
        if slow.detail.get("open_high") and not slow.detail["open_low"]:
            suffix = slow.name.removeprefix(TIME)
            own = [name for name in names if (name.endswith(suffix) if suffix else "_b" not in name)]
            curve = [name for name in own if name.startswith("stiffness")]
            kept = tuple(f"static_{power}_" for power in (1, 2, 3) if power > len(curve))
            static = [name for name in names if name.startswith("static") and not name.startswith(kept)]
            taken |= {*curve, *static, f"{VISCOSITY}{suffix}"}
    unknown = partial(replace, value=None, stderr=None, identified=False)
    return tuple(unknown(one) if one.name in taken else one for one in parameters)


def slow_share(identified: Identified) -> float:
    """Share of the samples in contact that are slower than half of the speed at contact."""
    system = identified.system
    touching = system.count * (system.means(system.travel) > 0.0)
    return float(touching[system.means(system.speed_ratio) < SLOW].sum() / max(touching.sum(), 1.0))


def theta_covariance(identified: Identified) -> FloatArray:
    """Covariance of theta, machine held, (p, p); rows of what bounds hold against the data are zero."""
    optimum, law, t = identified.optimum, identified.law, identified.law.times
    shared = np.concatenate([np.arange(t), np.arange(t + 3, t + 3 + law.linear)])
    prior, normal = optimum.prior, optimum.normal
    hessian = normal.hessian[np.ix_(shared, shared)]
    walls = prior.cone[optimum.active][:, shared]
    # a wall against which data press by less than two standard deviations holds nothing
    pressure = np.linalg.lstsq(walls.T, -normal.gradient[shared], rcond=None)[0]
    free = free_of(walls[pressure**2 * np.diag(walls @ covariance_of(hessian) @ walls.T) > 4.0])
    inner = free.T @ hessian @ free
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    values, vectors = np.linalg.eigh(inner / scale / scale[:, None])
    kept = values > 1e-14 * np.abs(values).max(initial=0.0)
    # by a root, so that what is nearly flat leaves it symmetric and positive
    root = free @ (vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None])
    theta = law.theta(optimum.point.log_times, optimum.point.linear, exact=True)[0]
    change = np.zeros((theta.size, len(shared)))
    for k in range(len(shared)):
        step = 1e-6 * max(abs(float(optimum.point.shared[shared[k]])), 1e-3)
        moved = optimum.point.shared.copy()
        moved[shared[k]] += step
        change[:, k] = (law.theta(moved[:t], moved[t + 3 :], exact=True)[0] - theta) / step
    root = change @ root
    return np.asarray(root @ root.T)


def estimate_tissue(identified: Identified) -> TissueEstimate:
    """Reported parameters of the chosen law at its optimum."""
    model, point = identified.model, identified.optimum.point
    theta = identified.law.theta(point.log_times, point.linear)[0]
    covariance = theta_covariance(identified)
    bounded = bool(identified.optimum.active[: len(identified.law.cone)].any())
    if not identified.quotable:
        return TissueEstimate(model, theta, covariance, (), (), bounded)
    static = [k for k, name in enumerate(model.parameter_names) if name.startswith("static")]
    depths = np.array(CURVE_DEPTHS) * model.depth_mm
    fitted = _Fitted(model, theta, covariance)
    parameters = _alike(fitted, static, lambda theta: model.static_force(theta, depths))
    if isinstance(model, DampedModel):
        parameters = _damped(fitted, parameters, confounded=slow_share(identified) < FEWEST_SLOW)
    profiles: list[tuple[ProfileInterval, dict[str, list[float]]]] = []
    order = np.argsort(point.log_times[: identified.law.counts[0]]).tolist()
    for branch in range(model.branches):
        if order:
            profiles.append(profile(identified, order[branch]))
        parameters += _branch_estimates(fitted, branch, profiles[-1] if order else None)
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    intervals = tuple(interval for interval, _ in profiles)
    return TissueEstimate(model, theta, finite, without_exchanged(parameters), intervals, bounded)
