"""Prediction of real recordings that ``tissueid fit`` has not seen, and description of those it has.

A hold that was left out is predicted from the other logs of its cut and from its own ramp, which gives its
own elastic curve: the others' force is multiplied by a curve of depth, so that static force and K scale alike
and the relaxation is that of the others.  A ramp time that was left out is predicted with nothing free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from real_baselines import (
    FittedLaw,
    FractionalPower,
    Law,
    Log,
    Paper,
    Proportional,
    QuasiLinear,
    Spectrum,
    Yardstick,
    carried_to,
    curve_rays,
    deepest,
    fit_law,
    fit_own,
    nrmsd,
)
from real_pooled import fit_pooled
from real_recordings import Found, Recording, fit_of, grouped, left_out, tell

import tissueid
from tissueid.model.base import ContactPath
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law

Array = NDArray[np.float64]

#: Order of the laws written apart where tissueid gives none.
USUAL_ORDER = (2, 1)
NO_MODEL = "no model: peak x mean curve"
OURS, PEER = "tissueid", "least squares, same law and freedom"
OWN, QUASI = "own curve, K in proportion", "quasi-linear, own curve"
AT_PEAK = " (peak given)"


def foreign_force(found: Found, log: Log, shift_mm: float = 0.0) -> Array:
    """Force that a fit, whose contacts lie ``shift_mm`` above a log's, predicts along that log's path [N]."""
    model = found.law
    theta = np.asarray(found.fit.theta, dtype=np.float64)
    depth = np.maximum(log.depth_mm + shift_mm, 0.0)
    if depth.max() <= model.depth_mm or not model.is_passive(theta):
        return model.force(theta, ContactPath(time_s=log.time_s, depth_mm=depth))
    # beyond the fitted depth the law is continued as it is rendered
    law, state = servo_law(model, theta).packed(), np.zeros(STATE_SIZE)
    steps = zip(depth.tolist(), np.diff(log.time_s, prepend=log.time_s[0]).tolist(), strict=True)
    return np.array([tissue_step_in(law, 0, state, 0, x, dt) for x, dt in steps])


def foreign_error(found: Found, log: Log, others: Sequence[Log]) -> float:
    """NRMSD of what a fit of others predicts, their contacts where the fit has them."""
    depths = [float(one.depth_mm.max()) for one in found.logs()]
    shift = float(np.mean(depths)) - float(np.mean([one.depth_mm.max() for one in others]))
    return nrmsd(foreign_force(found, log, shift), log.force_N)


def no_model(log: Log, others: Sequence[Log]) -> Array:
    """A log up to its peak, then that times the others' mean normalised curve [N]; NaN beyond them all."""
    after = log.time_s[log.peak :] - log.time_s[log.peak]
    curves = [
        np.interp(
            after,
            one.time_s[one.peak :] - one.time_s[one.peak],
            one.force_N[one.peak :] / one.force_N[one.peak],
            right=np.nan,
        )
        for one in others
    ]
    known = np.isfinite(curves)
    total = np.where(known, curves, 0.0).sum(axis=0)
    mean = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
    return np.concatenate([log.force_N[: log.peak], log.force_N[log.peak] * mean])


def hold_error(predicted: Array, log: Log, usable: NDArray[np.bool_]) -> float:
    """NRMSD of the samples after the peak, over the range of the log's forces."""
    after = slice(log.peak + 1, None)
    return nrmsd(
        predicted[after][usable[after]], log.force_N[after][usable[after]], float(np.ptp(log.force_N))
    )


def multiplied(force: Array, log: Log, depth_mm: float) -> Array:
    """Force of others times a non-negative curve of depth that follows from the ramp [N]."""
    rays = curve_rays(log.depth_mm / depth_mm, 2)
    return carried_to(rays * force[:, None], log)


def carried(found: Found, log: Log, depth_mm: float) -> Array:
    """Force that a fit of others predicts with an own elastic curve that follows from the ramp [N].

    The curve of a quasi-linear law stands inside the convolution, that of any other multiplies the force.
    """
    theta = dict(zip(found.fit.theta_names, found.fit.theta, strict=True))
    times = [value for name, value in theta.items() if name.startswith("relaxation_time_s")]
    ratios = [value for name, value in theta.items() if name.startswith("relaxation_ratio")]
    if not ratios or len(ratios) != len(times):
        return multiplied(foreign_force(found, log), log, depth_mm)
    law = QuasiLinear(len(times), depth_mm)
    return carried_to(law.columns(log, np.log([*times, *np.maximum(ratios, 1e-12)])), log)


def _peer(pooling: str, law: Paper, logs: Sequence[Log]) -> FittedLaw:
    """Least squares of the paper's law with the freedom of a pooling."""
    if pooling == "shared" or len(logs) == 1:
        return fit_law(law, logs)
    return fit_pooled(law, logs, shaped=pooling == "scaled").fitted


