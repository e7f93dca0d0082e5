"""Recordings of a push into a tissue whose law is written down: air, ramp, a crosshead that brakes, hold."""

import numpy as np
from scipy.signal import lfilter

from tissueid.trial import Source, Trial

#: Steps of the integration between two samples.
FINE = 20


def pushed(
    *, brake_s: float = 0.2, tau_s: float = 0.5, gain: float = 1.0, speed: float = 2.0, depth_mm: float = 4.0,
    air_mm: float = 1.0, hold_s: float = 10.0, rate_Hz: float = 100.0, noise_N: float = 0.01,
    zero_N: float = 0.0, drift_N_per_s: float = 0.0, overshoot_mm: float = 0.0,
    stop_force_N: float = np.inf, seed: int = 0,
) -> Trial:  # fmt: skip
    """Force ``gain * (5 d + z)`` N, where z of 10 N/mm relaxes in ``tau_s``; braking is even.

    ``overshoot_mm`` decays over 0.1 s after the stop; ``stop_force_N`` is where the load cell ends.
    """
    step = 1.0 / (rate_Hz * FINE)
    corner = 1.0 + (air_mm + depth_mm) / speed - 0.5 * brake_s
    time = np.arange(round((corner + brake_s + hold_s) / step) + 1) * step
    braking = np.clip(1.0 - (time - corner) / max(brake_s, step), 0.0, 1.0)
    rate = np.where(time < 1.0, 0.0, speed * braking)
    travel = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * step])
    after = time - corner - brake_s
    swing = overshoot_mm * np.sin(np.pi * np.clip(after / 0.1, 0.0, 1.0))
    depth = np.maximum(travel + swing - air_mm, 0.0)
    decay = np.exp(-step / tau_s)
    branch = lfilter([10.0 * np.sqrt(decay)], [1.0, -decay], np.diff(depth, prepend=0.0))
    force = gain * (5.0 * depth + branch)
    time, place, force = time[::FINE], np.round((travel + swing)[::FINE], 5), force[::FINE]
    noise = noise_N * np.random.default_rng(seed).normal(size=time.size)
    read = zero_N + drift_N_per_s * time + np.minimum(force + noise, stop_force_N)
    return Trial("liver", time, place, read, source=Source(path="push.csv"))
