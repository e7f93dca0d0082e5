"""The committed synthetic sets still give the committed numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tissueid import identify, read_trials

REFERENCE = Path(__file__).resolve().parents[2] / "reports" / "paper-a" / "identification.json"


def test_committed_sets_give_the_committed_identification(datasets: Path) -> None:
    expected = json.loads(REFERENCE.read_text(encoding="utf-8"))["specimens"]
    folders = (datasets / "paper-a-30-10Hz", datasets / "paper-a-hold-100Hz")
    found = identify([trial for folder in folders for trial in read_trials(folder)]).specimens
    assert [one.specimen for one in found] == [one["specimen"] for one in expected]
    for fit, reference in zip(found, expected, strict=True):
        assert fit.model.as_json() == reference["model"]
        for estimate, then in zip(fit.parameters, reference["parameters"], strict=True):
            assert (estimate.name, estimate.identified) == (then["name"], then["identified"])
            # data changed by 1e-15 of themselves move the estimates by 2e-4 of a standard error: the noise of
            # residuals is found in rounds, and processors differ in the last digits
            tolerance = 1e-3 * then["detail"]["estimate_stderr"]
            assert estimate.detail["estimate"] == pytest.approx(then["detail"]["estimate"], abs=tolerance)
        assert fit.nrmsd.range == pytest.approx(reference["nrmsd"]["range"], rel=1e-6)
