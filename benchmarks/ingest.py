"""Reading against the floor: our full ``read_trials`` and ``pandas.read_csv(engine="c")`` on the same files.

Ours includes SHA-256, detection, header, units, every check and the read-only trial; pandas is told
where the table begins and how numbers are printed, and only parses.  Pairs are interleaved in one run.

    python benchmarks/ingest.py [--rows 200000] [--pairs 9]

Times are of the processor, all threads together.

Bars: bare cells <= 1.5, quoted cells with thousands separators and decimal comma <= 2, on the layout
that Bluehill writes (an empty line under the header).  Without that line pandas 3.1 splits the file over
all processors; those ratios are printed too, without a bar.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from harness import command_line

from tissueid.ingest import read_trials

HEADER_LINES = 3
HEAD = 'Text Inputs : Specimen label{d}"bench"{n}{blank}Time{d}Extension{d}Load{n}(sec){d}(mm){d}(N){n}'


def write(path: Path, n: int, *, quoted: bool, blank_line: bool) -> None:
    """A synthetic ramp and hold at 1 kHz, as Bluehill prints it."""
    rng = np.random.default_rng(1)
    time_s = np.arange(n) * 1e-3 + (5000.0 if quoted else 0.0)
    depth = -8.0 * np.minimum(1.0, np.arange(n) / n * 3) - 2.0
    force = -1500.0 * np.minimum(1.0, np.arange(n) / n * 3) + rng.normal(0.0, 1.0, n)
    delimiter = ";" if quoted else ","
    head = HEAD.format(d=delimiter, n="\r\n", blank="\r\n" if blank_line else "")

    def cell(value: float) -> str:
        if not quoted:
            return f"{value:.5f}"
        return '"' + f"{value:,.5f}".translate(str.maketrans(",.", ".,")) + '"'

    with path.open("w", newline="") as stream:
        stream.write(head)
        for row in zip(time_s, depth, force, strict=True):
            stream.write(delimiter.join(map(cell, row)) + "\r\n")


def peer(path: Path, *, quoted: bool, blank_line: bool) -> Callable[[], object]:
    skip = HEADER_LINES + blank_line
    if quoted:
        return lambda: pd.read_csv(
            path, engine="c", skiprows=skip, header=None, sep=";", decimal=",", thousands=".", quotechar='"'
        )
    return lambda: pd.read_csv(path, engine="c", skiprows=skip, header=None)


def timed(task: Callable[[], object]) -> float:
    start = time.process_time()
    task()
    return time.process_time() - start


def measure(path: Path, theirs: Callable[[], object], pairs: int) -> tuple[float, float, float]:
    """Median seconds of ours and theirs, and the median ratio of neighbours."""
    read_trials(path)
    theirs()
    ours_s, theirs_s = [], []
    for _ in range(pairs):
        ours_s.append(timed(lambda: read_trials(path)))
        theirs_s.append(timed(theirs))
    ratios = [a / b for a, b in zip(ours_s, theirs_s, strict=True)]
    return statistics.median(ours_s), statistics.median(theirs_s), statistics.median(ratios)


def peak_bytes_per_row(path: Path, rows: int) -> float:
    tracemalloc.start()
    read_trials(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / rows


def main() -> int:
    parser = command_line(__doc__, json_words=None)
    parser.add_argument("--rows", type=int, default=200_000)
    parser.add_argument("--pairs", type=int, default=9)
    options = parser.parse_args()
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, quoted, blank_line, bar in (
            ("bare", False, True, 1.5),
            ("bare, no empty line: pandas 3.1 uses all processors", False, False, None),
            ("quoted, thousands, decimal comma", True, True, 2.0),
            ("quoted, thousands, decimal comma, no empty line", True, False, None),
        ):
            path = Path(folder) / "log.csv"
            write(path, options.rows, quoted=quoted, blank_line=blank_line)
            ours, theirs, ratio = measure(
                path, peer(path, quoted=quoted, blank_line=blank_line), options.pairs
            )
            missed += bar is not None and ratio > bar
            memory = peak_bytes_per_row(path, options.rows)
            print(
                f"{name}: {options.rows} rows, {path.stat().st_size / 1e6:.1f} MB:"
                f" tissueid {ours * 1e3:.1f} ms, pandas {theirs * 1e3:.1f} ms,"
                f" ratio {ratio:.2f} ({f'bar {bar}' if bar else 'no bar'}), peak {memory:.0f} bytes a row"
            )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
