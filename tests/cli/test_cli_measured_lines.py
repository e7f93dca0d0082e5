"""What was measured, in the lines of ``fit``."""

from __future__ import annotations

from typing import Any

from typed_call import typed_call

from tissueid.report.specimen_lines import brief_measured_lines, measured_lines

brief_measured_lines = typed_call(brief_measured_lines)
measured_lines = typed_call(measured_lines)


def row(name: str, mean: float | None, **more: Any) -> dict[str, Any]:
    kept = {"unit": "N", "program": 1, "hold": 1, "time_s": None, "ramp_time_s": [2.0, 2.0], "count": 3}
    return {"name": name, "mean": mean, "sd": 0.5, "reason": None} | kept | more


ROWS = (
    row("peak", 10.0),
    row("force", 8.0, time_s=1.0),
    row("force", 6.0, time_s=10.0),
    row("peak", 4.0, program=2, hold=0),
    row("peak", 2.0, program=3, hold=0),
)


def test_a_specimen_among_many_has_one_line_of_its_first_program() -> None:
    assert brief_measured_lines(ROWS) == [
        "measured    peak 10.00 ± 0.50 N, F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N, 2 more programs"
    ]
    assert brief_measured_lines(()) == []
    assert brief_measured_lines([row("peak", None)]) == []


def test_a_specimen_alone_shows_two_programs_and_counts_the_others() -> None:
    lines = measured_lines(ROWS)
    assert lines[0].startswith(
        "measured program 1, no model, ± sd of 3 logs, ramp of 2 s: peak 10.00 ± 0.50 N"
    )
    assert lines[1] == "  F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N"
    assert lines[2].startswith("measured program 2, no model")
    assert lines[3] == "1 more programs and holds stand in the report"
