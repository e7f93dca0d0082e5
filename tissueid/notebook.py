"""Results as a notebook shows them: a table and a small drawing, without a script and without the network.

A type that is shown has :class:`Shown` among its bases; what is written of it stands here, in one place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray

if TYPE_CHECKING:
    from tissueid.flags import Flag
    from tissueid.manifest import Study
    from tissueid.result import Estimate, Identification, SpecimenFit
    from tissueid.store.bundle import Bundle
    from tissueid.trial import Trial
    from tissueid.uncertainty import ParameterUncertainty, Posterior

#: Size of a drawing, and the room for its numbers [px].
WIDTH, HEIGHT, MARGIN = 420, 190, 44
#: Points of a drawn curve: the smallest and largest of each of half as many parts.
POINTS = 400
#: Rows of a table before the rest is counted.
MOST_ROWS = 30
_NOT_SAMPLED = "–"
MEASURED, MODEL = "#56b4e9", "#d55e00"
_CONTRADICTED = "<p>The residuals contradict the model: no interval can be believed.</p>"


class Shown:
    """Base of what a notebook shows."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return html_of(self)


def html_of(one: Any) -> str:
    """A result as a notebook shows it."""
    return f'<div class="tissueid">{_WRITERS[type(one).__name__](one)}</div>'


def table(caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of text; everything is escaped, and a long one is cut with the number of what is left out."""
    head = "".join(f'<th scope="col" style="text-align:left">{escape(one)}</th>' for one in headings)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row) + "</tr>"
        for row in rows[:MOST_ROWS]
    )
    left = len(rows) - MOST_ROWS
    more = f'<tr><td colspan="{len(headings)}">and {left} more</td></tr>' if left > 0 else ""
    words = f'<caption style="text-align:left;caption-side:top">{escape(caption)}</caption>'
    return f"<table>{words}<thead><tr>{head}</tr></thead><tbody>{body}{more}</tbody></table>"


def drawing(
    curves: Sequence[tuple[str, FloatArray, FloatArray, str]],
    *,
    up: str,
    words: str,
    across: str = "time [s]",
) -> str:
    """Curves as an inline SVG that takes the colour of the text around it."""
    drawn = [(name, *_thinned(x, y), colour) for name, x, y, colour in curves]
    x_from, x_to = _ends([x for _, x, _, _ in drawn])
    y_from, y_to = _ends([y for _, _, y, _ in drawn])
    right, top = WIDTH - 8, 24
    bottom = HEIGHT - MARGIN

    def place(x: FloatArray, y: FloatArray) -> str:
        px = MARGIN + (x - x_from) / (x_to - x_from) * (right - MARGIN)
        py = bottom - (y - y_from) / (y_to - y_from) * (bottom - top)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))

    lines = "".join(
        f'<polyline fill="none" stroke="{colour}" stroke-width="1.5" points="{place(x, y)}"/>'
        for _, x, y, colour in drawn
    )
    legend = "".join(
        f'<text x="{MARGIN + 110 * k}" y="14" fill="{colour}">{escape(name)}</text>'
        for k, (name, _, _, colour) in enumerate(drawn)
    )
    marks = (
        f'<text x="{MARGIN}" y="{bottom + 16}">{x_from:.3g}</text>'
        f'<text x="{right}" y="{bottom + 16}" text-anchor="end">{x_to:.3g}</text>'
        f'<text x="{(MARGIN + right) / 2}" y="{bottom + 32}" text-anchor="middle">{escape(across)}</text>'
        f'<text x="{MARGIN - 4}" y="{bottom}" text-anchor="end">{y_from:.3g}</text>'
        f'<text x="{MARGIN - 4}" y="{top + 8}" text-anchor="end">{y_to:.3g}</text>'
        f'<text x="4" y="{(top + bottom) / 2}">{escape(up)}</text>'
    )
    frame = f'<path d="M{MARGIN},{top}V{bottom}H{right}" fill="none" stroke="currentColor" opacity=".5"/>'
    return (
        f'<svg role="img" aria-label="{escape(words)}" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        f'height="{HEIGHT}" style="max-width:100%;font:11px sans-serif;fill:currentColor">'
        f"{frame}{lines}{legend}{marks}</svg>"
    )


def svg_file(drawn: str) -> bytes:
    """A drawing as a file of its own, dark on whatever it lies on."""
    return drawn.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" color="#222" ', 1).encode("utf-8")


def _ends(rows: list[FloatArray]) -> tuple[float, float]:
    low, high = min(float(row.min()) for row in rows), max(float(row.max()) for row in rows)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest value of each part of a curve: peaks and corners stay."""
    if x.size <= POINTS:
        return x, y
    keep: list[int] = []
    for part in np.array_split(np.arange(x.size), POINTS // 2):
        keep += sorted({int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])})
    return x[keep], y[keep]


