"""Recovery of every registered law from its own simulations, by the public interface.

Each law (every static law, stiffness and relaxation at least once) draws tissues, records one push and hold
of 6.5 s at 100 Hz with white noise, and is asked for by name; the machine is stated, as it is.  Records are
kept, and a second call goes on where the first ended.

    python benchmarks/laws.py [--kind recovery|choice] [--specimens 100] [--cases NAME ...] [--minutes M]
                              [--records FILE] [--json]

Recovery prints: truths inside their total 95 % interval (of parameters that are given one), the band in
which that count lies with 99 % where 95 % are true, bias and spread in units of the interval's own deviation.
Choice lets each law push at three speeds (0.4, 4 and 40 mm/s) and asks for the best of :data:`AMONG`; where
the best Kelvin-Voigt law, fitted to two speeds without noise, misses the third by more than twice the noise,
it counts how often the true law, or one that ties with it, is taken (the Kelvin-Voigt law is never right
there), and elsewhere how often a law is taken that ties.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from field import STATED, compared, identified
from harness import asked_for, by_case, kept
from scipy.stats import binom

import tissueid as ti
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import known_laws, parsed
from tissueid.model.law import Shape

DEPTH_MM, RATE_HZ, NOISE_N, AIR_S, LENGTH_S, SPEED_MM_S = 6.0, 100.0, 0.15, 0.5, 8.5, 4.0
#: Time that is fitted: from contact to the last sample.
WINDOW_S, SURFACE_MM = LENGTH_S - AIR_S - 1.0 / RATE_HZ, 2.0
#: Middle of the truths by the beginning of a parameter's name, and their spread in the logarithm.
TRUTH = {
    "static_1": 20.0, "static_2": -1.2, "static_3": 0.35, "static_N_per_mm": 12.0, "static_exponent": 1.4,
    "static_stiffness": 12.0, "static_rate": 0.15, "stiffness_0": 30.0, "stiffness_1": 4.0,
    "stiffness_2": -0.2, "relaxation_time": 0.4, "relaxation_exponent": 0.5, "relaxation_span": 100.0,
    "relaxation_ratio": 1.2,
}  # fmt: skip
SPREAD, SIZE_SPREAD, SECOND_TIME = 0.1, 0.2, 4.0
#: Laws that are chosen among, beside the Kelvin-Voigt law, and the speeds [mm/s].
AMONG = (
    "power * power-law", "power * stretched", "power * fractional", "power * fung",
    "power * tangent * prony:1",
)  # fmt: skip
SPEEDS_MM_S, HOLD_S = (0.4, 4.0, 40.0), 6.0
#: One tissue whose contact is known: nothing of a log is free.
CONTACT = ti.SegmentOptions(contact_displacement_mm=SURFACE_MM, contact_sd_mm=1e-3)
SHARED, WHITE = ti.FitOptions(static="shared"), ti.FitOptions(static="shared", noise="white")
TWICE = 2.0


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


def _truth(model: ChannelModel, rng: np.random.Generator) -> dict[str, float]:
    """A tissue of a law."""
    size = float(np.exp(rng.normal(0.0, SIZE_SPREAD)))
    truth = {}
    for row in model.layout:
        # of a law that the table does not know its shapes start where it says
        one, starts = (row.spec, row.starts) if isinstance(row, Shape) else (row, (TRUTH["static_N_per_mm"],))
        known = (middle for start, middle in TRUTH.items() if one.name.startswith(start))
        value = next(known, None) or float(np.median(starts))
        if one.name.endswith("_b2") and one.name.startswith("relaxation_time"):
            value *= SECOND_TIME
        scaled = "N" in one.unit
        # polynomials stay in proportion, or they would not stay passive
        truth[one.name] = value * (size if scaled else float(np.exp(rng.normal(0.0, SPREAD))))
    return truth


def _push(
    model: ChannelModel, truth: dict[str, float], speed: float, length_s: float
) -> tuple[np.ndarray, ...]:
    """Times, travel and force without noise of a push from the air at a speed, and a hold."""
    time_s = np.arange(0.0, length_s, 1.0 / RATE_HZ)
    depth = np.interp(time_s, [AIR_S, AIR_S + DEPTH_MM / speed], [0.0, DEPTH_MM])
    force = model.force(np.array(list(truth.values())), ContactPath(time_s, depth))
    return time_s, np.where(time_s < AIR_S, speed * (time_s - AIR_S), depth) + SURFACE_MM, force


def simulated(name: str, rng: np.random.Generator) -> tuple[dict[str, float], tuple[np.ndarray, ...]]:
    """Truth and a recording."""
    model = _model(name)
    truth = _truth(model, rng)
    time_s, travel, force = _push(model, truth, SPEED_MM_S, LENGTH_S)
    return truth, (time_s, travel, force + rng.normal(0.0, NOISE_N, time_s.size))


def judged(name: str, number: int) -> dict[str, Any]:
    """Record of one specimen."""
    rng = np.random.default_rng([20261125, number, *name.encode()])
    truth, (time_s, travel, force) = simulated(name, rng)
    started = time.process_time()
    found = identified([ti.Trial("law", time_s, travel, force)], STATED, number, name)
    document = found.as_json()["specimens"][0]
    rows = {
        one["name"]: compared(one, truth[one["name"]])
        for one in document["parameters"]
        if one["name"] in truth and one["ci95_total"] is not None
    }
    return {
        "parameters": rows, "nrmsd": document["nrmsd"]["range"],
        "converged": document["sampler"]["converged"],
        "flags": sorted({flag["code"] for flag in document["flags"]}),
        "cpu_s": time.process_time() - started,
    }  # fmt: skip


def _pushes(model: ChannelModel, truth: dict[str, float], noise: np.random.Generator | None) -> list[Any]:
    """A push and a hold at each speed."""
    out = []
    for k, speed in enumerate(SPEEDS_MM_S):
        time_s, travel, force = _push(model, truth, speed, AIR_S + DEPTH_MM / speed + HOLD_S)
        if noise is not None:
            force = force + noise.normal(0.0, NOISE_N, time_s.size)
        out.append(ti.Trial(f"speed {k}", time_s, travel, force))
    return out


def _missed(trials: list[Any]) -> float:
    """Root-mean-square miss of a speed that the best Kelvin-Voigt law of the others predicts.

    The median of the speeds or, where the first two are missed by more than twice the noise, the lesser.
    """
    missed: list[float] = []
    for k, one in enumerate(trials):
        rest = [other for i, other in enumerate(trials) if i != k]
        residual = ti.fit(rest, segment=CONTACT, options=WHITE).residual(one)
        missed.append(float(np.sqrt(np.nanmean(residual**2))))
        if k == 1 and min(missed) > TWICE * NOISE_N:
            return min(missed)
    return float(np.median(missed))


def chosen(name: str, number: int) -> dict[str, Any]:
    """Record of a choice."""
    rng = np.random.default_rng([20261125, number, *b"choice", *name.encode()])
    model = _model(name)
    truth, started = _truth(model, rng), time.process_time()
    missed = _missed(_pushes(model, truth, None))
    every = " | ".join(["kelvin-voigt", *AMONG])
    fit = ti.fit(_pushes(model, truth, rng), every, segment=CONTACT, options=SHARED)
    rows = [row for row in fit.selection if row.get("model") == name]
    tied = bool(rows) and (rows[0]["chosen"] or rows[0]["score"] >= -max(rows[0]["stderr"], 0.02))
    taken = str(fit.result.model.name)
    return {
        "taken": taken, "tied": tied, "missed_N": missed,
        "right": taken != "kelvin-voigt" and (taken == name or tied), "cpu_s": time.process_time() - started,
    }  # fmt: skip


def choice_lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Table of one true law after another."""
    for name, mine in by_case(found):
        apart = [one for one in mine if one["missed_N"] > TWICE * NOISE_N]
        near = [one for one in mine if one["missed_N"] <= TWICE * NOISE_N]
        taken, right = Counter(one["taken"] for one in mine), sum(one["right"] for one in apart)
        yield (
            f"{name}: {len(mine)} specimens; Kelvin-Voigt misses a speed in {len(apart)}, true law or a tie "
            f"taken in {right}; of the {len(near)} others a tie in {sum(one['tied'] for one in near)}; "
            f"taken {dict(taken)}; {np.median([one['cpu_s'] for one in mine]):.1f} s"
        )


def lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Table of one law after another."""
    for name, mine in by_case(found):
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
    asked = asked_for(
        __doc__, ("recovery", "choice"), "recovery", specimens=100, records="laws-records.jsonl"
    )
    recovery = asked.kind == "recovery"
    found = kept(asked.cases or (names() if recovery else AMONG), asked, judged if recovery else chosen)
    table = lines if recovery else choice_lines
    print(json.dumps(found) if asked.json else "\n".join(table(found)), flush=True)


if __name__ == "__main__":
    main()
