"""Measures of recordings, no model: peaks, forces in the hold, loop areas, relaxation times, moduli.

Above segmentation, below every fit.  No compiled kernel is loaded here: a first look at a file must not
wait for a compiler.
"""

from __future__ import annotations

from tissueid.measured.measuring import TIMES_S, measure
from tissueid.measured.spread import spread

__all__ = ["TIMES_S", "measure", "spread"]
