"""Bombs, junk, pipes, circles and moving files: bounded time and memory, one clear message, no traceback."""

import contextlib
import os
import socket
import sys
import threading
import time
from pathlib import Path

import hostile_files as hostile
import pytest
from ingest_files import put, read, refusal

from tissueid.errors import InputError
from tissueid.ingest import each_input, find_inputs, loading, read_each

#: What reading may take: the libraries alone map about one GiB of address space.
ADDRESS_SPACE = 3 << 30
MEBI = 1 << 20
#: A second or two on a quiet machine; a reader that takes squared or endless time takes far longer.
LONGEST_S = 20.0
SOON_S = 5.0
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="limits, pipes and links of a POSIX system")


def bounded(folder: Path, files: dict[str, bytes]) -> dict[str, hostile.Verdict]:
    """Verdicts of a child on files, in the time and memory of a real workbook of some megabytes."""
    for name, data in files.items():
        (folder / name).write_bytes(data)
    paths = [folder / name for name in files]
    verdicts = hostile.read_in_child(paths, memory_bytes=ADDRESS_SPACE, timeout_s=100.0)
    for name, verdict in verdicts.items():
        assert verdict.seconds < LONGEST_S, name
        assert verdict.peak_bytes < 600 * MEBI, name
    return verdicts


@linux_only
def test_hostile_workbooks_are_refused_in_bounded_time_and_memory(tmp_path: Path) -> None:
    verdicts = bounded(tmp_path, hostile.hostile_workbooks())
    assert verdicts.pop("sound.xlsx").codes == ("read",)
    for name, verdict in verdicts.items():
        assert verdict.codes in (("unreadable_workbook",), ("no_trial_sheet",)), name
        assert "\n" not in verdict.messages[0]
    for name in ("far.xlsx", "far-row.xlsx", "far-column.xlsx", "far.xlsb"):
        assert "stray cells" in verdicts[name].messages[0], name
    assert "times its size" in verdicts["ratio.xlsx"].messages[0]


@linux_only
def test_hostile_archives_are_refused_or_read_in_bounded_time_and_memory(tmp_path: Path) -> None:
    files = hostile.hostile_archives()
    verdicts = bounded(tmp_path, files)
    assert verdicts.pop("sound.zip").codes == ("read",)
    # members are read where they are, whatever place they name
    assert verdicts.pop("outside.zip").codes == ("read", "read")
    assert {path.name for path in tmp_path.iterdir()} == set(files)
    for name, verdict in verdicts.items():
        assert "read" not in verdict.codes, name
    assert set(verdicts["bomb.zip"].codes) == {"unreadable_archive"}
    assert "a.csv" in verdicts["bomb.zip"].messages[0]
    assert "MiB" in verdicts["bomb.zip"].messages[0]


@linux_only
def test_hostile_texts_are_refused_or_read_in_bounded_time_and_memory(tmp_path: Path) -> None:
    verdicts = bounded(tmp_path, hostile.hostile_texts())
    assert {len(verdict.codes) for verdict in verdicts.values()} == {1}
    # a last row that was not written to its end, or a file that was filled ahead
    assert verdicts["half-row.csv"].codes == verdicts["nul-tail.csv"].codes == ("read",)
    for name in ("junk.csv", "nested.json.csv", "headers-only.csv", "bom-soup.csv"):
        assert verdicts[name].codes == ("not_an_export",), name
    refused = (
        "junk-after-head", "junk-late", "nul-inside", "wide-name", "big-exponent", "many-marks",
    )  # fmt: skip
    for stem in refused:
        assert verdicts[f"{stem}.csv"].codes != ("read",), stem


def endless_lines(folder: Path, size: int) -> list[Path]:
    rows = b"".join(b"%.1f,%.2f,%.2f\n" % (0.1 * i, 0.1 * i, 0.2 * i) for i in range(50))
    return [
        hostile.endless(folder / "one-line.csv", size),
        hostile.endless(folder / "one-line.txt", size, piece=b"1.5,2.5,3.5,"),
        hostile.endless(folder / "second-line.csv", size, start=hostile.HEAD + rows),
        hostile.endless(folder / "utf-16.csv", size, start=b"\xff\xfe", piece=b"1\x00,\x00"),
        hostile.endless(folder / "zeros.csv", size, piece=b"\0\0"),
        hostile.endless(folder / "spaces.csv", size, piece=b"  "),
    ]


