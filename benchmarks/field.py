"""Calibration and alarms of ``tissueid fit`` on tissues and machines as laboratories have them.

Every specimen is drawn, recorded by :mod:`field_simulator`, and identified by the public interface with its
default options: nothing of the tissue is told.  Calibration states the machine, as it is, but in the case
that is named after it; laws and mechanisms are met with a machine of which nothing is said.  Specimens are
taken case by case in turn, so that a run that is stopped has the same number of each; records are kept, and
a second call goes on where the first ended.

    python benchmarks/field.py [--kind calibration|forms|mechanisms|all] [--specimens 200]
                               [--cases NAME ...] [--minutes M] [--records FILE] [--json]

Calibration: truths inside 95 % intervals, bias and spread in units of the interval's own deviation, error of
tau, and orders.  Forms: laws that are not the paper's.  Mechanisms: flags that are raised, and false ones.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from field_simulator import Drainage, Log, Machine, Tissue, recorded
from harness import asked_for, by_case, kept

import tissueid as ti
from tissueid.result import Identification
from tissueid.trial import Source

PROGRAM = (
    Log(4.0, 1.0),
    Log(8.0, 250.0 / 60.0),
    Log(8.0, 500.0 / 60.0),
    Log(4.0, 250.0 / 60.0, 3.0),
    Log(8.0, 250.0 / 60.0, 3.0),
    Log(8.0, 250.0 / 60.0, 3.0),
)
HOLDS = tuple(Log(6.0, 4.0, 6.0) for _ in range(6))
PLAIN = Machine(sigma_N=0.5)
#: Coefficient of variation of sites, and standard deviation of contact points [mm].
SITES, CONTACT_MM = 0.02, 0.02
#: Depth at which viscosity is quoted, over the largest.
HALF = 0.5
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Specimen:
    """Logs with their tissue and machine; what is true of the order, and which flag is due."""

    tissue: Tissue
    logs: tuple[Log, ...]
    machine: Machine
    order: tuple[int, int] | None = None
    tip: str = ""


Maker = Callable[[np.random.Generator], Specimen]


def _tissue(
    rng: np.random.Generator, *, rows: tuple[tuple[float, ...], ...], tau: tuple[float, ...]
) -> Tissue:
    """A tissue near the middle of its kind."""
    size = float(np.exp(rng.normal(0.0, 0.15)))
    static = (20.0 * size, -1.2 * size, 0.35 * size)
    scaled = tuple(tuple(size * k for k in row) for row in rows)
    times = tuple(float(t * np.exp(rng.normal(0.0, 0.3))) for t in tau)
    return Tissue(static, scaled, times)


def _sites(rng: np.random.Generator, logs: tuple[Log, ...], cv: float = SITES) -> tuple[Log, ...]:
    return tuple(
        replace(log, gain=float(np.exp(rng.normal(0.0, cv))), offset_mm=float(rng.normal(0.0, CONTACT_MM)))
        for log in logs
    )


def _case(
    rows: tuple[tuple[float, ...], ...] = ((30.0, 4.0),),
    tau: tuple[float, ...] = (0.3,),
    logs: tuple[Log, ...] = PROGRAM,
    machine: Callable[[np.random.Generator], Machine] = lambda _: PLAIN,
    each: Callable[[int, Log], Log] = lambda _, log: log,
    tip: str = "",
    **changes: Any,
) -> Maker:
    """Maker of specimens of one kind."""
    order = (len(tau), len(rows[0]) - 1)

    def make(rng: np.random.Generator) -> Specimen:
        tissue = replace(_tissue(rng, rows=rows, tau=tau), **changes)
        own = tuple(each(i, log) for i, log in enumerate(_sites(rng, logs)))
        return Specimen(tissue, own, machine(rng), None if changes else order, tip)

    return make


def _unstated(rng: np.random.Generator) -> Machine:
    """An ordinary machine of which nothing was stated."""
    stiffness = float(np.exp(rng.uniform(np.log(300.0), np.log(5000.0))))
    return replace(
        PLAIN,
        compliance_mm_per_N=1.0 / stiffness,
        filter_s=float(rng.uniform(0.0, 0.008)),
        skew_s=float(rng.normal(0.0, 0.0015)),
    )


def _gained(factor: Callable[[int], float]) -> Callable[[int, Log], Log]:
    """Change of the gain of each log by its number."""
    return lambda i, log: replace(log, gain=log.gain * factor(i))


UNSTATED = "unstated machine"
CALIBRATION: dict[str, Maker] = {
    "plain": _case(),
    "constant K": _case(rows=((60.0,),)),
    "rounded corners": _case(machine=lambda _: replace(PLAIN, rounding_s=0.06)),
    UNSTATED: _case(machine=_unstated),
    "K of degree 1 at the edge": _case(rows=((0.0, 12.0),)),
    "K of degree 2 at the edge": _case(rows=((48.0, -24.0, 3.0),)),
    "quantum 0.1 N": _case(machine=lambda _: replace(PLAIN, sigma_N=0.02, quantum_N=0.1)),
    "one log": _case(rows=((60.0,),), logs=HOLDS[:1]),
    "one log, K of degree 1": _case(tau=(1.0,), logs=HOLDS[:1]),
    "one log, K of degree 1 at the edge": _case(rows=((0.0, 12.0),), tau=(1.0,), logs=HOLDS[:1]),
    "two logs": _case(rows=((60.0,),), logs=HOLDS[:2]),
    "three logs": _case(rows=((60.0,),), logs=HOLDS[:3]),
    "hold of 0.3 tau": _case(
        rows=((60.0,),), tau=(5.0,), logs=tuple(replace(one, hold_s=1.5) for one in PROGRAM)
    ),
    "two branches": _case(rows=((60.0,), (20.0,)), tau=(0.1, 1.5), logs=(*PROGRAM, *HOLDS[:2])),
    "drift of 3 % a log": _case(each=_gained(lambda i: 1.0 + 0.03 * (i - (len(PROGRAM) - 1) / 2.0))),
}
FORMS: dict[str, Maker] = {
    "quasi-linear": _case(inside=True, tau=(1.0,), rows=((30.0,),), logs=(*PROGRAM[:3], *HOLDS[:3])),
    "power law": _case(power=0.2, rows=((60.0,),), logs=(*PROGRAM[:3], *HOLDS[:3])),
}


def _base(depth: np.ndarray, force: np.ndarray) -> np.ndarray:
    """A rigid base 9 mm below the surface."""
    return force / (1.0 - np.clip(depth / 9.0, 0.0, 0.95)) ** 3


def _stick_slip(depth: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Friction that builds up over 0.6 mm of travel and lets go, 8 % of the force."""
    phase = np.mod(np.maximum(depth, 0.0), 0.6) / 0.6
    return force * (1.0 + 0.08 * (phase - 0.5))


