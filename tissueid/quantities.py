"""Numbers that people quote: from when they hold, and the interval of the next indentation."""

from __future__ import annotations

import math

#: From this slope d ln tau / d ln T on a relaxation time is one of its window, where the slope is known to
#: so many standard errors.
EFFECTIVE_SLOPE, EFFECTIVE_SD = 0.2, 2.6
#: Name of the slope of ln relaxation time on ln contact radius among the quantities of a model.
DEPTH_TEST = "relaxation_by_contact_radius"
#: A force earlier than so many ramp times after the stop still knows the ramp.
RAMP_TIMES = 10.0
#: Ramp times are known to a sample or two: a time this little short of it counts.
ALMOST = 0.01


def beyond_ramp(time_s: float, ramp_time_s: float) -> bool:
    """True where a time after the stop is ten ramp times or later."""
    return time_s >= (1.0 - ALMOST) * RAMP_TIMES * ramp_time_s


#: 97.5 % points of Student's t with 1, 2, ... degrees of freedom; the normal's beyond.
_T_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
_NORMAL_975 = 1.96


def predicted(mean_ln: float, sd_ln: float, count: int) -> tuple[float, float] | None:
    """95 % prediction interval of one more value, from mean and standard deviation of logarithms."""
    if count < 2:
        return None
    t = _T_975[count - 2] if count - 2 < len(_T_975) else _NORMAL_975
    half = t * sd_ln * math.sqrt(1.0 + 1.0 / count)
    if not math.isfinite(half) or half > 20.0:
        return None
    return math.exp(mean_ln - half), math.exp(mean_ln + half)


def predicted_mean(mean: float | None, sd: float | None, count: int) -> tuple[float, float] | None:
    """95 % prediction interval of the next indentation, t on the log scale; ``None`` below two logs."""
    if mean is None or sd is None or mean <= 0.0 or count < 2:
        return None
    spread = math.sqrt(math.log1p((sd / mean) ** 2))
    return predicted(math.log(mean) - 0.5 * spread**2, spread, count)
