"""Lines that command and library print of a fitted specimen: parameters, measured numbers, warnings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tissueid.digits import together, with_error
from tissueid.documents.identification import Estimate, Selection, Specimen
from tissueid.documents.measured import Spread
from tissueid.documents.quantities import Cycle, Quantity, UnloadingMiss
from tissueid.flags import FLAGS, harm_rank, warning_line
from tissueid.quantities import DEPTH_TEST
from tissueid.report.uncertainty_words import reported_order, window_words
from tissueid.report.wording import counted, misfit_raised, remarks

#: Programs and holds that get lines of their own.
MOST_PLACES = 2

#: Names of forces in a hold, as they are written.
_FORCES = {
    "force": "F({t:g} s)",
    "force_over_10s": "F({t:g} s)/F(10 s)",
    "force_over_peak": "F({t:g} s)/F_peak",
}
#: Numbers of the one line, and times after the stop [s].
_BRIEF = ("peak", "depth")
_BRIEF_TIMES_S = (1.0, 10.0)
_PUSH = {"peak": "peak", "depth": "depth", "speed": "speed", "modulus_loading": "E loading"}


def measured_lines(rows: Sequence[Spread]) -> list[str]:
    """Lines of a specimen's ``measured``; the number after the sign is the sd between logs."""
    lines: list[str] = []
    found = {(row.program, row.hold) for row in rows if row.name != "loop_area"}
    places = sorted(found, key=lambda place: (place[0], place[1] == 0, place[1]))
    several = len({program for program, _ in places}) > 1
    for program, hold in places[:MOST_PLACES]:
        own = [row for row in rows if (row.program, row.hold) == (program, hold)]
        held = len({number for known, number in places if known == program and number}) > 1
        words = [f"program {program}"] * several + [f"hold {hold}"] * (held and hold > 0)
        lines += _of_hold(
            [row for row in own if row.name != "loop_area"], " " * bool(words) + ", ".join(words)
        )
    if len(places) > MOST_PLACES:
        lines.append(f"the report has {len(places) - MOST_PLACES} more of these, by program and hold")
    areas = [row for row in rows if row.name == "loop_area" and row.mean is not None]
    if areas:
        lines.append(f"loop area {_said(areas[-1])}")
    return lines


def brief_measured_lines(rows: Sequence[Spread]) -> list[str]:
    """One line of a specimen among many: its first program's push, and forces in newtons."""
    first = [row for row in rows if row.program == 1 and row.hold <= 1 and row.mean is not None]
    said = [f"{_PUSH[row.name]} {_said(row)}" for row in first if row.name in _BRIEF]
    forces = (row for row in first if row.name == "force" and row.time_s in _BRIEF_TIMES_S)
    said += [f"{_name(row)} {_said(row)}" for row in forces]
    more = len({row.program for row in rows}) - 1
    told = f", {counted(more, 'more program')}" * (more > 0)
    return [f"measured    {', '.join(said)}{told}"] if said else []


def _of_hold(rows: Sequence[Spread], number: str) -> list[str]:
    pushed = [f"{_PUSH[row.name]} {_said(row)}" for row in rows if row.name in _PUSH]
    logs = max(row.count for row in rows)
    # one number where both ends of the ramps' times look alike
    ends = dict.fromkeys(f"{value:.3g}" for value in rows[0].ramp_time_s or ())
    in_time = f", ramp of {' to '.join(ends)} s" if ends else ""
    spread = f", ± sd of {logs} logs" if logs > 1 else ", one log: spread between sites unknown"
    lines = [f"measured{number}, no model{spread}{in_time}: {', '.join(pushed)}"]
    for name in _FORCES:
        parts = [f"{_name(row)} {_said(row)}" for row in rows if row.name == name and row.mean is not None]
        if parts:
            depends = "; depends on the ramp" if name == "force_over_peak" else ""
            lines.append(f"  {', '.join(parts)}{depends}")
    for reason in dict.fromkeys(row.reason for row in rows if row.reason):
        names = [_name(row) for row in rows if row.reason == reason]
        lines.append(f"  not pooled: {', '.join(names)}: {reason}")
    tau = next((row for row in rows if row.name == "relaxation_time" and row.mean is not None), None)
    if tau is not None:
        lines.append(f"  relaxation time of the hold, for its window only {_said(tau)}")
    return lines


def _name(row: Spread) -> str:
    form = _FORCES.get(row.name)
    return row.name.replace("_", " ") if form is None else form.format(t=row.time_s)


def _with_unit(value: float | None, error: float | None, unit: str) -> str:
    return with_error(value, error) + ("" if unit == "1" else f" {unit}")


def _said(row: Spread) -> str:
    return "not pooled" if row.mean is None else _with_unit(row.mean, row.sd, row.unit)


