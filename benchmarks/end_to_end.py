"""Time of a whole ``tissueid fit`` against what it can't do without, in the same run.

Thirty Bluehill CSVs at 1 kHz (paper-a-30-k1, some 571,700 rows) to a converged posterior of 10,000 effective
draws, bundle and report, with warm caches.  The floor is the import time of the libraries that the fit needs
plus ten times ``pandas.read_csv`` of the same files; the bar is three floors.  Every figure is the median of
interleaved runs, whole processes where processes are compared.

    python benchmarks/end_to_end.py [--pairs 3] [--json]

The breakdown is one further fit in a process of its own, its stages told by the progress messages.
"""

from __future__ import annotations

import json
import shutil
import statistics
import tempfile
from itertools import pairwise
from pathlib import Path

from harness import command_line, run

RECIPE = "paper-a-30-k1"
BAR = 3.0
LIBRARIES = "click, emcee, h5py, jinja2, lmfit, numba, numpy, pandas, plotly, rich, scipy.optimize"

READ = """
import sys, time
import pandas as pd
files = sys.argv[1:]
best = 9e9
for _ in range(3):
    start = time.perf_counter()
    for name in files:
        pd.read_csv(name, skiprows=2, header=None)
    best = min(best, time.perf_counter() - start)
print(best)
"""

STAGES = """
import json, sys, time
from contextlib import contextmanager
start = time.perf_counter()
from tissueid.cli import fit_command
seen = [("start", time.perf_counter())]

@contextmanager
def told(*, show):
    def progress(message, done, total):
        seen.append((message, time.perf_counter()))
    yield progress

from tissueid.cli.main import main
fit_command.progress_bar = told
main(["fit", *sys.argv[1:], "-q"])
seen.append(("end", time.perf_counter()))
print(json.dumps([["import", start], *seen]))
"""

#: First words of a progress message -> the stage they belong to; in the order in which they are tried.
NAMES = (
    ("reading", "read and segment"),
    ("how logs differ", "scatter between logs"),
    ("noise", "noise"),
    ("1 branch", "model choice"),
    ("2 branch", "model choice"),
    ("3 branch", "model choice"),
    ("the optimum", "the optimum"),
    ("the frame", "the optimum"),
    ("Levenberg-Marquardt", "second optimiser"),
    ("relaxation time of", "shorter windows"),
    ("residuals", "second pass"),
    ("sampling", "sampling"),
    ("the tissue's centre", "intervals, budget, checks"),
    ("writing", "report and files"),
)


def stage(message: str) -> str:
    """The stage that a message opens."""
    text = message.split(": ", 1)[-1]
    return next((name for words, name in NAMES if words in text), text)


def breakdown(data: Path, out: Path) -> dict[str, float]:
    """Seconds a stage."""
    shutil.rmtree(out)
    *_, text = run("-c", STAGES, str(data), "-o", str(out), "--specimen-by", data.name)
    marks = json.loads(text.splitlines()[-1])
    total: dict[str, float] = {}
    for (message, start), (_, end) in pairwise(marks):
        name = stage(message)
        total[name] = total.get(name, 0.0) + end - start
    return dict(sorted(total.items(), key=lambda item: -item[1]))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--pairs", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder) / "logs", Path(folder) / "out"
        run("-m", "tissueid", "synth", RECIPE, "-o", str(data), "--rate", "1000", "-q")
        files = sorted(map(str, data.glob("*.csv")))

        def fit() -> float:
            # a folder that holds results is gone on with: every run begins in an empty one
            shutil.rmtree(out, ignore_errors=True)
            return run("-m", "tissueid", "fit", str(data), "-o", str(out), "--specimen-by", "logs", "-q")[0]

        fit()
        times: dict[str, list[float]] = {"fit": [], "import": [], "bare": [], "read_csv": []}
        for _ in range(options.pairs):
            times["bare"].append(run("-c", "pass")[0])
            times["import"].append(run("-c", f"import {LIBRARIES}")[0])
            times["read_csv"].append(float(run("-c", READ, *files)[2]))
            times["fit"].append(fit())
        found = json.loads((out / "identification.json").read_text(encoding="utf-8"))["specimens"][0]
        stages = breakdown(data, out)
    median = {name: statistics.median(values) for name, values in times.items()}
    floor = median["import"] - median["bare"] + 10.0 * median["read_csv"]
    result = {
        "fit_s": median["fit"],
        "import_s": median["import"] - median["bare"],
        "read_csv_s": median["read_csv"],
        "ratio": median["fit"] / floor,
        "bar": BAR,
        "converged": found["sampler"]["converged"],
        "effective_draws": found["sampler"]["detail"]["ess"],
        "n_samples": found["n_samples"],
        "stages_s": stages,
    }
    if options.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result.items():
        print(f"{name:16}", value if not isinstance(value, dict) else "")
    for name, seconds in stages.items():
        print(f"  {name:28}{seconds:7.2f} s")


if __name__ == "__main__":
    main()
