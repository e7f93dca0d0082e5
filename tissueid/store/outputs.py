"""The output folder: a run's files appear together or not at all, whenever the process is killed.

::

    OUT/
    |-- .lock               one writer at a time
    |-- .runs/000007/       the files of one run, and manifest.json with their hashes
    |-- .current            "000007": renaming this one file commits the run
    |-- .sampling/          chains that are being sampled; gone once the run is committed
    |-- identification.json, bundle-*.h5, report.html, ...   public copies of the current run

A run is written into its own folder.  Renaming ``.current`` commits it.  The public names are then
refreshed one by one; a kill in between leaves a mixture for as long as no command looks, because every
command calls :func:`complete_refresh` first, which finishes the work from the committed run.

The lock is the operating system's (``flock``, or ``msvcrt.locking`` on Windows) on the file ``.lock``,
so it vanishes with the process that held it, however that died: there are no stale locks to judge by
process numbers, which systems use again.  The file's text names the holder for the message.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from tissueid.documents.folder import Outputs
from tissueid.errors import BundleError, UsageError, refuse
from tissueid.store.files import (
    IDENTIFICATION,
    RUPTURE,
    TEMPORARY_PREFIX,
    json_bytes,
    replace_file,
    sha256_of,
    write_file,
)
from tissueid.store.schema import check

LOCK_NAME = ".lock"

# One byte far behind the text is locked: Windows forbids others to read a locked range
_LOCKED_BYTE = 1 << 20
_BUSY = {errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK}
_POLL_S = 0.05


def _try_lock(stream: IO[bytes]) -> bool:
    """Take the lock if it is free; ``False`` where another holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(_LOCKED_BYTE)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            try:
                from fcntl import LOCK_EX, LOCK_NB, flock
            except ModuleNotFoundError:  # a build of Python without it: locks of the process
                os.lockf(stream.fileno(), os.F_TLOCK, 1)
            else:
                flock(stream, LOCK_EX | LOCK_NB)
    except OSError as error:
        if error.errno in _BUSY:
            return False
        raise
    return True


@contextmanager
def folder_lock(folder: Path, *, wait_s: float = 0.0) -> Iterator[None]:
    """A context in which this process alone writes into a folder that exists.

    ``wait_s``: how long to wait for another writer [s].  Raises BundleError: on entering, where another
    process holds the lock or the file system knows no locks.
    """
    path, deadline = folder / LOCK_NAME, time.monotonic() + wait_s
    try:
        stream = path.open("ab+")
    except OSError as error:
        msg = f"{folder}: can't be written to ({error.strerror}); choose another output folder"
        raise BundleError(msg) from error
    # closing gives the lock back; the file stays, since deleting it would race with the next writer
    with stream:
        try:
            locked = _try_lock(stream)
            while not locked and time.monotonic() < deadline:
                time.sleep(_POLL_S)
                locked = _try_lock(stream)
        except OSError as error:
            raise BundleError(
                f"{folder}: this file system can't lock files ({error.strerror}); "
                "write to a local folder and copy the result"
            ) from error
        if not locked:
            try:
                holder = json.loads(path.read_bytes())
                who = f"process {holder['pid']} on {holder['host']}"
            except (OSError, ValueError, KeyError, TypeError):
                who = "another process"
            raise BundleError(f"{folder}: {who} is writing here; wait for it to end or choose another folder")
        stream.truncate(0)
        stream.write(json.dumps({"pid": os.getpid(), "host": platform.node()}).encode())
        stream.flush()
        try:
            yield
        finally:
            stream.truncate(0)


_RUNS = ".runs"
_CURRENT = ".current"
_SAMPLING = ".sampling"
_MANIFEST = "manifest.json"
_REFRESHED = ".refreshed"
_SCHEMA = "tissueid/outputs/1"

# A refresh copies a few megabytes: a second command waits this long for it
_REFRESH_WAIT_S = 20.0


@dataclass(frozen=True, slots=True)
class CommittedRun:
    """The run that an output folder shows."""

    folder: Path  # where its files were written
    files: dict[str, dict[str, Any]]  # ``name -> {"sha256", "bytes"}``
    replaces: tuple[str, ...]  # public names of the set before it


def current_run(out: Path | str) -> CommittedRun | None:
    """Find the committed run of an output folder, if any; BundleError if it is missing or damaged."""
    out = Path(out)
    run_id = _run_id(out)
    if run_id is None:
        return None
    folder = out / _RUNS / run_id
    if not run_id.isdigit() or not (folder / _MANIFEST).is_file():
        msg = f"{out}: its current run {run_id!r} is missing; restore the folder or run `tissueid fit` again"
        raise BundleError(msg)
    try:
        document = json.loads((folder / _MANIFEST).read_text(encoding="utf-8"))
    except ValueError as error:
        raise BundleError(f"{folder / _MANIFEST}: not JSON ({error}); run `tissueid fit` again") from error
    check(document, Outputs, where=str(folder / _MANIFEST))
    return CommittedRun(folder, document["files"], tuple(document["replaces"]))


def refuse_unwritten(out: Path, names: Sequence[str]) -> None:
    """Refuse, by UsageError, a folder of another command, or files of our names that no run made: they stay.

    ``names``: patterns of the files that the coming run writes.
    """
    for name, command in ((IDENTIFICATION, "fit"), (RUPTURE, "rupture")):
        if name not in names and (out / name).exists():
            refuse(f"{out} holds outputs of `tissueid {command}`, which this replaces: choose another folder")
    if (out / _CURRENT).exists() or not out.is_dir():
        return
    foreign = sorted(path.name for name in names for path in out.glob(name))
    if foreign:
        refuse(
            f"{out} holds {', '.join(foreign)} that tissueid did not write there: choose another folder "
            "with -o, or move them away"
        )


