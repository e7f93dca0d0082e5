"""The yardstick: what any passive law of depth and time could reach on a recording; no law to quote.

Nonlinear superposition (doi 10.1016/0022-5096(68)90016-1), ``F = G_0(x) + sum_j int exp(-(t - t') / tau_j)
dG_j(x(t')) + sum_k K_k(x) s_k`` with increasing G_j (Bernstein integrals of degree 4) inside the convolution
and K_k >= 0 (degree 2) outside it, both passive (docs/model.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath, ParameterSpec, branch_suffix
from tissueid.model.channels import ChannelModel, Part
from tissueid.model.law import About, Shape
from tissueid.model.laws.relaxation import Prony
from tissueid.model.laws.stiffness import Quadratic
from tissueid.model.states import branch_states

YARDSTICK = "yardstick"
#: Increasing curves inside the convolution, and Bernstein polynomials of the present depth outside it.
INSIDE, OUTSIDE = 4, 3


@lru_cache
def _increments() -> FloatArray:
    """Powers of u, constant first, of curves from 0 to 1 whose non-negative sums are what increases."""
    return np.array([_bernstein(INSIDE)[first:].sum(axis=0) for first in range(1, INSIDE + 1)])


@lru_cache
def _bernstein(degree: int) -> FloatArray:
    """Powers of u of the Bernstein polynomials of a degree, (degree + 1, degree + 1)."""
    rows = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        for i in range(degree - k + 1):
            rows[k, k + i] = comb(degree, k) * comb(degree - k, i) * (-1.0) ** i
    return rows


def presents(u: FloatArray) -> FloatArray:
    """Bernstein polynomials of the present depth, (...) -> (OUTSIDE, ...)."""
    return np.array([polyval(u, row) for row in _bernstein(OUTSIDE - 1)])


@dataclass(frozen=True, slots=True)
class Increasing:
    """Increasing curve of depth, by non-negative parts of degree :data:`INSIDE`."""

    depth_mm: float
    about: ClassVar[About] = About(
        "increasing", "static", "G = sum_i g_i I_i(x / depth)", "10.1016/0022-5096(68)90016-1", "", ""
    )
    polynomial: ClassVar[bool] = False
    shapes: ClassVar[tuple[Shape, ...]] = ()

    @property
    def coefficients(self) -> tuple[ParameterSpec, ...]:
        """Force of each part at the largest depth."""
        return tuple(
            ParameterSpec(f"curve_{i + 1}_N", f"g{i + 1}", "N", 0.0, np.inf, "part of the static curve")
            for i in range(INSIDE)
        )

    def basis(self, depth_mm: FloatArray, *_: Any) -> FloatArray:
        """Parts, each from 0 to 1 at the largest depth."""
        u = np.asarray(depth_mm) / self.depth_mm
        return np.array([polyval(u, row) for row in _increments()])

    def slope(self, depth_mm: FloatArray, *_: Any) -> FloatArray:
        """Their derivatives [1/mm]."""
        u = np.asarray(depth_mm) / self.depth_mm
        return np.array([polyval(u, polyder(row)) for row in _increments()]) / self.depth_mm


@dataclass(frozen=True)
class Yardstick(ChannelModel):
    """Curves of depth at nodes of time, inside the convolution and outside it."""

    inside_s: tuple[float, ...] = ()  # nodes
    outside_s: tuple[float, ...] = ()

    @cached_property
    def fixed_s(self) -> FloatArray:
        """Nodes, inside first."""
        return np.array([*self.inside_s, *self.outside_s])

    @property
    def branches(self) -> int:
        """Nodes."""
        return len(self.inside_s) + len(self.outside_s)

    @property
    def outside(self) -> bool:
        """False: curves stand on both sides of the convolution."""
        return False

    @property
    def stiffness_degree(self) -> int:
        """Degree of K(x)."""
        return OUTSIDE - 1

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Nodes with the places of their coefficients."""
        at, out = INSIDE, []
        for j, tau in enumerate(self.fixed_s.tolist()):
            size = INSIDE if j < len(self.inside_s) else OUTSIDE
            out.append(Part(slice(at, at + size), None, slice(at + size, at + size), tau))
            at += size
        return tuple(out)

    @cached_property
    def layout(self) -> tuple[ParameterSpec | Shape, ...]:
        """Parts of the static curve, then of each node."""
        specs: list[ParameterSpec | Shape] = [*self.static.coefficients]
        for j, tau in enumerate(self.fixed_s.tolist()):
            if j < len(self.inside_s):
                rows = [("inside", i + 1, "N", "") for i in range(INSIDE)]
            else:
                rows = [("outside", i, "N/mm", "_per_mm") for i in range(OUTSIDE)]
            specs += [
                ParameterSpec(
                    f"{kind}_{i}_N{suffix}{branch_suffix(j)}", f"{kind[0]}{i}_{j + 1}", unit, 0.0, np.inf,
                    f"part {kind} the convolution at {tau:.3g} s",
                )
                for kind, i, unit, suffix in rows
            ]  # fmt: skip
        return tuple(specs)

    def curves(self, theta: FloatArray, branch: int) -> tuple[FloatArray, FloatArray]:
        """Driver of a node and the stiffness beside it, by powers of x, constant first: (5,) and (3,)."""
        own, stiffness = np.zeros(INSIDE + 1), np.zeros(OUTSIDE)
        weights = theta[self.parts[branch].stiffness]
        if branch < len(self.inside_s):
            own[:] = (weights @ _increments()) / self.depth_mm ** np.arange(INSIDE + 1.0)
            stiffness[0] = 1.0
        else:
            own[1] = 1.0
            stiffness[:] = (weights @ _bernstein(OUTSIDE - 1)) / self.depth_mm ** np.arange(float(OUTSIDE))
        return own, stiffness

    def stiffness(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """Stiffness that relaxes after a small sudden move at depths, (branches, n) [N/mm]."""
        x = np.asarray(depth_mm, dtype=np.float64)
        found = [self.curves(theta, j) for j in range(self.branches)]
        rows = [polyval(x, polyder(own)) * polyval(x, stiffness) for own, stiffness in found]
        return np.array(rows).reshape(self.branches, *x.shape)

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path in permanent contact, within the identified depth."""
        x = path.depth_mm
        total = self.static_force(theta, x)
        for j in range(self.branches):
            own, stiffness = self.curves(theta, j)
            follows = np.asarray(polyval(x, own), dtype=np.float64)
            state = branch_states(path.time_s, follows, self.fixed_s[j : j + 1])[0]
            total = total + polyval(x, stiffness) * state
        return np.asarray(total)

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True of rows without a negative weight, (n, p) -> (n,)."""
        return np.asarray((np.isfinite(theta) & (theta >= 0.0)).all(axis=1))


def yardstick_of(depth_mm: float, inside_s: tuple[float, ...], outside_s: tuple[float, ...]) -> Yardstick:
    """The yardstick with nodes at these times."""
    nodes = [*inside_s, *outside_s, 1.0]
    return Yardstick(
        static=Increasing(depth_mm),
        stiffness_law=Quadratic(),
        relaxation=Prony(),
        depth_mm=depth_mm,
        resolution_s=min(nodes),
        window_s=max(nodes),
        name=YARDSTICK,
        inside_s=inside_s,
        outside_s=outside_s,
    )
