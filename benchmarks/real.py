"""Judge ``tissueid fit`` on real recordings, by the command itself and the public interface.

Five parts:

* ``coherence``: is every printed value inside its own intervals (a missing interval holds nothing), how many
  are withheld, does a second seed say the same (within 0.1 total standard deviations), does an independent
  lmfit fit of the same model on the samples agree (within one, in 90 %), and do random halves of a cut agree
  (ln tau and ln(F(1 s) / F(10 s)) within 2.6 combined standard deviations, in 95 %).
* ``prediction``: holds of logs that were left out of their cut, with an own elastic curve from their ramp,
  beside no model at all and least squares of the same law; ramp times of muscle that were left out, nothing
  free, beside five families of laws that are written apart in :mod:`real_baselines`.
* ``laws``: the same holds and ramp times by the law that ``--model auto`` chooses, each group over the best
  of five laws that are written apart (within 10 % in the median, 25 % in the worst).
* ``insample``: NRMSD of cuts over least squares with the same freedom, and of single recordings.
* ``speed``: processor seconds a sheet, memory, first and second fit of one 100 Hz log over bare imports.

    python benchmarks/real.py [--part coherence|prediction|laws|insample|speed|all] [--data FOLDER]
                              [--json] [--only 230403-FF1*] [--sheets N] [--cuts N] [--logs N] [--splits 10]

The recordings are not part of the project: ``--data`` or TISSUEID_REAL_DATA names their folder, and without
it the benchmark says that it was skipped.  Nothing is copied.  Progress goes to stderr.

An NRMSD is a root-mean-square deviation over the range of the measured force.  Ratios count; seconds belong
to one machine.  Everything takes an hour or more: ``--only``, ``--sheets``, ``--cuts``, ``--logs`` and
``--splits`` make less of it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from harness import command_line
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = {"left_out_logs": "holds of logs left out of their cut", "left_out_speeds": "ramp times left out"}
PARTS = ("coherence", "prediction", "laws", "insample", "speed")


def default_data() -> Path:
    """Folder of the recordings where none is named."""
    named = os.environ.get("TISSUEID_REAL_DATA")
    return Path(named) if named else ROOT.parent / "shared" / "data"


def options() -> argparse.Namespace:
    """Options of the command line."""
    parser = command_line(__doc__)
    parser.add_argument("--part", choices=(*PARTS, "all"), default="all")
    parser.add_argument("--data", type=Path, default=default_data(), help="folder of the recordings")
    parser.add_argument("--only", default="*", help="pattern of the recordings' names")
    parser.add_argument("--sheets", type=int, help="most recordings of a file")
    parser.add_argument("--cuts", type=int, help="most cuts that are pooled")
    parser.add_argument("--logs", type=int, help="most logs that are left out of a cut")
    parser.add_argument("--splits", type=int, default=10, help="random halves of each cut")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def measured(asked: argparse.Namespace) -> dict[str, Any]:
    """Results of the parts that were asked for."""
    # loaded here: recordings that are absent need no fit
    from real_coherence import coherence
    from real_laws import among_laws
    from real_prediction import insample, prediction
    from real_recordings import recordings
    from real_speed import speed

    parts = PARTS if asked.part == "all" else (asked.part,)
    found = [] if parts == ("speed",) else recordings(asked.data, asked.only, asked.sheets)
    made: dict[str, Callable[[], Any]] = {
        "coherence": lambda: coherence(found, cuts=asked.cuts, splits=asked.splits, seed=asked.seed),
        "prediction": lambda: prediction(found, cuts=asked.cuts, logs=asked.logs),
        "laws": lambda: among_laws(found, cuts=asked.cuts, logs=asked.logs),
        "insample": lambda: insample(found, cuts=asked.cuts),
        "speed": lambda: speed(asked.data, ROOT, sheets=asked.sheets),
    }
    return {part: made[part]() for part in parts}


def percent(value: float | None) -> str:
    """A fraction in percent, or a dash."""
    return "-" if value is None else f"{100.0 * value:.2f} %"


def coherence_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Table of the coherence, a row a kind of specimen."""
    bars = result["bars"]
    yield "coherence of printed values"
    yield (
        f"  {'':14}{'specimens':>10}{'printed':>9}{'inside':>10}{'no interval':>13}{'withheld':>10}"
        f"{'2nd seed':>10}{'worst sd':>10}{'lmfit':>10}{'cpu s':>8}"
    )
    for kind, row in result["summary"].items():
        if kind == "halves":
            continue
        worst, cpu = row["seed_worst_sd"], row["cpu_s_median"]
        yield (
            f"  {kind:14}{row['specimens']:10d}{row['printed']:9d}{percent(row['inside']):>10}"
            f"{row['without_interval']:13d}{percent(row['withheld_share']):>10}{percent(row['seed_near']):>10}"
            f"{'-' if worst is None else f'{worst:.3f}':>10}{percent(row['independent_agree']):>10}"
            f"{'-' if cpu is None else f'{cpu:.1f}':>8}"
        )
    yield (
        f"  bars: inside {percent(bars['inside'])}, seeds within {bars['seed_sd']:g} sd, "
        f"lmfit within 1 sd in {percent(bars['independent'])}"
    )
    halves = result["summary"].get("halves")
    if halves:
        yield (
            f"  halves within {bars['halves_sd']:g} sd (bar {percent(bars['halves'])}): ln tau "
            f"{percent(halves['ln_tau_agree'])} of {halves['ln_tau_compared']}, ln F(1 s)/F(10 s) "
            f"{percent(halves['ln_shape_agree'])} of {halves['ln_shape_compared']}, "
            f"mute {halves['mute_taus']}"
        )
    yield from failures([*result["recordings"], *result["cuts"], *result["halves"]])