@linux_only
@pytest.mark.parametrize(
    ("size", "longest_s"), [(64 * MEBI, LONGEST_S), pytest.param(1 << 30, 60.0, marks=pytest.mark.slow)]
)
def test_a_line_of_64_mib_or_more_is_refused_by_its_beginning(tmp_path, size, longest_s) -> None:
    paths = endless_lines(tmp_path, size)
    try:
        verdicts = hostile.read_in_child(paths, memory_bytes=ADDRESS_SPACE + 2 * size, timeout_s=300.0)
    finally:
        for path in paths:  # gigabytes: not left for the next runs
            path.unlink()
    for name, verdict in verdicts.items():
        assert verdict.codes in (("not_an_export",), ("empty_file",)), name
        assert verdict.seconds < (SOON_S if name == "one-line.csv" else longest_s), name
        # the file itself, in pieces and joined, and the libraries
        assert verdict.peak_bytes < 300 * MEBI + 2.2 * size, name
        assert name != "second-line.csv" or "line 53" in verdict.messages[0]


def test_a_file_larger_than_any_recording_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "disk.csv"
    with path.open("wb") as stream:
        stream.write(hostile.HEAD)
        stream.truncate(loading.LARGEST_BYTES + 1)  # sparse: takes no room
    start = time.perf_counter()
    error = refusal(path)
    assert (error.code, "2.0 GiB" in error.message) == ("unreadable_file", True)
    assert time.perf_counter() - start < SOON_S


@pytest.mark.parametrize(
    ("fault", "word"),
    [(MemoryError(), "memory"), (OSError(116, "Stale file handle"), "Stale file handle")],
    ids=["little memory", "a server that went away"],
)
def test_what_keeps_a_file_from_being_read_is_told(tmp_path, monkeypatch, fault, word) -> None:
    def failing(handle: int, size: int) -> bytes:
        raise fault

    path = put(tmp_path / "a.csv", hostile.HEAD + b"0,1,2\n1,2,3\n")
    monkeypatch.setattr(loading.os, "read", failing)
    error = refusal(path)
    assert (error.code, word in error.message) == ("unreadable_file", True)


@linux_only
def test_what_is_no_file_is_refused_by_its_kind_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    os.mkfifo(tmp_path / "pipe.txt")
    os.mkfifo(tmp_path / "pipe.zip")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    (tmp_path / "self.csv").symlink_to("self.csv")
    (tmp_path / "gone.csv").symlink_to("nowhere.csv")
    listener = socket.socket(socket.AF_UNIX)
    with contextlib.chdir(tmp_path):  # the name of a socket may be 107 bytes long
        listener.bind("socket.csv")
    start = time.perf_counter()
    found = find_inputs([tmp_path])
    said = {path.name: refusal(path) for path in found}
    listener.close()
    assert time.perf_counter() - start < SOON_S
    assert {name: error.code for name, error in said.items()} == dict.fromkeys(
        ["pipe.csv", "pipe.txt", "pipe.zip", "zero.csv", "self.csv", "gone.csv", "socket.csv"],
        "unreadable_file",
    )
    for name, word in (("pipe.csv", "a pipe"), ("zero.csv", "a device"), ("gone.csv", "No such file")):
        assert word in said[name].message


