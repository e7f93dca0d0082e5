"""Second looks at an optimum: Levenberg-Marquardt (lmfit) from a rougher start, and shorter holds.

Of tissue that relaxes over decades one exponential follows the window it was shown: d ln tau / d ln T says
so.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import lmfit
import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import RelaxationWindow
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.engine import Identified, badness, refit
from tissueid.inference.logs import LogHandle, blocks_of
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import about_mean, free_of, minimise, nearest_in_cone, prior_cost, whitener_of
from tissueid.inference.prior import PriorRows, prior_rows, time_bounds
from tissueid.inference.search import starting_points
from tissueid.inference.system import SHAPE, Point, System
from tissueid.inference.window import MIN_SAMPLES
from tissueid.measured.pushes import after_rupture
from tissueid.quantities import EFFECTIVE_SD, EFFECTIVE_SLOPE

#: Standard errors within which optima agree: of ln tau, and squared of the objective, which one lifts by 1.
AGREE_SD = 0.2
#: ln tau starts at the nearest multiple of this, other parameters so far off, relatively.
START_GRID, START_OFF = 0.5, 0.05
MAX_EVALUATIONS, TOLERANCE = 300, 1e-10
#: Steps of a fit that begins where Levenberg-Marquardt ended.
RESTARTED = 100
#: Twice the log density by which its optimum must be better: less is within one standard error.
LOWER = 1.0
#: Parameters and residuals are kept below this; shares of the largest, and of a wall, that are nothing.
BEYOND, ROUNDING, WALL = 1e12, 1e-12, 1e-6
#: ln tau is kept within this.
FARTHEST = 40.0


class _Problem:
    """The objective as lmfit sees it: a vector of residuals of a vector of parameters."""

    def __init__(self, identified: Identified) -> None:
        self.system, self.law, self.optimum = identified.system, identified.law, identified.optimum
        self.white = whitener_of(self.system, self.optimum.noise.memory)
        t = self.law.times
        self.free = free_of(self.optimum.prior.cone[self.optimum.active][:, t + 3 :])
        point = self.optimum.point
        self.start = np.concatenate([point.log_times, self.free.T @ point.linear, point.own.ravel()])

    def point(self, values: FloatArray) -> Point:
        """Vector -> point."""
        t, m = self.law.times, self.free.shape[1]
        values = np.append(np.clip(values[:t], -FARTHEST, FARTHEST), values[t:])
        own = values[t + m :].reshape(self.optimum.point.own.shape)
        own = about_mean(own) if self.system.centred else own
        return Point(values[:t], self.optimum.point.machine, self.free @ values[t : t + m], own)

    def residual(self, values: FloatArray) -> FloatArray:
        """Whitened residuals and priors."""
        point, prior = self.point(values), self.optimum.prior
        left = self.white(self.system.force - self.system.predict(point)) / self.optimum.noise.sigma_N
        own = np.sqrt(prior.own) * point.own
        common = values[self.start.size - own.size :].reshape(own.shape).sum(axis=0)[-SHAPE:]
        rows = [left, prior.rows @ point.shared - prior.target, own.ravel()]
        return np.concatenate([*rows, common] if self.system.centred else rows)

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Derivative of :meth:`residual`."""
        point, prior, t = self.point(values), self.optimum.prior, self.law.times
        parts = self.system.derivatives(point, machine=False)
        scale = -1.0 / self.optimum.noise.sigma_N
        to = np.zeros((self.system.size, t + self.free.shape[1]))
        to[:t, :t], to[t + 3 :, t:] = np.eye(t), self.free
        logs, q = point.own.shape
        shared = np.vstack([self.white(parts.shared) * scale, prior.rows]) @ to
        out = np.zeros((len(shared) + logs * q, to.shape[1] + logs * q))
        out[: len(shared), : to.shape[1]] = shared
        if q:
            own = self.white(parts.own) * scale
            for i in range(logs):
                at = slice(to.shape[1] + i * q, to.shape[1] + (i + 1) * q)
                mine = np.flatnonzero(self.system.log == i)
                out[mine, at] = own[mine]
                out[len(shared) + i * q : len(shared) + (i + 1) * q, at] = np.diag(np.sqrt(prior.own[i]))
        return self._about_mean(out, logs, q) if self.system.centred else out

    def _about_mean(self, rows: FloatArray, logs: int, q: int) -> FloatArray:
        """Rows by shapes about their mean, and rows that hold their sum."""
        own = rows[:, -logs * q :].reshape(-1, logs, q)
        own[:, :, -SHAPE:] -= own[:, :, -SHAPE:].mean(axis=1, keepdims=True)
        held = np.zeros((SHAPE, rows.shape[1]))
        for k in range(SHAPE):
            held[k, rows.shape[1] - SHAPE + k :: -q] = 1.0
        held[:, : rows.shape[1] - logs * q] = 0.0
        return np.vstack([rows, held])


