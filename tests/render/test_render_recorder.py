"""The recorder keeps what it got, stops where the disk is full, and never overwrites."""

from __future__ import annotations

import resource
import subprocess
from pathlib import Path

import pytest
from command_line import REPOSITORY, python
from session_heads import head_of, indentation, records_of, summary_of

from tissueid.errors import UsageError
from tissueid.rendering.recorder import Recorder
from tissueid.store.session_log import read_session_log


def test_what_was_appended_is_in_the_log_and_the_part_is_gone(tmp_path: Path) -> None:
    records = records_of(indentation(1.0))
    recorder = Recorder(tmp_path / "out.h5", head_of())
    for piece in (records[:100], records[100:100], records[100:]):
        recorder.append(piece)
    assert recorder.finish(summary_of(records)) == tmp_path / "out.h5"
    assert recorder.stopped is None
    assert read_session_log(tmp_path / "out.h5").records.tobytes() == records.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["out.h5"]


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out.h5").write_bytes(b"mine")
    with pytest.raises(UsageError, match="exists already"):
        Recorder(tmp_path / "out.h5", head_of())
    (tmp_path / "other.h5.part").write_bytes(b"mine")
    with pytest.raises(UsageError, match="left by a session that was killed"):
        Recorder(tmp_path / "other.h5", head_of())
    assert (tmp_path / "other.h5.part").read_bytes() == b"mine"


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="can't be written"):
        Recorder(tmp_path / "missing" / "out.h5", head_of())


FULL_DISK = """
import resource, sys
sys.path[:0] = sys.argv[3:]
from pathlib import Path
from session_heads import head_of, indentation, records_of, summary_of
from tissueid.rendering.recorder import Recorder
records, limit = records_of(indentation(2.0)), int(sys.argv[2])
if limit < 1000:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
recorder = Recorder(Path(sys.argv[1]), head_of())
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
for start in range(0, len(records), 100):
    recorder.append(records[start : start + 100])
print(recorder.written, len(records), recorder.stopped, recorder.finish(summary_of(records)), sep="|")
"""


def recorded_within(limit_bytes: int, log: Path) -> subprocess.CompletedProcess[str]:
    """A recording in a process whose files may not be larger."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] in (-1, resource.RLIM_INFINITY)
    return python("-c", FULL_DISK, log, str(limit_bytes), REPOSITORY / "tests", check=False)


def test_a_full_disk_stops_the_recording_and_keeps_what_is_there(tmp_path: Path) -> None:
    shown = recorded_within(60_000, tmp_path / "out.h5")
    written, given, stopped, where = shown.stdout.strip().split("|")
    assert 0 < int(written) < int(given)
    assert "File too large" in stopped
    assert read_session_log(Path(where)).records.size >= int(written)


def test_no_room_even_for_the_head_is_said_before_the_session(tmp_path: Path) -> None:
    shown = recorded_within(64, tmp_path / "out.h5")
    assert "UsageError" in shown.stderr
    assert "choose another place" in shown.stderr
    assert list(tmp_path.iterdir()) == []
