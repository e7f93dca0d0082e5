"""The posterior of one specimen: tissue, machine, noise and scatter between logs in one density.

What logs have for themselves is integrated, linearised about the optimum; of a single log the contact is a
coordinate, and linear parameters are drawn from their normal given all else, which is exact.  A branch's
stiffness is sampled times its largest state, so that its time moves alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.inference.channel_law import LARGEST_LN
from tissueid.inference.conditional import Conditional, Walls, conditional, holding
from tissueid.inference.engine import Identified
from tissueid.inference.law import relaxation_states
from tissueid.inference.noise import Memory, Whitener
from tissueid.inference.optimum import Optimum, covariance_of, nearest_inside, whitener_of
from tissueid.inference.prior import coordinate, own_precision, quantile, time_bounds
from tissueid.inference.ridges import SCATTERS, Ridges, ridges_of, straight_beyond
from tissueid.inference.system import MACHINE, SHAPE, Point

#: Points of ln tau at which the largest state is tabulated, and step of ln memory at which noise is whitened.
TAU_GRID, MEMORY_GRID = 48, 0.05
#: Negative slack of a constraint, relative to typical values, that counts as rounding.
ROUNDING = 1e-9
#: Step of numerical second derivatives of ln memory and ln scatter, and their bounds.
STEP, LEAST_CURVATURE, MOST_CURVATURE = 0.2, 1.0, 400.0
#: Share of the largest force below which own derivatives stay those of the optimum.
SLIGHT = 1e-3
#: Points along all logs, times vectors, of one evaluation.
PART = 131_072
#: Scale below which one is not undone.
LEAST_SCALE = 1e-3
#: Ln of the common scale beyond which the prior of gains lets none be.
MOST_SCALE = 30.0


class Target(Protocol):
    """A density in whitened coordinates, cut by half spaces, with the normal it is like."""

    centre: FloatArray
    rows: FloatArray
    walls: FloatArray
    likely: IntArray
    is_normal: bool  # it is that normal within the walls
    size: int  # coordinates

    def bent(self, z: FloatArray) -> FloatArray:
        """Points of that normal in the coordinates of :meth:`densities`, (n, d) -> (n, d)."""

    def densities(self, z: FloatArray) -> FloatArray:
        """Log densities of rows of points, (n, d) -> (n,)."""

    def walked(self, z: FloatArray) -> FloatArray:
        """The same, or with vectors of the points behind them, (n, 1 + size)."""


class SpecimenTarget:
    """Log posterior density of a specimen about the optimum of its law."""

    is_normal = False  # its tails and bends are its own

    def __init__(self, identified: Identified, *, machine: bool = True) -> None:
        self.identified = identified
        self.system, self.law = identified.system, identified.law
        self.optimum, self.priors = identified.optimum, identified.request.priors
        self.alone = len(self.system.logs) == 1
        self.force = float(np.abs(self.system.force).max())
        self._whiteners: dict[int, Whitener] = {}
        self._ln_tau = np.linspace(*time_bounds(self.system), TAU_GRID)
        path = self.system.path(self.system.travel)
        states = relaxation_states(path, path.depth_mm / self.system.depth_mm, np.exp(self._ln_tau))
        self._ln_state = np.log(np.maximum(np.abs(states).max(axis=1), 1e-12))
        priors = [self.priors.calibration[name] for name in MACHINE]
        #: Numbers and priors of the machine that its bounds cut: no normal, and quantiles of these.
        self._cut = {k: one for k, one in enumerate(priors) if math.isfinite(one.lower)}
        #: The machine is not bent by its priors, and linear parameters follow all else in proportion.
        self.straight = False
        parts = self.system.derivatives(self.optimum.point, machine=False, follow=True)
        self._own_at_optimum, self._force_at_optimum = parts.own.T, parts.force
        self._lay_out(machine)
        #: Linear parameters are drawn from their normal given all else.
        self.follows = self.alone
        self._whiten()

    def _lay_out(self, machine: bool) -> None:
        """Names, places and values at the optimum of the coordinates."""
        found, scatter, effects = self.optimum, self.identified.scatter, self.system.effects
        names = [f"ln_tau_{j + 1}" for j in range(self.law.counts[0])]
        names += [f"ln_{one.spec.name}" for one in self.law.shapes[len(names) :]]
        names += [*MACHINE, *(f"linear_{k + 1}" for k in range(self.law.linear))]
        values = list(found.point.shared)
        self.n_shared = len(names)
        self.places: dict[str, int] = {}

        def add(name: str, value: float) -> None:
            self.places[name] = len(names)
            names.append(name)
            values.append(value)

        if self.alone:
            add("contact", float(found.point.own[0, 0]))
        add("ln_sigma", float(np.log(found.noise.sigma_N)))
        if found.noise.memory.time_s > 0.0:
            add("ln_memory", float(np.log(found.noise.memory.time_s)))
        if effects.gain:
            add("ln_gain_sd", float(np.log(scatter.gain)))
        self.names, self.mode = tuple(names), np.array(values)
        self.free = np.ones(len(names), dtype=bool)
        at = np.arange(self.law.times, self.law.times + len(MACHINE))
        self.free[at] = machine
        self.size, self.open = int(self.free.sum()), machine
        #: Places of the machine, where it is open, and of what its bounds cut.
        self.machine_places = at[self.free[at]]
        self.cut_places = at[[k for k in self._cut if self.free[at[k]]]]
        # linear parameters of a single log come last, as they follow all else
        last = self.linear_places if self.alone else slice(0)
        rest = np.setdiff1d(np.flatnonzero(self.free), np.append(at, np.arange(self.mode.size)[last]))
        #: Places of all but the machine, in the order of whitened coordinates, and these among the free.
        self.still_places: list[int] = [*rest.tolist(), *range(self.mode.size)[last]]
        self.still = np.searchsorted(np.flatnonzero(self.free), self.still_places)
        typical = np.concatenate(
            [np.ones(self.law.times), np.full(len(MACHINE), 1e-3), np.full(self.law.linear, self.force)]
        )
        self._slack = -ROUNDING * (np.abs(found.prior.cone) @ typical)
        self.scale = self._scale() if "ln_gain_sd" in self.places else np.zeros(self.mode.size)

    @property
    def linear_places(self) -> slice:
        """Places of the law's linear parameters."""
        return slice(self.law.times + len(MACHINE), self.n_shared)

    def _scale(self) -> FloatArray:
        """Row that makes of a vector the common scale of its forces, 1 at the optimum, (size,)."""
        linear = self.linear_places
        columns, out = self.optimum.normal.shared[:, linear], np.zeros(self.mode.size)
        force = columns @ self.mode[linear]
        out[linear] = columns.T @ force / max(float(force @ force), 1e-300)
        return out

    @property
    def samples(self) -> int:
        """Observations that the scale of the noise is known from."""
        more = 0 if self.optimum.noise.memory.time_s > 0.0 else self.system.within_freedom
        return int(self.system.force.size + more)

    def _amplitudes(self, log_times: FloatArray) -> FloatArray:
        """Ln of each branch's largest state, against that at the optimum; (..., j)."""
        times = self.optimum.point.log_times[: self.law.counts[0]]
        then = np.interp(times, self._ln_tau, self._ln_state)
        return np.asarray(np.interp(log_times, self._ln_tau, self._ln_state) - then)

    def _scales(self, log_times: FloatArray) -> list[tuple[slice, FloatArray]]:
        """Linear parameters of each branch, and what its largest state makes of them, (...,)."""
        if not (self.law.relaxation.branches and self.law.counts[0]):
            return []
        scale = np.exp(-self._amplitudes(log_times[..., : self.law.counts[0]]))
        return [(one.at, scale[..., one.branch]) for one in self.law.blocks if one.branch >= 0]

    def shared(self, x: FloatArray) -> FloatArray:
        """Times, machine and linear parameters of the law at vectors, (..., size) -> (..., shared)."""
        return self._unscaled(x[..., : self.n_shared])

    def _unscaled(self, scaled: FloatArray) -> FloatArray:
        """Shared parameters with stiffness of each branch without its largest state."""
        out, linear = np.array(scaled), np.arange(self.linear_places.start, self.linear_places.stop)
        for at, scale in self._scales(scaled):
            out[..., linear[at]] *= scale[..., None]
        return out

    def point(self, x: FloatArray) -> Point:
        """Vectors -> point, or n of them; own parameters that are integrated stay at the optimum."""
        return self.optimum.point.moved(self.shared(x), self._own(x))

    def _own(self, x: FloatArray) -> FloatArray:
        """Own parameters of the logs: the contact of a single one moves, others stay at the optimum."""
        if "contact" in self.places:
            return np.asarray(x[..., self.places["contact"], None, None])
        return self.optimum.point.own

    def forces(self, x: FloatArray) -> FloatArray:
        """Observations near the optimum at vectors, (n, size) -> (n, k)."""
        return np.concatenate([self.system.near(self.point(part)) for part in self._parts(x)])

    def _parts(self, x: FloatArray) -> list[FloatArray]:
        """Vectors in parts whose forces stay in the processor's cache."""
        each = self.system.travel.size * (1 + self.law.linear * self.follows)
        size = max(PART // each, 1)
        return [x[i : i + size] for i in range(0, len(x), size)]

    def vectors(self, z: FloatArray) -> FloatArray:
        """Whitened points -> vectors, (n, d) -> (n, size)."""
        return self.following(self._spread(z), z)

    def _spread(self, z: FloatArray) -> FloatArray:
        """Vectors of whitened points, linear parameters that follow all else left where they are."""
        x = np.broadcast_to(self.mode, (*z.shape[:-1], self.mode.size)).copy()
        x[..., self.free] += (z if self.straight else self._straight(z)) @ self.root.T
        if self.straight:
            return x
        at, rest = self.machine_places, self.still_places
        for place, curve in self.ridges.quantiles.items():
            x[..., place] = straight_beyond(curve, z[..., at.size + rest.index(place)])[0]
        if self.ridges.widths is not None:
            wider = self.ridges.widths(self._scatter(x)) - self.root[self.still, at.size :]
            wider[..., [rest.index(place) for place in self.ridges.quantiles], :] = 0.0
            x[..., rest] += (wider @ z[..., at.size :, None])[..., 0]
        if self.ridges.ln_scale is not None:
            # the logarithm of a common scale is normal
            linear, found = self.linear_places, (x - self.mode) @ self.scale
            ln_scale = np.clip(found + self.ridges.ln_scale(self._scatter(x)), -MOST_SCALE, MOST_SCALE)
            unscaled = x[..., linear] - found[..., None] * self.mode[linear]
            x[..., linear] = unscaled * np.exp(ln_scale)[..., None]
        return x

    def _scatter(self, x: FloatArray) -> FloatArray:
        """Scatter of gains of vectors within what is tabulated, (..., size) -> (...,)."""
        return np.clip(x[..., self.places["ln_gain_sd"]], *SCATTERS[[0, -1]])

    def _followed(self, x: FloatArray, z: FloatArray) -> Iterator[tuple[FloatArray, Conditional, FloatArray]]:
        """Parts of vectors with linear parameters at the last coordinates of whitened points, ln volumes."""
        for part, own in zip(self._parts(x), self._parts(z[:, -self.law.linear :]), strict=True):
            given, out = self.conditional(part, self._walls_held), part.copy()
            out[:, self.linear_places], ln_volume = given.drawn(own)
            yield out, given, ln_volume

    def following(self, x: FloatArray, z: FloatArray) -> FloatArray:
        """Vectors (n, size) with linear parameters that follow them, at whitened points (n, d)."""
        return np.concatenate([one for one, *_ in self._followed(x, z)]) if self.follows else x

    def conditional(self, x: FloatArray, walls: Walls) -> Conditional:
        """Normal of a single log's linear parameters, within walls, at all else of vectors, (n, size)."""
        x, linear, prior = np.clip(x, *self._range), self.linear_places, self.optimum.prior
        x[:, linear] = 0.0
        shared = x[:, : self.n_shared]
        seen = self.system.near_parts(self.optimum.point.moved(shared, self._own(x)))
        for at, scale in self._scales(shared):
            seen[1:][at] *= scale[:, None]
        seen[0] = self.system.force - seen[0]
        white, log_det = self._whitened(x, seen)
        off = prior.target - shared @ prior.rows.T
        return conditional(white, log_det, prior.rows[:, linear], off, walls)

    @cached_property
    def _walls_held(self) -> Walls:
        """Rows of linear parameters (c, p) and values of the walls that hold the optimum."""
        prior, linear = self.optimum.prior, self.linear_places
        rows, least = prior.cone[:, linear], prior.least
        free = self.conditional(self.mode[None], (rows[:0], least[:0]))
        held = holding(free.factor[0], rows, rows @ self.mode[linear] - least)
        return rows[held], least[held]

    @cached_property
    def _range(self) -> FloatArray:
        """Ends of what each coordinate of a vector may be, (2, size)."""
        out = np.tile([[-np.inf], [np.inf]], self.mode.size)
        out[:, : self.law.times] = self.law.bounds(*time_bounds(self.system))
        for k, one in self._cut.items():
            out[0, self.law.times + k] = one.lower
        out[:, self.places["ln_sigma"]] = -LARGEST_LN, LARGEST_LN
        return out

    @cached_property
    def ridges(self) -> Ridges:
        """Curves along coordinates that are far from normal."""
        return ridges_of(self)

    def levels(self, x: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log densities of vectors, (n,), and these with linear parameters that follow, (n, size)."""
        if not self.follows:
            return self.density(x), x
        parts = [(self._density(one, given) + volume, one) for one, given, volume in self._followed(x, z)]
        return np.concatenate([level for level, _ in parts]), np.concatenate([one for _, one in parts])

    def _straight(self, z: FloatArray) -> FloatArray:
        """Points with the cut machine by quantiles of its prior -> whitened points, (..., d) -> (..., d).

        It comes first in whitened coordinates, and what follows it linearly goes with it.
        """
        at = self.cut_places
        if at.size == 0:
            return z
        out = np.array(z)
        values = [quantile(one, z[..., k]) for k, one in enumerate(self._cut.values())]
        off = np.stack(values, axis=-1) - self.mode[at]
        out[..., : at.size] = np.linalg.solve(self.root[at, : at.size], off[..., None])[..., 0]
        return out

    def bent(self, z: FloatArray) -> FloatArray:
        """Whitened points -> points with the cut machine as quantiles of its prior, (n, d) -> (n, d)."""
        out, x = np.array(z), self.mode[self.free] + z @ self.root.T
        for k, (at, one) in enumerate(zip(self.cut_places, self._cut.values(), strict=False)):
            out[:, k] = coordinate(one, x[:, at])
        return out

    def _bent(self, x: FloatArray) -> FloatArray:
        """Derivative of the law's parameters by the vector."""
        out, step = np.eye(len(x)), 1e-5
        own = slice(self.n_shared)
        sizes = step * np.maximum(np.abs(x[own]), 1.0)
        moved = np.tile(x, (self.n_shared, 1))
        moved[:, own] += np.diag(sizes)
        out[own, own] = (self.shared(moved) - self.shared(x)).T / sizes
        return out

    def curvature(self, optimum: Optimum) -> tuple[FloatArray, FloatArray]:
        """Hessian of the negative log density at an optimum, and the downhill gradient."""
        slope, normal, prior, s, n = self.slope, optimum.normal, optimum.prior, self.n_shared, len(self.mode)
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        if self.alone:
            off = prior.rows @ optimum.point.shared - prior.target
            hessian[:s, :s] = normal.shared.T @ normal.shared + prior.rows.T @ prior.rows
            gradient[:s] = normal.shared.T @ normal.residual - prior.rows.T @ off
            if "contact" in self.places:
                k = self.places["contact"]
                hessian[k, :s] = hessian[:s, k] = normal.cross[0, 0]
                hessian[k, k] = 1.0 / normal.own_inverse[0, 0, 0]
                gradient[k] = normal.own_gradient[0, 0]
        else:
            hessian[:s, :s], gradient[:s] = normal.hessian, normal.gradient
        hessian, gradient = slope.T @ hessian @ slope, slope.T @ gradient
        k = self.places["ln_sigma"]
        hessian[k, k] = 2.0 * self.samples
        for name in ("ln_memory", "ln_gain_sd"):
            if name in self.places:
                hessian[self.places[name], self.places[name]] = self._numeric_curvature(self.places[name])
        return hessian, gradient

    def _numeric_curvature(self, at: int) -> float:
        """Second derivative of the negative log density by one coordinate, bounded."""
        x = np.tile(self.mode, (3, 1))
        x[:, at] += (-STEP, 0.0, STEP)
        values = self.density(x)
        value = (2.0 * values[1] - values[0] - values[2]) / STEP**2
        return float(np.clip(value if np.isfinite(value) else 0.0, LEAST_CURVATURE, MOST_CURVATURE))

    def _whiten(self) -> None:
        """Coordinates whitened about the optimum; walls and the centre of the normal in them."""
        self.slope = self._bent(self.mode)
        hessian, gradient = self.curvature(self.optimum)
        self.precision = hessian[np.ix_(self.free, self.free)]
        covariance = covariance_of(self.precision)
        self.root = self.factor(covariance)
        prior = self.optimum.prior
        used = prior.least > -1e200
        rows = np.zeros((int(used.sum()), len(self.mode)))
        rows[:, : self.n_shared] = prior.cone[used]
        self.wall_rows, self.lowest = rows[:, self.free], covariance @ gradient[self.free]
        self.walls = np.minimum(prior.least[used] - rows @ self.mode, 0.0)
        # draws that follow stay behind the walls that hold, and others cut few
        root = np.zeros_like(self.root) if self.follows else self.root
        self.rows, self.centre = self.wall_rows @ root, root.T @ gradient[self.free]
        self.likely = self._likely(used)

    def factor(self, covariance: FloatArray) -> FloatArray:
        """Root of a covariance of the free coordinates, the machine first, and of that what is cut."""
        open_ends = np.setdiff1d(self.machine_places, self.cut_places)
        order = np.concatenate([self.cut_places, open_ends, self.still]).astype(np.int64)
        inner = covariance[np.ix_(order, order)]
        out = np.empty_like(inner)
        out[order] = np.linalg.cholesky(inner + 1e-14 * np.diag(np.diag(inner)))
        return np.asarray(out)

    def _likely(self, used: NDArray[np.bool_]) -> IntArray:
        """Constraints that may be active: ends and middle of polynomials, bounds of the machine."""
        first, rows = 0, []
        for one in self.law.blocks:
            size = len(self.law.passive(one))
            rows += [first, first + size - 1] if one.size > 1 else [first]
            rows += [first + size // 2] if one.size > 2 else []
            first += size
        rows += [len(used) - 2, len(used) - 1] if self.open else []
        at = np.cumsum(used) - 1
        return np.array([at[k] for k in rows if used[k]], dtype=np.int64)

    def _white(self, key: int) -> Whitener:
        """Whitening by the number of a step of ln memory."""
        if key not in self._whiteners:
            memory = self.optimum.noise.memory
            changed = replace(memory, time_s=float(np.exp(key * MEMORY_GRID)))
            memory = changed if "ln_memory" in self.places else Memory()
            self._whiteners[key] = whitener_of(self.system, memory)
        return self._whiteners[key]

    def _whitened(self, x: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Observations in units of the noise of each vector, (n, k, c), and ln determinants of it, (n,)."""
        keys = np.zeros(len(x), dtype=np.int64)
        if "ln_memory" in self.places:
            steps = np.round(x[:, self.places["ln_memory"]] / MEMORY_GRID)
            keys = np.clip(steps, -1000, 1000).astype(np.int64)
        out, log_det = np.empty(rows.shape), np.empty(len(x))
        c, _, k = rows.shape
        for key in np.unique(keys):
            mine, white = keys == key, self._white(int(key))
            out[:, mine] = white(rows[:, mine].reshape(-1, k).T).T.reshape(c, -1, k)
            log_det[mine] = white.log_det
        return out * np.exp(-x[:, self.places["ln_sigma"]])[None, :, None], log_det

    def _log_prior(self, x: FloatArray, shared: FloatArray) -> FloatArray:
        """Of shared parameters, scale, memory and scatter, (n,); minus infinity out of their bounds."""
        prior, places = self.optimum.prior, self.places
        off = shared @ prior.rows.T - prior.target
        value, ln_sigma = -0.5 * (off**2).sum(axis=1), x[:, places["ln_sigma"]]
        value += self.law.ln_volume(shared[:, : self.law.times], self.priors.linear)
        outside = np.abs(ln_sigma) > 60.0
        if self.priors.sigma_N is not None:
            stated = self.priors.sigma_N
            value -= 0.5 * ((ln_sigma - math.log(stated.median)) / stated.sd_ln) ** 2
        if "ln_gain_sd" in places:
            v = x[:, places["ln_gain_sd"]]
            outside |= (v <= -14.0) | (v >= 10.0)
            value += v - 0.5 * (np.exp(np.minimum(v, 10.0)) / self.priors.gain_sd) ** 2
            free = sum(name not in self.priors.linear for name in self.law.linear_names)
            value -= free * np.log(np.maximum(x @ self.scale, LEAST_SCALE))  # flat in ln of the common scale
        if "contact" in places:
            value -= 0.5 * float(prior.own[0, 0]) * x[:, places["contact"]] ** 2
        if "ln_memory" in places:
            low = np.log(0.1 * self.system.obs_step.min())
            high = np.log(100.0 * np.ptp(self.system.mid) + 1e-300)
            outside |= (x[:, places["ln_memory"]] <= low) | (x[:, places["ln_memory"]] >= high)
        return np.where(outside, -np.inf, value)

    def density(self, x: FloatArray) -> FloatArray:
        """Log densities of vectors up to a constant, (n, size) -> (n,); minus infinity where not passive."""
        return np.concatenate([self._density(part) for part in self._parts(x)])

    def _density(self, x: FloatArray, given: Conditional | None = None) -> FloatArray:
        """Log densities of some vectors, (n,); ``given``: the normal that their linear parameters follow."""
        shared, prior = x[:, : self.n_shared], self.optimum.prior
        out = self._log_prior(x, shared)
        out[(shared @ prior.cone.T - prior.least < self._slack).any(axis=1)] = -np.inf
        inside = np.flatnonzero(np.isfinite(out))
        if given is not None:
            left = given.residual - (x[:, None, self.linear_places] @ given.basis)[:, 0]
            out[inside] += self._of_noise(x, (left**2).sum(axis=1), given.log_det)[inside]
        elif inside.size:
            out[inside] += self._log_likelihood(x[inside], shared[inside])
        return out

    def _of_noise(self, x: FloatArray, square: FloatArray, log_det: FloatArray) -> FloatArray:
        """Log likelihoods of vectors from their squares in units of the noise, (n,)."""
        ln_sigma = x[:, self.places["ln_sigma"]]
        if "ln_memory" not in self.places:
            square = square + self.system.within_N2 * np.exp(-2.0 * ln_sigma)
        return np.asarray(-0.5 * square - self.samples * ln_sigma - 0.5 * log_det)

    def _log_likelihood(self, x: FloatArray, shared: FloatArray) -> FloatArray:
        """Log likelihoods of passive vectors, what is the logs' own integrated, (n,)."""
        point = self.optimum.point.moved(self._unscaled(shared), own := self._expected(x))
        integrated = not self.alone
        force = self.system.near(point)
        rows = (self.system.force - force)[None]
        white, log_det = self._whitened(x, np.concatenate([rows, self.by_own(force)]) if integrated else rows)
        value = self._of_noise(x, (white[0] ** 2).sum(axis=1), log_det)
        return value + self._integrated(x, own, white) if integrated else value

    def _expected(self, x: FloatArray) -> FloatArray:
        """Own parameters about which the logs' are integrated: they undo a common scale, and common times."""
        own = self._own(x)
        if "ln_gain_sd" not in self.places:
            return own
        own = np.repeat(own[None], len(x), axis=0)
        own[:, :, 0] -= np.log(np.maximum(x @ self.scale, LEAST_SCALE))[:, None]
        if self.system.effects.time and (times := self.law.counts[0]):
            own[:, :, self.system.effects.time_at] -= (x[:, :times] - self.mode[:times]).mean(axis=1)[:, None]
        return own

    def _integrated(self, x: FloatArray, own: FloatArray, white: FloatArray) -> FloatArray:
        """Term that integrating the logs' own parameters adds to log densities, (n,)."""
        gain = np.exp(x[:, self.places["ln_gain_sd"]]) if "ln_gain_sd" in self.places else np.ones(len(x))
        logs = len(self.system.logs)
        begins, columns, q = self.system.begins, white[1:], white.shape[0] - 1
        inner, right = np.empty((len(x), logs, q, q)), np.empty((len(x), logs, q))
        for i in range(q):
            right[:, :, i] = np.add.reduceat(columns[i] * white[0], begins, axis=1)
            for j in range(i + 1):
                product = np.add.reduceat(columns[i] * columns[j], begins, axis=1)
                inner[:, :, i, j] = inner[:, :, j, i] = product
        precision = np.broadcast_to(own_precision(self.system, self.identified.scatter), (len(x), logs, q))
        if self.system.effects.gain:
            precision = precision.copy()
            precision[:, :, 0] = (gain**-2)[:, None]
        pull = precision * own
        factor = np.asarray(np.linalg.cholesky(inner + precision[..., None] * np.eye(q)), dtype=np.float64)
        half = np.asarray(np.linalg.solve(factor, (right - pull)[..., None])[..., 0], dtype=np.float64)
        value = 0.5 * (half**2).sum(axis=(1, 2)) - 0.5 * (own * pull).sum(axis=(1, 2))
        value -= np.log(np.diagonal(factor, axis1=2, axis2=3)).sum(axis=(1, 2))
        if self.system.centred:
            value -= _of_mean(factor, half, self.optimum.point.own)
        return np.asarray(value + 0.5 * np.log(precision).sum(axis=(1, 2)))

    def by_own(self, force: FloatArray) -> FloatArray:
        """Derivatives by what is the logs' own, as at the optimum, (n, k) -> (q, n, k)."""
        out, then = self._own_at_optimum[:, None], self._force_at_optimum
        found = np.repeat(out, len(force), axis=1)
        share = np.divide(force, then, out=np.ones(force.shape), where=np.abs(then) > SLIGHT * self.force)
        for i in range(len(found)):
            if i != int(self.system.effects.gain):
                found[i] *= share
        return found

    def densities(self, z: FloatArray) -> FloatArray:
        """Log densities of points whose cut machine is given by quantiles, (n, d) -> (n,)."""
        return self.walked(z)[:, 0]

    def walked(self, z: FloatArray) -> FloatArray:
        """The same, and the points' vectors behind them, (n, d) -> (n, 1 + size)."""
        x = self._spread(z)
        out, vectors = self.levels(x, z)
        for k, (at, one) in enumerate(zip(self.cut_places, self._cut.values(), strict=False)):
            off = (x[:, at] - one.mean) / one.sd
            out += 0.5 * off**2 - 0.5 * z[:, k] ** 2
        if self.straight:
            return np.column_stack([out, vectors])
        rest, machine = self.still_places, len(self.machine_places)
        for place, curve in self.ridges.quantiles.items():
            out += straight_beyond(curve, z[:, machine + rest.index(place)])[1]
        if self.ridges.widths is not None:
            roots = np.diagonal(self.ridges.widths(self._scatter(x)), axis1=1, axis2=2)
            roots = np.delete(roots, [rest.index(k) for k in self.ridges.quantiles], axis=1)
            out += np.log(roots).sum(axis=1)
        if self.ridges.ln_scale is not None:
            out += self.law.linear * np.log(x @ self.scale)
        return np.column_stack([out, vectors])


class NormalTarget:
    """The generalised posterior: a normal about an optimum, brought into the passive set.

    Each draw is moved to the nearest passive point in its metric: the distribution of estimates at active
    bounds (Andrews 1999, doi 10.1111/1468-0262.00082). The root of ``base`` is replaced.
    """

    is_normal = True  # its walls are met after drawing

    def __init__(self, base: SpecimenTarget, covariance: FloatArray) -> None:
        root = base.factor(covariance)
        self.rows, self.walls, self.likely = base.wall_rows @ root, base.walls, base.likely
        self.centre: FloatArray = np.asarray(np.linalg.solve(root, base.lowest), dtype=np.float64)
        base.root, base.straight, base.follows = root, True, False
        self.machine, self.size = len(base.machine_places), base.size

    def bent(self, z: FloatArray) -> FloatArray:
        """The same points."""
        return z

    def densities(self, z: FloatArray) -> FloatArray:
        """Log densities of whitened points, walls apart, (n, d) -> (n,)."""
        return np.asarray(-0.5 * ((z - self.centre) ** 2).sum(axis=1))

    walked = densities

    def passive(self, z: FloatArray, held: int = 0) -> FloatArray:
        """Nearest points within the walls, (n, d) -> (n, d), the first ``held`` coordinates as they are."""
        rows, rest = self.rows[:, held:], z[:, held:]
        # one wall for all: held coordinates are the same in every point
        walls = self.walls - self.rows[:, :held] @ z[0, :held]
        inside = nearest_inside(rest, rows, walls)
        return np.hstack([z[:, :held], np.where(np.isfinite(inside), inside, 0.0)])

    def at_mean_machine(self, z: FloatArray, inside: FloatArray) -> FloatArray:
        """Points as drawn with the machine at the mean of those within the walls, moved inside."""
        out, machine = z.copy(), self.machine
        out[:, :machine] = inside[:, :machine].mean(axis=0)
        return self.passive(out, machine)


def _of_mean(factor: FloatArray, half: FloatArray, own: FloatArray) -> FloatArray:
    """Loss of log density by shapes of mean zero, (n,), from factors (n, logs, q, q) and whitened steps."""
    q = half.shape[-1]
    columns = np.linalg.solve(factor, np.broadcast_to(np.eye(q)[:, -SHAPE:], (*factor.shape[:-1], SHAPE)))
    loose = np.einsum("nlqa,nlqb->nab", columns, columns)
    off = np.einsum("nlqa,nlq->na", columns, half) + own[:, -SHAPE:].sum(axis=0)
    root = np.linalg.cholesky(loose)
    square = (np.linalg.solve(root, off[..., None])[..., 0] ** 2).sum(axis=1)
    return np.asarray(0.5 * square + np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1))