def own_curves(order: tuple[int, int], depth_mm: float, others: Sequence[Log], log: Log) -> dict[str, Array]:
    """Predictions of the laws with an own curve of each log, by least squares."""
    found = {}
    for name, law in ((OWN, Proportional(*order, depth_mm)), (QUASI, QuasiLinear(order[0], depth_mm))):
        fitted = fit_own(law, others)
        found[name] = carried_to(law.columns(log, fitted.shape), log)
    return found


def _left_out_log(cut: str, left_out: Recording, rest: Sequence[Recording]) -> dict[str, Any]:
    """Row of one log: NRMSD of its hold by every predictor."""
    log, others = left_out.log, [one.log for one in rest]
    depth = deepest([*others, log])
    ours = fit_of(rest, cut, sampled=False)
    order = ours.order if isinstance(ours, Found) and ours.order[0] else USUAL_ORDER
    pooling = ours.pooling if isinstance(ours, Found) else "partial"
    forces = own_curves(order, depth, others, log)
    peer = _peer(pooling, Paper(*order, depth), others)
    forces[PEER] = multiplied(peer.force(log), log, depth)
    if isinstance(ours, Found):
        forces[OURS] = carried(ours, log, depth)
    plain = no_model(log, others)
    usable = np.isfinite(plain)
    errors = {NO_MODEL: hold_error(plain, log, usable)}
    for name, force in forces.items():
        errors[name] = hold_error(force, log, usable)
        errors[name + AT_PEAK] = hold_error(force * log.force_N[log.peak] / force[log.peak], log, usable)
    row = {"cut": cut, "log": log.name, "order": list(order), "pooling": pooling, "nrmsd": errors}
    return row if isinstance(ours, Found) else {**row, "failed": ours}


def speed_laws(logs: Sequence[Log]) -> dict[str, Law]:
    """Laws that predict a ramp time that was left out."""
    depth = deepest(logs)
    laws: dict[str, Law] = {
        f"paper, {b} branch{'es' if b > 1 else ''}, K of degree {d}": Paper(b, d, depth)
        for b in (1, 2, 3)
        for d in (0, 1, 2)
    }
    laws |= {f"quasi-linear, {b} branch{'es' if b > 1 else ''}": QuasiLinear(b, depth) for b in (1, 2, 3)}
    laws |= {f"spectrum of 12, K of degree {d}": Spectrum.of(logs, degree=d) for d in (0, 2)}
    return laws | {"yardstick": Yardstick.of(logs), "fractional x power of depth": FractionalPower(depth)}


def band_holds(left_out: Recording, rest: Sequence[Recording]) -> dict[str, bool]:
    """Report if the whole curve at a speed that was left out lies in its band, by law."""
    held = {}
    for model in ("kelvin-voigt", "auto"):
        sampled = tissueid.fit([one.trial for one in rest], model, specimen="rest").sample()
        low, high = sampled.band(left_out.trial)
        seen, force = np.isfinite(low), left_out.trial.force_N
        held[model] = bool(((low <= force) & (force <= high))[seen].all())
    return held


def _left_out_speeds(condition: str, members: Sequence[Recording]) -> list[dict[str, Any]]:
    """Rows of one condition: each ramp time predicted from the others, nothing free."""
    rows = []
    members = sorted(members, key=lambda one: float(one.log.time_s[one.log.peak]))
    for place, one in enumerate(members):
        tell(f"prediction: {one.name} from the other ramp times")
        rest = [other for i, other in enumerate(members) if i != place]
        logs = [other.log for other in rest]
        errors: dict[str, float | None] = {}
        chosen: dict[str, Any] = {}
        for pooling in ("partial", "shared"):
            name = f"{OURS} ({'default' if pooling == 'partial' else 'one tissue'})"
            options = {} if pooling == "partial" else {"static": pooling}
            found = fit_of(rest, condition, sampled=False, **options)
            errors[name] = None
            chosen[name] = found if isinstance(found, str) else [*found.order, found.pooling]
            if isinstance(found, Found):
                errors[name] = foreign_error(found, one.log, logs)
        for name, law in speed_laws(logs).items():
            errors[name] = nrmsd(fit_law(law, logs).force(one.log), one.log.force_N)
        row = {"condition": condition, "left_out": one.name, "chosen": chosen, "nrmsd": errors}
        rows.append({**row, "whole_in_band": band_holds(one, rest)})
    return rows


def _medians(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float | int]]:
    """Median and worst NRMSD by predictor."""
    names = list(dict.fromkeys(name for row in rows for name in row["nrmsd"]))
    out: dict[str, dict[str, float | int]] = {}
    for name in names:
        values = [row["nrmsd"][name] for row in rows if row["nrmsd"].get(name) is not None]
        if values:
            out[name] = {"median": float(np.median(values)), "worst": max(values), "count": len(values)}
    return out


#: Measured curves and numbers whose next value is predicted, and peaks within which a log is of the program.
NEXT = ("force", "force_at_depth", "force_over_10s", "force_over_peak", "relaxation_time")
SAME_PEAK = 1.05


