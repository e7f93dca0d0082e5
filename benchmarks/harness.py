"""Processes of this interpreter and what they cost, the command line of a benchmark, and records it keeps."""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

#: Exit codes of a command that was finished; 4 is a result with something that is not identified.
FINISHED = (0, 4)
Record = dict[str, Any]


def run(*arguments: str) -> tuple[float, float, str]:
    """Wall time, processor time of it and its children [s], and output of one whole process."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run([sys.executable, *arguments], check=False, capture_output=True, text=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode not in FINISHED:
        sys.exit(ended.stderr)
    return wall, sum(after[:2]) - sum(before[:2]), ended.stdout


def peak_MB(pid: int | str = "self") -> float:
    """Largest resident memory of a process alone [MB] (getrusage carries the parent's over an exec)."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    return 0.0


def command_line(
    doc: str | None, *, json_words: str | None = "print one JSON document"
) -> argparse.ArgumentParser:
    """A command line that is described by a module's words, with ``--json`` unless it has none."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    if json_words is not None:
        parser.add_argument("--json", action="store_true", help=json_words)
    return parser


def asked_for(doc: str | None, kinds: Sequence[str], kind: str, *, specimens: int, records: str) -> Any:
    """What the command line of kept records asks for."""
    parser = command_line(doc, json_words="print records instead of tables")
    parser.add_argument("--kind", choices=kinds, default=kind)
    parser.add_argument("--specimens", type=int, default=specimens)
    parser.add_argument("--cases", nargs="*", help="names of cases; all without")
    parser.add_argument("--minutes", type=float, default=480.0, help="no specimen is begun after so long")
    parser.add_argument("--records", type=Path, default=Path(records))
    return parser.parse_args()


def kept(
    cases: Iterable[str], asked: Any, judge: Callable[[str, int], Record], key: str = "case"
) -> list[Record]:
    """Records of every case in turn: a second call goes on where the file of the first ended."""
    known, found, until = {}, [], time.monotonic() + 60.0 * asked.minutes
    if asked.records is not None and asked.records.exists():
        for line in asked.records.read_text(encoding="utf-8").splitlines():
            one = json.loads(line)
            known[one[key], one["number"]] = one
    with threadpool_limits(1):
        for number in range(asked.specimens):
            for name in cases:
                one = known.get((name, number))
                if one is None:
                    if time.monotonic() > until:
                        continue
                    one = {key: name, "number": number, **judge(name, number)}
                    if asked.records is not None:
                        with asked.records.open("a", encoding="utf-8") as file:
                            file.write(json.dumps(one) + "\n")
                found.append(one)
    return found


def by_case(found: list[Record]) -> Iterator[tuple[str, list[Record]]]:
    """Records of one case after another."""
    for name in dict.fromkeys(one["case"] for one in found):
        yield name, [one for one in found if one["case"] == name]
