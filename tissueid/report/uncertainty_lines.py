"""Lines of ``fit`` on parameters and how sure they are; the report and the JSON have the rest.

A specimen is a block of lines: relaxation times, the one relaxation time with its window, viscosities, static
and dynamic polynomial, each value with its widest 95 % interval to one place.  ``-v`` prints a line a
parameter with both intervals; where the residuals contradict the model, or nothing is identified, none
stands.
"""

from __future__ import annotations

from collections.abc import Sequence

from tissueid.digits import with_error
from tissueid.documents.identification import Estimate, Specimen

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
    from tissueid.digits import together

    if entry.value is None:
        return "not identified", "", ""
    unit = "" if entry.unit == "1" else f" {entry.unit}"
    if "withheld" in entry.detail:
        return f"{entry.value:.4g}{unit}, no interval", "", ""
    if entry.ci95 is None:
        return f"{with_error(entry.value, entry.stderr)}{unit}", "", ""
    ends = [*entry.ci95, *(entry.ci95_total or [])]
    value, *texts = together([entry.value, *ends], entry.sd)
    said = f"{value}{unit}"
    if not intervals:
        return said, "", ""
    total = f"[{', '.join(texts[2:])}]" if texts[2:] else ""
    return said, f"[{', '.join(texts[:2])}]", total


def block_lines(document: Specimen) -> list[str]:
    """The model in five lines, wrapped where they are long; what is not identified is only named.

    ``document``: a specimen of identification.json.
    """
    from tissueid.report.uncertainty_words import window_words
    from tissueid.report.wording import misfit_raised

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
    """One line a parameter; columns are aligned.

    ``document``: a specimen of identification.json.
    """
    from tissueid.report.uncertainty_words import reported_order
    from tissueid.report.wording import misfit_raised

    entries = reported_order(document.parameters)
    cells = [_cells(entry, intervals=not misfit_raised(document)) for entry in entries]
    wide = [max(len(row[column]) for row in cells) for column in range(3)]
    lines = []
    for entry, (value, statistical, total) in zip(entries, cells, strict=True):
        line = f"{entry.symbol:<6} {value:<{wide[0]}}"
        if statistical:
            line += f"  95 % {statistical:<{wide[1]}}"
        if total:
            line += f"  total {total}"
        bound = (
            "  (at the passivity bound)" if entry.value is not None and entry.detail.get("at_bound") else ""
        )
        lines.append(line.rstrip() + bound)
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
