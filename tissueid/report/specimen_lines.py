"""Lines that the command and the library print of a fitted specimen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.report.measured_lines import brief_measured_lines, measured_lines
from tissueid.report.quoted_lines import quoted_lines
from tissueid.report.uncertainty_lines import alarm_lines, block_lines, parameter_lines, sampling_lines
from tissueid.report.warning_lines import warning_lines


@dataclass(frozen=True, slots=True)
class Line:
    """One line."""

    text: str
    kind: str = "plain"  # ``title``, ``plain``, ``alarm``, ``serious`` or ``remark``


def specimen_lines(
    fit: Mapping[str, Any], shared: Sequence[str] = (), *, verbose: int = 0, brief: bool = False
) -> list[Line]:
    """Title, model, measured block and warnings of a specimen.

    ``fit``: a specimen of identification.json; ``shared``: codes of warnings that are said once for a batch;
    ``verbose``: above 0 nothing is left out; ``brief``: one line of what was measured.
    """
    lines = [Line(_title(fit), "title")]
    lines += [Line(f"  {line}") for line in _paper(fit)]
    own = [*parameter_lines(fit), *sampling_lines(fit)] if verbose else block_lines(fit)
    measured = (brief_measured_lines if brief else measured_lines)(fit.get("measured", ()))
    lines += [Line(f"  {line}") for line in (*own, *quoted_lines(fit), *measured)]
    alarms = alarm_lines(fit)
    lines += [Line(f"  ! {line}", "alarm") for line in alarms]
    for level, line in warning_lines(fit, shared=shared, verbose=verbose, alarms=len(alarms)):
        lines.append(Line(f"  ! {line}", "serious" if level == "serious" else "remark"))
    if verbose:
        for row in fit["relaxation"]:
            tau = "none" if row["tau_single_s"] is None else f"{row['tau_single_s']:.4g} s"
            window = f"{row['window_s'][0]:g} to {row['window_s'][1]:g} s"
            lines.append(Line(f"  hold {window}: one exponential {tau}"))
    return lines


def _paper(fit: Mapping[str, Any]) -> list[str]:
    """The paper's model beside another that predicts as well and was chosen; words of the yardstick."""
    rows, model = fit["selection"], fit["model"]
    if model["key"] == "yardstick":
        inside, outside = len(model.get("inside_s", ())), len(model.get("outside_s", ()))
        nodes = f"{inside} times inside the convolution, {outside} outside it"
        return [f"the mark that a passive law can reach ({nodes}); no law, nothing to quote"]
    lines = []
    others = [row for row in rows if "model" not in row]
    if others and "model" in next((row for row in rows if row["chosen"]), {}):
        best = max(others, key=lambda row: float(row["score"]))
        branches = f"{best['branches']} branch{'es' * (best['branches'] > 1)}"
        words = f"{branches}, K of degree {best['stiffness_degree']}: tau {best['tau_s']:.3g} s"
        lines = [f"paper's model  {words}, misses what was left out by {_more(best)}"]
    mark = next((row for row in rows if row.get("model") == "yardstick"), None)
    return [*lines, f"mark        the yardstick misses what was left out by {_more(mark)}"] if mark else lines


def _more(row: Mapping[str, Any]) -> str:
    """Deviation on what was left out beside that of the chosen law."""
    more = 100.0 * (math.exp(-0.5 * row["score"]) - 1.0)
    return f"{abs(more):.0f} % {'more' if more >= 0.0 else 'less'}"


def _title(fit: Mapping[str, Any]) -> str:
    """Specimen, logs, law and deviation."""
    model, logs = fit["model"], len(fit["trials"])
    branches = "1 branch" if model["branches"] == 1 else f"{model['branches']} branches"
    law = f"{branches}, K of degree {model['stiffness_degree']}"
    if model["key"] != "kelvin-voigt":
        law = model["key"]
    return (
        f"{fit['specimen']}  {logs} log{'s' * (logs > 1)}, {law}, {model['static_pooling']} static, "
        f"NRMSD {100 * fit['nrmsd']['range']:.2f} % of range"
    )