@linux_only
def test_links_in_circles_and_deep_folders_end(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.csv").write_bytes(hostile.HEAD)
    for name in "abcde":
        (tmp_path / "a" / f"to-{name}").symlink_to("../b")
        (tmp_path / "b" / f"to-{name}").symlink_to("../a")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "folder.csv" / "inside.csv").write_bytes(hostile.HEAD)
    deep = tmp_path
    for _ in range(1200):  # more than the interpreter's stack bears, less than a path's 4096 bytes
        deep /= "d"
        deep.mkdir()
    (deep / "deep.csv").write_bytes(hostile.HEAD)
    start = time.process_time()
    found = list(each_input([tmp_path]))
    names = sorted(item.name for item in found if isinstance(item, Path))
    circles = {Path(item.path).name: item for item in found if isinstance(item, InputError)}
    seconds = time.process_time() - start
    # what clears folders after a test recurses
    (deep / "deep.csv").unlink()
    while deep != tmp_path:
        deep.rmdir()
        deep = deep.parent
    assert names == ["a.csv", "b.csv", "deep.csv", "inside.csv"]
    assert sorted(circles) == [f"to-{name}" for name in "abcde"]
    for error in circles.values():
        assert error.code == "unreadable_file"
        assert "circle" in error.message
    # five links each way between two folders are 5 ** 40 paths before the system sees the circle
    assert seconds < 20.0


@linux_only
def test_links_of_a_folder_do_not_lead_outside_it(tmp_path: Path) -> None:
    inside, outside = tmp_path / "lab", tmp_path / "elsewhere"
    for folder in (inside / "real", outside):
        folder.mkdir(parents=True)
        (folder / "a.csv").write_bytes(hostile.HEAD)
    (inside / "alias").symlink_to("real")
    (inside / "away").symlink_to(outside)
    (inside / "away.csv").symlink_to(outside / "a.csv")
    found = list(each_input([inside]))
    # a folder of two names is read under the first
    assert [item.parent.name for item in found if isinstance(item, Path)] == ["alias"]
    refused = {Path(item.path).name: item for item in found if isinstance(item, InputError)}
    assert sorted(refused) == ["away", "away.csv"]
    assert all(str(outside) in error.message for error in refused.values())
    # a link that is named itself is followed
    assert [path.name for path in find_inputs([inside / "away"])] == ["a.csv"]


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path, monkeypatch) -> None:
    path = put(tmp_path / "a.csv", hostile.HEAD + b"0.1,1.5,2.5\n" * 9)
    real = os.read

    def growing(handle: int, size: int) -> bytes:
        with path.open("ab") as stream:
            stream.write(b"9.9,1.5,2.5\n")
        return real(handle, size)[:100]

    with monkeypatch.context() as patch:
        # a machine that writes faster than we read
        patch.setattr(loading.os, "read", lambda handle, size: growing(handle, size) if size else b"")
        patch.setattr(loading, "_PIECE_BYTES", 0)
        error = refusal(path)
    assert (error.code, "changed while it was read" in error.message) == ("unreadable_file", True)
    # when it is done the file is read
    read(path)


@linux_only
def test_a_slow_folder_is_read_once_and_byte_by_byte_as_it_comes(tmp_path, monkeypatch) -> None:
    """A network folder gives few bytes a call: no byte is asked for twice, and none is missed."""
    path = tmp_path / "a.csv"
    rows = b"".join(b"%.1f,%.2f,%.2f\n" % (0.1 * i, 0.1 * i, 0.2 * i) for i in range(200))
    path.write_bytes(hostile.HEAD + rows)
    real, asked = os.read, []

    def slow(handle: int, size: int) -> bytes:
        time.sleep(0.001)
        got = real(handle, min(size, 97))
        asked.append(len(got))
        return got

    monkeypatch.setattr(loading.os, "read", slow)
    trial = read(path)
    assert trial.time_s.size == 200
    assert sum(asked) == path.stat().st_size


def test_files_that_appear_and_vanish_while_a_folder_is_searched_do_not_stop_it(tmp_path: Path) -> None:
    keep = put(tmp_path / "keep.csv", hostile.HEAD + b"0.1,1.5,2.5\n0.2,2.5,3.5\n")
    stop = threading.Event()

    def busy() -> None:
        while not stop.is_set():
            for k in range(20):
                (tmp_path / f"t{k}.csv").write_bytes(hostile.HEAD)
            for k in range(20):
                (tmp_path / f"t{k}.csv").unlink()

    thread = threading.Thread(target=busy)
    thread.start()
    try:
        for _ in range(50):
            found = find_inputs([tmp_path])
            assert keep in found
            for path in found:
                list(read_each(path))
    finally:
        stop.set()
        thread.join()
