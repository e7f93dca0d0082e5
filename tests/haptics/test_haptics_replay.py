"""A recorded motion, played again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import BundleError, DeviceError
from tissueid.haptics.replay import ReplayDevice
from tissueid.haptics.ring import RECORD
from tissueid.store import session_log

QUIET = np.zeros(3)


def motion(count: int = 200) -> np.ndarray:
    """Records of a motion on an uneven time base."""
    rng = np.random.default_rng(4)
    records = np.zeros(count, RECORD)
    records["time_s"] = 17.0 + np.cumsum(rng.uniform(5e-4, 2e-3, count))
    records["position_m"] = [0.0, 0.01, 0.13] + 0.01 * rng.normal(size=(count, 3)).cumsum(axis=0) / count
    records["buttons"] = np.arange(count) // 50
    return records


def player(monkeypatch: pytest.MonkeyPatch, records: np.ndarray, **options: object) -> ReplayDevice:
    """A replay device of records that need no file."""
    log = session_log.SessionLog(head={}, records=records, summary=None)
    monkeypatch.setattr(session_log, "read_session_log", lambda _path: log)
    return ReplayDevice(log="motion.h5", **options)  # type: ignore[arg-type]


def test_it_is_where_the_log_says_and_between_records_on_their_line(monkeypatch):
    records = motion()
    now = [3.0]
    device = player(monkeypatch, records, clock=lambda: now[0])
    own = records["time_s"] - records["time_s"][0]
    with device:
        first = device.read()
        np.testing.assert_array_equal(first.position_m, records["position_m"][0])
        for at in (20, 77, 150):
            now[0] = 3.0 + own[at]
            np.testing.assert_allclose(device.read().position_m, records["position_m"][at], atol=1e-15)
            now[0] = 3.0 + 0.5 * (own[at] + own[at + 1])
            between = 0.5 * (records["position_m"][at] + records["position_m"][at + 1])
            sample = device.read()
            np.testing.assert_allclose(sample.position_m, between, atol=1e-15)
            assert sample.buttons == at // 50
        assert not device.ended
        now[0] = 3.0 + own[-1] + 10.0
        np.testing.assert_array_equal(device.read().position_m, records["position_m"][-1])
        assert device.ended
    assert device.duration_s == pytest.approx(own[-1], abs=1e-12)
    assert device.longest_gap_s == pytest.approx(np.diff(own).max(), abs=1e-12)


def test_no_force_changes_the_motion(monkeypatch):
    records = motion()
    paths = []
    for force in (0.0, 3.0):
        device = player(monkeypatch, records, real_time=False)
        with device:
            device.engage()
            path = []
            for _ in range(150):
                path.append(device.read().position_m)
                device.write_force([0.0, 0.0, force], 1e-3)
            paths.append(np.array(path))
    np.testing.assert_array_equal(paths[0], paths[1])
    time = 1e-3 * np.arange(150)
    own = records["time_s"] - records["time_s"][0]
    expected = np.column_stack([np.interp(time, own, records["position_m"][:, axis]) for axis in range(3)])
    np.testing.assert_allclose(paths[0], expected, atol=1e-15)


def test_records_that_are_no_numbers_are_left_out(monkeypatch):
    records = motion()
    records["position_m"][60, 1] = np.nan
    device = player(monkeypatch, records, real_time=False)
    assert device.longest_gap_s == pytest.approx(records["time_s"][61] - records["time_s"][59], abs=1e-12)


@pytest.mark.parametrize("spoil", ["short", "backward"])
def test_a_log_without_motion_is_refused(monkeypatch, spoil):
    records = motion()
    if spoil == "short":
        records = records[:1]
    else:
        records["time_s"][100] = 0.0
    with pytest.raises(DeviceError, match="hold no motion"):
        player(monkeypatch, records)


def test_a_log_that_is_none_is_refused_and_a_missing_one_asked_for(tmp_path: Path):
    file = tmp_path / "log.h5"
    file.write_bytes(b"something else")
    with pytest.raises(BundleError, match=r"log\.h5"):
        ReplayDevice(log=file)
    with pytest.raises(DeviceError, match="give one with --replay"):
        ReplayDevice().open()
    assert "needs the log" in ReplayDevice.detect()[0].note
    assert not ReplayDevice().capabilities.hardware