#: Columns of a terminal that lines of numbers are wrapped to.
WIDTH = 98
#: Lines of the block: what they are of, and how the names of their parameters begin.
_FAMILIES = (
    ("relaxation", "relaxation"),
    ("viscosity", "viscosity"),
    ("static F_s", "static"),
    ("dynamic K", "stiffness"),
    ("damping", "damping"),
)
_MARGIN = 12


def _cells(entry: Estimate, *, intervals: bool) -> tuple[str, str, str]:
    """Value with unit, statistical and total interval."""
    if entry.value is None:
        return "not identified", "", ""
    unit = "" if entry.unit == "1" else f" {entry.unit}"
    if "withheld" in entry.detail:
        return f"{entry.value:.4g}{unit}, no interval", "", ""
    if entry.ci95 is None:
        return _with_unit(entry.value, entry.stderr, entry.unit), "", ""
    ends = [*entry.ci95, *(entry.ci95_total or [])]
    value, *texts = together([entry.value, *ends], entry.sd)
    said = f"{value}{unit}"
    if not intervals:
        return said, "", ""
    total = f"[{', '.join(texts[2:])}]" if texts[2:] else ""
    return said, f"[{', '.join(texts[:2])}]", total


def block_lines(document: Specimen) -> list[str]:
    """The model in five lines, wrapped where they are long; what is not identified is only named."""
    intervals = not misfit_raised(document)
    lines: list[str] = []
    window = window_words(document)
    for label, start in _FAMILIES:
        entries = [one for one in document.parameters if one.name.startswith(start)]
        known = [one for one in entries if one.value is not None]
        parts = [_part(one, intervals=intervals) for one in known]
        unknown = [one.symbol for one in entries if one.value is None]
        parts += [f"{' '.join(unknown)} not identified"] if unknown else []
        lines += _wrapped(label, parts)
        if window and start == "relaxation":
            lines += _wrapped("one tau", [window])
    return lines


def _part(entry: Estimate, *, intervals: bool) -> str:
    value, statistical, total = _cells(entry, intervals=intervals)
    bound = " at its bound" if entry.detail.get("at_bound") else ""
    return f"{entry.symbol} {value} {total or statistical}".rstrip() + bound


def _wrapped(label: str, parts: Sequence[str]) -> list[str]:
    """Parts behind a label, in as many lines as they need."""
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + len(part) + 3 <= WIDTH:
            lines[-1] += f"; {part}"
        else:
            lines.append(f"{'' if lines else label:<{_MARGIN}}{part}")
    return lines


def parameter_lines(document: Specimen) -> list[str]:
    """One line a parameter with both intervals; columns are aligned."""
    entries = reported_order(document.parameters)
    cells = [_cells(entry, intervals=not misfit_raised(document)) for entry in entries]
    wide = [max(len(row[column]) for row in cells) for column in range(3)]
    lines = []
    for entry, (value, statistical, total) in zip(entries, cells, strict=True):
        line = f"{entry.symbol:<6} {value:<{wide[0]}}"
        line += f"  95 % {statistical:<{wide[1]}}" if statistical else ""
        line += f"  total {total}" if total else ""
        at_bound = entry.value is not None and entry.detail.get("at_bound")
        lines.append(line.rstrip() + ("  (at the passivity bound)" if at_bound else ""))
    return lines


def sampling_lines(document: Specimen) -> list[str]:
    """Lines on the sampling of the posterior, and the noise in it; none without a posterior."""
    sampler, noise = document.sampler, document.noise
    if sampler is None:
        return []
    found = [one.detail.get("posterior", {}).get("r_hat", one.r_hat) for one in document.parameters]
    known = [r_hat for r_hat in found if r_hat is not None]
    parts = [f"{sampler.draws:,} draws"]
    if known:
        parts.append(f"R-hat at most {max(known):.3f}")
    parts.append(f"{100.0 * sampler.acceptance:.0f} % accepted")
    parts.append("converged" if sampler.converged else "not converged")
    said = "" if noise is None else f"noise  {noise.model}, {noise.sigma_N:.3g} {document.units.force}"
    if noise is not None and noise.model != "white":
        said += f", correlation {noise.phi:.3g} over {noise.reference_step_s:.3g} s"
    return [f"{sampler.name}  {', '.join(parts)}", said]


def alarm_lines(document: Specimen) -> list[str]:
    """Reasons that take the intervals away or make them rough, in a sentence each."""
    sampler, misfit = document.sampler, document.misfit
    if sampler is None:
        return []
    lines = []
    said = {flag.code for flag in document.flags}
    if misfit is not None and misfit.raised and "misfit" not in said:
        seen = "; ".join(check.message.rstrip(".") for check in misfit.checks if check.raised)
        lines.append(f"no interval is given, the recordings contradict this model or its noise: {seen}")
    if not sampler.converged and "sampler_not_converged" not in said:
        reason = sampler.detail.get("reason")
        why = f": {reason}" if reason else ""
        lines.append(f"the sampler stopped before its rule was met, intervals are rough{why}")
    return lines


