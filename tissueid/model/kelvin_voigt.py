"""Modified Kelvin-Voigt contact model with one to three relaxation branches.

::

    F(t) = F_s(x) + sum_j K_j(x) s_j,      tau_j ds_j/dt + s_j = tau_j dx/dt
    F_s(x) = a1 x + a2 x^2 + a3 x^3,       K_j(x) = b_j0 + b_j1 x + b_j2 x^2

The stiffness stands **outside** the convolution, K(x(t)) times the state; quasi-linear
viscoelasticity has it inside, and the two differ as soon as K varies.  Equations (1) to (8) of
Sadeghnejad et al. (endoscopic sinus surgery), reconstructed from their text because the typeset
equations are lost; the model goes back to Mahvash & Dupont, doi 10.1109/ROBOT.2009.5152617.

theta = (a1, a2, a3, then for each branch by ascending tau: b_j0 [, b_j1 [, b_j2]], tau_j).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import (
    ContactPath,
    ParameterSpec,
    Stepper,
    branch_suffix,
    static_spec,
    stiffness_spec,
)
from tissueid.model.kernels import (
    LAW_SIZE,
    STATE_SIZE,
    branch_sensitivity,
    branch_state,
    pack_law,
    tissue_step_in,
)
from tissueid.model.polynomial import MAX_DEGREE, minimum_on_unit

KEY = "kelvin-voigt"
STATIC_DEGREE = 3
MAX_BRANCHES = 3
#: Depths at which uniqueness of the free surface is examined.
CONTACT_LOSS_GRID = 257
#: Negative values of F_s/x or K up to this fraction of the largest coefficient are rounding.
PASSIVE_TOLERANCE = 1e-10


def _time_spec(branch: int) -> ParameterSpec:
    return ParameterSpec(
        name=f"relaxation_time_s{branch_suffix(branch)}",
        symbol="tau" if branch == 0 else f"tau{branch + 1}",
        unit="s",
        lower=0.0,
        upper=np.inf,
        meaning=f"relaxation time of branch {branch + 1}",
    )


@dataclass(frozen=True, slots=True)
class KelvinVoigt:
    """The model for a given number of branches, degree of K and largest depth."""

    branches: int  # 0 (elastic) to 3
    stiffness_degree: int  # degree of each K_j(x), 0 to 2
    #: Largest identified depth [mm]: passivity is demanded on [0, depth_mm] and the law is continued beyond
    #: it (F_s with its end slope, not below 0; K linearly where it grows, else constant).
    depth_mm: float

    def __post_init__(self) -> None:
        if not 0 <= self.branches <= MAX_BRANCHES:
            msg = f"{self.branches} branches are not offered, 0 to {MAX_BRANCHES} are"
            raise ValueError(msg)
        if not 0 <= self.stiffness_degree <= MAX_DEGREE:
            msg = f"degree {self.stiffness_degree} of K is not offered, 0 to {MAX_DEGREE} are"
            raise ValueError(msg)
        if not self.depth_mm > 0.0:
            msg = f"depth_mm must be positive, is {self.depth_mm}"
            raise ValueError(msg)

    @property
    def key(self) -> str:
        """Registry key."""
        return KEY

    @property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Parameters in the order of theta."""
        specs = [static_spec(power) for power in range(1, STATIC_DEGREE + 1)]
        for branch in range(self.branches):
            specs += [stiffness_spec(power, branch) for power in range(self.stiffness_degree + 1)]
            specs.append(_time_spec(branch))
        return tuple(specs)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of theta."""
        return tuple(spec.name for spec in self.parameters)

    @property
    def block(self) -> int:
        """Parameters a branch has."""
        return self.stiffness_degree + 2

    def split(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Static coefficients (3,), stiffness coefficients (branches, degree + 1), tau (branches,)."""
        theta = np.asarray(theta, dtype=np.float64)
        expected = STATIC_DEGREE + self.branches * self.block
        if theta.shape != (expected,):
            msg = f"theta has shape {theta.shape}, ({expected},) is needed"
            raise ValueError(msg)
        branch = theta[STATIC_DEGREE:].reshape(self.branches, self.block)
        return theta[:STATIC_DEGREE], branch[:, :-1], branch[:, -1]

    def join(self, static: FloatArray, stiffness: FloatArray, tau: FloatArray) -> FloatArray:
        """Theta from its parts, branches sorted by tau; inverse of :meth:`split`."""
        order = np.argsort(tau, kind="stable")
        branch = np.column_stack([np.asarray(stiffness)[order], np.asarray(tau)[order]])
        return np.concatenate([np.asarray(static, dtype=np.float64), branch.ravel()])

    def static_force(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """F_s [N] at depths within the identified range."""
        static, _, _ = self.split(theta)
        x = np.asarray(depth_mm)
        return np.asarray(x * (static[0] + x * (static[1] + x * static[2])))

    def stiffness(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """K_j(x) [N/mm] at depths within the identified range, shape (branches, n)."""
        _, stiffness, _ = self.split(theta)
        powers = np.asarray(depth_mm)[None, :] ** np.arange(self.stiffness_degree + 1)[:, None]
        return np.asarray(stiffness @ powers)

    def static_slope(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """F_s' [N/mm]."""
        static, _, _ = self.split(theta)
        x = np.asarray(depth_mm)
        return np.asarray(static[0] + x * (2.0 * static[1] + 3.0 * x * static[2]))

    def times(self, theta: FloatArray) -> FloatArray:
        """Relaxation time of each branch [s], (branches,)."""
        return self.split(theta)[2]

    def modes(
        self, theta: FloatArray, depth_mm: float, amplitude_mm: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Stiffness [N/mm] and time [s] of every exponential for a cycle about a depth, (branches,) each."""
        _, coefficients, tau = self.split(theta)
        curved = coefficients[:, 2] if coefficients.shape[1] > 2 else np.zeros(tau.size)
        return self.stiffness(theta, np.array([depth_mm]))[:, 0] + curved * amplitude_mm**2 / 4.0, tau

    def relaxing(
        self, theta: FloatArray, depth_mm: float, time_s: FloatArray, speed_mm_s: float | None
    ) -> FloatArray:
        """Relaxing force at times after a ramp to a depth, or after an ideal step, (n,) -> (n,) [N]."""
        stiffness, tau = self.modes(theta, depth_mm)
        state = np.full(tau.size, depth_mm)
        if speed_mm_s is not None:
            length = speed_mm_s * tau
            state = -length * np.expm1(-depth_mm / length)
        return np.asarray((stiffness * state) @ np.exp(-np.asarray(time_s) / tau[:, None]))

    def loading(self, theta: FloatArray, depth_mm: FloatArray, speed_mm_s: float) -> FloatArray:
        """Relaxing force at depths reached at constant speed from rest, (n,) -> (n,) [N]."""
        _, _, tau = self.split(theta)
        x = np.asarray(depth_mm)
        length = speed_mm_s * tau[:, None]
        states = -length * np.expm1(-x[None, :] / length)
        return np.asarray((self.stiffness(theta, x) * states).sum(axis=0))

    def states(self, tau: FloatArray, path: ContactPath) -> FloatArray:
        """Branch states [mm] from rest, shape (branches, n)."""
        if len(tau) == 0:
            return np.zeros((0, path.time_s.size))
        return np.stack([branch_state(path.time_s, path.depth_mm, float(value), 0.0) for value in tau])

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path in permanent contact, within the identified depth."""
        _, _, tau = self.split(theta)
        dynamic = (self.stiffness(theta, path.depth_mm) * self.states(tau, path)).sum(axis=0)
        return np.asarray(self.static_force(theta, path.depth_mm) + dynamic)

    def jacobian(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Derivative of :meth:`force` by theta, shape (n, p)."""
        _, _, tau = self.split(theta)
        stiffness = self.stiffness(theta, path.depth_mm)
        x = path.depth_mm
        columns = [x, x**2, x**3]
        for branch in range(self.branches):
            state, by_tau = branch_sensitivity(path.time_s, x, float(tau[branch]))
            columns += [state * x**k for k in range(self.stiffness_degree + 1)]
            columns.append(stiffness[branch] * by_tau)
        return np.column_stack(columns)

    def linear_basis(self, nonlinear: FloatArray, path: ContactPath) -> FloatArray:
        """Columns of the linear parameters for given log relaxation times.

        ``nonlinear`` (branches,): ln(tau_j / s).  Returns (n, 3 + branches * (degree + 1)).
        """
        x = path.depth_mm
        columns = [x, x**2, x**3]
        for state in self.states(np.exp(nonlinear), path):
            columns += [state * x**k for k in range(self.stiffness_degree + 1)]
        return np.column_stack(columns)

    def is_passive(self, theta: FloatArray) -> bool:
        """F_s >= 0 and every K_j >= 0 on [0, depth_mm], and every tau > 0 (exact, see model.md 1.3)."""
        static, stiffness, tau = self.split(theta)
        if not np.isfinite(theta).all() or (tau <= 0.0).any():
            return False
        for coefficients in (static, *stiffness):
            q = coefficients * self.depth_mm ** np.arange(coefficients.size)
            if minimum_on_unit(q) < -PASSIVE_TOLERANCE * np.abs(q).max(initial=0.0):
                return False
        return True

    def contact_loss_is_unique(self, theta: FloatArray) -> bool:
        """True where a tissue that was let go has one force-free surface at every state.

        Demands ``(F_s / K)' > -1`` on [0, depth_mm] with K the sum over branches (model.md 1.2, derived
        for one branch); otherwise the surface may jump while it recovers, although it stays passive.
        """
        static, stiffness, _ = self.split(theta)
        x = np.linspace(0.0, self.depth_mm, CONTACT_LOSS_GRID)
        slope = static[0] + x * (2.0 * static[1] + 3.0 * x * static[2])
        powers = np.arange(1.0, self.stiffness_degree + 1)
        total = self.stiffness(theta, x).sum(axis=0)
        rate = (stiffness[:, 1:].sum(axis=0) * powers) @ (x[None, :] ** (powers[:, None] - 1.0))
        return bool((slope * total - self.static_force(theta, x) * rate + total**2 >= 0.0).all())

    def stepper(self, theta: FloatArray) -> Stepper:
        """A running copy that starts at rest."""
        return TissueStepper(self, theta)


class TissueStepper:
    """The tissue under a moving tool: pushes, lets go, recovers, is pushed again.

    ``theta`` (p,): must be passive.
    """

    def __init__(self, model: KelvinVoigt, theta: FloatArray) -> None:
        if not model.is_passive(theta):
            msg = "theta is not passive (F_s or K negative somewhere): it can't be rendered"
            raise ValueError(msg)
        static, stiffness, tau = model.split(theta)
        self._law = np.empty(LAW_SIZE)
        pack_law(
            np.concatenate([[0.0], static]),
            np.array(stiffness),
            np.array(tau),
            model.depth_mm,
            self._law,
            0,
        )
        self._state = np.zeros(STATE_SIZE)

    @property
    def surface_mm(self) -> float:
        """Level of the tissue surface [mm below its rest level]."""
        return float(self._state[0])

    def step(self, depth_mm: float, dt_s: float) -> float:
        """Force [N], never negative, after ``dt_s`` s of linear motion to ``depth_mm`` (< 0: in air)."""
        return float(tissue_step_in(self._law, 0, self._state, 0, depth_mm, dt_s))

    def reset(self) -> None:
        """Tissue at rest."""
        self._state[:] = 0.0


def constant_speed_force(
    model: KelvinVoigt, theta: FloatArray, depth_mm: FloatArray, *, speed_mm_s: float
) -> FloatArray:
    """Closed form (7): force at depths reached at constant speed from rest.

    ``F = F_s(x) + sum_j K_j(x) v tau_j (1 - exp(-x / (v tau_j)))``.
    """
    return model.static_force(theta, depth_mm) + model.loading(theta, depth_mm, speed_mm_s)


def ramp_hold_state(time_s: FloatArray, *, speed_mm_s: float, depth_mm: float, tau_s: float) -> FloatArray:
    """Closed form of the branch state in a ramp to ``depth_mm`` followed by a hold [mm]."""
    corner = depth_mm / speed_mm_s
    time = np.asarray(time_s)
    rising = -speed_mm_s * tau_s * np.expm1(-np.minimum(time, corner) / tau_s)
    return rising * np.exp(-np.maximum(time - corner, 0.0) / tau_s)