def _tilted(depth: np.ndarray) -> np.ndarray:
    """Mean depth of a flat punch of 5 mm radius that stands 8 degrees askew."""
    across = 5.0 * np.sin(np.radians(8.0)) * np.linspace(-1.0, 1.0, 41)
    chord = np.sqrt(1.0 - np.linspace(-1.0, 1.0, 41) ** 2)
    lower = np.maximum(depth[:, None] - 5.0 * np.sin(np.radians(8.0)) + across, 0.0)
    return np.asarray(lower @ (chord / chord.sum()))


def _drained(rng: np.random.Generator) -> Specimen:
    """A soaked disc under a sphere, held at four depths twice each."""
    size, spread = rng.lognormal(0.0, 0.15), rng.lognormal(0.0, 0.3)
    tissue = Tissue(drains=Drainage(8.0 * size, 0.5, 60.0 * spread, 20.0))
    return Specimen(tissue, _sites(rng, DEPTHS), PLAIN, tip=SPHERE)


def _all_bent(bent: Any) -> Callable[[int, Log], Log]:
    return lambda _, log: replace(log, bent=bent)


#: Two pushes each to four depths, and the tip that they are made with.
DEPTHS = tuple(Log(depth, 2.0 * depth, 8.0) for depth in (2.0, 4.0, 6.0, 9.0) for _ in range(2))
SPHERE = """schema = "tissueid/study/1"
[tip]
shape = "sphere"
radius_mm = 20.0
"""
FLAT = SPHERE.replace("sphere", "flat").replace("20.0", "5.0")
#: Makers with the flags of which one is due.
MECHANISMS: dict[str, tuple[Maker, tuple[str, ...]]] = {
    "none": (_case(logs=HOLDS), ()),
    "first push 20 % stiffer": (
        _case(logs=HOLDS, each=_gained(lambda i: 1.2 if i == 0 else 1.0)),
        ("order_effect",),
    ),
    "damage of 5 % a push": (_case(logs=HOLDS, each=_gained(lambda i: 0.95**i)), ("order_effect",)),
    "rigid base": (_case(each=_all_bent(_base)), ("discrepancy", "misfit")),
    "drainage at four depths": (_drained, ("poroelastic",)),
    "viscous at four depths": (_case(logs=DEPTHS, tip=SPHERE), ()),
    "pull-off": (
        _case(logs=tuple(replace(one, returns=True) for one in HOLDS), adhesion_N=8.0),
        ("adhesion", "contact_loss_misfit"),
    ),
    "tilt of 8 degrees": (
        _case(each=lambda _, log: replace(log, met=_tilted), tip=FLAT),
        ("discrepancy", "misfit"),
    ),
    "stick-slip": (_case(logs=HOLDS, each=_all_bent(_stick_slip)), ("discrepancy", "misfit", "slip")),
}
FALSE_ALARMS = ("discrepancy", "misfit", "order_effect", "gain_spread", "slip", "poroelastic", "adhesion")


