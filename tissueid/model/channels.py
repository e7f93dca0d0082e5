"""Contact model of a static law and a stiffness with a relaxation law, or a damping.

    F(t) = F_s(x) + sum_j K_j(x) s_j,             s_j = int R_j(t - t') dx(t')       (outside)
    F(t) = F_s(x) + sum_j g_j int R_j(t - t') dF_s(x(t'))                             (inside: tangent)
    F(t) = F_s(x) (1 + chi r) >= 0,               r the speed over that at contact   (damped)

theta = static coefficients, shapes of the static law, then of each branch its stiffness coefficients (or the
ratio g) and the shapes of its relaxation, a sum of exponentials at fixed nodes (:class:`Nodes`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath, ParameterSpec, branch_suffix, stiffness_spec
from tissueid.model.law import DampingLaw, RelaxationLaw, Shape, StaticLaw, StiffnessLaw
from tissueid.model.states import branch_sensitivity, branch_states


def minimum_on_unit(q: FloatArray) -> FloatArray:
    """Smallest values on [0, 1] of polynomials of degree <= 2, (..., powers of u) -> (...)."""
    ends = np.minimum(q[..., 0], q.sum(axis=-1))
    if q.shape[-1] < 3:
        return np.asarray(ends)
    bent = q[..., 2] > 0.0
    vertex = np.clip(-q[..., 1] / (2.0 * np.where(bent, q[..., 2], 1.0)), 0.0, 1.0)
    turn = q[..., 0] + vertex * (q[..., 1] + vertex * q[..., 2])
    return np.asarray(np.where(bent, np.minimum(ends, turn), ends))


#: Nodes of a decade, reach of the nodes below the resolution and beyond the window, and a time that is none.
PER_DECADE, BELOW, BEYOND, FOREVER = 4, 30.0, 30.0, 1e6
#: Times of a decade at which a relaxation is looked at, and ridge of the projection.
TIMES_PER_DECADE, RIDGE = 16, 1e-13
#: Points of a ramp by which an inside channel is integrated, and step of derivatives.
RAMP_POINTS, STEP = 64, 6e-6
#: Depths between which a static law is a line where it is convolved along a ramp.
LOADING_POINTS = 201
#: Negative values of F_s/x or K up to this share of the largest coefficient are rounding.
PASSIVE_TOLERANCE = 1e-10
#: Depths at which uniqueness of the free surface is examined.
CONTACT_LOSS_GRID = 257
#: Depths at which the static law has to grow where it is convolved.
GROWING_POINTS = 65
#: Ratio of relaxing to static force, inside the convolution.
RATIO = Shape(
    ParameterSpec("relaxation_ratio", "g", "1", 1e-3, 1e3, "relaxing over static force of a sudden push"),
    (0.3, 2.0),
)


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Exponentials at fixed times for relaxations that are looked at from a resolution to a window."""

    tau_s: FloatArray  # (n,)
    time_s: FloatArray  # (t,), at which a relaxation is given
    project: FloatArray  # (n, t), from values at ``time_s`` to weights


@lru_cache(maxsize=16)
def nodes_for(resolution_s: float, window_s: float) -> Nodes:
    """Nodes for times from a fifth of the resolution to ten windows."""
    low, high = np.log10(resolution_s), np.log10(window_s)
    below, beyond = np.log10(BELOW), np.log10(BEYOND)
    count = int(np.ceil(PER_DECADE * (high + beyond - low + below))) + 1
    tau = np.append(np.logspace(low - below, high + beyond, count), FOREVER * window_s)
    span = high + 1.0 - low + np.log10(5.0)
    time = np.append(0.0, np.logspace(low - np.log10(5.0), high + 1.0, int(TIMES_PER_DECADE * span)))
    matrix = np.exp(-time[:, None] / tau)
    left, size, right = np.linalg.svd(matrix, full_matrices=False)
    project = (right.T * (size / (size**2 + RIDGE * size[0] ** 2))) @ left.T
    return Nodes(tau, time, project)


