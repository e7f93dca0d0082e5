"""Lines that the command and the library print of a fitted specimen, and what people quote of its model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tissueid.digits import with_error
from tissueid.documents.identification import Selection, Specimen
from tissueid.documents.quantities import Cycle, Quantity
from tissueid.quantities import DEPTH_TEST
from tissueid.report.measured_lines import brief_measured_lines, measured_lines
from tissueid.report.uncertainty_lines import alarm_lines, block_lines, parameter_lines, sampling_lines
from tissueid.report.warning_lines import warning_lines


def _said(one: Quantity, words: str) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{words} {with_error(one.value, one.stderr)}{unit}"


def _known(rows: Sequence[Quantity]) -> list[Quantity]:
    return [one for one in rows if one.value is not None]


def quoted_lines(document: Specimen) -> list[str]:
    """Modulus and loops in one line each, where there are any.

    ``document``: a specimen of identification.json; ``verbose``: 0 leaves the model's shares out where
    measured ones stand.
    """
    lines: list[str] = []
    quoted = document.quoted
    if quoted is not None:
        moduli = _known(quoted.moduli)
        if moduli:
            depth = max(one.at.depth_mm or 0.0 for one in moduli)
            best = moduli[0].at.formula
            chosen = [one for one in moduli if (one.at.formula, one.at.depth_mm) == (best, depth)]
            words = {"modulus_equilibrium": "E_inf", "modulus_instantaneous": "E_0"}
            parts = [_said(one, words[one.name]) for one in chosen]
            lines.append(f"modulus by {best} at {depth:.3g} mm  {', '.join(parts)}")
        lines += [_drainage(one) for one in quoted.model if one.name == DEPTH_TEST]
    if document.cycles:
        lines.append(_loops(document.cycles))
    return lines


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
    said = f"{len(cycles)} loop{'s' * (len(cycles) > 1)}, last: area "
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

    ``fit``: a specimen of identification.json; ``shared``: codes of warnings that are said once for a batch;
    ``verbose``: above 0 nothing is left out; ``brief``: one line of what was measured.
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
        branches = f"{best.branches} branch{'es' * (best.branches > 1)}"
        words = f"{branches}, K of degree {best.stiffness_degree}: tau {best.tau_s:.3g} s"
        lines = [f"paper's model  {words}, misses what was left out by {_more(best)}"]
    mark = next((row for row in rows if row.model == "yardstick"), None)
    return [*lines, f"mark        the yardstick misses what was left out by {_more(mark)}"] if mark else lines


def _more(row: Selection) -> str:
    """Deviation on what was left out beside that of the chosen law."""
    more = 100.0 * (math.exp(-0.5 * (row.score or 0.0)) - 1.0)
    return f"{abs(more):.0f} % {'more' if more >= 0.0 else 'less'}"


def _title(fit: Specimen) -> str:
    """Specimen, logs, law and deviation."""
    model, logs = fit.model, len(fit.trials)
    branches = "1 branch" if model.branches == 1 else f"{model.branches} branches"
    law = f"{branches}, K of degree {model.stiffness_degree}"
    if model.key != "kelvin-voigt":
        law = model.key
    return (
        f"{fit.specimen}  {logs} log{'s' * (logs > 1)}, {law}, {model.static_pooling} static, "
        f"NRMSD {100 * fit.nrmsd.range:.2f} % of range"
    )
