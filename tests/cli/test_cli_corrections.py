"""Corrections of one recording from the command line: contact, hold, rupture, exclusion."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from command_line import LOG, REPOSITORY, run


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


@pytest.mark.parametrize("other", [("--json",), ("--html", "x.html"), ("--no-study",)])
def test_a_served_page_takes_no_other_output(tmp_path: Path, other: tuple[str, ...]) -> None:
    (tmp_path / "one.csv").write_text("x", encoding="ascii")
    ended = run("inspect", str(tmp_path), "--serve", *other)
    assert ended.code == 2
    assert other[0] in ended.stderr


def test_a_hold_that_begins_after_the_end_is_an_error_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("x", encoding="ascii")
    (tmp_path / "study.toml").write_text(
        'schema = "tissueid/study/1"\n[[override]]\nfile = "one.csv"\nend_s = 4.0\nbecause = "x"\n'
        '[[override]]\nfile = "one.csv"\nhold_from_s = 5.0\nbecause = "y"\n',
        encoding="utf-8",
    )
    ended = run("inspect", str(tmp_path))
    assert ended.code == 3
    assert "line 2: one.csv: hold_from_s = 5 is not before end_s = 4" in ended.stderr


def test_the_served_page_is_told_and_ends_by_ctrl_c(tmp_path: Path) -> None:
    shutil.copy(LOG, tmp_path / "one.csv")
    serving = subprocess.Popen(
        [sys.executable, "-m", "tissueid", "inspect", str(tmp_path / "one.csv"), "--serve", "--no-browser"],
        cwd=REPOSITORY,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert serving.stderr is not None
        url = serving.stderr.readline().split()[-1]
        assert f"corrections go into {tmp_path / 'study.toml'}" in serving.stderr.readline()
        with urllib.request.urlopen(url, timeout=60) as answer:
            page = answer.read().decode("utf-8")
        assert url.startswith("http://127.0.0.1:")
        assert page.count('<form class="correct"') == 5
        serving.send_signal(signal.SIGINT)
        _, rest = serving.communicate(timeout=30)
    finally:
        serving.kill()
    assert serving.returncode == 0
    assert "Traceback" not in rest
    assert not (tmp_path / "study.toml").exists()
