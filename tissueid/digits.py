"""Digits for people: a value and its interval to the place that the interval's size supports.

The one form of a rounded number, of the terminal as of the report: two digits of the standard error, the
value and the ends of its interval to the same place, powers of ten with raised digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

NOT_IDENTIFIED = "not identified"

#: Digits of a standard error.
ERROR_DIGITS = 2
#: Digits of a number that has none.
VALUE_DIGITS = 4
#: Numbers below this are written with a power of ten.
SMALL = 1e-3
#: Numbers from ten to this power on are, too.
LARGE_POWER = 6
_MOST_DECIMALS = 9
#: Numbers below this part of their standard deviation are roundings of 0.
ROUNDING = 1e-9
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_POWER = re.compile(r"(×?)10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
#: A number as a computer prints it, by itself: in no word, file name or longer number.
_COMPUTED = re.compile(r"(?<![\w.])([-−+]?\d+(?:\.\d+)?)e([-+]\d{1,3})(?![\w]|\.\w)")


def power_of_ten(exponent: int) -> str:
    """``×10⁻³`` for -3."""
    return f"×10{str(exponent).translate(_RAISED)}"


def _minus(text: str) -> str:
    return text.replace("-", "−")


def _power(value: float) -> int:
    return math.floor(math.log10(abs(value)))


def number(value: float | None, digits: int = VALUE_DIGITS) -> str:
    """A number to so many significant digits, in the way a person writes it; a dash where there is none.

    >>> number(0.0000125), number(-63.6157)
    ('1.250×10⁻⁵', '−63.62')
    """
    if value is None:
        return "–"
    if value == 0 or not math.isfinite(value):
        return _minus(f"{value:zg}")
    power = _power(value)
    if -4 <= power < LARGE_POWER:
        return _minus(f"{value:.{max(digits - 1 - power, 0)}f}")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return _minus(mantissa) + power_of_ten(int(exponent))


def together(values: Sequence[float], sd: float | None) -> list[str]:
    """Numbers to the place that a standard deviation supports, all to the same."""
    if sd is None or not (sd > 0.0 and math.isfinite(sd)):
        return [number(value) for value in values]
    largest = max(abs(value) for value in values)
    if largest < ROUNDING * sd:
        largest, values = 0.0, [0.0] * len(values)
    power = _power(largest) if largest > 0.0 else 0
    if 0.0 < largest < SMALL:
        scaled = together([value / 10.0**power for value in values], sd / 10.0**power)
        return [text + power_of_ten(power) if text.strip("−0.") else "0" for text in scaled]
    places = ERROR_DIGITS - 1 - _power(sd)
    if places < 0 or places > _MOST_DECIMALS:
        return [number(value) for value in values]
    return [_minus(f"{value:z.{places}f}") for value in values]


def with_error(value: float | None, stderr: float | None) -> str:
    """``63.62 ± 0.89``: the error to two digits, the value to the same place.

    >>> with_error(5.174e-6, 1.12e-7)
    '(5.17 ± 0.11)×10⁻⁶'
    """
    if value is None:
        return NOT_IDENTIFIED
    if stderr is None or stderr <= 0 or not math.isfinite(stderr):
        return number(value)
    largest = max(abs(value), stderr)
    if largest < SMALL:
        power = _power(largest)
        return f"({with_error(value / 10.0**power, stderr / 10.0**power)}){power_of_ten(power)}"
    places = ERROR_DIGITS - 1 - _power(stderr)
    if places < 0 or places > _MOST_DECIMALS:
        return f"{number(value)} ± {number(stderr, ERROR_DIGITS)}"
    return _minus(f"{value:z.{places}f} ± {stderr:.{places}f}")


def typeset(text: str) -> str:
    """A sentence with its powers of ten as people write them; names that hold such letters stay.

    >>> typeset("noise 1.2e-05 N, a step of 1.23e+03 N in run_1e-05.csv")
    'noise 1.2×10⁻⁵ N, a step of 1230 N in run_1e-05.csv'
    """
    return _COMPUTED.sub(_typeset, text)


def _typeset(found: re.Match[str]) -> str:
    mantissa, exponent = found[1], int(found[2])
    if 0 <= exponent < LARGE_POWER:
        return f"{float(found[0].replace('−', '-')):.0f}" if "−" not in found[0] else found[0]
    if mantissa.lstrip("-−+") == "1":
        return mantissa[:-1] + power_of_ten(exponent)[1:]
    return mantissa + power_of_ten(exponent)


def plain_exponents(text: str) -> str:
    """Raised digits as ``x10^-3``, for a stream that has none.

    >>> plain_exponents("1.2×10⁻⁵")
    '1.2x10^-5'
    """
    return _POWER.sub(lambda found: f"{'x' * bool(found[1])}10^{found[2].translate(_LOWERED)}", text)


#: A clock that stands at so much counts from an epoch [s].
EPOCH_S = 1e8


def clock_start(first_s: float) -> float:
    """Start of a record whose clock counts from an epoch, from which its times are printed; else 0."""
    return float(first_s) if abs(first_s) >= EPOCH_S else 0.0
