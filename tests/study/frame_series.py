"""Tissue in series with a compliant frame: the oracle of the frame correction.

The crosshead stands at ``x_c``, the tip at ``x``, and between them the frame gives by ``u(F)``: ``x_c = x +
u(F)``, ``F = F_s(x) + K s``, ``s' = x' - s / tau``.  Differentiated by time,

    x' = (x_c' + u'(F) K s / tau) / (1 + u'(F) (F_s'(x) + K)),

an ordinary differential equation that is integrated to 1e-10 of the travel between the corners of the
crosshead's program.  Nothing is shared with the correction, which knows neither the equation nor its solver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tissueid.arrays import FloatArray
from tissueid.synth import Hold, Log, Move, Recipe
from tissueid.trial import Protocol, Source, Trial

#: Truth of the named protocols: F_s [N/mm, N/mm2, N/mm3], K [N/mm], tau [s].
STATIC = (20.0, -1.2, 0.35)
STIFFNESS_N_PER_MM = 63.62
TAU_S = 0.021


@dataclass(frozen=True)
class Frame:
    """Deflection ``u(F)`` [mm] and compliance ``u'(F)`` [mm/N] of a frame."""

    deflection: Callable[[float], float]
    compliance: Callable[[float], float]


def linear_frame(stiffness_N_per_mm: float) -> Frame:
    """A spring."""
    return Frame(lambda f: f / stiffness_N_per_mm, lambda _f: 1.0 / stiffness_N_per_mm)


def seating_frame(stiffness_N_per_mm: float, seat_mm: float, seat_N: float) -> Frame:
    """A spring behind joints that close: ``F / k + seat (1 - exp(-F / F_seat))``."""
    return Frame(
        lambda f: f / stiffness_N_per_mm + seat_mm * -np.expm1(-f / seat_N),
        lambda f: 1.0 / stiffness_N_per_mm + seat_mm / seat_N * float(np.exp(-f / seat_N)),
    )


def _force(x: float, s: float) -> float:
    a1, a2, a3 = STATIC
    return x * (a1 + x * (a2 + x * a3)) + STIFFNESS_N_PER_MM * s


def _rates(frame: Frame, speed: float) -> Callable[[float, FloatArray], tuple[float, float]]:
    a1, a2, a3 = STATIC

    def rates(_t: float, state: FloatArray) -> tuple[float, float]:
        x, s = float(state[0]), float(state[1])
        give = frame.compliance(_force(x, s))
        tangent = a1 + x * (2.0 * a2 + 3.0 * a3 * x) + STIFFNESS_N_PER_MM
        moves = (speed + give * STIFFNESS_N_PER_MM * s / TAU_S) / (1.0 + give * tangent)
        return moves, moves - s / TAU_S

    return rates


def _pieces(log: Log) -> Iterator[tuple[float, float]]:
    """Duration [s] and speed [mm/s] of every part of a program."""
    at = 0.0
    for move in log.moves:
        assert isinstance(move, Move | Hold)
        if isinstance(move, Move):
            yield (move.to_mm - at) / move.speed_mm_s, move.speed_mm_s
            at = move.to_mm
        else:
            yield move.hold_s, 0.0


def crosshead_and_force(log: Log, frame: Frame, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Crosshead travel [mm] and force [N] of one program from contact at rest, at the given times."""
    travel, force = np.empty(time_s.size), np.empty(time_s.size)
    start, at, state = 0.0, 0.0, np.zeros(2)
    for duration, speed in _pieces(log):
        inside = (time_s >= start - 1e-12) & (time_s <= start + duration + 1e-12)
        when = np.clip(time_s[inside] - start, 0.0, duration)
        solved = solve_ivp(
            _rates(frame, speed), (0.0, duration), state, method="DOP853",
            t_eval=np.append(when, duration) if when.size == 0 or when[-1] < duration else when,
            rtol=1e-10, atol=1e-11,
        )  # fmt: skip
        x, s = solved.y[0, : when.size], solved.y[1, : when.size]
        travel[inside] = at + speed * when
        force[inside] = [_force(a, b) for a, b in zip(x.tolist(), s.tolist(), strict=True)]
        state, start, at = solved.y[:, -1], start + duration, at + speed * duration
    return travel, force


def series_trials(
    plan: Recipe, frame: Frame, *, sigma_N: float, rng: np.random.Generator, specimen: str = "tissue"
) -> list[Trial]:
    """The recordings of a recipe's program on a compliant frame, crosshead travel logged."""
    trials = []
    clean: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
    for repeat in range(1, max(log.repeats for log in plan.logs) + 1):
        for log in plan.logs:
            if repeat > log.repeats:
                continue
            if log.name not in clean:
                time_s = np.arange(0.0, sum(duration for duration, _ in _pieces(log)), 1.0 / plan.rate_Hz)
                clean[log.name] = (time_s, *crosshead_and_force(log, frame, time_s))
            time_s, travel, force = clean[log.name]
            noisy = force + sigma_N * rng.standard_normal(force.size)
            source = Source(path=f"{log.name}-{repeat}.csv", recipe="synthetic")
            trials.append(Trial(specimen, time_s, travel, noisy, Protocol(), source))
    return trials