@dataclass(frozen=True, slots=True)
class Part:
    """One relaxing part of a model."""

    stiffness: slice  # its stiffness coefficients in theta; empty inside
    ratio: int | None  # place of g in theta, inside
    shapes: slice  # shapes of its relaxation in theta
    tau_s: float | None = None  # of a fixed exponential


@dataclass(frozen=True)
class ChannelModel:
    """Contact model by its parts."""

    static: StaticLaw
    stiffness_law: StiffnessLaw
    relaxation: RelaxationLaw
    depth_mm: float  # largest depth that it is claimed for
    resolution_s: float  # times between which relaxations are looked at
    window_s: float
    name: str = field(default="", compare=False)  # as it was asked for

    @property
    def inside(self) -> bool:
        """True where the static law itself is convolved."""
        return self.stiffness_law.powers == 0

    @property
    def outside(self) -> bool:
        """True where every stiffness K_j(x) stands outside the convolution."""
        return not self.inside

    @property
    def viscous(self) -> bool:
        """True of exponentials outside the convolution: K tau is the viscosity of each."""
        return bool(self.relaxation.branches) and self.outside

    @cached_property
    def nodes(self) -> Nodes:
        """Nodes of its relaxation."""
        return nodes_for(self.resolution_s, self.window_s)

    @cached_property
    def fixed_s(self) -> FloatArray:
        """Times of a discrete spectrum; none of other relaxations."""
        count = int(getattr(self.relaxation, "nodes", 0))
        return np.geomspace(self.resolution_s, self.window_s, count) if count else np.zeros(0)

    @property
    def branches(self) -> int:
        """Relaxing parts."""
        return max(self.relaxation.branches, self.fixed_s.size, 1)

    @cached_property
    def layout(self) -> tuple[ParameterSpec | Shape, ...]:
        """Parameters in the order of theta, those that the force is not linear in as shapes."""
        rows: list[ParameterSpec | Shape] = [*self.static.coefficients, *self.static.shapes]
        for j in range(self.branches):
            rows += [stiffness_spec(k, j) for k in range(self.stiffness_law.powers)]
            rows += [_numbered(RATIO, j)] if self.inside else []
            rows += [_numbered(one, j) for one in self.relaxation.shapes if not self.fixed_s.size]
        return tuple(rows)

    @cached_property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Parameters in the order of theta."""
        return tuple(one.spec if isinstance(one, Shape) else one for one in self.layout)

    @cached_property
    def shape_places(self) -> NDArray[np.int64]:
        """Places of the shapes in theta."""
        return np.array([k for k, one in enumerate(self.layout) if isinstance(one, Shape)], dtype=np.int64)

    @cached_property
    def time_places(self) -> NDArray[np.int64]:
        """Places of the relaxation times in theta."""
        names = self.parameter_names
        return np.array(
            [k for k in self.shape_places if names[k].startswith("relaxation_time")], dtype=np.int64
        )

    @cached_property
    def linear_places(self) -> NDArray[np.int64]:
        """Places of the linear parameters in theta."""
        return np.setdiff1d(np.arange(len(self.parameters)), self.shape_places)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Relaxing parts."""
        at, out = len(self.static.coefficients) + len(self.static.shapes), []
        shapes = 0 if self.fixed_s.size else len(self.relaxation.shapes)
        for j in range(self.branches):
            size = self.stiffness_law.powers
            ratio = at if self.inside else None
            last = at + size + int(self.inside)
            tau = float(self.fixed_s[j]) if self.fixed_s.size else None
            out.append(Part(slice(at, at + size), ratio, slice(last, last + shapes), tau))
            at = last + shapes
        return tuple(out)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of theta."""
        return tuple(spec.name for spec in self.parameters)

    def _whole(self, theta: FloatArray) -> FloatArray:
        """Theta, refused where it has another length."""
        if np.shape(theta) != (len(self.parameters),):
            raise ValueError(f"theta has shape {np.shape(theta)}, ({len(self.parameters)},) is needed")
        return np.asarray(theta, dtype=np.float64)

    def _static_parts(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients and shapes of the static law."""
        count = len(self.static.coefficients)
        return theta[:count], theta[count : count + len(self.static.shapes)]

    def static_force(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """F_s [N] at depths within the identified range."""
        linear, shapes = self._static_parts(theta)
        x = np.asarray(depth_mm, dtype=np.float64)
        if self.static.polynomial:
            return np.asarray(x * np.polynomial.polynomial.polyval(x, linear))
        # a path in contact may begin a rounding, or its noise, above the surface
        return np.asarray(linear @ self.static.basis(np.maximum(x, 0.0), *shapes))

    def static_slope(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """F_s' [N/mm]."""
        linear, shapes = self._static_parts(theta)
        return np.asarray(linear @ self.static.slope(np.asarray(depth_mm, dtype=np.float64), *shapes))

    @property
    def block(self) -> int:
        """Parameters of a branch of exponentials outside the convolution: stiffness and time."""
        return self.stiffness_law.powers + 1

    def split(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Static parameters, stiffness coefficients (branches, powers), tau (branches,), of a viscous law."""
        theta = self._whole(theta)
        first = len(self.parameters) - self.branches * self.block
        branch = theta[first:].reshape(self.branches, self.block)
        return theta[:first], branch[:, :-1], branch[:, -1]

    def join(self, static: FloatArray, stiffness: FloatArray, tau: FloatArray) -> FloatArray:
        """Theta from its parts, branches sorted by tau; inverse of :meth:`split`."""
        order = np.argsort(tau, kind="stable")
        branch = np.column_stack([np.asarray(stiffness)[order], np.asarray(tau)[order]])
        return np.concatenate([np.asarray(static, dtype=np.float64), branch.ravel()])

    def exponentials(self, theta: FloatArray, part: Part) -> tuple[FloatArray, FloatArray]:
        """Weights and times of a part's relaxation, (n,) each."""
        if part.tau_s is not None:
            return np.ones(1), np.array([part.tau_s])
        shapes = theta[part.shapes]
        if self.relaxation.branches:
            return np.ones(1), shapes[:1]
        return self.nodes.project @ self.relaxation.value(self.nodes.time_s, *shapes), self.nodes.tau_s

    def stiffness(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """Stiffness that relaxes after a small sudden move at depths, (branches, n) [N/mm]."""
        x = np.asarray(depth_mm, dtype=np.float64)
        if self.outside:
            powers = x[None, :] ** np.arange(self.stiffness_law.powers)[:, None]
            rows = np.array([theta[part.stiffness] for part in self.parts])
            return np.asarray(rows.reshape(len(self.parts), len(powers)) @ powers)
        slope = self.static_slope(theta, x)
        return np.array([theta[part.ratio] * slope for part in self.parts])

    @property
    def stiffness_degree(self) -> int:
        """Degree of K; 0 inside."""
        return max(self.stiffness_law.powers - 1, 0)

    def times(self, theta: FloatArray) -> FloatArray:
        """Relaxation time of each relaxing part [s], (branches,)."""
        return np.array([theta[p.shapes][0] if p.tau_s is None else p.tau_s for p in self.parts])

    def contact_loss_is_unique(self, theta: FloatArray) -> bool:
        """True where a viscous tissue that was let go has one force-free surface at every state.

        Demands ``(F_s / K)' > -1`` on [0, depth_mm] with K the sum over branches (derived for one
        branch); otherwise the surface may jump while it recovers, although it stays passive.
        """
        if not self.viscous:
            return bool(np.isfinite(theta).all())
        x = np.linspace(0.0, self.depth_mm, CONTACT_LOSS_GRID)
        total = self.stiffness(theta, x).sum(axis=0)
        powers = np.arange(1.0, self.stiffness_law.powers)
        rate = sum((theta[part.stiffness][1:] for part in self.parts), np.zeros(powers.size)) * powers
        rise = rate @ x[None, :] ** (powers[:, None] - 1.0)
        slope = self.static_slope(theta, x)
        return bool((slope * total - self.static_force(theta, x) * rise + total**2 >= 0.0).all())

    def modes(
        self, theta: FloatArray, depth_mm: float, amplitude_mm: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Stiffness [N/mm] and time [s] of every exponential for a cycle about a depth, (n,) each."""
        sizes = self.stiffness(theta, np.array([depth_mm]))[:, 0]
        if self.stiffness_law.powers > 2:
            sizes = sizes + np.array([theta[p.stiffness][2] for p in self.parts]) * amplitude_mm**2 / 4.0
        found = [self.exponentials(theta, part) for part in self.parts]
        weights = [size * one[0] for size, one in zip(sizes, found, strict=True)]
        return np.concatenate(weights), np.concatenate([one[1] for one in found])

    def relaxing(
        self, theta: FloatArray, depth_mm: float, time_s: FloatArray, speed_mm_s: float | None
    ) -> FloatArray:
        """Relaxing force at times after a ramp to a depth, or after an ideal step, (n,) -> (n,) [N]."""
        time = np.asarray(time_s, dtype=np.float64)
        if self.outside:
            stiffness, tau = self.modes(theta, depth_mm)
            state = np.full(tau.size, depth_mm)
            if speed_mm_s is not None:
                length = speed_mm_s * tau
                state = -length * np.expm1(-depth_mm / length)
            return np.asarray((stiffness * state) @ np.exp(-time / tau[:, None]))
        at, weight = np.polynomial.legendre.leggauss(RAMP_POINTS)
        deep = 0.5 * depth_mm * (at + 1.0)
        pushed = 0.5 * depth_mm * weight * self.stiffness(theta, deep)
        total = np.zeros(time.shape)
        for part, sudden in zip(self.parts, pushed, strict=True):
            weights, tau = self.exponentials(theta, part)
            left = np.ones((tau.size, RAMP_POINTS))
            if speed_mm_s is not None:
                left = np.exp(-(depth_mm - deep) / (speed_mm_s * tau[:, None]))
            total += (weights * (left @ sudden)) @ np.exp(-time / tau[:, None])
        return total

    def loading(self, theta: FloatArray, depth_mm: FloatArray, speed_mm_s: float | FloatArray) -> FloatArray:
        """Relaxing force at ascending depths reached at constant speed from rest, (n,) -> (n,) [N].

        Depths need not ascend where each has a speed of its own.
        """
        x = np.asarray(depth_mm, dtype=np.float64)
        if self.outside:
            states = np.zeros((len(self.parts), x.size))
            for j, part in enumerate(self.parts):
                weights, tau = self.exponentials(theta, part)
                length = speed_mm_s * tau[:, None]
                states[j] = -weights @ (length * np.expm1(-x[None, :] / length))
            return np.asarray((self.stiffness(theta, x) * states).sum(axis=0))
        if isinstance(speed_mm_s, np.ndarray):
            each = zip(x[:, None], speed_mm_s.tolist(), strict=True)
            return np.concatenate([self.loading(theta, depth, speed) for depth, speed in each])
        fine = np.union1d(np.linspace(0.0, float(x.max()), LOADING_POINTS), x)
        force = self.force(theta, ContactPath(fine / speed_mm_s, fine)) - self.static_force(theta, fine)
        return np.asarray(force[np.searchsorted(fine, x)])

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path in permanent contact, within the identified depth."""
        theta, x = self._whole(theta), path.depth_mm
        elastic = self.static_force(theta, x)
        factors = self.stiffness(theta, x) if self.outside else np.array([theta[p.ratio] for p in self.parts])
        relaxing = np.zeros(x.size)
        for part, factor in zip(self.parts, factors, strict=True):
            weights, tau = self.exponentials(theta, part)
            driver = x if self.outside else elastic
            relaxing = relaxing + factor * (weights @ branch_states(path.time_s, driver, tau))
        return np.asarray(elastic + relaxing)

    def jacobian(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Derivative of :meth:`force` by theta, shape (n, p); by central differences unless viscous."""
        if self.viscous and self.static.polynomial:
            return self._viscous_jacobian(theta, path)
        columns = []
        for k, value in enumerate(theta):
            step = STEP * max(abs(float(value)), 1e-3)
            up, down = theta.copy(), theta.copy()
            up[k] += step
            down[k] -= step
            columns.append((self.force(up, path) - self.force(down, path)) / (2.0 * step))
        return np.column_stack(columns)

    def _viscous_jacobian(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """The derivative of polynomials and exponentials, exactly."""
        theta, x = self._whole(theta), path.depth_mm
        columns = list(self.static.basis(x))
        stiffness = self.stiffness(theta, x)
        for branch, tau in enumerate(self.times(theta)):
            state, by_tau = branch_sensitivity(path.time_s, x, float(tau))
            columns += [state * x**k for k in range(self.stiffness_law.powers)]
            columns.append(stiffness[branch] * by_tau)
        return np.column_stack(columns)

    def follow(
        self, theta: FloatArray, time_s: FloatArray, tool_mm: FloatArray, *, relaxing: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Surface [mm] and force [N] of exponentials that a tool may leave, every K_j times ``relaxing``."""
        # compiled: what needs no surface needs no compiler
        from tissueid.model.kernels import surface_path

        static, stiffness, tau = self.split(theta)
        return surface_path(
            np.concatenate([[0.0], static]),
            np.ascontiguousarray(relaxing * stiffness),
            np.ascontiguousarray(tau),
            self.depth_mm,
            time_s,
            np.ascontiguousarray(tool_mm),
        )

    def is_passive(self, theta: FloatArray) -> bool:
        """F_s >= 0 and K >= 0 on [0, depth_mm], shapes positive, F_s growing where it is convolved."""
        return bool(self.passive(self._whole(theta)[None])[0])

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True for rows of theta, (n, p), that :meth:`is_passive` holds of, (n,)."""
        count, powers = len(self.static.coefficients), np.arange(float(max(theta.shape[1], 3)))
        good = np.asarray(np.isfinite(theta).all(axis=1))
        good &= (theta[:, self.shape_places] > 0.0).all(axis=1)
        blocks = [(part.stiffness, np.ones(1)) for part in self.parts if part.ratio is None]
        if self.static.polynomial:
            # of its slope where it is convolved, else of F_s / x
            blocks.append((slice(0, count), 1.0 + powers[:count] if self.inside else np.ones(1)))
        else:
            good &= (theta[:, :count] >= 0.0).all(axis=1)
        rows = np.where(good[:, None], theta, 0.0)
        for at, times in blocks:
            q = rows[:, at] * self.depth_mm ** powers[: at.stop - at.start] * times
            good &= minimum_on_unit(q) >= -PASSIVE_TOLERANCE * np.abs(q).max(axis=1, initial=0.0)
        if self.inside and not self.static.polynomial:
            grid = np.linspace(0.0, self.depth_mm, GROWING_POINTS)
            for k in np.flatnonzero(good):
                slope = self.static_slope(theta[k], grid)
                good[k] = slope.min() >= -PASSIVE_TOLERANCE * np.abs(slope).max()
        return np.asarray(good)


class ElasticModel(ChannelModel):
    """A static law alone: nothing relaxes."""

    @property
    def branches(self) -> int:
        """No relaxing parts."""
        return 0

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """No relaxing parts."""
        return ()


def loading_force(
    model: ChannelModel, theta: FloatArray, depth_mm: FloatArray, *, speed_mm_s: float | FloatArray
) -> FloatArray:
    """Force at depths reached at constant speed from rest, one for all or one each, (n,) -> (n,) [N]."""
    x = np.asarray(depth_mm, dtype=np.float64)
    return np.asarray(model.static_force(theta, x) + model.loading(theta, x, speed_mm_s))


def _numbered(shape: Shape, branch: int) -> Shape:
    """A shape of a branch."""
    if branch == 0:
        return shape
    spec = replace(
        shape.spec,
        name=shape.spec.name + branch_suffix(branch),
        symbol=f"{shape.spec.symbol}{branch + 1}",
        meaning=f"{shape.spec.meaning} of branch {branch + 1}",
    )
    return replace(shape, spec=spec)


#: Share of a bound within which a parameter lies on it.
ROUNDING = 1e-9


class DampedModel(ElasticModel):
    """Contact model of a static and a damping law."""

    @cached_property
    def layout(self) -> tuple[ParameterSpec | Shape, ...]:
        """Parameters of the static law, then that of the damping."""
        return (*self.static.coefficients, *self.static.shapes, self.damping.shape)

    @property
    def damping(self) -> DampingLaw:
        """Law of its damping, whose parameter is the last of theta."""
        return cast("DampingLaw", self.relaxation)

    def factor(self, theta: FloatArray) -> float:
        """Damping factor chi."""
        return float(self.damping.factor(theta[-1]))

    def loading_stiffness(self, theta: FloatArray) -> float:
        """First static coefficient times 1 + chi: all that records at one speed ratio determine."""
        return float(theta[0]) * (1.0 + self.factor(theta))

    def stiffness(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:  # noqa: ARG002
        """No stiffness relaxes, (0, n)."""
        return np.zeros((0, np.size(depth_mm)))

    def modes(
        self,
        theta: FloatArray,  # noqa: ARG002
        depth_mm: float,  # noqa: ARG002
        amplitude_mm: float = 0.0,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray]:
        """One that is not a number: a cycle in lasting contact has no speed at which it began."""
        return np.full(1, np.nan), np.ones(1)

    def relaxing(
        self, theta: FloatArray, depth_mm: float, time_s: FloatArray, speed_mm_s: float | None
    ) -> FloatArray:
        """Damping force at the end of a ramp, none once the tool stands still, (n,) -> (n,) [N]."""
        moving = self.loading(theta, np.array([depth_mm]), speed_mm_s or 1.0)[0]
        return np.where(np.asarray(time_s) > 0.0, 0.0, moving)

    def loading(
        self,
        theta: FloatArray,
        depth_mm: FloatArray,
        speed_mm_s: float | FloatArray,  # noqa: ARG002
    ) -> FloatArray:
        """Force beyond the static one at the speed of the contact, (n,) -> (n,) [N]."""
        return np.asarray(self.factor(theta) * self.static_force(theta, depth_mm))

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path, shape (n,)."""
        damped = np.maximum(1.0 + self.factor(theta) * path_ratio(path), 0.0)
        return np.asarray(self.static_force(theta, np.maximum(path.depth_mm, 0.0)) * damped)

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True of rows with F_s >= 0 and growing, chi >= 0: then no loop gives energy, (n, p) -> (n,)."""
        spec, last = self.damping.shape.spec, theta[:, -1]
        inside = (last >= spec.lower * (1.0 - ROUNDING)) & (last <= spec.upper * (1.0 + ROUNDING))
        return np.asarray(inside & super().passive(theta))


def path_ratio(path: ContactPath) -> FloatArray:
    """Speed over the speed at which the contact of each sample began, within +-1; 0 in air, shape (n,)."""
    if path.speed_ratio is not None:
        return np.asarray(path.speed_ratio)
    speed, touching = _piecewise_speed(path.time_s, path.depth_mm), path.depth_mm > 0.0
    begins = np.flatnonzero(touching & ~np.append(False, touching[:-1]))
    begun = np.searchsorted(begins, np.arange(speed.size), side="right") - 1
    at_contact = np.append(speed[begins], 0.0)[begun]
    inside = touching & (at_contact > 0.0)
    ratio = np.divide(speed, at_contact, out=np.zeros(speed.size), where=inside)
    return np.asarray(np.clip(ratio, -1.0, 1.0))


def _piecewise_speed(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed of the straight piece that ends at each sample [mm/s]; the first has that of the second."""
    step = np.diff(time)
    moved = step > 0.0
    rate = np.divide(np.diff(depth), step, out=np.zeros(step.size), where=moved)
    # a step without time has the speed of the one before it
    last = np.maximum.accumulate(np.where(moved, np.arange(step.size), -1))
    rate = np.where(last >= 0, rate[np.maximum(last, 0)], 0.0)
    return np.concatenate([rate[:1], rate])
