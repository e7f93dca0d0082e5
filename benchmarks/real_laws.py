"""The law that ``--model auto`` chooses against five laws written apart, on real groups of recordings.

Every hold of a cut of meat is predicted from the other logs, with an elastic curve of its own from its ramp;
every ramp time of a muscle condition from the others, nothing free.  A group's error is the root mean square
of its left-out NRMSDs, and counts over that of the best of the five.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from real_baselines import (
    FractionalPower,
    Law,
    Log,
    Paper,
    QuasiLinear,
    Spectrum,
    Yardstick,
    deepest,
    fit_law,
    nrmsd,
)
from real_prediction import (
    NO_MODEL,
    OWN,
    QUASI,
    USUAL_ORDER,
    carried,
    foreign_error,
    hold_error,
    multiplied,
    no_model,
    own_curves,
)
from real_recordings import Found, Recording, fit_of, left_out, tell

Array = NDArray[np.float64]

AUTO, PLAIN = "tissueid --model auto", "tissueid"
#: Bars: median over groups, and every group, over the best of the five.
MEDIAN_BAR, WORST_BAR = 1.10, 1.25


def five_laws(logs: Sequence[Log]) -> dict[str, Law]:
    """The paper's family, spectrum, quasi-linear law, yardstick, and springpot beside a power of depth."""
    depth = deepest(logs)
    return {
        "paper's family": Paper(*USUAL_ORDER, depth),
        "spectrum of 12": Spectrum.of(logs),
        "quasi-linear": QuasiLinear(USUAL_ORDER[0], depth),
        "yardstick": Yardstick.of(logs),
        "fractional x power of depth": FractionalPower(depth),
    }


def _levelled(logs: Sequence[Log]) -> list[Log]:
    """Logs with forces brought to one level, by the peak over the square of the depth."""
    level = np.log([float(log.force_N.max()) / float(log.depth_mm.max()) ** 2 for log in logs])
    return [
        replace(log, force_N=log.force_N * gain)
        for log, gain in zip(logs, np.exp(level.mean() - level), strict=True)
    ]


def _fitted(rest: Sequence[Recording], name: str, model: str | None, **options: str) -> Found | str:
    return fit_of(rest, name, sampled=False, **options, **({} if model is None else {"model": model}))


def _of_hold(cut: str, rest: Sequence[Recording], log: Log) -> dict[str, float]:
    """NRMSD of one hold by every predictor."""
    others = [one.log for one in rest]
    depth = deepest([*others, log])
    curves = own_curves(USUAL_ORDER, depth, others, log)
    own = {"paper's family": curves[OWN], "quasi-linear": curves[QUASI]}
    forces, levelled = {}, _levelled(others)
    for name, law in five_laws([*others, log]).items():
        known = own.get(name)
        forces[name] = multiplied(fit_law(law, levelled).force(log), log, depth) if known is None else known
    for name, model in ((AUTO, "auto"), (PLAIN, None)):
        ours = _fitted(rest, cut, model)
        if isinstance(ours, Found):
            forces[name] = carried(ours, log, depth)
    forces[NO_MODEL] = no_model(log, others)
    usable = np.isfinite(forces[NO_MODEL])
    return {name: hold_error(force, log, usable) for name, force in forces.items()}


def _of_speed(condition: str, rest: Sequence[Recording], log: Log) -> dict[str, float]:
    """NRMSD of one ramp time by every predictor, nothing free."""
    logs = [one.log for one in rest]
    found = {name: nrmsd(fit_law(law, logs).force(log), log.force_N) for name, law in five_laws(logs).items()}
    for name, model in ((AUTO, "auto"), (PLAIN, None)):
        # nothing is free of the log that is left out: of the others nothing but their contacts is
        ours = _fitted(rest, condition, model, static="shared")
        if isinstance(ours, Found):
            found[name] = foreign_error(ours, log, logs)
    return found


def _row(name: str, errors: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """A group: root mean squares by predictor, and what is chosen over the best of the five."""
    names = dict.fromkeys(key for one in errors for key in one)
    total = {
        key: float(np.sqrt(np.mean([one[key] ** 2 for one in errors])))
        for key in names
        if all(key in one for one in errors)
    }
    best = min((key for key in total if key not in {AUTO, PLAIN, NO_MODEL}), key=lambda key: total[key])
    ratios = {key: total[key] / total[best] for key in (AUTO, PLAIN) if key in total}
    return {"group": name, "count": len(errors), "nrmsd": total, "best": best, "ratio": ratios}


def among_laws(found: Sequence[Recording], *, cuts: int | None, logs: int | None) -> dict[str, Any]:
    """Rows of at most ``cuts`` groups of a kind, ``logs`` left out of each, and ratios to the best law."""
    rows = []
    for kind, one_of in (("muscle", _of_speed), ("meat", _of_hold)):
        errors: dict[str, list[dict[str, float]]] = {}
        for name, one, rest in left_out(found, kind, 3, cuts, logs):
            tell(f"laws: {one.name} from the others of {name}")
            errors.setdefault(name, []).append(one_of(name, rest, one.log))
        rows += [_row(name, every) for name, every in errors.items()]
    summary = {}
    for key in (AUTO, PLAIN):
        ratios = [row["ratio"][key] for row in rows if key in row["ratio"]]
        if ratios:
            summary[key] = {"median": float(np.median(ratios)), "worst": max(ratios), "count": len(ratios)}
    return {"summary": summary, "rows": rows, "bars": {"median": MEDIAN_BAR, "worst": WORST_BAR}}
