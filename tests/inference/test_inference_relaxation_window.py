"""The one relaxation time under shorter holds: of a broad relaxation it follows the window."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.inference.second_looks import _slope, relaxation_window
from tissueid.inference.specimen import window_flags
from tissueid.synth import Branch, Hold, Log, Move

LOGS = tuple(Log(f"hold-{v:.0f}", (Move(4.0, v), Hold(16.0))) for v in (240.0, 480.0))
BROAD = tuple(Branch((8.0,), tau) for tau in (0.1, 0.5, 2.5, 12.0))


def window(tissue, logs=LOGS, seed=1, **asked):
    handles = handles_for(draw(small_recipe(branches=tissue, logs=logs, sigma_N=0.05), seed))
    ours = identified(handles, noise="white", **asked)
    said = []
    return relaxation_window(handles, ours, said.append), said


def test_one_time_is_the_same_in_every_window():
    found, said = window((Branch((30.0,), 0.8),))
    assert said == ["relaxation time of shorter windows"]
    assert found.cut_s == pytest.approx((16.0, 8.0, 4.0), rel=1e-3)
    for tau, error in zip(found.tau_s, found.stderr_s, strict=True):
        assert abs(tau - 0.8) <= 4.0 * error
    assert abs(found.slope) <= 4.0 * found.slope_stderr
    assert found.slope_stderr < 0.02
    # a shorter window knows no more
    assert found.stderr_s[2] >= found.stderr_s[0]


def test_a_broad_relaxation_follows_its_window():
    found, _ = window(BROAD, branches=(2,))
    assert found.tau_s[0] > 1.3 * found.tau_s[1] > 1.3 * 1.3 * found.tau_s[2]
    assert 0.3 < found.slope < 1.2
    assert found.slope > 10.0 * found.slope_stderr


def test_without_a_hold_or_with_a_short_one_there_is_none():
    ramps = tuple(Log(f"ramp-{v:.0f}", (Move(4.0, v),)) for v in (60.0, 240.0))
    assert window((Branch((30.0,), 0.2),), logs=ramps)[0] is None
    short = tuple(Log(f"hold-{v:.0f}", (Move(4.0, v), Hold(0.1))) for v in (60.0, 240.0))
    assert window((Branch((30.0,), 0.2),), logs=short)[0] is None


def test_a_hold_that_bears_two_windows_gives_two():
    logs = (Log("a", (Move(4.0, 240.0), Hold(0.24))), *small_recipe().logs[:2])
    found, _ = window((Branch((30.0,), 0.05),), logs=logs)
    assert len(found.cut_s) == 2


def test_a_slope_is_that_of_the_line():
    x = np.log([4.0, 2.0, 1.0])
    slope, error = _slope(x, 0.7 * x + 3.0, np.array([0.1, 0.2, 0.3]))
    assert slope == pytest.approx(0.7)
    by = np.linalg.pinv(np.column_stack([x, np.ones(3)]))[0]
    assert error == pytest.approx(float(np.sqrt(by**2 @ np.array([0.01, 0.04, 0.09]))))


def test_a_time_that_follows_its_window_is_said_with_both():
    found, _ = window(BROAD, branches=(2,))
    (flag,) = window_flags(found)
    assert flag.code == "form_dependent"
    assert f"{found.tau_s[0]:.3g} s in 16 s" in flag.message
    assert window_flags(None) == window_flags(window((Branch((30.0,), 0.8),))[0]) == ()
