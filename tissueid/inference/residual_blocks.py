"""Means of a log's residual over blocks of its program: the misfit alarm, and the clustered sandwich.

Blocks of one place in the program have one key in every log: an error of the model repeats, noise does not,
and it is largest at corners.  Beside each mean stands what the fit has taken out.  Where a law misses more
than noise, scores of logs, or of stretches, give the covariance (Mueller 2013, doi 10.3982/ECTA9097).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import block_diag, solve_triangular

from tissueid.arrays import FloatArray
from tissueid.documents.identification import MisfitAlarm, MisfitCheck, NoiseFit
from tissueid.inference.optimum import covariance_of
from tissueid.inference.target import SpecimenTarget
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import FittedLog
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.trial import Segmentation

#: Ends of the blocks of a move, as fractions of its path; the first hold what a late contact leaves behind.
MOVE_EDGES = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
#: Blocks of a hold, in each decade of the time since its corner.
HOLD_BLOCKS_PER_DECADE = 4
#: Step for the derivative of the static force by depth, relative to the fitted depth.
DEPTH_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class ResidualBlocks:
    """Block means of one log; ``k`` blocks in the order of time."""

    phase: NDArray[np.int64]  # (k,), which move or hold of the log, counted from 0 by its kind
    hold: NDArray[np.bool_]  # (k,)
    #: (k,): of a move: the index of its :data:`MOVE_EDGES`; of a hold: the whole part of
    #: ``HOLD_BLOCKS_PER_DECADE log10(time since the corner / s)``.
    place: NDArray[np.int64]
    count: NDArray[np.int64]  # (k,), samples that take part in the likelihood
    mean_N: FloatArray  # (k,), mean of measured less modelled force
    start_s: FloatArray  # (k,), time of the first of these samples
    end_s: FloatArray  # (k,), time of the last
    shared: FloatArray  # (k, p), mean derivative of the model by its theta
    #: (k, q): mean derivative by what each log has for itself: ln gain, contact offset and shape; and by the
    #: branch states at its corners, which may lie between two samples.
    own: FloatArray
    speed_mm_s: float  # fastest loading of the log
    depth_mm: float  # its largest
    step_s: float  # median sampling interval


def _keys(segmentation: Segmentation, log: FittedLog) -> NDArray[np.int64]:
    """Phase by kind, kind, and place of every sample; shape (n, 3).  Phase -1: in none."""
    data = log.data
    offset = log.first - int(log.inserted)
    keys = np.zeros((data.time_s.size, 3), dtype=np.int64)
    keys[:, 0] = -1
    seen = {True: 0, False: 0}
    for phase in segmentation.phases:
        start, stop = max(phase.start - offset, 0), min(phase.stop - offset, data.time_s.size)
        if stop - start < 2:
            continue
        held = phase.kind == "hold"
        if held:
            since = np.maximum(data.time_s[start:stop] - phase.start_s, log.step_s / 2.0)
            place = np.floor(HOLD_BLOCKS_PER_DECADE * np.log10(since)).astype(np.int64)
        else:
            path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.depth_mm[start:stop])))])
            place = np.searchsorted(MOVE_EDGES, path / max(path[-1], 1e-300), side="right")
        keys[start:stop, :2], keys[start:stop, 2] = (seen[held], held), place
        seen[held] += 1
    return keys


def _corner_columns(
    model: ChannelModel, theta: FloatArray, log: FittedLog, segmentation: Segmentation
) -> FloatArray:
    """Remainder of an error of the branch states at each corner, shape (n, holds * branches)."""
    # a stop between two samples is not in the displacement: states behind it are off, until tau is over
    time, columns, tau = log.data.time_s, [], model.times(theta)
    for hold in segmentation.of_kind("hold"):
        since = time - hold.start_s
        inside = (since >= -0.5 * log.step_s) & (time <= hold.end_s + 0.5 * log.step_s)
        columns += [np.where(inside, np.exp(-np.maximum(since, 0.0) / float(one)), 0.0) for one in tau]
    return np.column_stack(columns) if columns else np.zeros((time.size, 0))


def residual_blocks(
    segmentation: Segmentation,
    log: FittedLog,
    model: ChannelModel,
    theta: FloatArray,
    adjustment: Adjustment,
    fitted: FloatArray,
) -> ResidualBlocks:
    """Block means of one log under its specimen's model; ``fitted`` (n,): its force along the log [N]."""
    data = log.data
    path = ContactPath(data.time_s, data.depth_mm, data.speed_ratio)
    keys = _keys(segmentation, log)
    used = np.flatnonzero(data.include & (keys[:, 0] >= 0))
    keys = keys[used]
    first = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-2) != 0, axis=1))
    last = np.append(first[1:], used.size) - 1
    count = np.diff(np.append(first, used.size))

    def means(columns: FloatArray) -> FloatArray:
        if first.size == 0:
            return np.zeros((0, *columns.shape[1:]))
        total = np.add.reduceat(columns[used], first, axis=0)
        return np.asarray(total / count.reshape(-1, *[1] * (columns.ndim - 1)))

    x, step = np.maximum(data.depth_mm, 0.0), DEPTH_STEP * model.depth_mm
    # the branch's share of a contact error is that of K's slope, which is small beside F_s'
    slope = (model.static_force(theta, x + step) - model.static_force(theta, x)) / step
    by_log = np.column_stack([fitted, -slope])
    by_corner = _corner_columns(model, theta, log, segmentation)
    return ResidualBlocks(
        phase=keys[first, 0],
        hold=keys[first, 1] == 1,
        place=keys[first, 2],
        count=count,
        mean_N=means(data.force_N - fitted),
        start_s=data.time_s[used[first]],
        end_s=data.time_s[used[last]],
        shared=means(adjustment.gain * model.jacobian(theta, path)),
        own=means(np.concatenate([by_log, by_corner], axis=1)),
        speed_mm_s=max(log.speeds_mm_s),
        depth_mm=log.depth_mm,
        step_s=log.step_s,
    )


