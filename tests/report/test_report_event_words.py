"""Events of a recording in words."""

from __future__ import annotations

from tissueid.documents.inspect import Units
from tissueid.report.wording import event_words, took

MM_N = Units(length="mm", force="N", time="s")


def test_a_rupture_is_told_in_words_and_units() -> None:
    values = {
        "force_before_N": 66.2,
        "drop_N": 12.5,
        "drop_fraction": 0.19,
        "depth_mm": 3.0,
        "work_N_mm": 64.16,
    }
    expected = "force before 66.20 N, falls by 12.50 N, depth 3.000 mm, work from contact 64.16 N mm"
    assert event_words(values, MM_N) == expected


def test_counts_have_no_unit_and_normalised_recordings_their_own() -> None:
    assert event_words({"turns": 3, "force_N": 2.0}, MM_N) == "turns 3, force 2.000 N"
    assert event_words({"drop_N": 2.0, "depth_mm": 0.5}, Units(length="1", force="MPa", time="s")) == (
        "falls by 2.000 MPa, depth 0.5"
    )


def test_a_stop_within_a_sampling_interval_is_not_called_instant() -> None:
    assert took(0.0) == "too short to see"
    assert took(0.02) == "took 0.020 s"
