"""Files that somebody else put into the output folder stay."""

from __future__ import annotations

from pathlib import Path

import pytest

from tissueid.cli.main import main

LOG = Path(__file__).resolve().parents[2] / "datasets_synthetic" / "paper-a-hold-100Hz"


def test_a_report_that_is_not_ours_is_not_overwritten(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "report.html").write_text("mine", encoding="utf-8")
    assert main(["fit", str(LOG), "-o", str(tmp_path)]) == 2
    assert "report.html" in capfd.readouterr().err
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "mine"
