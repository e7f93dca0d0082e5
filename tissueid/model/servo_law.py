"""A contact model as the servo steps it: cubic pieces of the static law, and at most twelve exponentials.

Other relaxations are projected on non-negative exponentials (doi 10.1137/1.9781611971217), passive by
construction, whose times are then fitted as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from tissueid.arrays import FloatArray
from tissueid.model.base import MOST_BRANCHES
from tissueid.model.channels import ChannelModel, DampedModel, Part
from tissueid.model.kernels import LAW_SIZE, MOST_PIECES, OWN_SIZE, pack_law, pack_pieces
from tissueid.model.yardstick import Yardstick

#: What branches follow; of a law without branches, the speed over that at contact.
DEPTH, STATIC, OWN, SPEED = 0, 1, 2, 3
#: Floor of the speed at contact [mm/s] (an encoder count a tick looks like 60), filter of the speed [s],
#: and how far outside a contact ends [mm].
SLOWEST_MM_S, SPEED_FILTER_S, HYSTERESIS_MM = 50.0, 0.01, 0.2
#: Nodes of a projection go from this share of the resolution to this many windows.
BELOW, BEYOND = 0.03, 10.0
#: Times at which a projection is compared, and a time that is none, in windows.
TIMES, FOREVER = 160, 1e6
#: Share of the largest weight that is none.
NONE = 1e-12
#: Points of the grids on which exponentials are sought; steps in which their times are fitted, the longest of
#: them in logarithms, its damping over the steepest slope at first and at the most, what a step that helps
#: leaves of it, and the share of the squares that a last step leaves.
GRIDS, POLISHING, LONGEST_LN = (60, 26, 18), 60, 1.0
FIRST_DAMPING, MOST_DAMPING, LESS_DAMPING, STILL = 3e-3, 1e3, 0.45, 0.9999
#: Shares of a time that is parted in two.
PARTED = (0.7, 1.4)
#: Depth at which the slope at the surface is taken, in first pieces.
NEAR = 1e-3
#: Steps of the active set, and how far beyond the outer ones of few times many are spread.
MOST_STEPS, WIDER = 200, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ServoLaw:
    """Law of a servo."""

    static: FloatArray  # (pieces, 4), cubics; piece i begins at depth (i / pieces)^2 [N, mm]
    #: (branches, k): coefficients of K_j by powers of x [N/mm^(k+1)]; inside, the ratio to the static force.
    stiffness: FloatArray
    tau_s: FloatArray  # (branches,)
    #: What the branches follow: 0 the depth, 1 the static force, 2 polynomials of their own; 3 of a static
    #: force damped by the speed over that at contact.
    followed: int
    depth_mm: float
    error: float  # largest error of the relaxing force by the projection, over the force of a sudden push
    #: (branches, OWN_SIZE): these by powers of x [N, mm]; of a damped force chi, floor, filter, hysteresis.
    own: FloatArray = field(default_factory=lambda: np.zeros((0, OWN_SIZE)))

    @property
    def slowest_mm_s(self) -> float:
        """Speed below which a contact counts as one that began at it [mm/s]; 0 where that means nothing."""
        return float(self.own[0, 1]) if self.followed == SPEED else 0.0

    def pack(self, law: FloatArray, at: int) -> None:
        """Write it from index ``at``, :data:`~tissueid.model.kernels.LAW_SIZE` numbers."""
        pack_law(self.static[0], self.stiffness, self.tau_s, self.depth_mm, law, at)
        if len(self.static) > 1 or self.followed:
            pack_pieces(law, at, self.static, followed=self.followed, own=self.own)

    def packed(self) -> FloatArray:
        """A block of its own, shape (LAW_SIZE,)."""
        law = np.zeros(LAW_SIZE)
        self.pack(law, 0)
        return law

    def stiffer(self, factor: float) -> ServoLaw:
        """The same tissue with all its forces times a factor."""
        stiffness = self.stiffness if self.followed == STATIC else factor * self.stiffness
        return replace(self, static=factor * self.static, stiffness=stiffness)

    def linearised(
        self, model: ChannelModel, theta: FloatArray, depth_mm: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Stiffness of every exponential for small moves about rest at depths, (branches, n), and times.

        Damping behind a filter is one, largest in a contact that began at the slowest speed.
        """
        x = np.asarray(depth_mm, dtype=np.float64)
        if self.followed == SPEED:
            chi, slowest, filter_s, _ = self.own[0]
            resistance = chi * model.static_force(theta, x) / slowest
            return resistance[None] / filter_s, np.array([filter_s])
        if self.followed == OWN:
            rows = zip(self.own, self.stiffness, strict=True)
            return np.array([polyval(x, polyder(one)) * polyval(x, k) for one, k in rows]), self.tau_s
        if self.followed == STATIC:
            return np.asarray(self.stiffness[:, :1] * model.static_slope(theta, x)), self.tau_s
        found = np.asarray(polyval(x, self.stiffness.T), dtype=np.float64)
        return found.reshape(len(self.tau_s), x.size), self.tau_s


