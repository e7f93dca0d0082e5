"""One or two lines of ``fit`` on the numbers people quote; the report and the JSON have them all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.cli.output import with_error

if TYPE_CHECKING:
    from tissueid.quantities import Quantity
    from tissueid.result import SpecimenFit

__all__ = ["quoted_lines"]


def _said(one: Quantity, words: str) -> str:
    assert one.value is not None  # noqa: S101  (only numbers that are there are said)
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{words} {with_error(one.value, one.stderr)}{unit}"


def quoted_lines(fit: SpecimenFit) -> list[str]:
    """Relaxation and modulus in one line each, where there are any.

    Parameters
    ----------
    fit : SpecimenFit
    """
    lines: list[str] = []
    if fit.quoted is not None:
        relaxed = [
            one
            for one in fit.quoted.model
            if one.name == "fraction_relaxed" and one.at["path"] == "ramp" and one.value is not None
        ]
        if relaxed:
            parts = [_said(one, f"{one.at['time_s']:g} s:") for one in relaxed]
            lines.append(f"relaxed after the ramp  {', '.join(parts)}")
        moduli = [one for one in fit.quoted.moduli if one.value is not None]
        if moduli:
            depth = max(float(one.at["depth_mm"]) for one in moduli)
            best = moduli[0].at["formula"]
            chosen = [one for one in moduli if one.at["formula"] == best and one.at["depth_mm"] == depth]
            words = {"modulus_equilibrium": "E_inf", "modulus_instantaneous": "E_0"}
            parts = [_said(one, words[one.name]) for one in chosen]
            lines.append(f"modulus by {best} at {depth:.3g} mm  {', '.join(parts)}")
    if fit.cycles:
        last = fit.cycles[-1]
        eta = last.viscosity_model_N_s_per_mm
        area = last.dissipated_mJ
        said = f"{len(fit.cycles)} loop{'s' * (len(fit.cycles) > 1)}, last: area "
        said += f"{with_error(area.value, area.stderr)} mJ" if area.value is not None else "none"
        if eta.value is not None:
            said += f", all viscosity from that area {with_error(eta.value, eta.stderr)} N s/mm"
        lines.append(said)
    return lines
