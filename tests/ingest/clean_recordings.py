"""Recordings as a sound machine writes them, from a simulator that shares nothing with the package.

A crosshead whose speed changes within 50 to 300 ms (constant or smooth deceleration), an encoder with its
counts, a Kelvin-Voigt tissue, and noise of the load cell: white, correlated, or with mains hum.  Printed with
the decimals of real exports.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

RATES_HZ = (10, 20, 50, 100, 200, 500, 1000)
SPEEDS_MM_S = tuple(speed / 60.0 for speed in (10, 70, 100, 150, 250, 500))
MOST_SAMPLES = 20_000
FINE_S = 0.0005


@dataclass
class Recording:
    """What a file would hold."""

    time_s: FloatArray
    displacement_mm: FloatArray
    force_N: FloatArray
    rate_Hz: float

    def channels(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.time_s, self.displacement_mm, self.force_N


def program(rng: np.random.Generator) -> tuple[list[tuple[float, float]], float]:
    """(speed, duration) of every move, and a sampling rate that keeps the file small."""
    rate, speed = float(rng.choice(RATES_HZ)), float(rng.choice(SPEEDS_MM_S))
    ramp, hold = rng.uniform(2.0, 8.0) / speed, rng.uniform(3.0, 30.0)
    moves = [(0.0, rng.uniform(0.0, 1.0)), (speed, ramp), (0.0, hold)]
    kind = rng.random()
    if kind < 0.3:
        moves += [(-speed, ramp), (0.0, 1.0)]
    elif kind < 0.5:
        moves = [(speed, ramp), (-speed, ramp)] * 3
    total = sum(duration for _, duration in moves)
    return moves, min(rate, 100.0) if rate * total > MOST_SAMPLES else rate


def path_of(moves: list[tuple[float, float]], time_s: FloatArray) -> FloatArray:
    """Displacement on straight lines with sharp corners."""
    knots = np.concatenate(([0.0], np.cumsum([duration for _, duration in moves])))
    reach = np.concatenate(([0.0], np.cumsum([speed * duration for speed, duration in moves])))
    return np.interp(time_s, knots, reach)


def crosshead(moves: list[tuple[float, float]], time_s: FloatArray, stop_s: float, kernel: str) -> FloatArray:
    """Displacement of a crosshead that takes ``stop_s`` for every change of speed."""
    fine = np.arange(0.0, time_s[-1] + 2.0 * stop_s, FINE_S)
    width = max(3, round(stop_s / FINE_S))
    weights = np.ones(width) if kernel == "constant" else np.hanning(width + 2)[1:-1]
    sharp = np.pad(path_of(moves, fine), width, mode="edge")
    smooth = np.convolve(sharp, weights / weights.sum(), mode="same")[width:-width]
    return np.interp(time_s, fine, smooth)


def tissue(rng: np.random.Generator, displacement_mm: FloatArray, step_s: float) -> FloatArray:
    """Force of a modified Kelvin-Voigt tissue met at a random travel."""
    depth = np.maximum(displacement_mm - rng.choice([0.0, 0.5, 1.0]), 0.0)
    tau, stiffness = rng.choice([0.02, 0.1, 1.0, 5.0]), rng.uniform(5.0, 80.0)
    decay = np.exp(-step_s / tau)
    stretch = np.zeros(depth.size)
    for i, rise in enumerate(np.diff(depth)):
        stretch[i + 1] = decay * stretch[i] + rise / step_s * tau * (1.0 - decay)
    return 20.0 * depth - 1.2 * depth**2 + 0.35 * depth**3 + stiffness * stretch


def load_cell(rng: np.random.Generator, time_s: FloatArray) -> FloatArray:
    """Noise of a force channel."""
    sigma = rng.choice([0.005, 0.02, 0.1, 0.5, 1.0])
    noise = rng.normal(0.0, sigma, time_s.size)
    kind = rng.choice(["white", "correlated", "hum"])
    if kind == "correlated":
        for i in range(1, noise.size):
            noise[i] += 0.7 * noise[i - 1]
    elif kind == "hum":
        noise += 2.0 * sigma * np.sin(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 6.0))
    return noise


def measured(seed: int) -> Recording:
    """A clean recording: real motion, encoder, tissue, noise, print."""
    rng = np.random.default_rng(seed)
    moves, rate = program(rng)
    time = np.arange(int(sum(duration for _, duration in moves) * rate)) / rate
    x = crosshead(moves, time, rng.uniform(0.05, 0.3), str(rng.choice(["constant", "smooth"])))
    force = tissue(rng, x, 1.0 / rate) + load_cell(rng, time)
    x = x + rng.choice([0.0, 2e-5, 1e-4, 5e-4]) * rng.normal(size=x.size)
    counts = rng.choice([0.0, 6e-5, 1e-3])
    x = np.rint(x / counts) * counts if counts else x
    if rng.random() < 0.3:
        time = np.maximum.accumulate(time + rng.normal(0.0, 2e-5, time.size).clip(-1e-4, 1e-4))
    return Recording(time.round(5), x.round(int(rng.choice([3, 4, 5, 6]))), force.round(3), rate)


def commanded(seed: int) -> Recording:
    """The same test with the displacement that the machine was told."""
    rng = np.random.default_rng(seed)
    moves, rate = program(rng)
    time = np.arange(int(sum(duration for _, duration in moves) * rate)) / rate
    told = path_of(moves, time)
    force = tissue(rng, crosshead(moves, time, 0.1, "smooth"), 1.0 / rate) + load_cell(rng, time)
    return Recording(time.round(5), told.round(int(rng.choice([4, 5, 6]))), force.round(3), rate)


def ramp_hold(seed: int = 7, *, rate_Hz: float = 100.0, decimals: int = 5) -> Recording:
    """One clean ramp of 4 mm at 2 mm/s and a hold of 10 s, 0.1 N of white noise."""
    rng = np.random.default_rng(seed)
    moves = [(0.0, 0.5), (2.0, 2.0), (0.0, 10.0)]
    time = np.arange(int(12.5 * rate_Hz)) / rate_Hz
    x = crosshead(moves, time, 0.15, "smooth") + 2e-5 * rng.normal(size=time.size)
    depth = np.maximum(x - 0.5, 0.0)
    force = 15.0 * depth + 2.0 * depth**2 + rng.normal(0.0, 0.1, time.size)
    return Recording(time, x.round(decimals), force.round(4), rate_Hz)
