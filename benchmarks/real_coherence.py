"""Coherence of printed values of real recordings: with their intervals, a second seed, a peer, and halves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from real_independent import independent_fit
from real_recordings import Found, Recording, fit_of, grouped, tell, value_of
from scipy.stats import t

#: Share of printed values inside both intervals, difference of seeds [total sd], share of parameters that the
#: independent fit agrees on, and share of halves that differ by less than HALVES_SD.
BARS = {"inside": 1.0, "seed_sd": 0.1, "independent": 0.90, "halves": 0.95}
HALVES_SD = 2.6
NORMAL_975 = 1.959963984540054
#: Logs that a cut must have to be halved.
LEAST_LOGS = 4
#: Static poolings that the independent fit knows.
WRITTEN_APART = ("scaled", "partial")


def inside(parameter: Mapping[str, Any]) -> bool:
    """Report if a printed value lies in both of its intervals; a missing interval holds nothing."""
    value = parameter["value"]
    spans = (parameter.get("ci95"), parameter.get("ci95_total"))
    return all(span is not None and span[0] <= value <= span[1] for span in spans)


def seed_distances(first: Found, second: Found) -> dict[str, float]:
    """Difference of a second seed by parameter [total sd]; infinite without an sd or a second value."""
    one, other = first.printed(), second.printed()
    distances = {}
    for name in {*one, *other}:
        if name not in one or name not in other:
            distances[name] = float("inf")
            continue
        (a, sd), (b, _) = value_of(one[name]), value_of(other[name])
        apart = abs(b - a)
        distances[name] = 0.0 if apart == 0.0 else apart / sd if sd else float("inf")
    return distances


def _independent(found: Found, members: Sequence[Recording]) -> dict[str, Any]:
    """Distances of the independent fit by parameter [total sd], and the deviations of both."""
    logs = found.logs(as_recorded=True)
    if len(logs) != len(members) or not found.order[0]:
        return {"skipped": "not every log was fitted, or nothing relaxes"}
    if len(members) > 1 and found.pooling not in WRITTEN_APART:
        return {"skipped": f"static {found.pooling!r} is not written apart"}
    searched = len(members) > 1 or found.offset_apart
    values, rmse = independent_fit(
        logs,
        found.order,
        sigma_N=found.document["sigma_N"],
        contact_sd_mm=[one.contact_sd_mm for one in members] if searched else None,
        shaped=found.pooling == "scaled",
    )
    distances = {}
    for name, parameter in found.printed().items():
        value, sd = value_of(parameter)
        if sd and name in values:
            distances[name] = abs(values[name] - value) / sd
    return {"rmse_N": rmse, "fit_rmse_N": found.document["nrmsd"]["rmse_N"], "sd": distances}


def judged(name: str, kind: str, members: Sequence[Recording], seed: int) -> dict[str, Any]:
    """Row of one specimen: intervals, a second seed, and the independent fit."""
    tell(f"coherence: {name}, {len(members)} log{'s' if len(members) > 1 else ''}")
    row: dict[str, Any] = {"name": name, "kind": kind, "logs": len(members)}
    first = fit_of(members, name, seed=seed)
    if isinstance(first, str):
        return {**row, "failed": first}
    printed = first.printed()
    parameters = first.document["parameters"]
    row |= {
        "order": list(first.order),
        "pooling": first.pooling,
        "nrmsd": first.document["nrmsd"]["range"],
        "cpu_s": first.cpu_s,
        "parameters": len(parameters),
        "printed": len(printed),
        "withheld": [one["name"] for one in parameters if one["value"] is None],
        "without_interval": [
            name for name, one in printed.items() if not (one.get("ci95") and one.get("ci95_total"))
        ],
        "outside": [name for name, one in printed.items() if not inside(one)],
    }
    second = fit_of(members, name, seed=seed + 1)
    row["seed_sd"] = {"failed": second} if isinstance(second, str) else seed_distances(first, second)
    row["independent"] = _independent(first, members)
    return row


def combined_sds(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Difference of two values with standard deviations, over their combined one."""
    return abs(one[0] - other[0]) / float(np.hypot(one[1], other[1]))


def _ln_taus(found: Found) -> dict[str, tuple[float, float]]:
    """Logarithm of each printed relaxation time, with the standard deviation of its total interval."""
    taus = {}
    for name, one in found.printed().items():
        total = one.get("ci95_total")
        if name.startswith("relaxation_time_s") and total is not None and total[0] > 0.0:
            taus[name] = (float(np.log(one["value"])), float(np.log(total[1] / total[0])) / 3.92)
    return taus


def _ln_shape(found: Found) -> tuple[float, float] | None:
    """ln(F(1 s) / F(10 s)) as measured, and the deviation of its mean over logs; programs are pooled.

    Like that of ln tau it is a 95 % interval over 3.92, by Student's t: few logs hardly know their scatter.
    """
    rows = [
        one
        for one in found.document.get("measured", ())
        if one["name"] == "force_over_10s" and one["time_s"] == 1.0 and one["mean"] is not None
    ]
    count = sum(one["count"] for one in rows)
    if count < 2:
        return None
    mean = sum(one["count"] * one["mean"] for one in rows) / count
    within = sum((one["count"] - 1) * one["sd"] ** 2 for one in rows if one["sd"] is not None)
    between = sum(one["count"] * (one["mean"] - mean) ** 2 for one in rows)
    variance = (within + between) / (count - 1)
    wide = float(t.ppf(0.975, count - 1)) / NORMAL_975
    return float(np.log(mean)), wide * float(np.sqrt(variance / count)) / mean


