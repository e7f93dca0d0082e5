"""Divide a recording: signs, approach, ramps, holds, retracts, cycles, and the contact point with its sd.

Arrays in, decisions out; nothing is read from files, nothing of the trial is changed.
"""

from __future__ import annotations

from tissueid.segment.options import SegmentOptions
from tissueid.segment.segmentation import segment

__all__ = ["SegmentOptions", "segment"]
