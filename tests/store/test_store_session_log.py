"""A session's log is whole after a kill, sealed after its close, and read as a recording."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from session_heads import head_of, indentation, records_of, summary_of

from tissueid.errors import BundleError
from tissueid.haptics.ring import RECORD
from tissueid.store.session_log import (
    RAW_MAGIC,
    convert_session_log,
    is_session_log,
    raw_head,
    read_session_log,
)


@pytest.fixture(scope="module")
def records():
    return records_of(indentation(2.0))


@pytest.fixture
def raw(tmp_path, records):
    path = tmp_path / "out.h5.part"
    path.write_bytes(raw_head(head_of(), RECORD) + records.tobytes())
    return path


def test_a_raw_log_comes_back_record_by_record_without_one_that_was_cut(raw, records):
    log = read_session_log(raw)
    assert log.records.tobytes() == records.tobytes()
    assert log.head["scale"] == head_of()["scale"]
    assert log.summary is None
    raw.write_bytes(raw.read_bytes()[:-5])
    assert read_session_log(raw).records.tobytes() == records[:-1].tobytes()


def test_records_outlive_a_kill_in_the_middle_of_writing(tmp_path):
    path = tmp_path / "killed.h5"
    script = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "from pathlib import Path\n"
        "from session_heads import head_of, indentation, records_of\n"
        "from tissueid.rendering.recorder import Recorder\n"
        "recorder = Recorder(Path(sys.argv[1]), head_of())\n"
        "records = records_of(indentation(2.0))\n"
        "while True:\n"
        "    recorder.append(records)\n"
        "    print(recorder.written, flush=True)\n"
    )
    folders = [str(Path(__file__).parents[1])]
    with subprocess.Popen(
        [sys.executable, "-c", script, str(path), *folders], stdout=subprocess.PIPE, text=True
    ) as process:
        said = [int(process.stdout.readline()) for _ in range(3)][-1]
        os.kill(process.pid, signal.SIGKILL)
    log = read_session_log(path.with_name("killed.h5.part"))
    assert log.records.size >= said
    assert (np.diff(log.records["tick"][: said // 3]) == 1).all()


def test_the_hdf5_file_holds_the_same_records_and_the_summary(raw, records, tmp_path):
    target = tmp_path / "out.h5"
    convert_session_log(raw, target, summary_of(records))
    log = read_session_log(target)
    assert log.records.tobytes() == records.tobytes()
    assert log.summary == summary_of(records)
    assert log.summary["ticks"] == records.size
    with h5py.File(target) as file:
        assert file.attrs["format"] == "tissueid/session"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".tmp")] == []


def stronger(file: Any) -> None:
    changed = file["records"][()]
    changed["force_N"] *= 1.01
    file["records"][...] = changed


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (stronger, "changed since it was written"),
        (lambda file: file.attrs.modify("schema_version", np.int64(2)), "schema version 2"),
    ],
)
def test_a_log_that_was_edited_is_refused(raw, records, tmp_path, edit, words):
    target = tmp_path / "out.h5"
    convert_session_log(raw, target, summary_of(records))
    with h5py.File(target, "r+") as file:
        edit(file)
    with pytest.raises(BundleError, match=words):
        read_session_log(target)


def test_a_log_without_its_head_or_with_another_is_refused_by_name(raw):
    whole = raw.read_bytes()
    heads = (b"[]", b"{}", b"not json", b'{"schema": "tissueid/session/9"}')
    cut = [whole[:length] for length in (0, 10, 20, 200)]
    for content in (*cut, *(RAW_MAGIC + len(head).to_bytes(8, "little") + head for head in heads)):
        raw.write_bytes(content)
        with pytest.raises(BundleError, match=r"out\.h5\.part: "):
            read_session_log(raw)
    raw.write_bytes(raw_head(head_of(), np.dtype([("time_s", "<f8"), ("force_N", "<f8", (3,))])))
    with pytest.raises(BundleError, match="records lack position_m"):
        read_session_log(raw)


def test_other_files_are_no_session_logs_and_a_head_holds_what_the_schema_allows(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["format"] = "tissueid/bundle"
    assert not is_session_log((tmp_path / "other.h5").read_bytes())
    assert not is_session_log(b"time,force\n")
    assert not is_session_log(b"\x89HDF\r\n\x1a\ndamaged")
    with pytest.raises(BundleError, match="format is 'tissueid/bundle'"):
        read_session_log(tmp_path / "other.h5")
    with pytest.raises(BundleError, match="can't be read"):
        read_session_log(tmp_path / "missing.h5")
    with pytest.raises(BundleError, match="name_of_the_person"):
        raw_head(head_of(name_of_the_person="Anna"), RECORD)