def servo_law(model: ChannelModel, theta: FloatArray, most: int = MOST_BRANCHES) -> ServoLaw:
    """The law that the servo steps for a tissue, a relaxation projected on at most ``most`` exponentials."""
    if isinstance(model, Yardstick):
        return _of_yardstick(model, theta)
    if isinstance(model, DampedModel):
        damping = np.array([[model.factor(theta), SLOWEST_MM_S, SPEED_FILTER_S, HYSTERESIS_MM]])
        none = np.zeros((0, 1)), np.zeros(0)
        return ServoLaw(_pieces(model, theta), *none, SPEED, model.depth_mm, 0.0, damping)
    rows, times, worst = [np.zeros((0, max(model.stiffness_law.powers, 1)))], [np.zeros(0)], 0.0
    share = max(most // max(model.branches, 1), 1)
    for part in model.parts:
        weights, tau, error = _exponentials(model, theta, part, share)
        size = np.array([theta[part.ratio]]) if part.ratio is not None else theta[part.stiffness]
        rows.append(weights[:, None] * size)
        times.append(tau)
        worst = max(worst, error)
    return ServoLaw(
        _pieces(model, theta),
        np.concatenate(rows),
        np.concatenate(times),
        STATIC if model.inside else DEPTH,
        model.depth_mm,
        worst,
    )


def _of_yardstick(model: Yardstick, theta: FloatArray) -> ServoLaw:
    """Each node an exponential that follows its own curve, or the depth beside a stiffness."""
    own, stiffness = np.zeros((model.branches, OWN_SIZE)), np.zeros((model.branches, 3))
    for j in range(model.branches):
        own[j], stiffness[j] = model.curves(theta, j)
    return ServoLaw(_pieces(model, theta), stiffness, model.fixed_s, OWN, model.depth_mm, 0.0, own)


def _pieces(model: ChannelModel, theta: FloatArray) -> FloatArray:
    """Cubics with the values and slopes of the static law at their ends; one of a polynomial."""
    if model.static.polynomial:
        out = np.zeros((1, 4))
        coefficients = theta[: len(model.static.coefficients)]
        out[0, 1 : 1 + coefficients.size] = coefficients
        return out
    ends = model.depth_mm * (np.arange(MOST_PIECES + 1) / MOST_PIECES) ** 2
    value, width = model.static_force(theta, ends), np.diff(ends)
    # an infinite slope at the surface would be none that a servo can render: the first chord stands there
    slope = model.static_slope(theta, np.maximum(ends, NEAR * ends[1]))
    slope[0] = min(slope[0], value[1] / width[0])
    rise = np.diff(value) / width
    square = (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / width
    cube = (slope[:-1] + slope[1:] - 2.0 * rise) / width**2
    return np.column_stack([value[:-1], slope[:-1], square, cube])


def _exponentials(
    model: ChannelModel, theta: FloatArray, part: Part, most: int
) -> tuple[FloatArray, FloatArray, float]:
    """Weights, times and largest error of at most ``most`` exponentials for a part's relaxation."""
    if part.tau_s is not None or model.relaxation.branches:
        weights, tau = model.exponentials(theta, part)
        return weights, tau, 0.0
    low, high = BELOW * model.resolution_s, BEYOND * model.window_s
    time = np.append(0.0, np.geomspace(0.2 * low, 2.0 * model.window_s, TIMES))
    wanted = model.relaxation.value(time, *theta[part.shapes])
    weights, tau = projected(time, wanted, (low, high), most)
    error = np.abs(np.exp(-time[:, None] / tau) @ weights - wanted)
    return weights, tau, float(error[time >= model.resolution_s].max())


def projected(
    time_s: FloatArray, wanted: FloatArray, span_s: tuple[float, float], most: int
) -> tuple[FloatArray, FloatArray]:
    """Weights and times of at most ``most`` decaying exponentials that are a relaxation, (n,) each.

    Non-negative least squares on a grid gives neighbours that stand for one time each; these, and times
    spread between the first and the last of them, are starts from which times are fitted.
    """
    best, forever = _Sum(np.zeros(0), np.zeros(0), np.inf), FOREVER * span_s[1]
    for count in GRIDS:
        grid = np.append(np.geomspace(*span_s, count), forever)
        times = _merged(_nonnegative(np.exp(-time_s[:, None] / grid), wanted), grid, most)
        starts, decaying = [times], times[times < forever]
        if decaying.size > 1:
            spread = np.geomspace(decaying.min() / WIDER, decaying.max() * WIDER, most - 1)
            starts.append(np.append(spread, forever))
        for start in starts:
            found = _filled(time_s, wanted, _polished(time_s, wanted, start), (most, forever))
            best = min(best, found, key=lambda one: one.error)
    return best.weights, best.tau_s


class _Sum(NamedTuple):
    """Exponentials, and the largest error of their sum."""

    weights: FloatArray
    tau_s: FloatArray
    error: float


def _merged(weights: FloatArray, grid: FloatArray, most: int) -> FloatArray:
    """Times of the heaviest groups of neighbours, the last time never in one."""
    used = np.flatnonzero(weights > NONE * weights.max())
    groups = np.split(used, np.flatnonzero((np.diff(used) > 1) | (used[1:] == len(grid) - 1)) + 1)
    groups = sorted(groups, key=lambda one: -weights[one].sum())[:most]
    return np.array([np.exp(np.average(np.log(grid[one]), weights=weights[one])) for one in groups])


def _filled(time_s: FloatArray, wanted: FloatArray, found: _Sum, limits: tuple[int, float]) -> _Sum:
    """The same with its heaviest time parted in two while that is better; ``limits``: count, last time."""
    most, forever = limits
    while found.tau_s.size < most:
        heaviest = int(np.argmax(np.where(found.tau_s < forever, found.weights, 0.0)))
        parts = np.append(np.delete(found.tau_s, heaviest), found.tau_s[heaviest] * np.array(PARTED))
        more = _polished(time_s, wanted, parts)
        if more.error >= found.error or more.tau_s.size <= found.tau_s.size:
            break
        found = more
    return found


def _polished(time_s: FloatArray, wanted: FloatArray, tau_s: FloatArray) -> _Sum:
    """Times that are nearest to a relaxation with the best non-negative weights of each.

    Variable projection (Golub & Pereyra 1973, doi 10.1137/0710036) with Kaufman's derivative (1975, doi
    10.1007/BF01932995), damped as by Levenberg and Marquardt.
    """
    x, damping = np.log(tau_s), FIRST_DAMPING
    each, weights = _weighted(time_s, wanted, x)
    off = each @ weights - wanted
    for _ in range(POLISHING):
        basis, _ = np.linalg.qr(each)
        slopes = each * (time_s[:, None] / np.exp(x)) * weights
        slopes -= basis @ (basis.T @ slopes)
        level = damping * np.linalg.norm(slopes, axis=0).max()
        matrix = np.vstack([slopes, level * np.eye(x.size)])
        move = np.linalg.lstsq(matrix, np.append(-off, np.zeros(x.size)), rcond=None)[0]
        trial = x + np.clip(move, -LONGEST_LN, LONGEST_LN)
        new, sizes = _weighted(time_s, wanted, trial)
        missed = new @ sizes - wanted
        better = missed @ missed < off @ off and (sizes > 0.0).sum() >= (weights > 0.0).sum()
        damping *= LESS_DAMPING if better else 1.0 / LESS_DAMPING
        still = better and missed @ missed > STILL * (off @ off)
        if better:
            x, each, weights, off = trial, new, sizes, missed
        if still or damping > MOST_DAMPING:
            break
    kept = weights > 0.0
    return _Sum(weights[kept], np.exp(x)[kept], float(np.abs(off).max()))


def _weighted(time_s: FloatArray, wanted: FloatArray, ln_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exponentials at times, (t, n), and their best non-negative weights, (n,)."""
    each = np.exp(-time_s[:, None] / np.exp(ln_tau))
    weights = np.asarray(np.linalg.lstsq(each, wanted, rcond=None)[0])
    return each, _nonnegative(each, wanted) if (weights <= 0.0).any() else weights


def _nonnegative(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """Least squares with non-negative unknowns, by Lawson and Hanson's active set."""
    count = matrix.shape[1]
    passive, out = np.zeros(count, dtype=bool), np.zeros(count)
    for _ in range(MOST_STEPS):
        gradient = matrix.T @ (target - matrix @ out)
        if passive.all() or gradient[~passive].max() <= NONE * np.abs(target).max():
            break
        passive[np.flatnonzero(~passive)[np.argmax(gradient[~passive])]] = True
        for _ in range(count):
            trial = np.zeros(count)
            trial[passive] = np.linalg.lstsq(matrix[:, passive], target, rcond=None)[0]
            bad = passive & (trial <= 0.0)
            if not bad.any():
                break
            out = out + float((out[bad] / (out[bad] - trial[bad])).min()) * (trial - out)
            passive &= out > NONE
            out[~passive] = 0.0
        out = trial
    return out
