"""Sentences on ruptures and speed, and their limits."""

from __future__ import annotations

from tissueid.rupture.speeds import Change
from tissueid.rupture.study import RuptureStudy

_NAMES = {"force_N": "Force", "depth_mm": "Depth", "work_N_mm": "Work"}


def sentences(study: RuptureStudy) -> list[str]:
    """Sentences of a study, each true by itself."""
    found = [study.confounding.sentence, *_changes(study), _absorbed(study), _sign(study)]
    censored = sum(not one.ruptured for one in study.failures)
    if censored:
        found.append(
            f"{censored} of {len(study.failures)} tests ended without a rupture. They count in the "
            "thresholds "
            "as lower bounds; means and standard deviations at a speed are of ruptured tests alone, and "
            "are low "
            "where the toughest did not rupture."
        )
    found.append(
        "The criteria are readings: Sadeghnejad et al. state none, and by their equation (7) alone the "
        "force at "
        "any depth rises with speed, so that no fall of the force at rupture follows from it."
    )
    return found


def _changes(study: RuptureStudy) -> list[str]:
    if study.confounding.kind in {"confounded", "single speed"}:
        return ["No effect of speed on rupture is claimed."]
    if not study.changes:
        return ["No specimen ruptured at two speeds often enough to say what speed does."]
    return [_change(one) for one in study.changes]


def _change(one: Change) -> str:
    percent = 100.0 * (one.ratio - 1.0)
    low, high = (100.0 * (end - 1.0) for end in one.ci95)
    said = {
        "falls": "falls with speed",
        "rises": "rises with speed",
        "undecided": "may fall or rise with speed",
    }[one.direction]
    return (
        f"{_NAMES[one.quantity]} at rupture {said}: {percent:+.1f} % at ten times the speed (95 %: "
        f"{low:+.1f} "
        f"to {high:+.1f} %), inside specimens."
    )


def _absorbed(study: RuptureStudy) -> str:
    work = next((one for one in study.changes if one.quantity == "work_N_mm"), None)
    if work is None:
        here = "these tests do not tell."
    elif work.direction == "undecided":
        here = "in these tests the work to rupture does not measurably change."
    else:
        here = f"in these tests the work to rupture {work.direction}."
    return (
        "Mahvash & Dupont (doi 10.1109/ROBOT.2009.5152617) report that less energy is absorbed at higher "
        "speed; "
        f"{here} A criterion of constant work can't show such a fall: it makes the energy constant by "
        "construction, and contradicts its source on this point."
    )


def _sign(study: RuptureStudy) -> str:
    found = study.hardening
    if found is None:
        return (
            "The sign test x F_s'/F can't be made: every test ruptured so fast that the relaxing branch was "
            "not in its steady state."
        )
    low, high = found.ci95
    means = {
        "falls": "above 1: under a constant work the force at rupture falls with speed",
        "rises": "below 1: under a constant work the force at rupture rises with speed",
        "undecided": "its interval holds 1: the sign is undecided",
    }[found.direction]
    return (
        f"Sign test x F_s'/F = {found.mean:.2f} (95 %: {low:.2f} to {high:.2f}, {found.ruptures} ruptures at "
        f"depths of ten v tau or more), {means}."
    )