def _number(value: float | None) -> str:
    return _NOT_SAMPLED if value is None or not math.isfinite(value) else f"{value:.4g}"


def _interval(ends: tuple[float, float] | None) -> str:
    return _NOT_SAMPLED if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}"


def _estimate_row(one: Estimate, *, believed: bool, unit: Callable[[str], str] = str) -> list[str]:
    if one.value is None:
        return [one.name, "not identified", "", "", unit(one.unit)]
    sure = one.uncertainty if believed else None
    error = f" ± {one.stderr:.2g}" if believed and sure is None and one.stderr is not None else ""
    intervals = (None, None) if sure is None else (sure.ci95, sure.ci95_total)
    return [one.name, _number(one.value) + error, *map(_interval, intervals), unit(one.unit)]


def _parameters(
    caption: str, parameters: Sequence[Estimate], *, believed: bool, unit: Callable[[str], str] = str
) -> str:
    headings = ("parameter", "value", "95 % statistical", "95 % total", "unit")
    return table(caption, headings, [_estimate_row(one, believed=believed, unit=unit) for one in parameters])


def _flags(flags: Sequence[Flag]) -> str:
    told = (f"<li>{escape(one.message)} <code>{escape(one.code)}</code></li>" for one in flags)
    return f"<ul>{''.join(told)}</ul>" if flags else ""


def _alarmed(found: Posterior | None) -> bool:
    """True where the residuals contradict the model."""
    return found is not None and found.misfit is not None and found.misfit.raised


def _specimen(fit: SpecimenFit) -> str:
    alarm = _alarmed(fit.posterior)
    branches = f"{fit.model.branches} branch{'es' * (fit.model.branches != 1)}"
    caption = (
        f"{fit.specimen}: {len(fit.trials)} trial{'s' * (len(fit.trials) != 1)}, {branches}, to "
        f"{fit.depth_mm:.3g} mm, NRMSD {100.0 * fit.nrmsd.range:.2g} % of range"
    )
    numbers = _parameters(caption, fit.parameters, believed=not alarm, unit=fit.axes.unit)
    return _CONTRADICTED * alarm + numbers + _fitted(fit) + _flags(fit.flags)


def _fitted(fit: SpecimenFit) -> str:
    """Force and model of the trial with the largest force."""
    if not fit.trials:
        return ""
    trial = max(fit.trials, key=lambda one: float(np.max(one.curve.force_N, initial=0.0)))
    curve = trial.curve
    if curve.time_s.size < 2:
        return ""
    channels = (("measured", curve.force_N, MEASURED), ("model", curve.model_N, MODEL))
    curves = [(name, curve.time_s, values, colour) for name, values, colour in channels]
    return drawing(curves, up=f"[{fit.axes.force}]", words=f"Force and model of {trial.path} against time")


#: Parameters that stand for a specimen among several, and their headings.
_OF_MANY = {
    "viscosity_N_s_per_mm": "viscosity [N s/mm]",
    "relaxation_time_s": "relaxation time [s]",
    "static_1_N_per_mm": "static, linear [N/mm]",
}


