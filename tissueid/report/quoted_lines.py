"""One or two lines of ``fit`` on what people quote of the model; the report and the JSON have them all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.digits import with_error
from tissueid.quantities import DEPTH_TEST


def _said(one: Mapping[str, Any], words: str) -> str:
    unit = "" if one["unit"] == "1" else f" {one['unit']}"
    return f"{words} {with_error(one['value'], one['stderr'])}{unit}"


def _known(rows: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [one for one in rows if one["value"] is not None]


def quoted_lines(document: Mapping[str, Any]) -> list[str]:
    """Modulus and loops in one line each, where there are any.

    ``document``: a specimen of identification.json; ``verbose``: 0 leaves the model's shares out where
    measured ones stand.
    """
    lines: list[str] = []
    quoted = document["quoted"]
    if quoted is not None:
        moduli = _known(quoted["moduli"])
        if moduli:
            depth = max(float(one["at"]["depth_mm"]) for one in moduli)
            best = moduli[0]["at"]["formula"]
            chosen = [one for one in moduli if (one["at"]["formula"], one["at"]["depth_mm"]) == (best, depth)]
            words = {"modulus_equilibrium": "E_inf", "modulus_instantaneous": "E_0"}
            parts = [_said(one, words[one["name"]]) for one in chosen]
            lines.append(f"modulus by {best} at {depth:.3g} mm  {', '.join(parts)}")
        lines += [_drainage(one) for one in quoted["model"] if one["name"] == DEPTH_TEST]
    if document["cycles"]:
        lines.append(_loops(document["cycles"]))
    return lines


def _drainage(slope: Mapping[str, Any]) -> str:
    """The depth test: drainage or viscosity."""
    if slope["value"] is None:
        return f"depth test: can't decide, {slope['reason']}"
    at = slope["at"]
    return (
        f"depth test: tau grows as contact radius^{slope['value']:.2f} [{at['low']:.2f}, {at['high']:.2f}], "
        f"{at['verdict']} (0 viscous, 2 drainage)"
    )


def _loops(cycles: list[Mapping[str, Any]]) -> str:
    """Line on the number of load-unload loops and the last of them."""
    eta, area = cycles[-1]["viscosity_model_N_s_per_mm"], cycles[-1]["dissipated_mJ"]
    said = f"{len(cycles)} loop{'s' * (len(cycles) > 1)}, last: area "
    said += f"{with_error(area['value'], area['stderr'])} mJ" if area["value"] is not None else "none"
    if eta["value"] is not None:
        said += f", all viscosity from that area {with_error(eta['value'], eta['stderr'])} N s/mm"
    return said
