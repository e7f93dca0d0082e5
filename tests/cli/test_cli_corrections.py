"""Corrections of one recording from the command line: contact, hold, rupture, exclusion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run


def test_the_command_line_takes_them_and_says_so(tmp_path: Path) -> None:
    time = np.arange(0.0, 14.0, 0.02)
    depth = np.minimum(time, 4.0)
    force = 2.0 * depth + 3.0 * np.where(time < 4.0, depth, 4.0 * np.exp(-(time - 4.0) / 2.0))
    lines = [f"{t:.3f},{x:.5f},{f:.5f}" for t, x, f in zip(time, depth, force, strict=True)]
    for name in ("one.csv", "two.csv"):
        rows = "\n".join(["Time,Extension,Load", "(s),(mm),(N)", *lines])
        (tmp_path / name).write_text(rows + "\n", encoding="utf-8")
    ended = run("inspect", str(tmp_path), "--hold-from", "4.5", "--exclude", "two.csv", "--json")
    one, two = ended.json()
    assert [phase["start_s"] for phase in one["phases"] if phase["kind"] == "hold"] == [pytest.approx(4.5)]
    assert one["excluded"] is None
    assert two["excluded"] == "--exclude two.csv"
    assert run("inspect", str(tmp_path), "--hold-from", "5", "--hold-to", "4").code == 2