def failures(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """A line for each row that failed."""
    for row in rows:
        if "failed" in row:
            yield f"  failed: {row.get('name') or row.get('log') or row.get('cut')}: {row['failed']}"


def prediction_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Tables of what was left out: NRMSD by predictor, best first."""
    for key, title in LEFT_OUT.items():
        part = result[key]
        yield f"{title}, NRMSD"
        yield f"  {'':52}{'median':>10}{'worst':>10}{'count':>7}"
        for name, row in sorted(part["summary"].items(), key=lambda item: item[1]["median"]):
            yield f"  {name:52}{percent(row['median']):>10}{percent(row['worst']):>10}{row['count']:7d}"
        yield from failures(part["rows"])
    yield "measured curves of left-out logs, whole in prediction95 of the others"
    for name, row in result["measured_next"].items():
        yield f"  {name:52}{percent(row['inside']):>10}{row['count']:>17d}"
    for condition in dict.fromkeys(row["condition"] for row in result["left_out_speeds"]["rows"]):
        rows = [row for row in result["left_out_speeds"]["rows"] if row["condition"] == condition]
        yield f"  {condition:42}" + "".join(f"{row['left_out'].removeprefix(condition):>10}" for row in rows)
        for name in rows[0]["nrmsd"]:
            yield f"    {name:40}" + "".join(f"{percent(row['nrmsd'][name]):>10}" for row in rows)
        for name in rows[0]["whole_in_band"]:
            held = ("inside" if row["whole_in_band"][name] else "outside" for row in rows)
            yield f"    {f'whole curve in the band, {name}':40}" + "".join(f"{one:>10}" for one in held)


def law_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Table of groups: NRMSD of every predictor, and ratios to the best of the five laws."""
    yield "left-out NRMSD by group, and over the best of five laws"
    for row in result["rows"]:
        ratios = ", ".join(f"{name} {value:.2f}" for name, value in row["ratio"].items())
        yield f"  {row['group']} ({row['count']}): {ratios}; best is {row['best']}"
        yield "    " + ", ".join(f"{name} {percent(value)}" for name, value in row["nrmsd"].items())
    for name, row in result["summary"].items():
        yield f"  {name}: median {row['median']:.2f}, worst {row['worst']:.2f} of {row['count']} groups"


def insample_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Table of in-sample deviations."""
    yield "in-sample NRMSD, and over least squares with the same freedom"
    yield f"  {'':14}{'count':>7}{'median':>10}{'ratio':>8}{'worst':>8}"
    for kind, row in result["summary"].items():
        ratio, worst = (
            "-" if row[key] is None else f"{row[key]:.2f}" for key in ("ratio_median", "ratio_worst")
        )
        yield f"  {kind:14}{row['count']:7d}{percent(row['nrmsd_median']):>10}{ratio:>8}{worst:>8}"
    for row in result["cuts"]:
        peers = row.get("least_squares", {})
        told = ", ".join(f"{name} {percent(value)}" for name, value in peers.items())
        if "failed" not in row:
            kind = f"{row['order']!s:8}{row['pooling']:9}"
            yield f"    {row['name']:14}{kind}{percent(row['nrmsd']):>9}  ({told})"
    yield from failures([*result["cuts"], *result["recordings"]])


def speed_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Table of costs."""
    yield "processor seconds and memory"
    log = result["one_log"]
    for name in ("imports", "first", "second"):
        row = log[name]
        over = "" if name == "imports" else f", {log[f'{name}_over_imports']:.1f} times the imports"
        failed = f", exit {row['exit']}: {row['error']}" if row.get("error") else ""
        yield f"  {name:10}{row['cpu_s']:9.2f} s{row['peak_MB']:9.0f} MB{over}{failed}"
    for row in result["workbooks"]:
        failed = f", exit {row['exit']}: {row['error']}" if row.get("error") else ""
        yield (
            f"  {row['workbook']}: {row['cpu_s_per_sheet']:.2f} s a sheet of {row['sheets']}, "
            f"{row['peak_MB']:.0f} MB{failed}"
        )


LINES = {
    "coherence": coherence_lines,
    "prediction": prediction_lines,
    "laws": law_lines,
    "insample": insample_lines,
    "speed": speed_lines,
}


def main() -> int:
    """Print what was measured; 0 where the recordings are absent as well."""
    asked = options()
    if not any(asked.data.glob("*/SOURCE.txt")):
        why = f"no recordings in {asked.data} (--data, or TISSUEID_REAL_DATA)"
        print(json.dumps({"skipped": why}) if asked.json else f"skipped: {why}")
        return 0
    # small matrices gain nothing from threads of the linear algebra library
    with threadpool_limits(limits=1, user_api="blas"):
        result = measured(asked)
    if asked.json:
        # numbers that JSON does not know are ``null``
        text = msgspec.json.encode(result, enc_hook=lambda value: value.tolist())
        print(msgspec.json.format(text, indent=2).decode())
        return 0
    for part, value in result.items():
        print("\n".join(LINES[part](value)), end="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