def _measured(members: Sequence[Recording], name: str) -> Sequence[Mapping[str, Any]]:
    """Measured numbers of logs, which no law touches."""
    found = fit_of(members, name, sampled=False, branches=1, stiffness_degree=0)
    return [] if isinstance(found, str) else found.document["measured"]


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Name of a measured number, with its hold and its time or depth."""
    return row["name"], row["hold"], row["time_s"] or row.get("depth_mm")


def measured_next(cut: str, left_out: Recording, rest: Sequence[Recording]) -> dict[str, bool]:
    """Report if the measured curves of a left-out log lie whole in ``prediction95`` of the others."""
    rows = _measured(rest, cut)
    own = {_key(row): row["mean"] for row in _measured([left_out], cut)}
    for program in dict.fromkeys(row["program"] for row in rows):
        known = {_key(row): row for row in rows if row["program"] == program}
        peak, mine = (
            next(row["mean"] for key, row in known.items() if key[0] == "peak"),
            own.get(("peak", 1, None)),
        )
        if mine and peak and max(peak, mine) < SAME_PEAK * min(peak, mine):
            break
    else:
        return {}
    inside: dict[str, list[bool]] = {}
    for key, row in known.items():
        if key[0] in NEXT and row.get("prediction95") and own.get(key) is not None:
            low, high = row["prediction95"]
            inside.setdefault(key[0], []).append(low <= own[key] <= high)
    return {name: all(every) for name, every in inside.items()}


def prediction(found: Sequence[Recording], *, cuts: int | None, logs: int | None) -> dict[str, Any]:
    """Holds left out of at most ``cuts`` cuts, ``logs`` of each, and ramp times of the muscle conditions."""
    holds = []
    for cut, one, rest in left_out(found, "meat", 3, cuts, logs):
        tell(f"prediction: {one.name} from the other logs of {cut}")
        holds.append(_left_out_log(cut, one, rest))
    speeds = [
        row
        for condition, members in grouped(found, "muscle", 3).items()
        for row in _left_out_speeds(condition, members)
    ]
    later = [measured_next(*each) for each in left_out(found, "meat", 4, cuts, logs)]
    held = {name: [one[name] for one in later if name in one] for name in NEXT}
    return {
        "measured_next": {
            name: {"inside": float(np.mean(every)), "count": len(every)}
            for name, every in held.items()
            if every
        },
        "left_out_logs": {"summary": _medians(holds), "rows": holds},
        "left_out_speeds": {"summary": _medians(speeds), "rows": speeds},
    }


def _of_curves(found: Found) -> float:
    """NRMSD of a fit over its fitted samples, from its curves."""
    counted = [np.asarray(one.curve.fitted, dtype=bool) for one in found.fit.trials]
    pairs = list(zip(found.fit.trials, counted, strict=True))
    model = np.concatenate([np.asarray(one.curve.model_N)[mask] for one, mask in pairs])
    force = np.concatenate([np.asarray(one.curve.force_N)[mask] for one, mask in pairs])
    return nrmsd(model, force)


def _least_squares(found: Found) -> dict[str, float]:
    """NRMSD of least squares on the samples of a fit by freedom, its own law and order."""
    logs, law = found.logs(), Paper(*found.order, deepest(found.logs()))
    if len(logs) == 1:
        # contact is at the fit's own point
        return {"shared": fit_law(law, logs).nrmsd}
    freedoms = dict.fromkeys(("partial", "scaled", found.pooling))
    return {pooling: _peer(pooling, law, logs).nrmsd for pooling in freedoms}


def _in_sample(name: str, kind: str, members: Sequence[Recording]) -> dict[str, Any]:
    tell(f"in-sample: {name}")
    found = fit_of(members, name, sampled=False)
    if isinstance(found, str):
        return {"name": name, "kind": kind, "failed": found}
    ours = _of_curves(found)
    row = {"name": name, "kind": kind, "order": list(found.order), "pooling": found.pooling, "nrmsd": ours}
    if not found.order[0]:
        return row
    peers = _least_squares(found)
    same = peers["shared" if len(members) == 1 else found.pooling]
    return {**row, "least_squares": peers, "ratio": ours / same if same else None}


def insample(found: Sequence[Recording], *, cuts: int | None) -> dict[str, Any]:
    """NRMSD of at most ``cuts`` cuts over least squares with the same freedom, and of single recordings."""
    pooled = [
        _in_sample(name, "cut", members) for name, members in list(grouped(found, "meat").items())[:cuts]
    ]
    single = [_in_sample(one.name, one.kind, [one]) for one in found]
    out: dict[str, Any] = {"summary": {}, "cuts": pooled, "recordings": single}
    for kind in sorted({row["kind"] for row in [*pooled, *single]}):
        good = [row for row in [*pooled, *single] if row["kind"] == kind and "failed" not in row]
        ratios = [row["ratio"] for row in good if row.get("ratio")]
        out["summary"][kind] = {
            "count": len(good),
            "nrmsd_median": float(np.median([row["nrmsd"] for row in good])) if good else None,
            "ratio_median": float(np.median(ratios)) if ratios else None,
            "ratio_worst": max(ratios, default=None),
        }
    return out
