"""What `study init` understood of the programs: groups, steps, holds, speeds and their counts."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tissueid.ingest.manifest import read_study
from tissueid.study.draft import draft_study, programs_of
from tissueid.trial import Protocol, Source, Trial


def pushed(
    name: str, *steps: tuple[float, float, float], air_mm: float = 0.5, stated: float | None = None
) -> Trial:
    """Steps of (travel [mm], speed [mm/s], hold [s]) from above a springy tissue; 50 Hz."""
    times, places = [0.0, 1.0], [0.0, 0.0]
    for travel, speed, hold in steps:
        times += [times[-1] + travel / speed, times[-1] + travel / speed + hold]
        places += [places[-1] + travel, places[-1] + travel]
    time = np.arange(0.0, times[-1], 0.02)
    x = np.interp(time, times, places)
    depth = np.maximum(x - air_mm, 0.0)
    lag = np.zeros_like(depth)
    for i in range(1, depth.size):
        lag[i] = lag[i - 1] + (depth[i] - lag[i - 1]) * 0.02 / 1.5
    force = 2.0 * depth + 3.0 * (depth - lag) + np.random.default_rng(5).normal(0.0, 0.002, depth.size)
    protocol = Protocol(speed_mm_s=stated)
    return Trial(name, time, x, force, source=Source(path=f"{name}.csv"), protocol=protocol)


def test_recordings_of_one_program_are_one_whatever_their_depth():
    trials = [
        pushed("a", (4.0, 1.0, 12.0)),
        pushed("b", (4.02, 1.01, 12.1)),
        pushed("c", (4.0, 0.25, 12.0)),
        pushed("d", (3.0, 1.0, 12.0), air_mm=0.3),
    ]
    fast, slow = programs_of(trials)
    assert (fast.trials, slow.trials) == ([0, 1, 3], [2])
    assert fast.table["kind"] == "ramp-hold"
    assert fast.table["speed_mm_s"] == pytest.approx(1.0, rel=0.02)
    assert fast.table["hold_s"] == pytest.approx(12.0, rel=0.02)
    # 3 and 4 mm are no one depth: a range in the comments
    assert "depth_mm" not in fast.table
    assert slow.table["depth_mm"] == pytest.approx(4.0, rel=0.01)
    assert "3 recordings of 3 specimens" in fast.comments()
    assert "travel 3.00 to 4.02 mm" in fast.comments()


def test_steps_are_told_and_one_number_for_several_is_not_made_up():
    (alike,) = programs_of([pushed("a", *3 * [(1.0, 0.5, 15.0)])])
    assert re.fullmatch(r"3 steps, each 1\.0+ mm at 0\.500 mm/s, held 15\.0 s", alike.table["notes"])
    assert alike.table["hold_s"] == pytest.approx(15.0, rel=0.02)
    assert alike.name.startswith("ramp-hold in 3 steps")
    (mixed,) = programs_of([pushed("a", (1.5, 0.5, 10.0), (1.0, 0.1, 20.0))])
    told = r"2 steps: 1\.50 mm at 0\.500 mm/s, held 10\.0 s; 1\.0+ mm at 0\.10+ mm/s, held 20\.0 s"
    assert re.fullmatch(told, mixed.table["notes"])
    assert not {"hold_s", "speed_mm_s"} & set(mixed.table)


def test_the_speed_of_a_header_is_the_program_s():
    trials = [pushed("a", (4.0, 1.0, 12.0), stated=1.2), pushed("b", (4.0, 0.9, 12.0), stated=1.2)]
    (program,) = programs_of(trials)
    assert program.table["speed_mm_s"] == 1.2


def test_the_drafted_file_holds_the_counts_and_is_read_again(tmp_path):
    trials = [
        pushed(name, (4.0, 1.0, 12.0), *more)
        for name, more in (("a", ()), ("b", ()), ("c", [(1.0, 1.0, 12.0)]))
    ]
    text = draft_study(tmp_path, trials)
    assert "# 2 recordings of 2 specimens\n" in text
    assert "mm/s, held 12.0 s\n" in text
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("x", encoding="ascii")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    study = read_study(tmp_path)
    assert [entry.values["protocol"] in study.protocols for entry in study.trials] == [True] * 3
    assert len(study.protocols) == 2
