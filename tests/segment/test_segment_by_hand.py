"""Decisions of the user: where a hold begins and ends, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Source, Trial


def log(*, specimen: str = "knee", path: str = "knee.csv") -> Trial:
    """A ramp of 1 mm/s to 4 mm at 50 Hz, and 10 s of hold whose force decays."""
    time = np.arange(0.0, 14.0, 0.02)
    depth = np.minimum(time, 4.0)
    force = 2.0 * depth + 3.0 * np.where(time < 4.0, depth, 4.0 * np.exp(-(time - 4.0) / 2.0))
    return Trial(specimen, time, depth, force, source=Source(path=path))


def test_a_hold_begins_and_ends_where_it_is_said() -> None:
    found = segment(log(), options=SegmentOptions(hold_from_s=4.5, end_s=9.0))
    ramp, hold = found.phases[-2:]
    assert (ramp.kind, hold.kind) == ("ramp", "hold")
    assert ramp.end_s == hold.start_s == pytest.approx(4.5)
    assert hold.end_s == pytest.approx(9.0)
    (flag,) = [flag for flag in found.flags if flag.code == "decision_overridden"]
    assert flag.values["keys"] == ["end_s", "hold_from_s"]
    assert "4.5" in flag.message
    assert "9.0" in flag.message


def test_a_hold_is_made_in_a_ramp_where_there_is_none() -> None:
    time = np.arange(0.0, 20.0, 0.02)
    depth = time.copy()
    trial = Trial("slow", time, depth, 2.0 * depth)
    assert "hold" not in [phase.kind for phase in segment(trial).phases]
    phases = segment(trial, options=SegmentOptions(hold_from_s=12.0)).phases
    assert [(phase.kind, phase.start_s) for phase in phases][-1] == ("hold", pytest.approx(12.0))


@pytest.mark.parametrize("pattern", ["knee*", "*/knee.csv", "knee.csv", "patient-7"])
def test_patterns_fit_path_file_or_specimen(pattern: str) -> None:
    options = SegmentOptions(exclude=(pattern,))
    assert options.excludes(log(specimen="patient-7", path="lab/knee.csv")) == pattern
    assert options.excludes(log(specimen="other", path="lab/hip.csv")) is None


def test_a_hold_that_ends_before_it_begins_is_refused() -> None:
    with pytest.raises(ValueError, match="must end after it starts"):
        SegmentOptions(hold_from_s=5.0, end_s=4.0)
