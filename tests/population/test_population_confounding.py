from __future__ import annotations

from dataclasses import replace

import pytest
from cohort_factory import members

from tissueid.population.confounding import speed_confounding
from tissueid.population.members import Member

SLOW, MIDDLE, FAST = 10.0 / 60.0, 100.0 / 60.0, 500.0 / 60.0


def at_speeds(*speeds: tuple[float, ...]) -> tuple[Member, ...]:
    """Specimens, each with a log at each of its speeds."""
    made = members(len(speeds), repeats=1, draws=100)
    return tuple(
        replace(one, trials=tuple(replace(one.trials[0], speed_mm_s=speed) for speed in own))
        for one, own in zip(made, speeds, strict=True)
    )


def test_every_specimen_at_every_speed_is_not_confounded() -> None:
    found = speed_confounding(at_speeds((SLOW, MIDDLE, FAST), (SLOW, MIDDLE, FAST), (SLOW, MIDDLE, FAST)))

    assert found is not None
    assert found.kind == "none"
    assert len(found.parts) == 1
    assert found.flags() == []


def test_speeds_that_meet_along_a_chain_of_specimens_are_not_confounded() -> None:
    found = speed_confounding(at_speeds((SLOW, MIDDLE), (MIDDLE, FAST), (FAST,)))

    assert found is not None
    assert found.kind == "none"


def test_each_speed_from_other_specimens_is_confounded_and_refuses_the_causal_sentence() -> None:
    found = speed_confounding(at_speeds((SLOW,), (SLOW,), (MIDDLE,), (FAST,)))

    assert found is not None
    assert found.kind == "confounded"
    assert [flag.code for flag in found.flags()] == ["speed_confounded"]
    assert "no effect of speed can be claimed" in found.sentence
    assert "10, 10" not in found.sentence


def test_parts_that_share_no_specimen_are_named() -> None:
    found = speed_confounding(at_speeds((SLOW, MIDDLE), (SLOW, MIDDLE), (FAST,)))

    assert found is not None
    assert found.kind == "partly"
    assert found.parts == (pytest.approx((SLOW, MIDDLE)), pytest.approx((FAST,)))
    assert "different parts can't be compared" in found.sentence


def test_settings_that_differ_by_a_machine_s_error_are_one_speed() -> None:
    found = speed_confounding(at_speeds((SLOW,), (1.01 * SLOW,), (0.995 * SLOW,)))

    assert found is not None
    assert found.kind == "single speed"
    assert found.flags() == []
