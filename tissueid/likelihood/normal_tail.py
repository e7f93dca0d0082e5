"""The upper tail of a standard normal in compiled code, by logarithms, however far out."""

from __future__ import annotations

import math

from tissueid.compiled import kernel

__all__ = ["excess", "hazard", "log_tail", "tail_quantile"]

#: From here on the tail is taken from its asymptotic series, good to 1e-13 [standard deviations].
ASYMPTOTIC = 25.0
HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
LOG_HALF = math.log(0.5)
ROOT_HALF = math.sqrt(0.5)
#: The quantile of a probability that is one to rounding.
LOWEST = -38.5


@kernel()
def _mills_series(x: float) -> float:
    """Ratio of tail and density of a standard normal times x, for x from ASYMPTOTIC on."""
    r = 1.0 / (x * x)
    return 1.0 - r * (1.0 - 3.0 * r * (1.0 - 5.0 * r * (1.0 - 7.0 * r * (1.0 - 9.0 * r))))


@kernel()
def log_tail(x: float) -> float:
    """``ln P(Z > x)`` of a standard normal, to 1e-13 relative anywhere."""
    if x < 0.0:
        return math.log1p(-0.5 * math.erfc(-x * ROOT_HALF))
    if x < ASYMPTOTIC:
        return math.log(0.5 * math.erfc(x * ROOT_HALF))
    return -0.5 * x * x - HALF_LOG_2PI + math.log(_mills_series(x) / x)


@kernel()
def hazard(x: float, tail: float) -> float:
    """Density over tail of a standard normal, ``tail`` being ``log_tail(x)``."""
    if x < ASYMPTOTIC:
        return math.exp(-0.5 * x * x - HALF_LOG_2PI - tail)
    return x / _mills_series(x)


@kernel()
def excess(x: float, tail: float) -> float:
    """Mean of a standard normal above x, less x."""
    if x < ASYMPTOTIC:
        return hazard(x, tail) - x
    r = 1.0 / (x * x)
    return r * (1.0 - 3.0 * r * (1.0 - 5.0 * r * (1.0 - 7.0 * r * (1.0 - 9.0 * r)))) * x / _mills_series(x)


@kernel()
def tail_quantile(log_p: float) -> float:
    """The x with ``ln P(Z > x) = log_p``, for any log_p < 0.

    Starts from the rational form 26.2.23 of Abramowitz & Stegun (4.5e-4) and takes Halley's steps on the
    logarithm of the tail.
    """
    if log_p > LOG_HALF:
        other = -math.expm1(log_p)
        return -tail_quantile(math.log(other)) if other > 0.0 else LOWEST
    t = math.sqrt(-2.0 * log_p)
    x = t - (2.515517 + t * (0.802853 + t * 0.010328)) / (
        1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308))
    )
    for _ in range(3):
        tail = log_tail(x)
        slope = hazard(x, tail)
        step = (tail - log_p) / slope
        step /= 1.0 + 0.5 * step * (slope - x)
        x += step
        if abs(step) < 1e-5 * (1.0 + abs(x)):
            break  # the order is three: what is left is below 1e-15
    return x
