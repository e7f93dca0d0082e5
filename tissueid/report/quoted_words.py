"""Tables of the numbers people quote and of the load-unload loops, in printed cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tissueid.digits import number, with_error
from tissueid.documents.quantities import Cycle, Measure, Quantity, Quoted
from tissueid.quantities import DEPTH_TEST
from tissueid.report.parts import Table
from tissueid.report.wording import trial_label

#: Rows of a table that are printed; the rest is in identification.json.
MOST_ROWS = 12
NONE = "–"
_PATHS = {"step": "ideal step", "ramp": "ramp as recorded"}
#: Heads of the columns of loops, and the measures in them.
_OF_LOOPS = {
    "Peak [N]": "peak_force_N", "Area [mJ]": "dissipated_mJ", "Area over work [%]": "hysteresis",
    "Secant [N/mm]": "secant_N_per_mm", "Tangent [N/mm]": "tangent_N_per_mm",
    "Residual depth [mm]": "residual_depth_mm", "Peak against loop before [%]": "peak_force_change",
    "η from area [N·s/mm]": "viscosity_N_s_per_mm",
    "η from area, by model [N·s/mm]": "viscosity_model_N_s_per_mm",
}  # fmt: skip
_KINDS = {"cycle": "cycle", "ramp-retract": "ramp and retract", "ramp-hold-retract": "ramp, hold and retract"}


def _shown(
    title: str,
    sentence: str,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    reasons: Sequence[str | None] = (),
) -> Table:
    """A table cut to its first and last rows where there are many."""
    kept = [tuple(row) for row in rows]
    if len(kept) > MOST_ROWS:
        kept = [*kept[: MOST_ROWS // 2], *kept[-(MOST_ROWS // 2) :]]
    unique = tuple(dict.fromkeys(reason for reason in reasons if reason))
    return Table(tuple(head), tuple(kept), title, sentence, len(rows) - len(kept), unique)


def _cell(entry: Measure | Quantity | None, *, percent: bool = False) -> str:
    if entry is None or entry.value is None:
        return NONE
    factor = 100.0 if percent else 1.0
    return with_error(factor * entry.value, None if entry.stderr is None else factor * entry.stderr)


def _find(entries: Sequence[Quantity], name: str, **at: Any) -> Quantity | None:
    alike = (one for one in entries if one.name == name)
    return next((one for one in alike if all(getattr(one.at, key) == at[key] for key in at)), None)


def _values(entries: Sequence[Quantity], name: str, key: str) -> list[Any]:
    """Distinct conditions of a quantity, in the order they come."""
    return list(dict.fromkeys(getattr(entry.at, key) for entry in entries if entry.name == name))


def _rows(
    entries: Sequence[Quantity], names: Sequence[str], places: Iterable[tuple[str, Mapping[str, Any]]]
) -> tuple[list[list[str]], list[str | None]]:
    """A row a place, of words and conditions: the quantities there; and why some are missing."""
    found = [(words, [_find(entries, name, **at) for name in names]) for words, at in places]
    reasons = [entry.reason for _, own in found for entry in own if entry is not None]
    return [[words, *map(_cell, own)] for words, own in found], reasons


def _relaxed(quoted: Quoted) -> Table:
    model = quoted.model
    times = _values(model, "fraction_relaxed", "time_s")
    rows, reasons = [], []
    for path, words in _PATHS.items():
        own = [entry for entry in model if entry.at.path == path]
        if all(entry.value is None for entry in own):
            reasons += [entry.reason for entry in own]
            continue
        at = own[0].at
        speed = f", {number(at.speed_mm_s, 3)} mm/s" if at.speed_mm_s is not None else ""
        found = [_find(own, "fraction_relaxed", time_s=time) for time in times]
        ratio = _find(own, "peak_to_plateau")
        reasons += [entry.reason for entry in (*found, ratio) if entry is not None]
        name = f"Model, {words} to {number(at.depth_mm, 3)} mm{speed}"
        rows.append([name, *(_cell(entry, percent=True) for entry in found), _cell(ratio)])
    head = ["Relaxed [%] after", *(f"{time:g} s" for time in times), "Peak over plateau"]
    sentence = (
        "Share of the model's peak force that is gone, counted from the end of the step or ramp. An ideal "
        f"step is computed, not tested. Nothing is said later than {number(quoted.window_s, 3)} s or "
        f"earlier than {number(quoted.resolution_s, 3)} s, which these recordings did not show."
    )
    return _shown("Relaxation", sentence, head, rows, reasons)


def _oscillation(quoted: Quoted) -> Table | None:
    model = quoted.model
    names = ("storage_stiffness", "loss_stiffness", "tan_delta", "dissipated_energy")
    at = [(f"{number(one, 3)} Hz", {"frequency_Hz": one}) for one in _values(model, names[2], "frequency_Hz")]
    rows, reasons = _rows(model, names, at)
    if not rows:
        return None
    energy = _find(model, "dissipated_energy")
    assert energy is not None  # noqa: S101  (there are rows)
    sentence = (
        f"Small oscillation about {number(energy.at.depth_mm, 3)} mm, computed from the model; energy "
        f"a cycle for an amplitude of {number(energy.at.amplitude_mm, 3)} mm."
    )
    head = ("Frequency", "Storage [N/mm]", "Loss [N/mm]", "tan δ", "Energy a cycle [mJ]")
    return _shown("Storage and loss", sentence, head, rows, reasons)


def _stiffness(quoted: Quoted) -> Table:
    model = quoted.model
    names = ("equilibrium_secant", "equilibrium_tangent", "instantaneous_secant", "instantaneous_tangent")
    at = [(f"{number(one, 3)} mm", {"depth_mm": one}) for one in _values(model, names[0], "depth_mm")]
    rows, reasons = _rows(model, names, at)
    sentence = (
        "Structural stiffness for this tip on this support [N/mm]: after every branch has relaxed, and at "
        "once (as far as these samples show). Secant: force over depth. Tangent: slope."
    )
    head = ("Depth", "Relaxed, secant", "Relaxed, tangent", "At once, secant", "At once, tangent")
    return _shown("Stiffness", sentence, head, rows, reasons)


def _moduli(quoted: Quoted) -> Table | None:
    moduli = quoted.moduli
    if not moduli:
        return None
    at = [
        (f"{str(formula).capitalize()}, {number(depth, 3)} mm", {"formula": formula, "depth_mm": depth})
        for formula, depth in dict.fromkeys((entry.at.formula, entry.at.depth_mm) for entry in moduli)
    ]
    rows, reasons = _rows(moduli, ("modulus_equilibrium", "modulus_instantaneous"), at)
    known = quoted.assumptions
    size = f"radius {number(known.radius_mm, 3)} mm"
    if known.shape == "cone":
        size = f"half angle {number(known.half_angle_deg, 3)}°"
    body = f"a {known.support} of {number(known.thickness_mm, 3)} mm"
    if known.thickness_mm is None:
        body = "a deep body (no thickness was stated)"
    sentence = (
        f"Young's modulus [kPa] for a {known.shape} of {size} on {body}, Poisson's ratio "
        f"{number(known.poisson, 2)}, no friction: a reading of the structural stiffness, valid as far "
        "as the remarks above say."
    )
    head = ("Formula and depth", "E∞, relaxed", "E₀, at once")
    return _shown("Modulus", sentence, head, rows, reasons)


def _drainage(quoted: Quoted) -> Table | None:
    """The depth test: relaxation times by contact radius."""
    found = _find(quoted.model, DEPTH_TEST)
    if found is None:
        return None
    at = found.at
    interval, verdict = (NONE, "can't decide") if found.value is None else (
        f"{number(at.low, 3)} to {number(at.high, 3)}", str(at.verdict)
    )  # fmt: skip
    row = (f"{number(at.depth_mm, 3)} mm", f"{at.holds:.0f}", _cell(found), interval, verdict)
    sentence = (
        "Slope of ln relaxation time on ln contact radius, over holds of one length at several depths: a "
        "viscous tissue has 0, one that drains 2."
    )
    head = ("Depth up to", "Holds", "Slope", "95 %", "Verdict")
    return _shown("Drainage or viscosity", sentence, head, [row], [found.reason])


def _spectra(quoted: Quoted) -> Table | None:
    """Share of the relaxing force by decades of relaxation time."""
    spectra = quoted.spectra
    if not spectra:
        return None
    found = [np.digitize(one.tau_s, [10.0**n for n in range(-6, 10)]) - 7 for one in spectra]
    used = sorted({int(n) for decades in found for n in decades if -6 <= n < 9})
    rows = []
    for one, decades in zip(spectra, found, strict=True):
        amplitudes, total = np.array(one.amplitude_N), sum(one.amplitude_N)
        own = [(n in decades, float(amplitudes[decades == n].sum())) for n in used]
        shares = [f"{100.0 * part / total:.0f}" if known and total else NONE for known, part in own]
        rows.append([trial_label(one), *shares, number(one.plateau_N, 3)])
    head = ("Hold of", *(f"{10.0**n:g} to {10.0 ** (n + 1):g} s" for n in used), "Plateau [N]")
    sentence = (
        "Where the relaxing force of each hold lies [% of it], by relaxation time: a smoothed spectrum of "
        "non-negative exponentials, as seen after its ramp. No contact model is involved."
    )
    return _shown("Relaxation spectrum", sentence, head, rows)


def quoted_tables(quoted: Quoted | None) -> tuple[Table, ...]:
    """The tables of one specimen's ``quoted`` object; none where there is none."""
    if quoted is None:
        return ()
    kinds = (_relaxed, _stiffness, _oscillation, _moduli, _drainage, _spectra)
    return tuple(table for kind in kinds if (table := kind(quoted)) is not None and table.rows)


def cycle_table(cycles: Sequence[Cycle]) -> Table | None:
    """Loops, measured from their samples; ``None`` where there are none."""
    if not cycles:
        return None
    rows = [
        [
            f"{trial_label(row)}, {_KINDS[row.kind]} {row.number}",
            number(row.peak_depth_mm, 3),
            *(_cell(getattr(row, key), percent=head.endswith("[%]")) for head, key in _OF_LOOPS.items()),
        ]
        for row in cycles
    ]
    head = ("Loop", "Depth [mm]", *_OF_LOOPS)
    sentence = (
        "Measured from the samples. The area holds every loss, viscous or not. As a viscosity it is first "
        "read in the limit of slow motion (area over the integral of squared speed), then by letting the "
        "fitted model walk the same path."
    )
    return _shown("Load-unload loops", sentence, head, rows)