#: Logs from which their scores alone are the spread, and stretches of a log that are one cluster otherwise.
LOGS_AS_CLUSTERS, TOGETHER = 4, 2
#: Standard deviation of ln tau between places of one piece (55 sheets of meat, two branches), and the degrees
#: of freedom that it counts for beside two or three logs.
BETWEEN_LN_TAU, BETWEEN_FREEDOM = 0.2, 3
NORMAL_975 = 1.959963984540054


def _columns(target: SpecimenTarget) -> FloatArray:
    """Derivatives of the observations by the free coordinates, the logs' own parameters following, (k, d)."""
    normal, s = target.optimum.normal, target.n_shared
    columns = np.zeros((normal.residual.size, len(target.mode)))
    columns[:, :s] = normal.shared
    if "contact" in target.places:
        columns[:, target.places["contact"]] = normal.own[:, 0]
    elif normal.own.shape[1]:
        # what a log takes up by itself moves nothing that is shared
        follow = np.einsum("lqr,lrs->lqs", normal.own_inverse, normal.cross)
        columns[:, :s] -= np.einsum("kq,kqs->ks", normal.own, follow[target.system.log])
    return np.asarray((columns @ target.slope)[:, target.free])


def _spread(rows: FloatArray, clusters: NDArray[np.int64]) -> tuple[FloatArray, int]:
    """Covariance (d, d) of the sum of scores (k, d) by the scatter of clusters, and their number."""
    _, labels = np.unique(clusters, return_inverse=True)
    count = int(labels.max()) + 1
    scores = np.zeros((count, rows.shape[1]))
    np.add.at(scores, labels, rows)
    scores -= scores.mean(axis=0)
    return scores.T @ scores * count / max(count - 1.0, 1.0), count


def _between(target: SpecimenTarget, data: FloatArray, root: FloatArray) -> FloatArray:
    """Covariance (d, d) of the sum of scores where ln tau differs between logs by what is stated."""
    names = np.array(target.names)[target.free]
    known = np.array([one.startswith("ln_tau_") for one in names], dtype=np.float64)
    whitened = np.linalg.solve(root, np.diag(known * BETWEEN_LN_TAU))
    move = data @ whitened
    return np.asarray(move @ move.T / len(target.system.logs))


