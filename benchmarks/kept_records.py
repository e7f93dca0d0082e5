"""Records of drawn specimens, one a line of a file: a second call goes on where the first ended."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

Record = dict[str, Any]


def asked_for(doc: str | None, kinds: Sequence[str], kind: str, *, specimens: int, records: str) -> Any:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kind", choices=kinds, default=kind)
    parser.add_argument("--specimens", type=int, default=specimens)
    parser.add_argument("--cases", nargs="*", help="names of cases; all without")
    parser.add_argument("--minutes", type=float, default=480.0, help="no specimen is begun after so long")
    parser.add_argument("--records", type=Path, default=Path(records))
    parser.add_argument("--json", action="store_true", help="print records instead of tables")
    return parser.parse_args()


def kept(cases: Iterable[str], asked: Any, judge: Callable[[str, int], Record]) -> list[Record]:
    """Records of every case in turn: those that stand in the file first; new ones are appended to it."""
    known, found, until = {}, [], time.monotonic() + 60.0 * asked.minutes
    if asked.records.exists():
        for line in asked.records.read_text(encoding="utf-8").splitlines():
            one = json.loads(line)
            known[one["case"], one["number"]] = one
    with threadpool_limits(1):
        for number in range(asked.specimens):
            for name in cases:
                one = known.get((name, number))
                if one is None:
                    if time.monotonic() > until:
                        continue
                    one = {"case": name, "number": number, **judge(name, number)}
                    with asked.records.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(one) + "\n")
                found.append(one)
    return found


def by_case(found: list[Record]) -> Iterator[tuple[str, list[Record]]]:
    """Records of one case after another."""
    for name in dict.fromkeys(one["case"] for one in found):
        yield name, [one for one in found if one["case"] == name]