#: Warnings of a specimen, and of a batch as a whole, without ``-v``.
MOST_WARNINGS = 5
#: A flag of so many specimens, and of this share of a batch, is counted once.
SHARED_FROM = 3
SHARED_SHARE = 0.5
#: Remarks that every other recording has; ``inspect``, the report and ``-v`` show them.
UNREMARKABLE = frozenset(
    {"starts_in_contact", "no_hold", "several_steps", "event_rows", "column_choice", "undecoded_text"}
)


def _codes(specimen: Specimen) -> set[str]:
    own = [*specimen.flags, *(flag for trial in specimen.trials for flag in trial.flags)]
    return {flag.code for flag in own} - UNREMARKABLE


def shared_codes(specimens: Sequence[Specimen]) -> tuple[str, ...]:
    """Codes that most specimens of a batch carry, the worst first."""
    counted = Counter(code for specimen in specimens for code in _codes(specimen))
    least = max(SHARED_FROM, SHARED_SHARE * len(specimens))
    return tuple(sorted((code for code, count in counted.items() if count >= least), key=harm_rank))


def shared_lines(specimens: Sequence[Specimen], codes: Sequence[str]) -> list[str]:
    """``24 of 29 sheets start preloaded. Start in air, or state --contact.``, a line a code."""
    lines = [_shared_line(specimens, code) for code in codes[:MOST_WARNINGS]]
    if len(codes) > MOST_WARNINGS:
        lines[-1] += f" ({len(codes) - MOST_WARNINGS} more: -v, or the report)"
    return lines


def _shared_line(specimens: Sequence[Specimen], code: str) -> str:
    trials = [trial for specimen in specimens for trial in specimen.trials]
    carriers = [trial for trial in trials if code in {flag.code for flag in trial.flags}]
    if carriers:
        noun = "sheets" if all(trial.sheet is not None for trial in trials) else "recordings"
        count, total = len(carriers), len(trials)
    else:
        noun, total = "specimens", len(specimens)
        count = sum(code in _codes(specimen) for specimen in specimens)
    advice = FLAGS.get(code)
    said = "carry " + code if advice is None else advice.many
    return warning_line(code, f"{count} of {total} {noun} {said}")


def warning_lines(
    specimen: Specimen, *, shared: Sequence[str] = (), verbose: int = 0, alarms: int = 0
) -> list[tuple[str, str]]:
    """Warnings with their level, the worst first, less ``shared`` codes; ``alarms`` of the few are said."""
    hidden = frozenset() if verbose else UNREMARKABLE | frozenset(shared)
    kept = [one for one in remarks(specimen, holds=verbose > 0) if one.code not in hidden]
    room = len(kept) if verbose else max(MOST_WARNINGS - alarms, 1)
    logs = len(specimen.trials)
    lines = []
    for remark in kept[:room]:
        places = remark.where[0] if len(remark.where) == 1 else f"{len(remark.where)} of {logs} logs"
        logs_of = "" if logs == 1 or not remark.where else f"{places}: "
        more = f" ({len(remark.messages) - 1} more)" if len(remark.messages) > 1 else ""
        lines.append((remark.level, f"{logs_of}{warning_line(remark.code, remark.messages[0])}{more}"))
    if len(kept) > room:
        level, last = lines[-1]
        lines[-1] = (level, f"{last} ({len(kept) - room} more: -v)")
    return lines


def quoted_lines(document: Specimen) -> list[str]:
    """Modulus and loops in one line each, where there are any."""
    lines: list[str] = []
    quoted = document.quoted
    if quoted is not None:
        moduli = [one for one in quoted.moduli if one.value is not None]
        if moduli:
            depth = max(one.at.depth_mm or 0.0 for one in moduli)
            best = moduli[0].at.formula
            chosen = [one for one in moduli if (one.at.formula, one.at.depth_mm) == (best, depth)]
            words = {"modulus_equilibrium": "E_inf", "modulus_instantaneous": "E_0"}
            parts = [f"{words[one.name]} {_with_unit(one.value, one.stderr, one.unit)}" for one in chosen]
            lines.append(f"modulus by {best} at {depth:.3g} mm  {', '.join(parts)}")
        lines += [_drainage(one) for one in quoted.model if one.name == DEPTH_TEST]
    if document.cycles:
        lines.append(_loops(document.cycles))
    missed = unloading_words(document.unloading_predicted)
    return [*lines, f"unloading   {missed}"] if missed else lines