def sandwich_covariance(target: SpecimenTarget) -> tuple[FloatArray, float]:
    """Covariance (d, d) of the free coordinates, and the samples that one independent sample stands for."""
    system, residual = target.system, target.optimum.normal.residual
    covariance = covariance_of(target.precision)
    root = np.asarray(np.linalg.cholesky(covariance + 1e-14 * np.diag(np.diag(covariance))), dtype=np.float64)
    whitened = _columns(target) @ root
    rows, logs = whitened * residual[:, None], len(system.logs)
    many = logs >= LOGS_AS_CLUSTERS
    spread, count = _spread(rows, system.log if many else system.log * 1000 + system.fold // TOGETHER)
    data = whitened.T @ whitened
    worth = max(float(np.trace(spread)) / max(float(np.trace(data)), 1e-12), 1.0)
    weight = count / (count + whitened.shape[1])
    middle, freedom = weight * spread + (1.0 - weight) * worth * data, count - 1
    if 1 < logs < LOGS_AS_CLUSTERS:
        stated = middle + _between(target, data, root)
        freedom = BETWEEN_FREEDOM + logs - 1
        seen = (logs - 1) * _spread(rows, system.log)[0]
        middle = (BETWEEN_FREEDOM * stated + seen) / freedom
    # prior directions keep their prior, none is known better than independent samples make it
    total = middle + np.eye(len(data)) - data
    values, vectors = np.linalg.eigh(0.5 * (total + total.T))
    tail = float(stats.t.ppf(0.975, freedom) / NORMAL_975) ** 2 if freedom > 0 else 1.0
    values = np.maximum(values, 1.0)
    values = np.where(values > 1.0, 1.0 + (values - 1.0) * tail, 1.0)
    return root @ ((vectors * values) @ vectors.T) @ root.T, worth


#: Probability with which each check may be raised by noise.
LEVELS = {"shared structure": 0.008, "within logs": 0.004, "early hold": 0.003, "ramp start": 0.003}
FLIPS = 1999
#: With fewer logs the exchanges of signs are too few for the level.
FEWEST_LOGS = 8
SEED = 20110
#: Noise that is known from a short record may be so much stronger at long lags than its fit says.
SPECTRUM_TOLERANCE = 1.15
#: Blocks count as early up to this share of a hold, as the start of a ramp up to this share of its path.
EARLY_SHARE, START_PLACES = 0.1, 3


class _Row(NamedTuple):
    """One statistic of signs: which blocks it sums, for the sentence."""

    words: str
    columns: NDArray[np.int64]


def _parts(noise: NoiseFit) -> tuple[float, float]:
    """Variances of the white and of the correlated part [N^2]."""
    variance = noise.sigma_N**2
    if noise.model == "white" or noise.phi <= 0.0:
        return variance, 0.0
    phi, theta = noise.phi, noise.moving_average
    lag_one = (1.0 - phi * theta) * (phi - theta) / (1.0 + theta * theta - 2.0 * phi * theta)
    share = min(max(lag_one / phi, 0.0), 1.0)
    return variance * (1.0 - share), variance * share


def _rate(noise: NoiseFit) -> float:
    """Decay of the correlation [1/s]; infinite for white noise."""
    return -float(np.log(noise.phi)) / noise.reference_step_s if noise.phi > 0.0 else float("inf")


def block_covariance(blocks: ResidualBlocks, noise: NoiseFit) -> FloatArray:
    """Covariance of the block means of one log under its noise, shape (k, k) [N^2].

    Geometric series: ``n + 2 sum_j (n - j) r^j`` of n samples whose neighbours are correlated by r,
    products across a gap.
    """
    white, correlated = _parts(noise)
    n = blocks.count.astype(np.float64)
    covariance = np.diag(white / n)
    if correlated == 0.0:
        return covariance
    rate = _rate(noise)
    step = np.where(n > 1, (blocks.end_s - blocks.start_s) / np.maximum(n - 1, 1), blocks.step_s)
    x = np.maximum(rate * step, 1e-12)
    r, one_less = np.exp(-x), -np.expm1(-x)
    series = -np.expm1(-n * x) / one_less
    own = (n * (1.0 + r) - 2.0 * r * series) / one_less / n**2
    gap = blocks.start_s[None, :] - blocks.end_s[:, None]
    mean = series / n
    across = np.exp(-rate * np.maximum(gap, 0.0)) * mean[:, None] * mean
    upper = np.triu(across, 1)
    return np.asarray(covariance + correlated * (upper + upper.T + np.diag(own)))


def _features(logs: Sequence[ResidualBlocks], values: Sequence[FloatArray]) -> tuple[FloatArray, list[_Row]]:
    """A value of each block by place and contrast, shape (logs, features), and how they are grouped."""
    keys_of = [
        list(zip(one.hold.tolist(), one.phase.tolist(), one.place.tolist(), strict=True)) for one in logs
    ]
    keys = sorted({key for found in keys_of for key in found})
    at = {key: k for k, key in enumerate(keys)}
    table = np.zeros((len(logs), len(keys)))
    present = np.zeros_like(table, dtype=bool)
    for i, (found, value) in enumerate(zip(keys_of, values, strict=True)):
        columns = [at[key] for key in found]
        table[i, columns] = value
        present[i, columns] = True
    speed = np.log(np.maximum([one.speed_mm_s for one in logs], 1e-12))
    depth = np.array([one.depth_mm for one in logs])
    held = np.array([key[0] for key in keys], dtype=bool)
    features: list[FloatArray] = []
    rows: list[_Row] = []
    for kind, what in ((True, "holds"), (False, "ramps")):
        chosen = np.flatnonzero((held == kind) & (present.sum(axis=0) > 1))
        for contrast, words in (
            (np.ones(len(logs)), f"{what} of all logs"),
            (speed, f"{what}, growing or falling with speed"),
            (depth, f"{what}, growing or falling with depth"),
        ):
            block = table[:, chosen]
            if not words.endswith("all logs"):
                there = present[:, chosen]
                mean = (contrast[:, None] * there).sum(axis=0) / there.sum(axis=0)
                block = block * (contrast[:, None] - mean) * there
            block = block[:, (block**2).sum(axis=0) > 0.0]
            if block.shape[1]:
                start = sum(one.shape[1] for one in features)
                rows.append(_Row(words, np.arange(start, start + block.shape[1])))
                features.append(block)
    return (np.concatenate(features, axis=1) if features else np.zeros((len(logs), 0))), rows


def shared_structure(
    logs: Sequence[ResidualBlocks], noise: NoiseFit, *, rng: np.random.Generator
) -> tuple[float, float, str] | None:
    """Structure that repeats from log to log, against exchanged signs.

    By place of the program the squared sum over logs of the block means, over the sum of their squares,
    after what the fit could take out; summed over holds and ramps, weighted with speed and depth, plain
    and whitened. The smallest p-value is judged against its own distribution. Returns statistic, p-value
    and group in words; ``None`` with too few logs.
    """
    if len(logs) < FEWEST_LOGS:
        return None
    projected = _project(logs, noise)
    white = np.split(projected.residual, np.cumsum([one.count.size for one in logs])[:-1])
    plain = [
        (root @ value) / np.sqrt((root**2).sum(axis=1))
        for root, value in zip(projected.roots, white, strict=True)
    ]
    signs = rng.choice(np.array([-1.0, 1.0]), size=(FLIPS + 1, len(logs)))
    signs[0] = 1.0
    rows: list[_Row] = []
    columns: list[FloatArray] = []
    largest: list[FloatArray] = []
    for values in (plain, white):
        table, groups = _features(logs, values)
        if not groups:
            return None
        squares = (signs @ table) ** 2 / (table**2).sum(axis=0)
        rows += groups
        columns += [squares[:, group.columns].sum(axis=1) for group in groups]
        largest.append(squares.max(axis=1))
    sums = np.column_stack(columns + largest)
    p_values = (sums.shape[0] - _ranks(sums)) / sums.shape[0]
    smallest = p_values.min(axis=1)
    strongest = int(np.argmin(p_values[0, : len(rows)]))
    strength = float(sums[0, strongest] / rows[strongest].columns.size)
    return strength, float((smallest <= smallest[0]).mean()), rows[strongest].words


def _ranks(values: FloatArray) -> FloatArray:
    """Values of the same column that are smaller; shape as given."""
    out = np.empty_like(values)
    for k in range(values.shape[1]):
        # equal values (the same exchange drawn twice) share the worst place
        column = np.round(values[:, k], 9)
        out[:, k] = np.searchsorted(np.sort(column), column, side="left")
    return np.asarray(out)


class _Projected(NamedTuple):
    """Whitened block means of all logs after the fit is projected away."""

    residual: FloatArray
    basis: FloatArray
    freedom: int
    roots: list[FloatArray]


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of the columns' span; columns of any scale."""
    norm = np.sqrt((columns**2).sum(axis=0))
    scaled = columns[:, norm > 0.0] / norm[norm > 0.0]
    if scaled.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _project(logs: Sequence[ResidualBlocks], noise: NoiseFit) -> _Projected:
    roots = [np.asarray(np.linalg.cholesky(block_covariance(one, noise)), dtype=np.float64) for one in logs]

    def whitened(name: str) -> list[FloatArray]:
        pairs = zip(logs, roots, strict=True)
        return [solve_triangular(root, getattr(one, name), lower=True) for one, root in pairs]

    basis = _orthonormal(np.hstack([block_diag(*whitened("own")), np.concatenate(whitened("shared"))]))
    value = np.concatenate(whitened("mean_N"))
    residual = value - basis @ (basis.T @ value)
    return _Projected(residual, basis, value.size - basis.shape[1], roots)


def _effective(logs: Sequence[ResidualBlocks], noise: NoiseFit) -> float:
    """Degrees of freedom of the noise's strength at long lags: half the effective samples under AR(1)."""
    total = 0.0
    for one in logs:
        n = float(one.count.sum())
        if _parts(noise)[1] > 0.0:
            n *= 0.5 * np.tanh(0.5 * _rate(noise) * one.step_s)
        total += n
    return max(total, 1.0)


def _within(projected: _Projected, effective: float) -> MisfitCheck:
    name = "within logs"
    if projected.freedom < 1:
        return MisfitCheck(name, 0.0, 1.0, "too few samples for a look at the residual within a log", False)
    ratio = float(projected.residual @ projected.residual) / projected.freedom
    p = float(stats.f.sf(ratio / SPECTRUM_TOLERANCE, projected.freedom, effective))
    times = f"{np.sqrt(ratio):.2f} times as much as the noise model explains"
    return MisfitCheck(name, ratio, p, f"block means of the residual scatter {times}", p < LEVELS[name])


def _directed(
    name: str,
    words: str,
    logs: Sequence[ResidualBlocks],
    projected: _Projected,
    masks: Sequence[NDArray[np.bool_]],
    effective: float,
) -> MisfitCheck:
    """Test the residual for one sign over the chosen blocks of all logs."""
    parts = [
        solve_triangular(root, mask.astype(np.float64), lower=True)
        for root, mask in zip(projected.roots, masks, strict=True)
    ]
    direction = np.concatenate(parts)
    direction -= projected.basis @ (projected.basis.T @ direction)
    norm = float(np.sqrt(direction @ direction))
    before = float(np.sqrt(sum(float(one @ one) for one in parts)))
    if not norm > 1e-6 * max(before, 1e-300):
        return MisfitCheck(name, 0.0, 1.0, f"nothing to see {words}", False)
    statistic = float(direction @ projected.residual) / norm
    p = float(2.0 * stats.t.sf(abs(statistic) / np.sqrt(SPECTRUM_TOLERANCE), effective))
    count = sum(int(one.count[mask].sum()) for one, mask in zip(logs, masks, strict=True))
    total = sum(float(one.count[mask] @ one.mean_N[mask]) for one, mask in zip(logs, masks, strict=True))
    off = f"{abs(total) / max(count, 1):.2g} N {'above' if total > 0.0 else 'below'} the model on average"
    message = f"{words} the force is {off} ({abs(statistic):.1f} standard errors)"
    return MisfitCheck(name, statistic, p, message, p < LEVELS[name])


def _early(one: ResidualBlocks) -> NDArray[np.bool_]:
    """Blocks of the first tenth of each hold's time, at least the first one."""
    mask = np.zeros(one.count.size, dtype=bool)
    for phase in np.unique(one.phase[one.hold]):
        inside = np.flatnonzero(one.hold & (one.phase == phase))
        start = one.start_s[inside[0]]
        early = one.end_s[inside] - start <= EARLY_SHARE * (one.end_s[inside[-1]] - start)
        early[0] = True
        mask[inside[early]] = True
    return mask


def misfit_alarm(logs: Sequence[ResidualBlocks], noise: NoiseFit) -> MisfitAlarm:
    """Look for structure in the residuals of a specimen at its optimum."""
    logs = [one for one in logs if one.count.size]
    if not logs or not noise.sigma_N > 0.0:
        return MisfitAlarm(raised=False)
    checks = []
    found = shared_structure(logs, noise, rng=np.random.default_rng(SEED))
    if found is not None:
        (statistic, p, words), name = found, "shared structure"
        where = f"the residual repeats from log to log, most in the {words}"
        message = f"{where}: mean squares are {statistic:.1f} times those of independent logs"
        checks.append(MisfitCheck(name, statistic, p, message, p < LEVELS[name]))
    if noise.discrepant:
        # misses within a log are in the intervals already
        return MisfitAlarm(raised=any(check.raised for check in checks), checks=tuple(checks))
    projected = _project(logs, noise)
    # what the fit has taken out is lost to the estimate of the noise as well
    effective = max(_effective(logs, noise) - projected.basis.shape[1], 1.0)
    checks.append(_within(projected, effective))
    early = [_early(one) for one in logs]
    start = [~one.hold & (one.place < START_PLACES) for one in logs]
    checks.append(_directed("early hold", "early in the holds", logs, projected, early, effective))
    checks.append(_directed("ramp start", "where ramps start", logs, projected, start, effective))
    return MisfitAlarm(raised=any(check.raised for check in checks), checks=tuple(checks))
