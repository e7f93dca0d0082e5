"""Recordings of tissues and machines as laboratories have them; shares no code with the models of tissueid.

Travel is a broken line with rounded stops, sampled twenty times as fast as the recording; forces come from
recursions over these samples; the frame gives way to the force, the load channel filters and lags, and what
is written is rounded to a quantum.  A mechanism changes one thing that the contact model does not know.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, lfilter

Array = NDArray[np.float64]

FINE = 20
#: Iterations of the frame's deflection; each leaves compliance times stiffness of the error before.
FRAME_ROUNDS = 40
AIR_S = 0.6
#: Height above the surface to which tissue that adheres is drawn.
NECK_MM = 0.8


@dataclass(frozen=True)
class Drainage:
    """A poroelastic half-space under a sphere [N, mm, s].

    Force of a sudden push: modulus x^1.5, of which a share is lost as fluid drains from a contact of radius
    a = sqrt(R x), by the function of Hu, Zhao, Vlassak & Suo 2010 (doi 10.1063/1.3370354, equation 11).
    """

    modulus: float
    share: float
    diffusivity_mm2_s: float
    radius_mm: float


@dataclass(frozen=True)
class Tissue:
    """A law by its parameters [N, mm, s].

    ``inside`` convolves the static force itself (quasi-linear); ``power`` is the exponent of a relaxation
    t^-power, made of many times.
    """

    static: tuple[float, float, float] = (20.0, -1.2, 0.35)
    stiffness: tuple[tuple[float, ...], ...] = ((30.0, 4.0),)
    tau_s: tuple[float, ...] = (0.3,)
    inside: bool = False
    power: float | None = None
    drains: Drainage | None = None
    adhesion_N: float = 0.0

    def elastic(self, x: Array) -> Array:
        """Static force [N]."""
        a, b, c = self.static
        return np.asarray(x * (a + x * (b + x * c)))


@dataclass(frozen=True)
class Machine:
    """Frame [mm/N], filter and skew [s], rounding of stops [s], quantum and noise [N]."""

    compliance_mm_per_N: float = 0.0
    filter_s: float = 0.0
    skew_s: float = 0.0
    rounding_s: float = 0.0
    quantum_N: float = 0.0
    sigma_N: float = 0.1
    rate_Hz: float = 100.0
    decimals: int = 5


@dataclass(frozen=True)
class Log:
    """A push: depth [mm], speed [mm/s], hold [s], return, and what is of this log alone."""

    depth_mm: float
    speed_mm_s: float
    hold_s: float = 0.0
    returns: bool = False
    gain: float = 1.0
    offset_mm: float = 0.0
    bent: Callable[[Array, Array], Array] | None = field(default=None, repr=False)
    met: Callable[[Array], Array] | None = field(default=None, repr=False)


def _state(x: Array, tau: float, dt: float) -> Array:
    """Convolution of x' with exp(-t / tau), x linear between samples."""
    decay = float(np.exp(-dt / tau))
    change = np.diff(x, prepend=x[0])
    return np.asarray(lfilter([tau / dt * (1.0 - decay)], [1.0, -decay], change))


def _draining(tissue: Drainage, deep: Array, dt: float) -> Array:
    """Force of each small push, lost by the function of drainage for the contact at the largest depth."""
    sudden = tissue.modulus * deep**1.5
    time = np.arange(deep.size) * dt * tissue.diffusivity_mm2_s / (tissue.radius_mm * deep.max())
    left = 0.491 * np.exp(-0.908 * np.sqrt(time)) + 0.509 * np.exp(-1.679 * time)
    kept = 1.0 - tissue.share + tissue.share * left
    return np.asarray(fftconvolve(np.diff(sudden, prepend=sudden[0]), kept)[: deep.size])


