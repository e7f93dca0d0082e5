"""A force law in Python under a limit of time: one that fails or does not return ends in zero force."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

import numpy as np

from tissueid.arrays import FloatArray

#: Longest time of one call [s]: until then the motors keep the last force.
LONGEST_S = 0.05


class _Overdue(BaseException):
    """The law has not returned; no ``except Exception`` of a law catches it."""


class BoundedLaw:
    """A law whose exceptions, wrong shapes and late returns are no number: a fault to the guard."""

    def __init__(self, name: str, law: Callable[[FloatArray, FloatArray, float], Any]) -> None:
        self.name, self.law = name, law
        self.said = ""  # what went wrong: it is not called again
        self._running = False

    def __enter__(self) -> Self:
        # without POSIX timers a law that does not return is not stopped
        self._timed = hasattr(signal, "setitimer")
        if self._timed:
            self._before = signal.signal(signal.SIGALRM, self._overdue)
        return self

    def __exit__(self, *_: object) -> None:
        if self._timed:
            signal.signal(signal.SIGALRM, self._before)

    def _overdue(self, _number: int, _frame: FrameType | None) -> None:
        if self._running:
            raise _Overdue

    def __call__(self, position: FloatArray, velocity: FloatArray, dt: float) -> FloatArray:
        """Force of the law [N], (3,); not a number once it failed."""
        if self.said:
            return np.full(3, np.nan)
        try:
            self._running = True
            self._set_timer(LONGEST_S)
            force = np.asarray(self.law(position, velocity, dt), dtype=np.float64).reshape(3)
            self._running = False
        except BaseException as error:  # noqa: BLE001 - of somebody else's law nothing may pass
            self._running = False
            late = f"did not return within {1e3 * LONGEST_S:.0f} ms"
            what = late if isinstance(error, _Overdue) else f"raised {type(error).__name__}: {error}"[:200]
            self.said = f"{self.name} {what}"
            force = np.full(3, np.nan)
        finally:
            self._set_timer(0.0)
        return force

    def _set_timer(self, seconds: float) -> None:
        if self._timed:
            signal.setitimer(signal.ITIMER_REAL, seconds)
