"""What to do after a test, while the specimen is still on the machine.

Rules by flag code, gravest first: what spoils the test asks for a repetition, what spoils the series for
another setting, what only limits the result is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from tissueid.flags import Flag

__all__ = ["LEVELS", "advice_of"]

#: From good to bad.
LEVELS = ("good", "look", "repeat", "refused")

#: Code -> what to do again, and how.
_REPEAT: Mapping[str, str] = MappingProxyType(
    {
        "too_few_samples": "the log has too few samples; sample faster, or let the test run to its end",
        "no_contact": "the tool never met the tissue; start nearer, or push deeper",
        "no_ramp": "no loading ramp was found",
        "clipped_force": "the load cell is at its limit; take a larger cell, or less depth",
        "aborted_ramp": "the ramp ended before its depth",
        "tension": "force and travel have opposite signs; check the mounting, or state it with --compression",
        "no_decimals": "the numbers have no decimals; export again with more digits",
    }
)
#: Code -> which setting to change before the next test.
_CHANGE: Mapping[str, str] = MappingProxyType(
    {
        "quantised_force": "the force has too few levels; take a smaller load cell, or export more digits",
        "below_resolution": "a channel has too few steps; export more digits, or take a finer sensor",
        "below_cell_range": "the force is below the cell's verified range; take a smaller cell",
        "commanded_displacement": "the displacement looks commanded; export the measured one",
        "gap": "the log has gaps; log at a constant rate",
        "starts_in_contact": "the log starts in contact; start in air, so that contact and zero are seen",
        "contact_uncertain": "contact is poorly known; start in air, approach at the same speed",
        "baseline_drift": "the load cell drifts in air; let it warm up, then zero it",
        "jump": "the travel leaps between two samples; log at a constant rate",
        "spike": "single samples stand far off; look for a bad cable",
        "load_limit_stop": "a load limit ended the move; the depth is not what was asked for",
        "not_preconditioned": "the last cycles still change; precondition longer",
        "cut_row": "the last row is cut; let the export finish, or export again",
        "corner_slow": "the crosshead stops slowly; relaxation faster than that is not seen",
    }
)
#: Share by which the force of equal tests may differ before it is said.
DRIFT_SAID = 0.1


def advice_of(
    flags: Sequence[Flag], *, tau: Mapping[str, Any], drift: Mapping[str, Any] | None
) -> tuple[str, list[str]]:
    """How good a test is, and what to do.

    Parameters
    ----------
    flags : sequence of Flag
        Of the recording and its segments.
    tau : mapping
        ``tau`` of a verdict: whether the hold times a relaxation.
    drift : mapping or None
        ``drift`` of a verdict.

    Returns
    -------
    level : str
        Of :data:`LEVELS`.
    advice : list of str
        The gravest first; a sentence that starts with "repeat this test" asks for that.
    """
    codes = [flag.code for flag in flags]
    again = [f"repeat this test: {_REPEAT[code]}" for code in _REPEAT if code in codes]
    if "rupture" in codes:
        again.insert(0, "do not repeat here: the tissue broke or the tool slipped; take another site")
    change = [f"before the next test: {_CHANGE[code]}" for code in _CHANGE if code in codes]
    if tau["advice"] is not None and not again:
        change.append(tau["advice"])
    if drift is not None and abs(drift["from_first"]) > DRIFT_SAID:
        way = "below" if drift["from_first"] < 0.0 else "above"
        change.append(
            f"the force is {abs(drift['from_first']):.0%} {way} that of the first equal test of this"
            " specimen: conditioning, damage or drying; rest longer, and randomise the order"
        )
    level = "repeat" if again else "look" if change else "good"
    return level, again + change
