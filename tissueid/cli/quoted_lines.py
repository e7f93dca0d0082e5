"""One or two lines of ``fit`` on the numbers people quote; the report and the JSON have them all."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import Any

from tissueid.digits import with_error

__all__ = ["quoted_lines"]

#: The model's share of the peak stands beside the measured one where it differs by this part of it.
APART, LEAST_SHARE = 0.1, 0.05


def _said(one: Mapping[str, Any], words: str) -> str:
    unit = "" if one["unit"] == "1" else f" {one['unit']}"
    return f"{words} {with_error(one['value'], one['stderr'])}{unit}"


def _known(rows: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [one for one in rows if one["value"] is not None]


def quoted_lines(document: Mapping[str, Any], *, verbose: int = 1) -> list[str]:
    """Relaxation and modulus in one line each, where there are any.

    Parameters
    ----------
    document : mapping
        A specimen of identification.json.
    verbose : int
        0 leaves the model's shares out where measured ones stand.
    """
    lines: list[str] = []
    quoted = document["quoted"]
    if quoted is not None:
        lines += _relaxed_lines(quoted, verbose=verbose)
        moduli = _known(quoted["moduli"])
        if moduli:
            depth = max(float(one["at"]["depth_mm"]) for one in moduli)
            best = moduli[0]["at"]["formula"]
            chosen = [one for one in moduli if (one["at"]["formula"], one["at"]["depth_mm"]) == (best, depth)]
            words = {"modulus_equilibrium": "E_inf", "modulus_instantaneous": "E_0"}
            parts = [_said(one, words[one["name"]]) for one in chosen]
            lines.append(f"modulus by {best} at {depth:.3g} mm  {', '.join(parts)}")
    if document["cycles"]:
        lines.append(_loops(document["cycles"]))
    return lines


def _relaxed_lines(quoted: Mapping[str, Any], *, verbose: int) -> list[str]:
    """Measured shares of the peak that have relaxed, and the model's beside them where they differ."""
    measured: dict[float, list[float]] = {}
    for one in _known(quoted["measured"]):
        if one["name"] == "fraction_relaxed":
            measured.setdefault(float(one["at"]["time_s"]), []).append(float(one["value"]))
    model = {
        float(one["at"]["time_s"]): one
        for one in _known(quoted["model"])
        if one["name"] == "fraction_relaxed" and one["at"]["path"] == "ramp"
    }
    lines = []
    if measured:
        parts = [f"{time:g} s: {_middle(values)}" for time, values in sorted(measured.items())]
        lines.append(f"relaxed after the ramp, measured  {', '.join(parts)}")
    apart = [
        _said(one, f"{time:g} s:")
        for time, one in sorted(model.items())
        if time not in measured or _differs(float(one["value"]), statistics.median(measured[time]))
    ]
    if apart and (verbose or not measured):
        lines.append(
            f"{'but by' if measured else 'relaxed after the ramp, by'} the model  {', '.join(apart)}"
        )
    return lines


def _middle(values: list[float]) -> str:
    """Median of the logs, and their range."""
    middle = f"{statistics.median(values):.3g}"
    return middle if len(values) == 1 else f"{middle} ({min(values):.3g} to {max(values):.3g})"


def _differs(model: float, measured: float) -> bool:
    return abs(model - measured) > APART * max(abs(measured), LEAST_SHARE)


def _loops(cycles: list[Mapping[str, Any]]) -> str:
    """How many load-unload loops there are, and what the last one says."""
    eta, area = cycles[-1]["viscosity_model_N_s_per_mm"], cycles[-1]["dissipated_mJ"]
    said = f"{len(cycles)} loop{'s' * (len(cycles) > 1)}, last: area "
    said += f"{with_error(area['value'], area['stderr'])} mJ" if area["value"] is not None else "none"
    if eta["value"] is not None:
        said += f", all viscosity from that area {with_error(eta['value'], eta['stderr'])} N s/mm"
    return said