#: A study that states the machine of :data:`PLAIN`.
STATED = """schema = "tissueid/study/1"
[calibration]
frame_stiffness_N_per_mm = 1e7
force_filter_s = 0.0
force_filter_s_sd = 1e-6
skew_s = 0.0
skew_s_sd = 1e-6
load_cell_class = 0.5
displacement_class = 0.5
"""


def identified(trials: Sequence[ti.Trial], told: str, seed: int, model: str | None = None) -> Identification:
    """Identify recordings with a posterior, beside a study file of the text that is told."""
    options = ti.IdentifyOptions(
        fit=ti.FitOptions(model=model), posterior=ti.PosteriorOptions(seed=seed), seed=seed
    )
    study = None
    if told:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "study.toml"
            path.write_text(told, encoding="utf-8")
            study = ti.read_study(path)
    return ti.identify(trials, study=study, options=options)


def compared(one: dict[str, Any], truth: float) -> dict[str, Any]:
    """A truth beside its total interval: in units of the interval's own deviation, and if it is inside."""
    low, high = one["ci95_total"]
    return {"z": (one["value"] - truth) / max((high - low) / 3.92, 1e-300), "in": low <= truth <= high}


def _truths(tissue: Tissue, depth_mm: float) -> dict[str, float]:
    """True parameters by the names of ``identification.json``, branches by ascending relaxation time."""
    found = {f"static_{k}_N_per_mm{'' if k == 1 else k}": tissue.static[k - 1] for k in (1, 2, 3)}
    for j, at in enumerate(np.argsort(tissue.tau_s)):
        suffix, row = "" if j == 0 else f"_b{j + 1}", tissue.stiffness[at]
        for k, value in enumerate(row):
            found[f"stiffness_{k}_N_per_mm{'' if k == 0 else k + 1}{suffix}"] = value
        found[f"relaxation_time_s{suffix}"] = tissue.tau_s[at]
        here = sum(k * (HALF * depth_mm) ** i for i, k in enumerate(row))
        found[f"viscosity_N_s_per_mm{suffix}"] = tissue.tau_s[at] * here
    return found


