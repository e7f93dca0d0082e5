"""Where a force begins to grow: the posterior of the contact point on one loading ramp.

The force at displacement u of a tool that meets relaxed tissue at c and moves on at constant speed is

    F = b + p1 z + p2 z^2 + p3 z^3 + A (1 - exp(-w/l)),   z = max(0, u - c),  w = max(0, u - max(c, u0)),

a cubic static curve and one relaxing branch (l = speed x relaxation time); u0 is where the record starts.
That branch is why the slope right at contact depends on the rate, and why no threshold and no straight line
finds the contact at all speeds.  b, p and A are linear: they are integrated out in closed form for each
(c, l) of a lattice, l is averaged over evenly in log, and what is left is the posterior of c; its mean and
standard deviation carry what the unknown shape adds.  Stiffness at contact and of the branch are taken as
positive.  Samples are averaged in bins that are fine near the contact.  The ramp is shortened until the
shape describes it within its noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["HingeFit", "fit_contact"]

FloatArray = NDArray[np.float64]

#: Prior standard deviation of the shape's coefficients, in force ranges of the window.
SHAPE_PRIOR = 10.0
#: Range of branch lengths, as shares of the window; the shortest is no branch at all.
BRANCH_RANGE = (1e-4, 0.5)
#: Nodes of the lattice along each axis, and its half width in posterior standard deviations.
LATTICE = 13
LATTICE_REACH = 3.5
#: Passes that fit the lattice to the posterior.
MAX_PASSES = 24
#: A mean this far out on the lattice lies at its edge; the axis is widened by this factor then.
EDGE = 2.0
EDGE_ROOM = 6.0
#: Where another mode is looked for, in posterior sd of the contact, and by how much it must be higher.
PROBE = np.sinh(np.linspace(-5.3, 5.3, 15))
PROBE_GAIN = 2.0
#: Part of the window over which the stiffness at contact is quoted.
EARLY_SHARE = 0.02
#: Bins of equal width next to the contact, on each side, and the growth of those further out.
NEAR_BINS = 24
BIN_GROWTH = 1.25
#: A window is accepted where chi-square exceeds its degrees of freedom by at most so many of its sd.
ADEQUATE_SD = 3.0
#: A window is given up early where chi-square per degree of freedom is above this after so many passes.
HOPELESS_EXCESS = 4.0
HOPELESS_PASSES = 5
#: Shares of the ramp tried, longest first.
WINDOWS = (1.0, 0.5, 0.25, 0.12, 0.06)
#: Fewer samples in contact do not say where between two samples it was.
FEW_SAMPLES = 20
#: Times the bins are laid anew around a better contact.
MAX_BINNINGS = 3
#: Contact is looked for, and first guessed, up to so much before the end of the ramp, in shares of it.
LAST_CONTACT = 0.02
LEAST_WINDOW = 0.04
#: Fewest bins with tissue in a window.
FEWEST_BINS = 8


@dataclass(frozen=True, slots=True)
class HingeFit:
    """Posterior of a contact point.

    Attributes
    ----------
    contact_mm, sd_mm : float
        Mean and standard deviation [mm].
    baseline_N, baseline_sd_N : float
        Force in air and its standard deviation [N]; 0 where it was held at 0.
    slope_N_per_mm : float
        Stiffness over the first part of the window [N/mm].
    adequate : bool
        Whether the shape describes the window within its noise.
    excess : float
        Chi-square of the best shape over its degrees of freedom.
    """

    contact_mm: float
    sd_mm: float
    baseline_N: float
    baseline_sd_N: float
    slope_N_per_mm: float
    adequate: bool
    excess: float


@dataclass(frozen=True, slots=True)
class _Binned:
    """Bin means, the variance of depth within each bin [mm2], and the samples in it."""

    depth_mm: FloatArray
    variance_mm2: FloatArray
    force_N: FloatArray
    count: FloatArray


def fit_contact(
    depth_mm: FloatArray, force_N: FloatArray, *, noise_N: float, baseline: bool, reach_back_mm: float
) -> HingeFit:
    """Posterior mean and standard deviation of the contact point.

    Parameters
    ----------
    depth_mm, force_N : ndarray, shape (n,)
        One loading ramp from its start, with what stands before it; both grow into the tissue.
    noise_N : float
        Standard deviation of the force noise, > 0.
    baseline : bool
        Whether the load cell may read something in air.  ``False`` (a record that starts in contact)
        takes it as tared.
    reach_back_mm : float
        How far before the first sample the contact may lie [mm]; 0 with a baseline.

    Returns
    -------
    HingeFit
    """
    start, end = float(depth_mm[0]), float(depth_mm.max())
    low, high = start - reach_back_mm, end
    guess, slope = _rough(depth_mm, force_N, noise_N)
    # a force that rises at the very end only must still leave the shape a window
    guess = min(max(guess, low), high - LEAST_WINDOW * (high - low))
    best: HingeFit | None = None
    for share in WINDOWS:
        window = share * (end - max(guess, start))
        inside = depth_mm <= max(guess, start) + window
        u, f = depth_mm[inside], force_N[inside]
        for _ in range(MAX_BINNINGS):
            binned, fine_mm = _bin(u, f, centre=guess, balance=(noise_N / slope) ** (2.0 / 3.0))
            if int((binned.depth_mm > guess).sum()) < FEWEST_BINS and best is not None:
                return best
            best = _centre(binned, noise_N, (low, high), (guess, window), start=start, baseline=baseline)
            off = abs(best.contact_mm - guess)
            guess, slope = best.contact_mm, best.slope_N_per_mm
            if off <= 0.5 * fine_mm:
                break
        if best is not None and best.adequate:
            break
    assert best is not None  # noqa: S101  (the first window always fits)
    touching = depth_mm[depth_mm > best.contact_mm]
    if touching.size < FEW_SAMPLES:
        # hardly more samples than coefficients: the shape between two samples is anyone's guess
        spacing = float(np.ptp(depth_mm)) / max(depth_mm.size - 1, 1)
        best = replace(best, sd_mm=float(np.hypot(best.sd_mm, spacing / np.sqrt(12.0))))
    return best


def _rough(depth_mm: FloatArray, force_N: FloatArray, noise_N: float) -> tuple[float, float]:
    """First guess of contact and slope: where the last of the falling stretch of the averaged force ends."""
    size = max(1, depth_mm.size // 256)
    whole = depth_mm.size // size * size
    u = depth_mm[:whole].reshape(-1, size).mean(axis=1)
    f = force_N[:whole].reshape(-1, size).mean(axis=1)
    first = f[: max(1, f.size // 20)].mean()
    above = f - first > 4.0 * noise_N / np.sqrt(size) + 0.01 * float(np.ptp(f))
    below = np.flatnonzero(~above)
    at = min(int(below[-1]) if below.size else 0, u.size - 2) if u.size > 1 else 0
    rest = max(float(u[-1] - u[at]), 1e-300)
    slope = max(float(f[-1] - f[at]) / rest, noise_N / rest)
    return float(u[at]), slope


def _bin(
    depth_mm: FloatArray, force_N: FloatArray, *, centre: float, balance: float
) -> tuple[_Binned, float]:
    """Average samples in bins along the record: narrow around a centre, growing away from it.

    Returns the bins, and how far from the centre they are narrow [mm].
    """
    n = depth_mm.size
    at = int(np.searchsorted(np.maximum.accumulate(depth_mm), centre))
    step = max(float(np.ptp(depth_mm)) / max(n - 1, 1), 1e-300)
    # sd of a bin mean falls as 1/sqrt(m), what it blurs grows as m: balance at m^(3/2) = noise/(slope step)
    width = max(1, int(balance / step ** (2.0 / 3.0)))
    width = min(width, max(1, n // (4 * NEAR_BINS)))
    growing = np.full(NEAR_BINS, float(width))
    while growing.sum() < n:
        growing = np.append(growing, growing[-1] * BIN_GROWTH)
    side = np.unique(np.concatenate([[0.0], np.cumsum(growing)]).round()).astype(int)
    edges = np.unique(np.clip(np.concatenate([at - side, at + side, [0, n]]), 0, n))[:-1]
    count = np.diff(np.append(edges, n)).astype(float)
    mean = np.add.reduceat(depth_mm, edges) / count
    off = depth_mm - np.repeat(mean, count.astype(int))
    variance = np.add.reduceat(off * off, edges) / count
    binned = _Binned(mean, variance, np.add.reduceat(force_N, edges) / count, count)
    return binned, NEAR_BINS * width * step


def _centre(
    binned: _Binned,
    noise_N: float,
    bounds: tuple[float, float],
    guess: tuple[float, float],
    *,
    start: float,
    baseline: bool,
) -> HingeFit:
    """Fit a lattice over (contact, log length) to the posterior: mean, spread and tilt, pass by pass.

    Contact and branch length make up for each other, so the posterior is a narrow ridge; the lattice is laid
    along its axes.
    """
    (low, high), (contact, window) = bounds, guess
    shortest, longest = (float(np.log(share * window)) for share in BRANCH_RANGE)
    limits = (low, high - LAST_CONTACT * (high - low)), (shortest, longest)
    axis = np.linspace(-LATTICE_REACH, LATTICE_REACH, LATTICE)
    unit = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    centre = np.array([contact, 0.5 * (shortest + longest)])
    shape = np.diag([max(0.5 * window, 1e-12), 0.5 * (longest - shortest)]) / LATTICE_REACH
    fit: HingeFit | None = None
    for passes in range(MAX_PASSES):
        nodes = centre + unit @ shape.T
        inside = ((nodes[:, 0] >= limits[0][0]) & (nodes[:, 0] <= limits[0][1])) & (
            (nodes[:, 1] >= limits[1][0]) & (nodes[:, 1] <= limits[1][1])
        )
        if not inside.any():
            break
        fit, mass, peak = _posterior(
            binned, noise_N, nodes[inside], window=window, start=start, baseline=baseline
        )
        kept = unit[inside]
        middle = mass @ kept
        covariance = (kept - middle).T @ ((kept - middle) * mass[:, None])
        spread = np.sqrt(np.diag(covariance))
        if (np.abs(middle) < 0.7).all() and (spread > 0.6).all() and (spread < 1.5).all():
            # another mode, far off on the ridge?  Look along both axes before believing this one
            around = fit.contact_mm + fit.sd_mm * PROBE
            lengths = np.linspace(shortest, longest, LATTICE)
            probe = np.stack(np.meshgrid(around, lengths, indexing="ij"), axis=-1).reshape(-1, 2)
            probe = probe[(probe[:, 0] >= limits[0][0]) & (probe[:, 0] <= limits[0][1])]
            _, other, height = _posterior(
                binned, noise_N, probe, window=window, start=start, baseline=baseline
            )
            if height <= peak + PROBE_GAIN:
                break
            centre = probe[int(other.argmax())]
            reach = max(abs(centre[0] - fit.contact_mm), fit.sd_mm)
            shape = np.diag([reach, lengths[1] - lengths[0]]) / LATTICE_REACH
            continue
        if passes >= HOPELESS_PASSES and fit.excess > HOPELESS_EXCESS:
            break
        centre = centre + shape @ middle
        # one lattice spacing at least is kept, and a posterior that lies at the edge is given room
        covariance += np.diag(np.full(2, (0.6 * (axis[1] - axis[0])) ** 2))
        room = np.where(np.abs(middle) > EDGE, EDGE_ROOM, 1.0)
        shape = shape @ np.linalg.cholesky(covariance * np.outer(room, room))
    assert fit is not None  # noqa: S101  (the guess lies inside)
    return fit


def _posterior(
    binned: _Binned,
    noise_N: float,
    nodes: FloatArray,
    *,
    window: float,
    start: float,
    baseline: bool,
) -> tuple[HingeFit, FloatArray, float]:
    """Posterior over nodes (contact, log length), its mass at each, and the highest log density."""
    contact, lengths = nodes[:, :1], np.exp(nodes[:, 1:])
    u = binned.depth_mm
    z = np.maximum(u - contact, 0.0) / window
    # means over a bin of z^2, z^3 and the exponential, from the mean and variance of depth in it
    within = np.where(z > 0.0, binned.variance_mm2 / window**2, 0.0)
    w = np.maximum(u - np.maximum(contact, start), 0.0)
    # A = K l: the prior is on the stiffness K of the branch, of the size of the static one
    blur = np.where(w > 0.0, np.minimum(0.5 * binned.variance_mm2 / lengths**2, 1.0), 0.0)
    rise = -(np.expm1(-w / lengths) + blur * np.exp(-w / lengths)) * (lengths / window)
    columns = [z, z * z + within, z**3 + 3.0 * z * within, rise]
    scale = SHAPE_PRIOR * max(float(np.ptp(binned.force_N)), noise_N)
    prior = [scale] * 4
    if baseline:
        columns.append(np.ones_like(z))
        prior.append(1e3 * scale)
    weight = np.sqrt(binned.count) / noise_N
    design = np.stack(columns, axis=-1) * (weight[:, None] * np.array(prior))
    target = binned.force_N * weight
    gram = design.swapaxes(-1, -2) @ design + np.eye(len(prior))
    moment = target @ design
    covariance = np.linalg.inv(gram)
    solved = np.einsum("njk,nk->nj", covariance, moment)
    log_density = 0.5 * np.einsum("nk,nk->n", solved, moment) - 0.5 * np.linalg.slogdet(gram)[1]
    # stiffness at contact and of the branch are positive: the mass of the half spaces
    for positive in (0, 3):
        log_density += _log_normal_mass(solved[:, positive] / np.sqrt(covariance[:, positive, positive]))
    peak = float(log_density.max())
    mass = np.exp(log_density - peak)
    mass /= mass.sum()
    mean = float(mass @ nodes[:, 0])
    spread = float(np.sqrt(mass @ (nodes[:, 0] - mean) ** 2))
    best = int(mass.argmax())
    residual = target - design[best] @ solved[best]
    freedom = max(target.size - len(prior) - 2, 1)
    excess = float(residual @ residual) / freedom
    coefficients = mass @ (solved * np.array(prior))
    early = min(EARLY_SHARE * window, float(np.ptp(u)))
    length = float(np.exp(mass @ nodes[:, 1]))
    slope = coefficients[0] / window + coefficients[3] * -np.expm1(-early / length) * length / window / early
    air = max(float(binned.count[u < mean].sum()), 1.0)
    fit = HingeFit(
        contact_mm=mean,
        sd_mm=spread * float(np.sqrt(max(excess, 1.0))),
        baseline_N=float(coefficients[-1]) if baseline else 0.0,
        baseline_sd_N=noise_N / float(np.sqrt(air)) if baseline else 0.0,
        slope_N_per_mm=max(float(slope), 1e-3 * float(np.ptp(binned.force_N)) / window),
        adequate=excess <= 1.0 + ADEQUATE_SD * np.sqrt(2.0 / freedom),
        excess=excess,
    )
    return fit, mass, peak


def _log_normal_mass(x: FloatArray) -> FloatArray:
    """Logarithm of the standard normal distribution function (tanh form, error of the function 3e-4)."""
    x = np.maximum(x, -8.0)
    argument: FloatArray = -2.0 * np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3)
    return -np.log1p(np.exp(argument))
