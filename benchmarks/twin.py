"""Twins of bundles of every kind of law: forces, and numbers that went in beside those that came out.

Each draw is a tissue of its law, one simulated recording of it (:mod:`laws`), the fit of that, and its bundle
felt by a machine along the recording's own travel: on the emulated Falcon and on the simulated device, each
grip's recording fitted by the same engine.  Records are kept, and a second call goes on from the first.

    python benchmarks/twin.py [--draws 50] [--laws NAME ...] [--minutes M] [--records FILE] [--json]

A parameter counts where it is identified in the bundle and the refit gives it an interval; ``inside`` is the
value that came out within the interval that went in, ``agree`` within it or the value that went in within the
interval that came out.  ``destroyed``: the refit gives no interval.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from field import STATED, identified
from harness import command_line, kept
from laws import DEPTH_MM, simulated

import tissueid as ti
from tissueid.documents.twin import Device
from tissueid.errors import TissueidError
from tissueid.store.bundle import bundle_from_fit, write_bundle
from tissueid.twin import Setup, program_of_recording, run_twin

#: Every static law, stiffness and relaxation once, and the whole names.
LAWS = (
    "kelvin-voigt", "yardstick", "polynomial * quadratic * prony:1", "power * tangent * fung",
    "exponential * linear * stretched", "hertz * constant * power-law", "sneddon * tangent * fractional",
    "flat * poroelastic", "power * spectrum",
)  # fmt: skip
#: Tissue of the two whole names, and where their recordings come from.
TISSUE_OF = {"kelvin-voigt": "polynomial * linear * prony:1", "yardstick": "flat * fung"}
FORCE_BAR, UNSEEN_BAR, INSIDE_BAR = 0.02, 0.03, 0.9


def _device(one: Device) -> dict[str, Any]:
    """Counts of one device's rows."""
    judged = [
        (row, row.went_in_ci95) for row in one.rows if row.went_in is not None and row.came_out is not None
    ]
    inside = [span is not None and span[0] <= (row.came_out or 0.0) <= span[1] for row, span in judged]
    return {
        "nrmsd": one.nrmsd_model,
        "inside": sum(inside),
        "agree": sum(row.verdict == "inside" for row, _ in judged),
        "outside": {
            row.name: (row.came_out or 0.0) / (row.went_in or 1.0) - 1.0
            for (row, _), held in zip(judged, inside, strict=True)
            if not held
        },
        "destroyed": sum(row.verdict == "destroyed" for row in one.rows),
        "judged": len(judged),
    }


def drawn(name: str, number: int) -> dict[str, Any]:
    """Record of one draw."""
    rng = np.random.default_rng([20261126, number, *name.encode()])
    _, (time_s, travel, force) = simulated(TISSUE_OF.get(name, name), rng)
    trial = ti.Trial("twin", time_s, travel, force)
    started = time.process_time()
    try:
        found = identified([trial], STATED, number, name)
        if not found.specimens:
            return {"failed": found.exit.reasons[0]}
        provenance = {"tissueid": ti.__version__, "versions": {}, "options": {}, "inputs": []}
        bundle = bundle_from_fit(found.specimens[0], provenance=provenance)
        program = program_of_recording(trial, bundle.depth_mm)
        with tempfile.TemporaryDirectory() as made:
            path = Path(made) / "bundle.h5"
            write_bundle(bundle, path)
            twin = run_twin(bundle, path, Setup(program), path.parent, lambda *_: None).found
    except TissueidError as error:
        return {"failed": str(error)}
    return {
        "force_scale": twin.force_scale,
        "motion_scale": twin.motion_scale,
        "unseen": twin.unseen.nrmsd_model,
        "devices": {one.device: _device(one) for one in twin.devices},
        "cpu_s": time.process_time() - started,
    }


def _rows(records: list[dict[str, Any]], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """A row for each law and device."""
    rows = []
    for name in names:
        mine = [one for one in records if one["law"] == name]
        good = [one for one in mine if "failed" not in one]
        for device in ("emulated Falcon", "simulated device") if good else ():
            found = [one["devices"][device] for one in good]
            judged = sum(one["judged"] for one in found)
            rows.append({
                "law": name, "device": device, "draws": len(mine), "failed": len(mine) - len(good),
                "nrmsd_most": max(one["nrmsd"] for one in found), "judged": judged,
                "unseen_most": max(one["unseen"] for one in good),
                "inside": sum(one["inside"] for one in found) / judged if judged else None,
                "agree": sum(one["agree"] for one in found) / judged if judged else None,
                "destroyed": sum(one["destroyed"] for one in found),
                "cpu_s": float(np.mean([one["cpu_s"] for one in good])),
            })  # fmt: skip
    return rows


def _line(row: dict[str, Any]) -> str:
    share = (
        "no refit: its times follow the recording"
        if row["inside"] is None
        else f"{row['judged']} numbers, {100.0 * row['inside']:.1f} % inside what went in, "
        f"{100.0 * row['agree']:.1f} % agree, {row['destroyed']} destroyed"
    )
    return (
        f"{row['law']:34} {row['device']:16} {row['draws']} draws, {row['failed']} failed; force NRMSD at "
        f"most {100.0 * row['nrmsd_most']:.2f} %, unseen speed {100.0 * row['unseen_most']:.2f} %; {share}; "
        f"{row['cpu_s']:.0f} s a draw"
    )


def main() -> None:
    """Run and print."""
    parser = command_line(__doc__)
    parser.add_argument("--draws", dest="specimens", type=int, default=50)
    parser.add_argument("--laws", nargs="+", default=list(LAWS))
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--records", type=Path)
    asked = parser.parse_args()
    records = kept(asked.laws, asked, drawn, key="law")
    rows = _rows(records, tuple(asked.laws))
    if asked.json:
        bars = {"force": FORCE_BAR, "unseen": UNSEEN_BAR, "inside": INSIDE_BAR, "depth_mm": DEPTH_MM}
        print(json.dumps({"bars": bars, "rows": rows}, indent=1))
        return
    for row in rows:
        print(_line(row))
    for one in records:
        if "failed" in one:
            print(f"failed: {one['law']} {one['number']}: {one['failed']}")


if __name__ == "__main__":
    main()