def settled(identified: Identified) -> tuple[Identified, dict[str, Any]]:
    """The lower of both optima and their comparison; a fit begins where Levenberg-Marquardt is lower."""
    told, reached = both_optimisers(identified)
    if told["agree"] is True or told["relative_difference"] >= 0.0:
        return identified, told
    system, t = identified.system, identified.law.counts[0]
    times = np.append(np.clip(reached.log_times[:t], *time_bounds(system)), reached.log_times[t:])
    start, prior = replace(reached, log_times=times), identified.optimum.prior
    inside = nearest_in_cone(start.shared, identified.optimum.covariance, prior.cone, prior.least)
    start = start.moved(inside, start.own)
    again = refit(identified, machine=identified.request.machine, start=start, steps=RESTARTED)
    better = badness(system, again) < badness(system, identified.optimum) - LOWER
    if not better or _outside(again.prior, again.point):
        return identified, told
    lower = replace(identified, optimum=again)
    return lower, both_optimisers(lower)[0]


def _outside(prior: PriorRows, point: Point) -> bool:
    """True where a point lies beyond a wall by more than rounding."""
    shared = np.abs(point.shared)
    rounding = WALL * (np.abs(prior.cone) @ shared) + ROUNDING * shared.max()
    return bool((prior.cone @ point.shared < prior.least - rounding).any())


def both_optimisers(identified: Identified) -> tuple[dict[str, Any], Point]:
    """Run Levenberg-Marquardt and compare: ``optimisers`` of identification.json, and its point."""
    problem, t = _Problem(identified), identified.law.times
    low, high = time_bounds(identified.system)
    parameters = lmfit.Parameters()
    for k, value in enumerate(problem.start.tolist()):
        rough = float(np.clip(round(value / START_GRID) * START_GRID, low + 0.05, high - 0.05))
        parameters.add(f"p{k}", value=rough if k < t else value * (1.0 + START_OFF))

    def vector(values: Any) -> FloatArray:
        found = np.array([values[f"p{k}"].value for k in range(len(problem.start))])
        return np.asarray(np.clip(found, -BEYOND, BEYOND))

    def residual(values: Any) -> FloatArray:
        # a step that leaves the range of numbers is a bad one, not an error
        return np.nan_to_num(problem.residual(vector(values)), nan=BEYOND, posinf=BEYOND)

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = lmfit.Minimizer(residual, parameters, scale_covar=False).leastsq(
            Dfun=lambda values: np.nan_to_num(problem.jacobian(vector(values))),
            max_nfev=MAX_EVALUATIONS, ftol=TOLERANCE, xtol=TOLERANCE,
        )  # fmt: skip
    reached = vector(found.params)
    variance = identified.optimum.noise.sigma_N**2
    lm_value = float((problem.residual(reached) ** 2).sum())
    value = identified.optimum.normal.objective
    difference = (lm_value - value) / max(value, 1e-300)
    sd = np.sqrt(np.maximum(np.diag(identified.optimum.covariance)[:t], 1e-24))
    apart = float((np.abs(np.sort(reached[:t]) - np.sort(problem.start[:t])) / sd).max(initial=0.0))
    # times that are not known are close to anything
    raised = abs(lm_value - value)
    agree = bool(raised <= AGREE_SD**2 or (raised <= LOWER and apart <= AGREE_SD))
    at_bound, prior = bool(problem.free.shape[1] < identified.law.linear), identified.optimum.prior
    point = problem.point(reached)
    # Levenberg-Marquardt knows no bounds: lower and not passive is no other optimum
    kept_out = difference < 0.0 and _outside(prior, point)
    told = {
        "method": "Levenberg-Marquardt (lmfit) and constrained Gauss-Newton",
        "lm_sum_of_squares_N2": lm_value * variance,
        "vp_sum_of_squares_N2": value * variance,
        "relative_difference": float(difference),
        "lm_evaluations": int(found.nfev),
        "lm_converged": bool(found.success),
        "agree": None if (at_bound or kept_out) and not agree else agree,
        "bound_active": at_bound,
        "prior_cost": prior_cost(prior, identified.optimum.point),
        "sigma_gain": identified.scatter.gain if identified.system.effects.gain else None,
    }
    return told, point