def _identification(found: Identification) -> str:
    refused = [str(one) for one in found.refused]
    said = f"<p>refused: {escape('; '.join(refused[:5]))}</p>" if refused else ""
    if len(found.specimens) == 1:
        return _specimen(found.specimens[0]) + said
    rows = []
    for fit in found.specimens:
        believed = not _alarmed(fit.posterior)
        known = {one.name: _estimate_row(one, believed=believed)[1] for one in fit.parameters}
        values = [known.get(name, "none") for name in _OF_MANY]
        left, codes = f"{100.0 * fit.nrmsd.range:.2g} %", ", ".join(flag.code for flag in fit.flags)
        rows.append([fit.specimen, str(len(fit.trials)), *values, left, codes])
    headings = ("specimen", "trials", *_OF_MANY.values(), "NRMSD", "flags")
    return table(f"{len(rows)} specimens", headings, rows) + said


def _posterior(found: Posterior) -> str:
    ended = "converged" if found.sampler.converged else "did not converge: intervals are rough"
    noise = f"noise {found.noise.model}, {found.noise.sigma_N:.3g} N"
    caption = f"{found.sampler.name}, {found.sampler.draws:,} draws, {ended}; {noise}"
    headings = ("parameter", "mean", "sd", "95 % statistical", "95 % total", "R-hat", "ESS bulk")
    rows = [[name, *_sure_cells(one)] for name, one in found.parameters.items()]
    return _CONTRADICTED * _alarmed(found) + table(caption, headings, rows)


def _sure_cells(one: ParameterUncertainty) -> list[str]:
    effective = f"{one.ess_bulk:.0f}" if math.isfinite(one.ess_bulk) else _NOT_SAMPLED
    intervals = [_interval(one.ci95), _interval(one.ci95_total)]
    return [_number(one.mean), f"{one.sd:.2g}", *intervals, _number(one.r_hat), effective]


def _bundle(held: Bundle) -> str:
    slow, fast = held.speeds_mm_s
    tip = "" if held.tip_radius_mm is None else f", tip of radius {held.tip_radius_mm:.3g} mm"
    kind = "population" if held.is_population else "tissue"
    draws = "no draws" if held.draws is None else f"{len(held.draws):,} draws"
    valid = f"valid to {held.depth_mm:.3g} mm and from {slow:.3g} to {fast:.3g} mm/s"
    caption = f"{held.specimen}: {kind}, {valid}{tip}; {draws}"
    alarm = any(flag.code == "misfit" for flag in held.flags)
    return _parameters(caption, held.parameters, believed=not alarm) + _flags(held.flags)


def _trial(trial: Trial) -> str:
    x, force = trial.displacement_mm, trial.force_N
    rows = [
        ["file", trial.name],
        ["read as", trial.source.recipe],
        ["samples", f"{trial.time_s.size:,}"],
        ["time", f"{trial.time_s[0]:.4g} to {trial.time_s[-1]:.4g} s"],
        ["displacement", f"{x.min():.4g} to {x.max():.4g} {trial.axes.unit('mm')}"],
        ["force", f"{force.min():.4g} to {force.max():.4g} {trial.axes.force}"],
    ]
    curves = [("force", trial.time_s, trial.force_N, MEASURED)]
    drawn = drawing(curves, up=f"[{trial.axes.force}]", words=f"Force of {trial.name} against time")
    return table(trial.specimen, ("", ""), rows) + drawn + _flags(trial.flags)


def _study(study: Study) -> str:
    rows = [
        ["specimens", ", ".join(study.specimens) or "none stated"],
        ["protocols", ", ".join(study.protocols) or "none stated"],
        ["trials", f"{len(study.trials)} stated, {len(study.overrides)} overridden"],
    ]
    out = [one.values for one in study.exclusions]
    rows += [[f"left out: {one['file']}", str(one.get("because", ""))] for one in out]
    return table(str(study.about.get("title", study.path)), ("", ""), rows)


_WRITERS: Mapping[str, Callable[[Any], str]] = {
    "Identification": _identification,
    "SpecimenFit": _specimen,
    "Posterior": _posterior,
    "Estimate": lambda one: _parameters("", [one], believed=True),
    "Bundle": _bundle,
    "Study": _study,
    "Trial": _trial,
}