def tissue_force(tissue: Tissue, x: Array, dt: float) -> Array:
    """Force along a depth [N]; air is no depth."""
    deep = np.maximum(x, 0.0)
    if tissue.drains is not None:
        return _draining(tissue.drains, deep, dt)
    elastic = tissue.elastic(deep)
    if tissue.power is not None:
        times = np.logspace(-3, 3, 25)
        weights = times**-tissue.power
        weights = 2.0 * weights / weights.sum()
        driver = elastic if tissue.inside else deep
        scale = (
            np.ones_like(deep)
            if tissue.inside
            else sum(k * deep**i for i, k in enumerate(tissue.stiffness[0]))
        )
        return elastic * 0.4 + scale * sum(
            w * _state(driver, float(t), dt) for w, t in zip(weights, times, strict=True)
        )
    force = elastic.copy()
    for row, tau in zip(tissue.stiffness, tissue.tau_s, strict=True):
        if tissue.inside:
            force += row[0] / tissue.static[0] * _state(elastic, tau, dt)
        else:
            force += sum(k * deep**i for i, k in enumerate(row)) * _state(deep, tau, dt)
    return np.asarray(np.where(x > 0.0, force, 0.0))


def _travel(log: Log, machine: Machine) -> tuple[Array, Array]:
    """Fine times and travel from the surface, negative in air."""
    ramp = log.depth_mm / log.speed_mm_s
    corners = [0.0, AIR_S + ramp, AIR_S + ramp + log.hold_s]
    places = [-AIR_S * log.speed_mm_s, log.depth_mm, log.depth_mm]
    if log.returns:
        corners.append(corners[-1] + ramp + AIR_S)
        places.append(places[0])
    end = corners[-1]
    count = int(np.floor(end * machine.rate_Hz)) * FINE + 1
    time = np.arange(count) / (machine.rate_Hz * FINE)
    x = np.interp(time, corners, places)
    width = round(machine.rounding_s * machine.rate_Hz * FINE)
    if width > 1:
        padded = np.concatenate([x[0] + (np.arange(-width, 0)) * (x[1] - x[0]), x, np.full(width, x[-1])])
        x = np.convolve(padded, np.ones(width) / width, mode="same")[width:-width]
    return time, np.asarray(x)


def _pull(tissue: Tissue, depth: Array) -> Array:
    """Adhesion: none while the tool goes in, all of it once it comes back, until the tissue lets go [N]."""
    if tissue.adhesion_N == 0.0:
        return np.zeros_like(depth)
    back = np.arange(depth.size) > int(np.flatnonzero(depth >= depth.max() - 1e-9)[-1])
    held = np.clip((depth + NECK_MM) / NECK_MM, 0.0, 1.0)
    return np.where(back, tissue.adhesion_N * held, 0.0)


def recorded(
    tissue: Tissue, log: Log, machine: Machine, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time [s], travel [mm] and force [N] as a file would hold them."""
    time, travel = _travel(log, machine)
    dt = float(time[1] - time[0])
    force = np.zeros_like(travel)
    for _ in range(FRAME_ROUNDS if machine.compliance_mm_per_N else 1):
        depth = travel - log.offset_mm - machine.compliance_mm_per_N * force
        force = log.gain * tissue_force(tissue, depth if log.met is None else log.met(depth), dt)
        # a tool without adhesion is never pulled
        force = np.maximum(force, 0.0) - _pull(tissue, depth)
        if log.bent is not None:
            force = log.bent(depth, force)
    if machine.filter_s > 0.0:
        decay = float(np.exp(-dt / machine.filter_s))
        force = lfilter([1.0 - decay], [1.0, -decay], force)
    if machine.skew_s != 0.0:
        force = np.interp(time - machine.skew_s, time, force)
    time, travel, force = time[::FINE], travel[::FINE], np.asarray(force)[::FINE]
    force = force + rng.normal(0.0, machine.sigma_N, force.size)
    if machine.quantum_N > 0.0:
        force = np.round(force / machine.quantum_N) * machine.quantum_N
    return (
        np.round(time, machine.decimals),
        np.round(travel - travel[0], machine.decimals),
        np.round(force, machine.decimals),
    )