def halves_of(count: int, splits: int, rng: np.random.Generator) -> list[tuple[list[int], list[int]]]:
    """Random splits of so many logs into halves."""
    out = []
    for _ in range(splits):
        order = rng.permutation(count).tolist()
        out.append((sorted(order[: count // 2]), sorted(order[count // 2 :])))
    return out


def _halves(
    name: str, members: Sequence[Recording], order: tuple[int, int], splits: int, seed: int
) -> list[dict[str, Any]]:
    """Rows of the splits of a cut: how far apart the halves are, in combined standard deviations."""
    rows = []
    rng = np.random.default_rng([20260301, seed, len(members)])
    for number, (left, right) in enumerate(halves_of(len(members), splits, rng)):
        tell(f"coherence: {name}, halves {number + 1} of {splits}")
        found = [
            fit_of([members[i] for i in half], name, seed=seed, branches=order[0], stiffness_degree=order[1])
            for half in (left, right)
        ]
        failed = [one for one in found if isinstance(one, str)]
        if failed:
            rows.append({"cut": name, "split": number, "failed": failed[0]})
            continue
        one, other = (half for half in found if isinstance(half, Found))
        taus, others = _ln_taus(one), _ln_taus(other)
        shapes = [shape for shape in (_ln_shape(one), _ln_shape(other)) if shape is not None]
        rows.append(
            {
                "cut": name,
                "split": number,
                "ln_tau_sd": {key: combined_sds(taus[key], others[key]) for key in taus if key in others},
                "mute_taus": order[0] - len(taus.keys() & others.keys()),
                "ln_shape_sd": combined_sds(*shapes) if len(shapes) == 2 else None,
            }
        )
    return rows


def _share(hits: int, count: int) -> float | None:
    return hits / count if count else None


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts over rows of one kind, with the bars they are held against."""
    good = [row for row in rows if "failed" not in row]
    printed = sum(row["printed"] for row in good)
    outside = sum(len(row["outside"]) for row in good)
    seeds = [sd for row in good if "failed" not in row["seed_sd"] for sd in row["seed_sd"].values()]
    peers = [sd for row in good for sd in row["independent"].get("sd", {}).values()]
    near = sum(sd <= BARS["seed_sd"] for sd in seeds)
    return {
        "specimens": len(rows),
        "failed": len(rows) - len(good),
        "printed": printed,
        "inside": _share(printed - outside, printed),
        "without_interval": sum(len(row["without_interval"]) for row in good),
        "specimens_all_inside": sum(not row["outside"] for row in good),
        "withheld_share": _share(
            sum(len(row["withheld"]) for row in good), sum(row["parameters"] for row in good)
        ),
        "seed_near": _share(near, len(seeds)),
        "seed_worst_sd": max(seeds, default=None),
        "independent_agree": _share(sum(sd <= 1.0 for sd in peers), len(peers)),
        "independent_compared": len(peers),
        "orders": sorted({tuple(row["order"]) for row in good}),
        "cpu_s_median": float(np.median([row["cpu_s"] for row in good])) if good else None,
    }


def _halves_summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    good = [row for row in rows if "failed" not in row]
    taus = [sd for row in good for sd in row["ln_tau_sd"].values()]
    shapes = [row["ln_shape_sd"] for row in good if row["ln_shape_sd"] is not None]
    return {
        "splits": len(rows),
        "failed": len(rows) - len(good),
        "ln_tau_agree": _share(sum(sd < HALVES_SD for sd in taus), len(taus)),
        "ln_tau_compared": len(taus),
        "mute_taus": sum(row["mute_taus"] for row in good),
        "ln_shape_agree": _share(sum(sd < HALVES_SD for sd in shapes), len(shapes)),
        "ln_shape_compared": len(shapes),
    }


def coherence(found: Sequence[Recording], *, cuts: int | None, splits: int, seed: int) -> dict[str, Any]:
    """Coherence of every recording, of the meat pooled by cut (at most ``cuts``), and of halves of cuts."""
    single = [judged(one.name, one.kind, [one], seed) for one in found]
    pooled, halves = [], []
    for name, members in list(grouped(found, "meat").items())[:cuts]:
        row = judged(name, "cut", members, seed)
        pooled.append(row)
        if "failed" not in row and len(members) >= LEAST_LOGS:
            halves += _halves(name, members, tuple(row["order"]), splits, seed)
    kinds = {kind: [row for row in single if row["kind"] == kind] for kind in {one.kind for one in found}}
    return {
        "bars": {**BARS, "halves_sd": HALVES_SD},
        "summary": {kind: summary(rows) for kind, rows in sorted(kinds.items())}
        | ({"cuts": summary(pooled), "halves": _halves_summary(halves)} if pooled else {}),
        "recordings": single,
        "cuts": pooled,
        "halves": halves,
    }
