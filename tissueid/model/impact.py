"""Contact with a hard body: Hertz's law with the damping of Flores (compiled, and as a contact model).

Pires et al., Haptic Positioning Environment for the Hip Resurfacing Surgery, equation (1)::

    F = k d^n (1 + chi d' / v0),    chi = 8 (1 - e) / (5 e)

with penetration d, its speed d' (> 0 while compressing), and the speed v0 at which this contact began.  The
factor is Flores et al. (2011), doi 10.1007/s11044-010-9237-4, equation (27).

A free mass that meets this law does not return with e times its speed.  Multiplying the equation of motion
by d' and integrating over the contact gives, whatever k, n and the mass are (derived here)::

    ln(1 - e' chi) + e' chi = ln(1 + chi) - chi

for the restitution e' that is reached.  ``flores`` takes chi from the equation above as printed; ``exact``
solves the line for the chi that reaches e.

Bounds: e is at least 0.05 (chi grows without bound below, and the first touch is a blow), v0 at least a
given slowest speed (a touch at 1 mm/s and a push at 0.1 m/s after it would be felt 160-fold), d' / v0 within
+-1, and F >= 0: nothing sticks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import tick_part
from tissueid.model.base import ContactPath, ParameterSpec, Stepper

__all__ = [
    "IMPACT_SIZE",
    "IMPACT_STATE",
    "KEY",
    "LEAST_RESTITUTION",
    "HertzImpact",
    "ImpactStepper",
    "damping_factor",
    "impact_step",
    "pack_impact",
    "reached_restitution",
]

FloatArray = NDArray[np.float64]
DampingLaw = Literal["flores", "exact"]

KEY = "hertz-impact"
LEAST_RESTITUTION = 0.05
#: Floor of the speed at contact [mm/s]: a third of what one count of a Falcon's encoder in 1 ms looks like.
SLOWEST_MM_S = 20.0
#: Halvings of a bracket: as many as a double has binary digits.
HALVINGS = 60

# -- the law's numbers, and what it remembers -----------------------------------------------------
IMPACT_SIZE = 6
STIFFNESS = 0
EXPONENT = 1
CHI = 2
SLOWEST = 3
FILTER_S = 4
HYSTERESIS_MM = 5

IMPACT_STATE = 4
LAST_DEPTH = 0
SPEED = 1
#: Speed at contact [mm/s]; 0 while no contact is on.
LATCHED = 2
STARTED = 3


def reached_restitution(chi: float) -> float:
    """Speed of a free mass after the contact over that before it.

    Parameters
    ----------
    chi : float
        Damping factor, not negative.

    Raises
    ------
    ValueError
        A negative factor.
    """
    if not chi >= 0.0:
        msg = f"a damping factor can't be negative, got {chi}"
        raise ValueError(msg)
    if chi == 0.0:
        return 1.0
    wanted = math.log1p(chi) - chi
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if math.log1p(-middle) + middle > wanted:
            low = middle
        else:
            high = middle
    return min(low / chi, 1.0)


def damping_factor(restitution: float, law: DampingLaw = "flores") -> float:
    """The damping factor chi for a coefficient of restitution.

    Parameters
    ----------
    restitution : float
        e, 0.05 to 1.
    law : {"flores", "exact"}
        As printed, or such that a free mass returns with e times its speed.

    Raises
    ------
    ValueError
        e is out of its range.
    """
    if not LEAST_RESTITUTION <= restitution <= 1.0:
        msg = f"a coefficient of restitution lies within {LEAST_RESTITUTION} and 1, got {restitution}"
        raise ValueError(msg)
    if law == "flores":
        return 8.0 * (1.0 - restitution) / (5.0 * restitution)
    low, high = 0.0, 1.0 / restitution
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if reached_restitution(middle) > restitution:
            low = middle
        else:
            high = middle
    return low


def _factor_slope(restitution: float, chi: float, law: DampingLaw) -> float:
    """Derivative of chi by e."""
    if law == "flores":
        return -1.6 / restitution**2
    rest = 1.0 - restitution * chi
    below = rest - restitution**2 * (1.0 + chi)
    # both vanish at e = 1, where chi begins as 1.5 (1 - e)
    return -1.5 if abs(below) < 1e-6 else restitution * chi * (1.0 + chi) / below


def pack_impact(
    stiffness: float,
    exponent: float,
    chi: float,
    block: FloatArray,
    at: int,
    *,
    slowest_mm_s: float = SLOWEST_MM_S,
    filter_s: float = 0.0,
    hysteresis_mm: float = 0.0,
) -> None:
    """Write the law's numbers.

    Parameters
    ----------
    stiffness : float
        k [N/mm^n].
    exponent, chi : float
    block : ndarray
        Written from index ``at``, :data:`IMPACT_SIZE` numbers.
    at : int
    slowest_mm_s : float
        Floor of v0 [mm/s].
    filter_s : float
        Time constant of the low-pass of the speed [s]; 0 for none.
    hysteresis_mm : float
        A contact ends, and its v0 is forgotten, this far outside.
    """
    block[at : at + IMPACT_SIZE] = stiffness, exponent, chi, slowest_mm_s, filter_s, hysteresis_mm


@tick_part
def impact_step(
    parameters: FloatArray, at: int, memory: FloatArray, first: int, depth: float, dt: float
) -> float:
    """Force after a step of linear motion.

    Parameters
    ----------
    parameters : ndarray
        :func:`pack_impact` from index ``at``.
    at : int
    memory : ndarray
        :data:`IMPACT_STATE` numbers from index ``first``, all zero before the first step; updated in place.
    first : int
    depth : float
        Penetration at the end of the step [mm], negative outside.
    dt : float
        [s]

    Returns
    -------
    float
        Force [N], never negative.
    """
    if memory[first + STARTED] > 0.0 and dt > 0.0:
        rate = (depth - memory[first + LAST_DEPTH]) / dt
        filter_s = parameters[at + FILTER_S]
        share = 1.0 - math.exp(-dt / filter_s) if filter_s > 0.0 else 1.0
        memory[first + SPEED] += share * (rate - memory[first + SPEED])
    memory[first + STARTED] = 1.0
    memory[first + LAST_DEPTH] = depth
    if depth <= 0.0:
        if depth < -parameters[at + HYSTERESIS_MM] or parameters[at + HYSTERESIS_MM] == 0.0:
            memory[first + LATCHED] = 0.0
        return 0.0
    speed = memory[first + SPEED]
    if memory[first + LATCHED] == 0.0:
        memory[first + LATCHED] = max(speed, parameters[at + SLOWEST])
    ratio = min(max(speed / memory[first + LATCHED], -1.0), 1.0)
    elastic = parameters[at + STIFFNESS] * depth ** parameters[at + EXPONENT]
    return float(max(elastic * (1.0 + parameters[at + CHI] * ratio), 0.0))


@dataclass(frozen=True, slots=True)
class HertzImpact:
    """The law as a contact model: k, n and e.

    Attributes
    ----------
    depth_mm : float
        Largest depth it is claimed for [mm].
    law : {"flores", "exact"}
        How chi follows from e.
    slowest_mm_s : float
        Floor of the speed at contact [mm/s].
    """

    depth_mm: float
    law: DampingLaw = "flores"
    slowest_mm_s: float = SLOWEST_MM_S

    @property
    def key(self) -> str:
        """Registry key."""
        return KEY

    @property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """k, n, e."""
        return (
            ParameterSpec(
                "stiffness_N_per_mm_n", "k", "N/mm^n", 0.0, np.inf, "generalized contact stiffness"
            ),
            ParameterSpec("exponent", "n", "1", 0.5, 4.0, "exponent of the penetration"),
            ParameterSpec(
                "restitution", "e", "1", LEAST_RESTITUTION, 1.0, "coefficient of restitution, as asked for"
            ),
        )

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of theta."""
        return tuple(spec.name for spec in self.parameters)

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path, shape (n,); speeds are the path's own, or those of its straight pieces."""
        stiffness, exponent, restitution = (float(value) for value in theta)
        ratio = self._ratio(path)
        factor = np.maximum(1.0 + damping_factor(restitution, self.law) * ratio, 0.0)
        return np.asarray(stiffness * np.maximum(path.depth_mm, 0.0) ** exponent * factor)

    def jacobian(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Derivative of :meth:`force` by k, n and e, shape (n, 3)."""
        stiffness, exponent, restitution = (float(value) for value in theta)
        chi = damping_factor(restitution, self.law)
        ratio = self._ratio(path)
        depth = np.maximum(path.depth_mm, 0.0)
        factor = np.maximum(1.0 + chi * ratio, 0.0)
        power = depth**exponent
        logarithm = np.log(depth, out=np.zeros_like(depth), where=depth > 0.0)
        by_restitution = (
            stiffness * power * np.where(factor > 0.0, ratio, 0.0) * _factor_slope(restitution, chi, self.law)
        )
        return np.column_stack([power * factor, stiffness * power * logarithm * factor, by_restitution])

    def linear_basis(self, nonlinear: FloatArray, path: ContactPath) -> FloatArray:
        """The column of k for given n and e, shape (n, 1)."""
        return self.force(np.array([1.0, *nonlinear]), path)[:, None]

    def is_passive(self, theta: FloatArray) -> bool:
        """Whether k >= 0, n > 0 and e is in its range: then no loop gives energy."""
        stiffness, exponent, restitution = theta
        return bool(
            np.isfinite(theta).all()
            and stiffness >= 0.0
            and exponent > 0.0
            and LEAST_RESTITUTION <= restitution <= 1.0
        )

    def stepper(self, theta: FloatArray) -> Stepper:
        """A running copy, out of contact."""
        return ImpactStepper(self, theta)

    def _ratio(self, path: ContactPath) -> FloatArray:
        """Speed over the speed at which the contact of each sample began, within +-1."""
        speed = path.velocity_mm_s
        if speed is None:
            speed = _piecewise_speed(path.time_s, path.depth_mm)
        begun = np.searchsorted(path.contact_starts, np.arange(speed.size), side="right") - 1
        at_contact = np.maximum(speed[np.asarray(path.contact_starts)], self.slowest_mm_s)
        return np.asarray(np.clip(speed / at_contact[np.maximum(begun, 0)], -1.0, 1.0))


def _piecewise_speed(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed of the straight piece that ends at each sample [mm/s]; the first has that of the second."""
    step = np.diff(time)
    moved = step > 0.0
    rate = np.divide(np.diff(depth), step, out=np.zeros(step.size), where=moved)
    # a step without time has the speed of the one before it
    last = np.maximum.accumulate(np.where(moved, np.arange(step.size), -1))
    rate = np.where(last >= 0, rate[np.maximum(last, 0)], 0.0)
    return np.concatenate([rate[:1], rate])


class ImpactStepper:
    """The law under a moving tool.

    Parameters
    ----------
    model : HertzImpact
    theta : ndarray, shape (3,)
        Must be passive.
    """

    def __init__(self, model: HertzImpact, theta: FloatArray) -> None:
        if not model.is_passive(theta):
            msg = f"k >= 0, n > 0 and e in [{LEAST_RESTITUTION}, 1] are needed, got {[*map(float, theta)]}"
            raise ValueError(msg)
        stiffness, exponent, restitution = (float(value) for value in theta)
        self._law = np.empty(IMPACT_SIZE)
        chi = damping_factor(restitution, model.law)
        pack_impact(stiffness, exponent, chi, self._law, 0, slowest_mm_s=model.slowest_mm_s)
        self._memory = np.zeros(IMPACT_STATE)

    def step(self, depth_mm: float, dt_s: float) -> float:
        """Force [N], never negative, after ``dt_s`` s of linear motion to ``depth_mm`` (< 0: in air)."""
        return float(impact_step(self._law, 0, self._memory, 0, depth_mm, dt_s))

    def reset(self) -> None:
        """Out of contact, nothing remembered."""
        self._memory[:] = 0.0
