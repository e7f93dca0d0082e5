"""Start of a growing force: the posterior of the contact point on one loading ramp.

The slope right at contact depends on the rate, so no threshold and no straight line finds the contact at all
speeds: the whole shape of :mod:`tissueid.segment.ramp_shape` is compared with the ramp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.segment.ramp_shape import RampShape, bin_samples

# Contact and branch length make up for each other, so their posterior is a narrow ridge.  The lattice is
# sheared along it, and fits itself to mean, spread and tilt pass by pass.
Density = Callable[[FloatArray, FloatArray], FloatArray]
Limits = tuple[float, float]

#: Nodes of the lattice along each axis, and its half width in posterior standard deviations.
NODES = 13
REACH = 3.5
#: Nodes and half width of the last one, on which moments are taken.
LAST_NODES = (29, 19)
LAST_REACH = 4.5
#: Passes that fit the lattice to the posterior.
MAX_PASSES = 24
#: A lattice fits where its mean and spread, in its own units, lie within these.
CENTRED = 0.7
SPREAD = (0.6, 1.5)
#: A mean this far out on the lattice lies at its edge; the axis is widened by this factor then.
EDGE = 2.0
EDGE_ROOM = 6.0
#: A node lies at a limit, and so within it, that it misses by less than this share of the range: the first
#: lattice reaches from limit to limit, and rounding would decide whether its ends count.
AT_LIMIT = 1e-9
#: Where another mode is looked for, in sd of the first parameter, and by how much it must be higher.
PROBE = np.sinh(np.linspace(-5.3, 5.3, 29))
PROBE_GAIN = 2.0


@dataclass(frozen=True, slots=True)
class Lattice:
    """Nodes within the limits of both parameters."""

    first: FloatArray  # (n,)
    second: FloatArray  # (n, m), clipped to its limits
    inside: NDArray[np.bool_]  # (n, m)
    steps: FloatArray  # (n, m, 2), position in units of the lattice

    def mass(self, log_density: FloatArray) -> FloatArray:
        """Share of each node, shape (n, m), sum 1; nodes outside have none."""
        height = np.where(self.inside, log_density, -np.inf)
        share = np.exp(height - height.max())
        return np.asarray(share / share.sum())


def locate(
    density: Density, limits: tuple[Limits, Limits], guess: float, doubt: float, *, beside: float
) -> Lattice:
    """Fit a lattice to a posterior, whose mode may lie beside a place."""
    centre = np.array([guess, 0.5 * sum(limits[1])])
    shape = np.diag([max(doubt, 1e-300), 0.5 * (limits[1][1] - limits[1][0])]) / REACH
    for _ in range(MAX_PASSES):
        lattice = _lattice(centre, shape, limits, (NODES, NODES), REACH)
        log_density = density(lattice.first, lattice.second)
        mass = lattice.mass(log_density)
        middle = np.einsum("nm,nmk->k", mass, lattice.steps)
        off = lattice.steps - middle
        covariance = np.einsum("nm,nmj,nmk->jk", mass, off, off)
        spread = np.sqrt(np.diag(covariance))
        if (np.abs(middle) < CENTRED).all() and (spread > SPREAD[0]).all() and (spread < SPREAD[1]).all():
            # another mode, far off on the ridge?  Look along both axes before believing this one
            peak = float(log_density[lattice.inside].max())
            mean, sd = float(centre[0] + shape[0, 0] * middle[0]), float(shape[0, 0] * spread[0])
            other = _elsewhere(density, limits, np.append(mean + sd * PROBE, beside), peak)
            if other is None:
                break
            centre = other
            width = (limits[1][1] - limits[1][0]) / (NODES - 1)
            shape = np.diag([max(abs(float(other[0]) - mean), sd), width]) / REACH
            continue
        centre = centre + shape @ middle
        # one lattice spacing at least is kept, and a posterior that lies at the edge is given room
        covariance += np.diag(np.full(2, (1.2 * REACH / (NODES - 1)) ** 2))
        room = np.where(np.abs(middle) > EDGE, EDGE_ROOM, 1.0)
        shape = shape @ np.linalg.cholesky(covariance * np.outer(room, room))
    return _lattice(centre, shape, limits, LAST_NODES, LAST_REACH)


def _lattice(
    centre: FloatArray, shape: FloatArray, limits: tuple[Limits, Limits], nodes: tuple[int, int], reach: float
) -> Lattice:
    """Nodes around a centre along the columns of a lower triangular shape."""
    a, b = (np.linspace(-reach, reach, count) for count in nodes)
    first = centre[0] + shape[0, 0] * a
    kept = _within(first, limits[0])
    if not kept.any():
        nearest = np.array([np.clip(centre[0], *limits[0])])
        a, first = (nearest - centre[0]) / shape[0, 0], nearest
    else:
        a, first = a[kept], first[kept]
    second = centre[1] + shape[1, 0] * a[:, None] + shape[1, 1] * b
    inside = _within(second, limits[1])
    if not inside.any():
        inside = np.ones_like(inside)
    steps = np.stack(np.broadcast_arrays(a[:, None], b), axis=-1)
    return Lattice(first, np.clip(second, *limits[1]), inside, steps)


def _within(places: FloatArray, limits: Limits) -> NDArray[np.bool_]:
    """True where places lie within limits or at them."""
    rounding = AT_LIMIT * (limits[1] - limits[0])
    return (places >= limits[0] - rounding) & (places <= limits[1] + rounding)


def _elsewhere(
    density: Density, limits: tuple[Limits, Limits], first: FloatArray, peak: float
) -> FloatArray | None:
    """Place of a density clearly higher than the peak found, ``None`` if at none of the first parameters."""
    first = first[_within(first, limits[0])]
    if first.size == 0:
        return None
    second = np.linspace(*limits[1], NODES)
    height = density(first, np.broadcast_to(second, (first.size, NODES)))
    i, j = np.unravel_index(int(height.argmax()), height.shape)
    return np.array([first[i], second[j]]) if float(height[i, j]) > peak + PROBE_GAIN else None


#: Shortest branch length, in resolutions of the contact (no branch at all), and the longest as a share of
#: the window.
SHORTEST = 0.02
LONGEST = 0.3
#: A window is accepted where chi-square exceeds its degrees of freedom by at most so many of its sd.
ADEQUATE_SD = 3.0
#: ... and one that it describes in none is denied by a shorter one whose contact lies so many sd away.
DENIED_SD = 3.0
#: Shares of the ramp tried, longest first.
WINDOWS = (1.0, 0.5, 0.25, 0.12, 0.06)
#: Times the bins are laid anew around a better contact.
MAX_BINNINGS = 3
#: A tool that stood at the first sample has left it beyond this share of the travel: of a contact before the
#: record, the samples from there on tell.
STANDING_SHARE = 1e-3
#: Contact is looked for, and first guessed, up to so much before the end of the ramp, in shares of it.
LAST_CONTACT = 0.02
LEAST_WINDOW = 0.04
#: Fewest bins with tissue in a window.
FEWEST_BINS = 8
#: Share of the samples that count as degrees of freedom of the noise (efficiency of a median), those that a
#: curved ramp of few samples costs, and the fewest.
NOISE_EFFICIENCY = 0.37
NOISE_CURVATURE = 3.0
LEAST_FREEDOM = 2.0
#: The stated standard deviation is the half width of the 95 % interval over this.
NORMAL_95 = 1.959963984540054
#: A step over the sd of a place within it.
STEP = 12.0**0.5


@dataclass(frozen=True, slots=True)
class HingeFit:
    """Posterior of a contact point."""

    #: Mean [mm], and standard deviation of the normal distribution with the same 95 % interval [mm].
    contact_mm: float
    sd_mm: float
    baseline_N: float  # force in air [N]; 0 where it was held at 0
    slope_N_per_mm: float  # stiffness over the first part of the window [N/mm]
    adequate: bool  # whether the shape describes the window within its noise
    at_start: float  # density of a contact at the first sample, as a share of the highest
    #: Stiffness over a larger part, and the share of it that the branch has from the first sample on.
    secant_N_per_mm: float = 0.0
    relaxing_share: float = 0.0


def fit_contact(
    depth_mm: FloatArray,
    force_N: FloatArray,
    *,
    noise_N: float,
    baseline: bool,
    reach_back_mm: float,
    noise_samples: int,
    latest_mm: float = float("inf"),
) -> HingeFit:
    """Posterior mean and sd of the contact point on one loading ramp with what stands before it.

    ``baseline``: the load cell may read something in air, else it was tared; ``reach_back_mm``: how far
    before the first sample the contact may lie; ``noise_samples``: that told the noise; ``latest_mm``: where
    the force has left its reading in air for good.
    """
    start, end = float(depth_mm[0]), float(depth_mm.max())
    low, high = start - reach_back_mm, end
    leaves = start + STANDING_SHARE * (end - start)
    guess, slope = _rough(depth_mm, force_N, noise_N)
    # a force that rises at the very end only must still leave the shape a window
    guess = min(max(guess, low), high - LEAST_WINDOW * (high - low), latest_mm)
    limits = (low, min(high - LAST_CONTACT * (high - low), latest_mm))
    found: list[HingeFit] = []
    for share in WINDOWS:
        window = share * (end - max(guess, start))
        inside = depth_mm <= max(guess, start) + window
        u, f = depth_mm[inside], force_N[inside]
        fit: HingeFit | None = None
        for _ in range(MAX_BINNINGS):
            bins = bin_samples(u, f, centre_mm=max(guess, leaves), balance=(noise_N / slope) ** (2.0 / 3.0))
            if int((bins.depth_mm > guess).sum()) < FEWEST_BINS and (found or fit):
                break
            shape = RampShape(
                bins=bins,
                noise_N=noise_N,
                noise_freedom=max(NOISE_EFFICIENCY * noise_samples - NOISE_CURVATURE, LEAST_FREEDOM),
                window_mm=window,
                start_mm=start,
                slope_N_per_mm=slope,
                baseline=baseline,
            )
            fit, slope = _fit(shape, limits, guess)
            off = abs(fit.contact_mm - guess)
            guess = fit.contact_mm
            if off <= 0.5 * bins.fine_mm:
                break
        if fit is None:
            break
        if fit.adequate:
            return fit
        found.append(fit)
    return _least_wrong(found)


def _least_wrong(found: list[HingeFit]) -> HingeFit:
    """Of windows that no shape describes, the one with the smallest sd that no shorter one denies."""
    agreeing = [
        at
        for at, one in enumerate(found)
        if all(
            abs(one.contact_mm - other.contact_mm) <= DENIED_SD * np.hypot(one.sd_mm, other.sd_mm)
            for other in found[at + 1 :]
        )
    ]
    k = min(agreeing, key=lambda at: found[at].sd_mm)
    beside = found[min(k + 1, len(found) - 1)]
    apart = abs(found[k].contact_mm - beside.contact_mm)
    return replace(found[k], sd_mm=float(np.hypot(found[k].sd_mm, apart)))


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


def _fit(
    shape: RampShape, limits: tuple[float, float], guess: float, *, tempered: bool = False
) -> tuple[HingeFit, float]:
    """Posterior on one window, and the slope that the next one is judged by [N/mm]."""
    window = shape.window_mm
    longest = LONGEST * window
    shortest = min(SHORTEST * shape.resolution_mm, 0.1 * longest)
    lengths = (float(np.log(shortest)), float(np.log(longest)))
    lattice = locate(
        lambda contact, length: shape.posterior(contact, np.exp(length)).log_density,
        (limits, lengths),
        guess,
        max(0.5 * window, 1e-300),
        beside=shape.start_mm,
    )
    lengths_mm = np.exp(lattice.second)
    found = shape.posterior(lattice.first, lengths_mm)
    mass = lattice.mass(found.log_density)
    contact, share = lattice.first, mass.sum(axis=1)
    mean = float(share @ contact)
    low, high = np.interp([0.025, 0.975], np.cumsum(share) - 0.5 * share, contact)
    # the lattice ends within one row of a limit
    row = float(contact[1] - contact[0]) if contact.size > 1 else 0.0
    start = np.clip(shape.start_mm, contact[0], None) if shape.start_mm >= contact[0] - row else np.nan
    begins = float(np.interp(start, contact, share, right=0.0)) / float(share.max()) if row else 1.0
    freedom = shape.freedom
    excess = float(found.misfit[lattice.inside].min()) / freedom
    adequate = excess <= 1.0 + ADEQUATE_SD * float(np.sqrt(2.0 / freedom))
    sd = float(high - low) / (2.0 * NORMAL_95)
    if not adequate and not tempered:
        # of a noise as large as the misfit: the lattice need not resolve the density of one far below it
        misfit = replace(shape, noise_N=shape.noise_N * float(np.sqrt(excess)))
        # a misfit goes on from sample to sample: none of them places the contact within the step to the next
        sd = float(np.hypot(_fit(misfit, limits, mean, tempered=True)[0].sd_mm, shape.bins.spacing_mm / STEP))
    early, slope, relaxes = shape.slopes(found, mass, contact, lengths_mm)
    fit = HingeFit(
        contact_mm=mean,
        sd_mm=sd,
        baseline_N=float((mass * found.static_N[:, :, -1]).sum()) if shape.baseline else 0.0,
        slope_N_per_mm=early,
        adequate=adequate,
        at_start=begins if np.isfinite(begins) else 0.0,
        secant_N_per_mm=slope,
        relaxing_share=relaxes,
    )
    return fit, slope