#: The hold is cut to these shares of its length.
SHARES = (1.0, 0.5, 0.25)
#: Sampling intervals that the shortest window has at least.
FEWEST_STEPS = 8
#: Distance from the ends of the search in ln tau at which a relaxation time is not known.
EDGE = 0.05
STEPS = 12


def _ln_tau(identified: Identified, handles: Sequence[LogHandle], share: float) -> tuple[float, float] | None:
    """Ln of the one relaxation time with its standard error, ``None`` at the ends of the search."""
    blocks = []
    for handle in handles:
        cut = replace(handle, hold_share=share)
        _, log = cut.fitted()
        if log.n_samples < MIN_SAMPLES:
            return None
        blocks.append(blocks_of(cut, log))
    found, request = identified.optimum.point, identified.request
    law = kelvin_voigt_law(1, identified.law.degree, identified.system.depth_mm)
    system = System(blocks, law, identified.system.depth_mm, identified.system.effects)
    at = Point(np.zeros(1), found.machine, np.zeros(law.linear), found.own)
    best = minimise(
        system,
        starting_points(system, law, at, whitener_of(system, Memory()))[0],
        partial(prior_rows, system, identified.scatter, request.priors, machine=False),
        machine=False,
        steps=STEPS,
    )
    low, high = time_bounds(system)
    if not low + EDGE < best.point.log_times[0] < high - EDGE:
        return None
    error = float(np.sqrt(best.covariance[0, 0]))
    return (float(best.point.log_times[0]), error) if np.isfinite(error) else None


def relaxation_window(
    handles: Sequence[LogHandle], identified: Identified, tick: Callable[[str], None]
) -> RelaxationWindow | None:
    """Relaxation time of the one-branch model with the hold cut to T, T/2 and T/4.

    Returns ``None`` where no hold, or a quarter of it, determines a relaxation time.
    """
    divided = [handle.segmentation for handle in handles]
    every = [[hold for hold in one.of_kind("hold") if not after_rupture(one, hold)] for one in divided]
    longest = [max((hold.end_s - hold.start_s for hold in holds), default=0.0) for holds in every]
    holds = [length for length in longest if length > 0.0]
    step = max(handle.facts.step_s for handle in handles)
    if not holds:
        return None
    shares = tuple(share for share in SHARES if share * min(holds) >= FEWEST_STEPS * step)
    if len(shares) < 2:
        return None
    tick("relaxation time of shorter windows")
    found = [_ln_tau(identified, handles, share) for share in shares]
    known = [(share, *pair) for share, pair in zip(shares, found, strict=True) if pair is not None]
    if found[0] is None or len(known) < 2:
        return None
    cut, ln_tau, error = np.array(known).T
    slope, slope_error = _slope(np.log(cut), ln_tau, error)
    return RelaxationWindow(
        cut_s=tuple((float(np.median(holds)) * cut).tolist()),
        tau_s=tuple(np.exp(ln_tau).tolist()),
        stderr_s=tuple((np.exp(ln_tau) * error).tolist()),
        slope=slope,
        slope_stderr=slope_error,
        effective=slope > max(EFFECTIVE_SLOPE, EFFECTIVE_SD * slope_error),
    )


def _slope(ln_cut: FloatArray, ln_tau: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Slope of the line through the windows, with the error that theirs give it were they independent."""
    weight = ln_cut - ln_cut.mean()
    weight /= weight @ weight
    return float(weight @ ln_tau), float(np.sqrt(weight**2 @ error**2))
