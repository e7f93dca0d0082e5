"""A load limit that the header states is part of the protocol; a maximum among the results is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from tissueid.ingest import read_trials

ROWS = "\n".join(f'"{0.1 * k:.5f}","{0.2 * k:.5f}","{1.5 * k:.5f}"' for k in range(20))


@pytest.mark.parametrize(
    ("line", "limit_N"),
    [
        ('Test : Load limit,"0.05000",kN', 50.0),
        ('Control : Force limit,"50.00000",N', 50.0),
        ('Test : Kraftgrenze,"50.00000",N', 50.0),
        ('Results : Maximum load,"50.00000",N', None),
        ('Test : Load limit,"50.00000",mm', None),
    ],
)
def test_a_stated_load_limit_is_read(tmp_path: Path, line: str, limit_N: float | None) -> None:
    path = tmp_path / "limit.csv"
    path.write_text(f"{line}\n\nTime,Extension,Load\n(s),(mm),(N)\n{ROWS}\n", encoding="utf-8")
    (trial,) = read_trials(path)
    assert trial.protocol.load_limit_N == (None if limit_N is None else pytest.approx(limit_N))
