"""Recordings at URLs are read where they lie, as those of a folder are."""

import sys
from pathlib import Path

import pytest
from ingest_files import read, refusal

from tissueid.errors import UsageError
from tissueid.ingest import each_input, read_trials
from tissueid.ingest.loading import url_of

fsspec = pytest.importorskip("fsspec")

ROWS = "".join(f"{0.1 * k:.1f},{0.05 * k:.3f},{0.3 * k:.2f}\n" for k in range(40))
LOG = f"Time,Displacement,Force\n(s),(mm),(N)\n{ROWS}".encode()


@pytest.fixture
def memory() -> object:
    """A file system in memory with two recordings, prose, hidden files and an output of tissueid."""
    system = fsspec.filesystem("memory")
    files = {
        "/lab/ramp-10.csv": LOG, "/lab/ramp-2.csv": LOG, "/lab/notes.txt": b"Calibrated in May.\n",
        "/lab/.hidden.csv": LOG, "/lab/out/identification.json": b"{}", "/lab/out/curves.csv": LOG,
    }  # fmt: skip
    for name, content in files.items():
        system.pipe_file(name, content)
    yield system
    system.rm("/lab", recursive=True)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("s3://bucket/logs", "s3://bucket/logs"), (str(Path("s3://bucket/logs")), "s3://bucket/logs"),
        (str(Path("file:///data/logs")), "file:///data/logs"), ("C:/data", None), ("logs/a.csv", None),
    ],
)  # fmt: skip
def test_a_url_is_told_from_a_path(path: str, expected: str | None) -> None:
    assert url_of(path) == expected


def test_a_folder_at_a_url_is_searched_as_one_of_this_machine_is(memory: object) -> None:
    found = [url_of(path) for path in each_input(["memory://lab"])]
    assert found == ["memory://lab/ramp-2.csv", "memory://lab/ramp-10.csv"]


def test_a_recording_at_a_url_is_that_of_the_file(memory: object, tmp_path: Path) -> None:
    (tmp_path / "ramp-2.csv").write_bytes(LOG)
    local = read(tmp_path / "ramp-2.csv")
    remote = {
        url: read_trials(url)[0] for url in ("memory://lab/ramp-2.csv", f"file://{tmp_path}/ramp-2.csv")
    }
    assert {url: trial.source.sha256 for url, trial in remote.items()} == dict.fromkeys(
        remote, local.source.sha256
    )
    assert all((trial.force_N == local.force_N).all() for trial in remote.values())


def test_what_is_not_there_is_refused_by_name(memory: object) -> None:
    with pytest.raises(UsageError, match="memory://nowhere: there is no such file or directory"):
        list(each_input(["memory://nowhere"]))
    assert refusal("memory://lab/gone.csv").code == "unreadable_file"


def test_a_protocol_that_nothing_reads_is_refused_with_the_way_out() -> None:
    with pytest.raises(UsageError, match="nosuch"):
        list(each_input(["nosuch://bucket/logs"]))


def test_without_fsspec_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(UsageError, match=r"pip install 'tissueid\[remote\]'"):
        list(each_input(["memory://lab"]))
