"""Logs of rendered sessions fitted again: how often the intervals hold what was rendered.

Each session is one push of a random depth, speed and hold on the simulated device, in virtual and in real
time by turns, through ``tissueid render``; its log goes through the fit that a test machine's goes through.
A value is held where it lies in the total interval that is printed for it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import command_line

from tissueid import IdentifyOptions, PosteriorOptions, identify, read_trials
from tissueid.rendering.options import PRESETS, as_tissue
from tissueid.rendering.tissue_block import Tissue
from tissueid.store.bundle import load_bundle

#: Deepest push of a bundle, speeds [mm/min], and holds [s] that sessions are drawn from.
SHARES, SPEEDS, HOLDS = (0.5, 0.98), (60.0, 500.0), (2.0, 6.0)
BAR = 0.9


def _bundles(folder: Path) -> dict[str, tuple[list[str], Tissue]]:
    """Name -> arguments of ``render``, and the truth."""
    data = Path(__file__).resolve().parents[1] / "datasets_synthetic"
    run = ["fit", str(data / "paper-a-hold-100Hz"), "-o", str(folder / "fitted"), "--quiet"]
    subprocess.run([sys.executable, "-m", "tissueid", *run], check=False, capture_output=True)
    fitted = folder / "fitted" / "bundle.h5"
    return {
        **{name: (["--preset", name], PRESETS[name]()) for name in ("paper-a", "meat")},
        "fitted": ([str(fitted)], as_tissue(load_bundle(fitted))),
    }


def _session(log: Path, arguments: list[str], script: str, *, virtual: bool) -> str | None:
    """Render one session; the last line of what went wrong."""
    options = ["--device", "sim", "--script", script, "--log", str(log), "--yes", "--quiet"]
    options += ["--virtual"] if virtual else []
    run = [sys.executable, "-m", "tissueid", "render", *arguments, *options]
    done = subprocess.run(run, check=False, capture_output=True, text=True)
    return None if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no message"])[-1]


def _row(tissue: Tissue, log: Path) -> dict[str, Any]:
    """Parameters that are printed, and those of them whose total interval holds the truth."""
    found = identify(read_trials(log), options=IdentifyOptions(posterior=PosteriorOptions()))
    if not found.specimens:
        return {"failed": "; ".join(found.exit.reasons)}
    fit = found.specimens[0]
    truth = dict(zip(tissue.model.parameter_names, tissue.theta.tolist(), strict=True))
    held, missed, order = [], [], (fit.model.branches, fit.model.stiffness_degree)
    for one in fit.parameters:
        spans = one.uncertainty and (one.uncertainty.ci95_total or one.uncertainty.ci95)
        if one.value is None or one.name not in truth or not spans:
            continue
        (held if spans[0] <= truth[one.name] <= spans[1] else missed).append(one.name)
    return {"order": order, "nrmsd": fit.nrmsd.range, "held": held, "missed": missed}


def main() -> None:
    """Run and print."""
    parser = command_line(__doc__)
    parser.add_argument("--sessions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=20261125)
    asked = parser.parse_args()
    rng, rows = np.random.default_rng(asked.seed), []
    with TemporaryDirectory() as made:
        folder = Path(made)
        bundles = _bundles(folder)
        for k in range(asked.sessions):
            name = list(bundles)[k % len(bundles)]
            arguments, tissue = bundles[name]
            depth = rng.uniform(*SHARES) * tissue.model.depth_mm
            speed = float(np.exp(rng.uniform(*np.log(SPEEDS))))
            script = f"indent {depth:.3g} mm at {speed:.3g} mm/min; hold {rng.uniform(*HOLDS):.2g} s"
            virtual, log = (k // len(bundles)) % 2 == 0, folder / f"{k}.h5"
            failed = _session(log, arguments, script, virtual=virtual)
            row = {"failed": failed} if failed else _row(tissue, log)
            rows.append({"bundle": name, "virtual": virtual, "script": script, **row})
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    good = [row for row in rows if "failed" not in row]
    held, missed = (sum(len(row[key]) for row in good) for key in ("held", "missed"))
    whole = sum(bool(row["held"]) and not row["missed"] for row in good)
    result = {
        "sessions": len(rows), "failed": len(rows) - len(good), "values": held + missed,
        "held": held / max(held + missed, 1), "sessions_whole": whole / max(len(rows), 1), "bar": BAR,
        "nrmsd_median": float(np.median([row["nrmsd"] for row in good])) if good else None, "rows": rows,
    }  # fmt: skip
    if asked.json:
        print(json.dumps(result, indent=1))
        return
    print(
        f"{result['sessions']} sessions, {result['failed']} failed: {100.0 * result['held']:.1f} % of "
        f"{result['values']} values inside their total interval (bar {100.0 * BAR:.0f} %), "
        f"{100.0 * result['sessions_whole']:.0f} % of sessions whole, NRMSD {result['nrmsd_median']:.1e}"
    )


if __name__ == "__main__":
    main()