def unloading_words(missed: UnloadingMiss | None) -> str:
    """Unloading as loading and holds predict it; empty where no tool turned back."""
    if missed is None:
        return ""
    side = "below" if missed.mean < 0.0 else "above"
    worst = f", {100 * missed.nrmsd_worst:.1f} at worst" if missed.logs > 1 else ""
    return (
        f"not fitted; loading and holds predict it to {100 * missed.nrmsd:.1f} % of the range"
        f"{worst} (measured {100 * abs(missed.mean):.1f} % {side} it)"
    )


def _drainage(slope: Quantity) -> str:
    """The depth test: drainage or viscosity."""
    if slope.value is None:
        return f"depth test: can't decide, {slope.reason}"
    at = slope.at
    return (
        f"depth test: tau grows as contact radius^{slope.value:.2f} [{at.low:.2f}, {at.high:.2f}], "
        f"{at.verdict} (0 viscous, 2 drainage)"
    )


def _loops(cycles: Sequence[Cycle]) -> str:
    """Line on the number of load-unload loops and the last of them."""
    eta, area = cycles[-1].viscosity_model_N_s_per_mm, cycles[-1].dissipated_mJ
    said = f"{counted(len(cycles), 'loop')}, last: area "
    said += f"{with_error(area.value, area.stderr)} mJ" if area.value is not None else "none"
    if eta.value is not None:
        said += f", all viscosity from that area {with_error(eta.value, eta.stderr)} N s/mm"
    return said


@dataclass(frozen=True, slots=True)
class Line:
    """One line."""

    text: str
    kind: str = "plain"  # ``title``, ``plain``, ``alarm``, ``serious`` or ``remark``


def specimen_lines(
    fit: Specimen, shared: Sequence[str] = (), *, verbose: int = 0, brief: bool = False
) -> list[Line]:
    """Title, model, measured block and warnings of a specimen.

    ``shared``: codes of warnings that are said once for a batch; ``brief``: one line of what was measured.
    """
    lines = [Line(_title(fit), "title")]
    lines += [Line(f"  {line}") for line in _paper(fit)]
    own = [*parameter_lines(fit), *sampling_lines(fit)] if verbose else block_lines(fit)
    measured = (brief_measured_lines if brief else measured_lines)(fit.measured or ())
    lines += [Line(f"  {line}") for line in (*own, *quoted_lines(fit), *measured)]
    alarms = alarm_lines(fit)
    lines += [Line(f"  ! {line}", "alarm") for line in alarms]
    for level, line in warning_lines(fit, shared=shared, verbose=verbose, alarms=len(alarms)):
        lines.append(Line(f"  ! {line}", "serious" if level == "serious" else "remark"))
    if verbose:
        for row in fit.relaxation:
            tau = "none" if row.tau_single_s is None else f"{row.tau_single_s:.4g} s"
            window = f"{row.window_s[0]:g} to {row.window_s[1]:g} s"
            lines.append(Line(f"  hold {window}: one exponential {tau}"))
    return lines


def _paper(fit: Specimen) -> list[str]:
    """The paper's model beside another that predicts as well and was chosen; words of the yardstick."""
    rows, model = fit.selection, fit.model
    if model.key == "yardstick":
        inside, outside = len(model.inside_s or ()), len(model.outside_s or ())
        nodes = f"{inside} times inside the convolution, {outside} outside it"
        return [f"the mark that a passive law can reach ({nodes}); no law, nothing to quote"]
    lines = []
    others = [row for row in rows if row.model is None]
    chosen = next((row for row in rows if row.chosen), None)
    if others and chosen is not None and chosen.model is not None:
        best = max(others, key=lambda row: row.score or 0.0)
        law = f"{counted(best.branches, 'branch', 'es')}, K of degree {best.stiffness_degree}"
        words = f"{law}: tau {best.tau_s:.3g} s"
        lines = [f"paper's model  {words}, misses what was left out by {_more(best)}"]
    mark = next((row for row in rows if row.model == "yardstick"), None)
    return [*lines, f"mark        the yardstick misses what was left out by {_more(mark)}"] if mark else lines


def _more(row: Selection) -> str:
    """Deviation on what was left out beside that of the chosen law."""
    more = 100.0 * (math.exp(-0.5 * (row.score or 0.0)) - 1.0)
    return f"{abs(more):.0f} % {'more' if more >= 0.0 else 'less'}"


def _title(fit: Specimen) -> str:
    """Specimen, logs, law and deviation."""
    model = fit.model
    law = f"{counted(model.branches, 'branch', 'es')}, K of degree {model.stiffness_degree}"
    if model.key != "kelvin-voigt":
        law = model.key
    return (
        f"{fit.specimen}  {counted(len(fit.trials), 'log')}, {law}, {model.static_pooling} static, "
        f"NRMSD {100 * fit.nrmsd.range:.2f} % of range"
    )