def _relaxed(tissue: Tissue, at: dict[str, Any]) -> float:
    """Share of the peak that the true tissue loses after a ramp."""
    # so fine that the corner between two samples is none of the error: at 1 kHz it was 2e-4 of the share
    exact = Machine(sigma_N=0.0, rate_Hz=20_000.0, decimals=12)
    log = Log(at["depth_mm"], at["speed_mm_s"], at["time_s"] + 0.1)
    time_s, _, force = recorded(tissue, log, exact, np.random.default_rng(0))
    peak = float(np.interp(log.depth_mm / log.speed_mm_s + 0.6, time_s, force))
    later = float(np.interp(log.depth_mm / log.speed_mm_s + 0.6 + at["time_s"], time_s, force))
    return 1.0 - later / peak


def _judged(specimen: Specimen, document: dict[str, Any]) -> dict[str, Any]:
    """What of a document is right."""
    depth = float(document["validity"]["depth_mm"]) if "depth_mm" in document["validity"] else 8.0
    truths = _truths(specimen.tissue, depth) if specimen.order else {}
    if len(specimen.logs) == 1:
        # one log speaks of this push
        gain = specimen.logs[0].gain
        truths = {name: value * (1.0 if "time" in name else gain) for name, value in truths.items()}
    model = document["model"]
    found = (model["branches"], model["stiffness_degree"])
    said = [*document["flags"], *(flag for trial in document["trials"] for flag in trial["flags"])]
    codes = sorted({flag["code"] for flag in said})
    rows: dict[str, Any] = {}
    for one in document["parameters"]:
        truth, value, total = truths.get(one["name"]), one["value"], one["ci95_total"]
        if truth is None or value is None or total is None or found[0] != (specimen.order or (0, 0))[0]:
            continue  # of another number of branches; a K of another degree has to hold the truth
        beside = compared(one, truth)
        rows[one["name"]] = {
            "z": beside["z"],
            "in": one["ci95"][0] <= truth <= one["ci95"][1],
            "in_total": beside["in"],
            "error": (value - truth) / truth if truth else None,
        }
    shares = [
        one for one in document["quoted"]["model"]
        if one["name"] == "fraction_relaxed" and one["at"]["path"] == "ramp" and one["at"]["time_s"] == 1.0
    ]  # fmt: skip
    share = None
    if shares and shares[0]["value"] is not None:
        truth = _relaxed(specimen.tissue, shares[0]["at"])
        share = {
            "value": shares[0]["value"],
            "truth": truth,
            "z": (shares[0]["value"] - truth) / shares[0]["stderr"],
        }
    tau = next(one for one in document["parameters"] if one["name"] == "relaxation_time_s")
    return {
        "order": list(found),
        "truth": None if specimen.order is None else list(specimen.order),
        "flags": codes,
        "parameters": rows,
        "share": share,
        "tau_error": None
        if tau["value"] is None or not specimen.order
        else tau["value"] / min(specimen.tissue.tau_s) - 1.0,
        # no property of the tissue, where it follows the hold, or the law that predicts as well
        "tau_identified": bool(tau["identified"]) and "form_dependent" not in codes,
    }


def _recorded(name: str, number: int) -> dict[str, Any]:
    """Record of one specimen, drawn with a seed of its own: the same in whatever order they are drawn."""
    rng = np.random.default_rng([20261125, number, *name.encode()])
    specimen, started = MAKERS[name](rng), time.process_time()
    trials = [
        ti.Trial("field", *recorded(specimen.tissue, log, specimen.machine, rng), source=Source(f"{k}.csv"))
        for k, log in enumerate(specimen.logs)
    ]
    told = STATED if name in CALIBRATION and name != UNSTATED else specimen.tip
    document = identified(trials, told, number).as_json()["specimens"][0]
    return {**_judged(specimen, document), "cpu_s": time.process_time() - started}


def _share(values: list[bool]) -> str:
    return f"{100.0 * float(np.mean(values)):5.1f}" if values else "    -"


