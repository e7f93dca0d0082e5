"""What the process that asks costs, whoever computes: listing, index, keeping, assembly and report by size.

One specimen of 22 short logs is fitted.  A cohort of hard links to its recordings is then run with that
result in place of every survey, job and page, so that thousands of specimens cost minutes: everything that
the asking process does is done, and nothing of what workers do.  Seconds and peak memory after each stage.

    python benchmarks/asking.py [--sizes 500 2000 10000] [--sampler emcee]

Every size is a process of its own; peak memory is that of the process so far.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
from cohort import SHORT, write_cohort
from harness import command_line, peak_MB

#: Name of the specimen that is fitted; others have names as long, so that its file can carry them.
ONE = "head-00000"


class Stages:
    """Wall time and peak memory after each stage of a run."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self._last = time.monotonic()

    def note(self, name: str) -> None:
        now = time.monotonic()
        self.rows.append({"stage": name, "seconds": now - self._last, "peak_MB": peak_MB()})
        self._last = now

    def after(self, place: Any, name: str) -> None:
        """Note when a function has ended."""
        function = getattr(place, name)

        def noted(*args: Any, **named: Any) -> Any:
            found = function(*args, **named)
            self.note(name.strip("_"))
            return found

        setattr(place, name, noted)


def renamed(content: bytes) -> Callable[[str], bytes]:
    """The file of :data:`ONE` under another name: its record, which assembly and report read."""
    with tempfile.NamedTemporaryFile(suffix=".h5") as file:
        file.write(content)
        file.flush()
        with h5py.File(file.name) as opened:
            record = opened["specimen/record"]
            first, size = record.id.get_offset(), record.id.get_storage_size()
    old = content[first : first + size]

    def bytes_of(name: str) -> bytes:
        new = old.replace(ONE.encode(), name.encode())
        if len(new) != size:
            raise ValueError(name)
        return content[:first] + new + content[first + size :]

    return bytes_of


def child(data: Path, out: Path, template: Path, sampler: str) -> None:
    """One run whose surveys and jobs are answered from the template; stages to stdout."""
    from tissueid.cli.main import main
    from tissueid.store.files import sha256_of
    from tissueid.store.index import RecordingRow
    from tissueid.study import batch, inventory, pages
    from tissueid.study.tasks import packed

    stages = Stages()
    stages.note("imports")
    file_of = renamed(template.read_bytes())
    digests = {path.name: sha256_of(path) for path in (data / ONE).iterdir()}

    def look_into(file: Any, _keep: object = None) -> list[RecordingRow]:
        path = Path(file.path)
        name = path.parent.name
        return [RecordingRow(file.path, None, digests[path.name], name, 150, "trial", name)]

    class Answered:
        """In place of a specimen's result: what packs it is told its name."""

        def __init__(self, job: Any, **_: Any) -> None:
            self.name = job.shown

    inventory.look_into = look_into
    batch.fit_here = Answered
    batch.specimen_bytes = lambda result: file_of(result.name)
    batch.with_page = lambda content: packed((content, b"<p>a page</p>"))
    listed = batch.fit_cohort

    def fit_cohort(*args: Any) -> Any:
        stages.note("listed")
        return listed(*args)

    batch.fit_cohort = fit_cohort
    stages.after(inventory.Inventory, "complete")
    for name in ("_plan", "_compute", "_make_pages"):
        stages.after(batch._Cohort, name)  # noqa: SLF001 -- its stages are what is timed
    stages.after(batch, "assemble")
    stages.after(pages, "write_report")
    # a first attempt at one specimen would parse what is answered here
    batch._Cohort._while_read = lambda *_: None  # noqa: SLF001
    main(["fit", str(data), "-o", str(out), *SHORT, sampler, "-q", "--workers", "1"])
    stages.note("committed")
    print(json.dumps(stages.rows))


def main() -> None:
    parser = command_line(__doc__, json_words=None)
    parser.add_argument("--sizes", type=int, nargs="+", default=[500, 2000, 10_000])
    parser.add_argument("--sampler", choices=["emcee", "none"], default="emcee")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(*map(Path, options.child), options.sampler)
        return
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as name:
        folder = Path(name)
        write_cohort(folder / "one", 1, 10.0)
        command = [sys.executable, "-m", "tissueid", "fit", str(folder / "one"), "-o", str(folder / "first")]
        subprocess.run([*command, *SHORT, options.sampler, "-q"], check=False)
        (template,) = (folder / "first" / "specimens").iterdir()
        for size in options.sizes:
            for number in range(size):
                own = folder / "data" / f"head-{number:05d}"
                own.mkdir(parents=True)
                for path in (folder / "one" / ONE).iterdir():
                    (own / path.name).hardlink_to(path)
            arguments = ["--child", str(folder / "data"), str(folder / "out"), str(template)]
            found = subprocess.run(
                [sys.executable, __file__, *arguments, "--sampler", options.sampler],
                check=True, capture_output=True, text=True,
            )  # fmt: skip
            rows = json.loads(found.stdout.splitlines()[-1])
            print(f"{size} specimens, {22 * size} recordings, load {os.getloadavg()[0]:.1f}", flush=True)
            for row in rows:
                each = 1e3 * row["seconds"] / size
                timed = f"{row['seconds']:8.1f} s {each:8.2f} ms each"
                print(f"  {row['stage']:<14}{timed} {row['peak_MB']:7.0f} MB")
            for one in ("data", "out"):
                shutil.rmtree(folder / one)


if __name__ == "__main__":
    main()
