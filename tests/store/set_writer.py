"""Output sets: one of a run, or, as a script, sets written into a folder for ever, until killed.

Run as a script by the kill test: ``set_writer.py OUT FIRST``.  Every file of set ``n`` says ``n``.
"""

import sys
from pathlib import Path

from fit_factory import identification, specimen_fit, write_results

from tissueid.result import Identification
from tissueid.store.files import REPORT
from tissueid.store.outputs import OutputSet


def commit(out: Path, run: Identification, **files: bytes) -> Identification:
    """Write the set of a run, other files of it beside or in the place of what the run writes."""
    with OutputSet(out) as outputs:
        write_results(outputs, run)
        for name, content in files.items():
            outputs.write(name, content)
        outputs.commit()
    return run


def write_set(out: Path, number: int) -> None:
    """One set whose specimens change in number and name, so that public names come and go."""
    names = [f"s{number}-{i}" for i in range(1 + number % 3)]
    run = identification([specimen_fit(name, trials=1, samples=40, seed=number) for name in names])
    commit(out, run, **{REPORT: f"<p>set {number}</p>".encode()})


if __name__ == "__main__":
    target, count = Path(sys.argv[1]), int(sys.argv[2])
    while True:
        write_set(target, count)
        print(count, flush=True)  # noqa: T201 -- the test counts the sets
        count += 1