def _middle(values: list[float]) -> str:
    """Median in percent."""
    return f"{100.0 * float(np.median(values)):.2f}" if values else "-"


def calibration_lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Tables of one case after another."""
    for name, mine in by_case(found):
        right = [one["order"] == one["truth"] for one in mine]
        open_ = ["model_undecided" in one["flags"] and one["order"] != one["truth"] for one in mine]
        wrong = [not r and not u for r, u in zip(right, open_, strict=True)]
        errors = [abs(one["tau_error"]) for one in mine if one["tau_error"] is not None]
        false = [bool({"misfit", "discrepancy"} & set(one["flags"])) for one in mine]
        yield (
            f"{name}: {len(mine)} specimens, order right {_share(right)} %, undecided {_share(open_)} %, "
            f"wrong {_share(wrong)} %; median error of tau {_middle(errors)} %; "
            f"false alarms {_share(false)} %; {np.median([one['cpu_s'] for one in mine]):.1f} s a specimen"
        )
        names = dict.fromkeys(key for one in mine for key in one["parameters"])
        for key in names:
            rows = [one["parameters"][key] for one in mine if key in one["parameters"]]
            z = np.array([row["z"] for row in rows])
            yield (
                f"  {key:32} n {len(rows):4d}  ci95 {_share([row['in'] for row in rows])}  total "
                f"{_share([row['in_total'] for row in rows])}  bias {np.mean(z):+.2f}  sd {np.std(z):.2f}"
            )
        shares = [one["share"]["z"] for one in mine if one["share"]]
        if shares:
            inside = _share([abs(z) < NORMAL_95 for z in shares])
            yield f"  {'relaxed 1 s after a ramp':32} n {len(shares):4d}  ci95 {inside}"


def form_lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Laws that are not the paper's."""
    for name, mine in by_case(found):
        shares = [one["share"]["z"] for one in mine if one["share"]]
        off = [abs(one["share"]["value"] - one["share"]["truth"]) for one in mine if one["share"]]
        yield (
            f"{name}: {len(mine)} specimens, share relaxed inside its interval "
            f"{_share([abs(z) < NORMAL_95 for z in shares])} %, off by {_middle(off)} points; tau identified "
            f"{_share([one['tau_identified'] for one in mine])} %; flags "
            + ", ".join(
                f"{code} {_share([code in one['flags'] for one in mine])} %"
                for code in ("form_dependent", "discrepancy", "misfit", "model_undecided")
            )
        )


def mechanism_lines(found: list[dict[str, Any]]) -> Iterator[str]:
    """Flags that are raised, and false ones."""
    for name, mine in by_case(found):
        due = MECHANISMS[name][1]
        wanted = due or FALSE_ALARMS
        hit = [bool(set(wanted) & set(one["flags"])) for one in mine]
        each = ", ".join(f"{code} {_share([code in one['flags'] for one in mine])}" for code in FALSE_ALARMS)
        yield f"{name}: {len(mine)} specimens, {'named' if due else 'false'} {_share(hit)} %  ({each})"


KINDS: dict[str, tuple[dict[str, Maker], Callable[[list[dict[str, Any]]], Iterator[str]]]] = {
    "calibration": (CALIBRATION, calibration_lines),
    "forms": (FORMS, form_lines),
    "mechanisms": ({name: one[0] for name, one in MECHANISMS.items()}, mechanism_lines),
}


MAKERS = {name: make for makers, _ in KINDS.values() for name, make in makers.items()}


def main() -> None:
    """Run what was asked for."""
    asked = asked_for(__doc__, (*KINDS, "all"), "all", specimens=200, records="field-records.jsonl")
    for kind, (makers, lines) in KINDS.items():
        if asked.kind not in (kind, "all"):
            continue
        found = kept([name for name in makers if not asked.cases or name in asked.cases], asked, _recorded)
        print(json.dumps(found) if asked.json else "\n".join([kind, *lines(found)]), flush=True)


if __name__ == "__main__":
    main()
