"""Recovery of every registered law from its own simulations, by the public interface.

Each law (every static law, stiffness and relaxation at least once) draws tissues, records one push and hold
of 6.5 s at 100 Hz with white noise, and is asked for by name; the machine is stated, as it is.  Records are
kept, and a second call goes on where the first ended.

    python benchmarks/laws.py [--specimens 100] [--cases NAME ...] [--minutes M] [--records FILE] [--json]

Printed: truths inside their total 95 % interval (of parameters that are given one), the band in which that
count lies with 99 % where 95 % are true, bias and spread in units of the interval's own deviation.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from field import STATED
from scipy.stats import binom
from threadpoolctl import threadpool_limits

from tissueid.model import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import known_laws, parsed

DEPTH_MM, RATE_HZ, NOISE_N, AIR_S, LENGTH_S, SPEED_MM_S = 6.0, 100.0, 0.15, 0.5, 8.5, 4.0
#: Time that is fitted: from contact to the last sample.
WINDOW_S = LENGTH_S - AIR_S - 1.0 / RATE_HZ
#: Middle of the truths by the beginning of a parameter's name, and their spread in the logarithm.
TRUTH = {
    "static_1": 20.0, "static_2": -1.2, "static_3": 0.35, "static_N_per_mm": 12.0, "static_exponent": 1.4,
    "static_stiffness": 12.0, "static_rate": 0.15, "stiffness_0": 30.0, "stiffness_1": 4.0,
    "stiffness_2": -0.2, "relaxation_time": 0.4, "relaxation_exponent": 0.5, "relaxation_span": 100.0,
    "relaxation_ratio": 1.2,
}  # fmt: skip
SPREAD, SIZE_SPREAD, SECOND_TIME = 0.1, 0.2, 4.0


def names() -> tuple[str, ...]:
    """Models that hold every law once or more."""

    def of(kind: str, *without: str) -> list[str]:
        return [key for key, law in known_laws().items() if law.about.kind == kind and key not in without]

    return (
        *(f"{key} * prony" for key in of("static", "polynomial")),
        *(f"power * {key} * prony" for key in of("stiffness")),
        *(f"flat * {key}" for key in of("relaxation", "prony")),
        "polynomial * tangent * prony:2",
        "polynomial * linear * prony:1",
        "polynomial * constant * prony:2",
    )


def _model(name: str) -> ChannelModel:
    named = parsed(name)
    if named.parts is None:
        # a Kelvin-Voigt law by its parts
        laws = known_laws()
        stiffness = ("constant", "linear", "quadratic")[named.degree or 0]
        return ChannelModel(
            laws["polynomial"](), laws[stiffness](), laws["prony"](named.branches), DEPTH_MM, 1.0 / RATE_HZ,
            WINDOW_S, name,
        )  # fmt: skip
    return named.model(DEPTH_MM, 1.0 / RATE_HZ, WINDOW_S)


def simulated(name: str, rng: np.random.Generator) -> tuple[dict[str, float], tuple[np.ndarray, ...]]:
    """Truth and a recording."""
    model, size = _model(name), float(np.exp(rng.normal(0.0, SIZE_SPREAD)))
    truth = {}
    for one in model.parameters:
        value = next(middle for start, middle in TRUTH.items() if one.name.startswith(start))
        if one.name.endswith("_b2") and one.name.startswith("relaxation_time"):
            value *= SECOND_TIME
        scaled = "N" in one.unit
        # polynomials stay in proportion, or they would not stay passive
        truth[one.name] = value * (size if scaled else float(np.exp(rng.normal(0.0, SPREAD))))
    time_s = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
    end = AIR_S + DEPTH_MM / SPEED_MM_S
    depth = np.interp(time_s, [AIR_S, end], [0.0, DEPTH_MM])
    force = model.force(np.array(list(truth.values())), ContactPath(time_s, depth))
    force = force + rng.normal(0.0, NOISE_N, time_s.size)
    travel = np.where(time_s < AIR_S, SPEED_MM_S * (time_s - AIR_S), depth)
    return truth, (time_s, travel + 2.0, force)


def judged(name: str, number: int) -> dict[str, Any]:
    """Record of one specimen."""
    import tissueid as ti

    rng = np.random.default_rng([20261125, number, *name.encode()])
    truth, (time_s, travel, force) = simulated(name, rng)
    trial = ti.Trial("law", time_s, travel, force)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(STATED, encoding="utf-8")
        study = ti.read_study(path)
    options = ti.IdentifyOptions(
        fit=ti.FitOptions(model=name), posterior=ti.PosteriorOptions(seed=number), seed=number
    )
    started = time.process_time()
    document = ti.identify([trial], study=study, options=options).as_json()["specimens"][0]
    rows = {}
    for one in document["parameters"]:
        total = one["ci95_total"]
        if one["name"] not in truth or total is None:
            continue
        sd = max((total[1] - total[0]) / 3.92, 1e-300)
        rows[one["name"]] = {
            "z": (one["value"] - truth[one["name"]]) / sd,
            "in": total[0] <= truth[one["name"]] <= total[1],
        }
    return {
        "case": name, "number": number, "parameters": rows, "nrmsd": document["nrmsd"]["range"],
        "converged": document["sampler"]["converged"],
        "flags": sorted({flag["code"] for flag in document["flags"]}),
        "cpu_s": time.process_time() - started,
    }  # fmt: skip


def records(cases: list[str], count: int, path: Path, minutes: float) -> Iterator[dict[str, Any]]:
    """Records of a file, and new ones until the time is over."""
    known = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            one = json.loads(line)
            known[one["case"], one["number"]] = one
    until = time.monotonic() + 60.0 * minutes
    for number in range(count):
        for name in cases:
            one = known.get((name, number))
            if one is None:
                if time.monotonic() > until:
                    continue
                one = judged(name, number)
                with path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(one) + "\n")
            yield one


def lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Table of one law after another."""
    for name in dict.fromkeys(one["case"] for one in found):
        mine = [one for one in found if one["case"] == name]
        misfit = np.mean([bool({"misfit", "discrepancy"} & set(one["flags"])) for one in mine])
        converged = 100 * np.mean([one["converged"] for one in mine])
        yield (
            f"{name}: {len(mine)} specimens, converged {converged:.0f} %, "
            f"false alarms {100 * misfit:.1f} %, {np.median([one['cpu_s'] for one in mine]):.1f} s a specimen"
        )
        for key in dict.fromkeys(key for one in mine for key in one["parameters"]):
            rows = [one["parameters"][key] for one in mine if key in one["parameters"]]
            z, inside = np.array([row["z"] for row in rows]), sum(row["in"] for row in rows)
            low, high = 100.0 * binom.ppf((0.005, 0.995), len(rows), 0.95) / len(rows)
            share = 100.0 * inside / len(rows)
            kept = "" if low <= share <= high else "  OUTSIDE"
            yield (
                f"  {key:32} n {len(rows):4d}  total {share:5.1f} (99 % band {low:.0f} to {high:.0f})  "
                f"bias {z.mean():+.2f}  sd {z.std():.2f}{kept}"
            )


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--specimens", type=int, default=100)
    parser.add_argument("--cases", nargs="*", help="names of models; all without")
    parser.add_argument("--minutes", type=float, default=480.0, help="no specimen is begun after so long")
    parser.add_argument("--records", type=Path, default=Path("laws-records.jsonl"))
    parser.add_argument("--json", action="store_true", help="print records instead of tables")
    asked = parser.parse_args()
    with threadpool_limits(1):
        found = list(records(asked.cases or list(names()), asked.specimens, asked.records, asked.minutes))
    print(json.dumps(found) if asked.json else "\n".join(lines(found)), flush=True)


if __name__ == "__main__":
    main()