def _run_id(out: Path) -> str | None:
    """Name of the committed run; empty where its mark is damaged, ``None`` where there is none."""
    try:
        return (out / _CURRENT).read_text(encoding="ascii").strip()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError:
        return ""


def _is_refreshed(out: Path) -> bool:
    """True where there is nothing to finish: two small reads, so that every command can afford it."""
    run_id = _run_id(out)
    return run_id is None or (out / _RUNS / run_id / _REFRESHED).exists()


def complete_refresh(out: Path | str) -> None:
    """Finish a refresh that a kill interrupted, cheap where there is none; BundleError where it can not."""
    out = Path(out)
    if _is_refreshed(out):
        return
    with folder_lock(out, wait_s=_REFRESH_WAIT_S):
        if not _is_refreshed(out):
            _refresh(out)


def _refresh(out: Path) -> None:
    run = current_run(out)
    if run is None:
        return
    for leftover in out.glob(f"{TEMPORARY_PREFIX}*"):
        leftover.unlink(missing_ok=True)
    for name in (*run.files, *(set(run.replaces) - set(run.files))):
        temporary = out / f"{TEMPORARY_PREFIX}{name}"
        try:
            if name not in run.files:
                (out / name).unlink(missing_ok=True)
                continue
            shutil.copyfile(run.folder / name, temporary)
            if sha256_of(temporary) != run.files[name]["sha256"]:
                msg = f"{run.folder / name}: damaged since it was written; run `tissueid fit` again"
                raise BundleError(msg)
            replace_file(temporary, out / name)
        except FileNotFoundError as error:
            msg = f"{run.folder / name}: missing from its run; run `tissueid fit` again"
            raise BundleError(msg) from error
        except PermissionError as error:
            raise BundleError(
                f"{out / name}: can't be replaced, another program holds it open; close it there and run "
                f"`tissueid validate {out}`, which finishes what was begun (the run itself is safe)"
            ) from error
    write_file(run.folder / _REFRESHED, b"")
    _prune(out, keep=run.folder.name)


def _prune(out: Path, *, keep: str | None) -> None:
    for folder in (out / _RUNS).iterdir():
        if folder.name != keep:
            # a file held open elsewhere stays until the next writer comes by
            shutil.rmtree(folder, ignore_errors=True)


class OutputSet:
    """One run's files on their way into an output folder.

    >>> with OutputSet("out") as run:                                       # doctest: +SKIP
    ...     run.write("identification.json", json_bytes(document))
    ...     write_bundle(bundle, run.path("bundle-kidney.h5"))
    ...     run.commit()

    Leaving the context without :meth:`commit` leaves the folder as it was.

    ``out``: output folder; made where it does not exist.  Raises BundleError: on entering, where another
    process writes into the folder or an earlier run is damaged.
    """

    def __init__(self, out: Path | str) -> None:
        self.out = Path(out)
        self._held = ExitStack()  # the lock, until the context is left
        self._folder: Path | None = None
        self._previous: CommittedRun | None = None

    def __enter__(self) -> Self:
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            msg = f"{self.out}: can't be made a folder ({error.strerror}); choose another output folder"
            raise UsageError(msg) from error
        with ExitStack() as held:
            held.enter_context(folder_lock(self.out))
            # before there is anything to abandon: an interrupt may come at any time
            held.callback(self._abandon)
            if not _is_refreshed(self.out):
                _refresh(self.out)
            self._previous = current_run(self.out)
            runs = self.out / _RUNS
            runs.mkdir(exist_ok=True)
            _prune(self.out, keep=self._previous.folder.name if self._previous else None)
            taken = [int(folder.name) for folder in runs.iterdir() if folder.name.isdigit()]
            self._folder = runs / f"{max(taken, default=0) + 1:06d}"
            self._folder.mkdir()
            self._held = held.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _abandon(self) -> None:
        """Remove what was not committed."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def path(self, name: str) -> Path:
        """Place to write the file that will be public as ``name`` (a plain file name)."""
        if not name or Path(name).name != name or name.startswith(".") or name == _MANIFEST:
            raise ValueError(f"{name!r} can't be a public name of an output set")
        return self._open_folder() / name

    def sampling(self) -> Path:
        """Folder of chains while they are sampled; a killed run finds them again."""
        folder = self.out / _SAMPLING
        folder.mkdir(exist_ok=True)
        return folder

    def write(self, name: str, content: bytes) -> None:
        """Write one file of the set."""
        write_file(self.path(name), content)

    def carry_over(self, *, but: Collection[str] = ()) -> None:
        """Take the files of the current set, but some, into this one as they are."""
        if self._previous is not None:
            for name in self._previous.files.keys() - but:
                shutil.copyfile(self._previous.folder / name, self.path(name))

    def commit(self) -> None:
        """Make this run the current one and refresh the public names."""
        folder = self._open_folder()
        for leftover in folder.glob(f"{TEMPORARY_PREFIX}*"):
            leftover.unlink()
        sealed = {
            path.name: {"sha256": sha256_of(path), "bytes": path.stat().st_size}
            for path in sorted(folder.iterdir())
        }
        manifest = {
            "schema": _SCHEMA,
            "run": folder.name,
            "files": sealed,
            "replaces": sorted(self._previous.files) if self._previous else [],
        }
        write_file(folder / _MANIFEST, json_bytes(manifest))
        write_file(self.out / _CURRENT, f"{folder.name}\n".encode("ascii"))
        self._folder = None
        shutil.rmtree(self.out / _SAMPLING, ignore_errors=True)
        _refresh(self.out)

    def _open_folder(self) -> Path:
        if self._folder is None:
            raise RuntimeError("the output set is not open: use it inside `with`, before commit")
        return self._folder
