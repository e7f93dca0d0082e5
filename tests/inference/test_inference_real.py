"""Real recordings: how intervals change with what they know, and whether bands hold the data.

Prints half-widths of 95 % intervals under white noise, under the noise that was found, by the cluster
bootstrap, and in total.  ``scripts/record-slow real-intervals`` with this file keeps them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import tissueid
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.ingest.options import ReadOptions
from tissueid.pipeline import IdentifyOptions
from tissueid.result import SpecimenFit

pytestmark = pytest.mark.slow

#: Effective draws: the ends of an interval are then good to 7 % of the standard deviation.
DRAWS = 2_000
SINGLE = ("230403-FF1A", "230403-RDG1A", "230403-FF2A")


def half(interval: tuple[float, float] | None) -> float:
    return float("nan") if interval is None else 0.5 * (interval[1] - interval[0])


def table(white: SpecimenFit, found: SpecimenFit) -> dict[str, tuple[float, float, float]]:
    """Half-widths of each parameter: white, as found, total."""
    rows = {}
    for one in found.parameters:
        before, after = white.parameter(one.name).uncertainty, one.uncertainty
        widths = (before and before.ci95, after and after.ci95, after and after.ci95_total)
        rows[one.name] = tuple(half(width) for width in widths)
    return rows


def told(white: SpecimenFit, found: SpecimenFit) -> str:
    """The table in words, with the share of samples that the bands hold."""
    raised = any(flag.code == "misfit" for flag in found.flags)
    lines = [
        "",
        f"{found.specimen}: {len(found.trials)} logs, misfit alarm {'raised' if raised else 'quiet'}",
    ]
    if found.posterior is not None:
        noise = found.posterior.noise
        lines.append(f"noise {noise.model} {noise.sigma_N:.3g} N, phi {noise.phi:.3g}")
        lines.append(f"within the predictive band: {100 * inside(found):.1f} % of the fitted samples")
    heads = ("value", "white", "found", "total")
    lines.append(f"{'95 % half-width':<34}" + "".join(f"{cell:>11}" for cell in heads))
    for name, widths in table(white, found).items():
        one = found.parameter(name)
        cells = "".join(f"{value:>11.4g}" for value in (one.detail["estimate"], *widths))
        lines.append(f"{name:<34}{cells}{'' if one.identified else '  not identified'}")
    return "\n".join(lines)


def inside(fit: SpecimenFit) -> float:
    """Share of the fitted samples within their predictive bands."""
    assert fit.posterior is not None
    held = []
    for trial in fit.trials:
        (low, _, high), on = fit.posterior.bands[trial.path, trial.sheet], trial.curve.fitted
        held.append(((trial.curve.force_N >= low) & (trial.curve.force_N <= high))[on])
    return float(np.concatenate(held).mean())


#: One piece of meat, or all of them pooled; branches.
CASES = [*((None, (sheet,), 2) for sheet in SINGLE), ("(230403)", (), 1)]


@pytest.mark.parametrize(("specimen_by", "sheets", "branches"), CASES)
def test_intervals_of_meat(workbook: Path, specimen_by: str | None, sheets: tuple[str, ...], branches: int):
    asked = {"branches": branches, "specimen_by": specimen_by, "sheets": sheets}
    (white,), (found,) = (fits(workbook, noise, **asked) for noise in ("white", "auto"))
    print(told(white, found))  # noqa: T201 -- the table is what this test is run for
    # knowing less of the machine can't tell more of the tissue
    assert not [
        name for name, (_, by_noise, total) in table(white, found).items() if total < NO_NARROWER * by_noise
    ]
    if specimen_by is None:
        # bands are pointwise 95 %; errors of one log follow each other, so that the share itself scatters
        assert inside(found) >= 0.9
        return
    # meat relaxes at many rates: the intervals of one relaxation time are no statement about it, and an
    # interval stands on enough draws about the right point, or there is none and the reason is told
    codes = {flag.code for flag in found.flags}
    assert "misfit" in codes
    assert found.posterior is not None or "sampler_not_converged" in codes


#: Ends of an interval from a thousand draws are good to 0.07 sd each, 5 % of a half-width in all; a filter
#: takes its share of a relaxation time, whose spread goes with it.
NO_NARROWER = 0.85


@pytest.fixture(scope="module")
def workbook(shared_data: Path) -> Path:
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    return path


def fits(
    workbook: Path, noise: str, *, branches: int, specimen_by: str | None = None, sheets: Sequence[str] = ()
) -> list[SpecimenFit]:
    """Fits of the workbook with a stated model, so that every column speaks of one."""
    trials = tissueid.read_trials(workbook, ReadOptions(specimen_by=specimen_by))
    chosen = [one for one in trials if not sheets or one.source.sheet in sheets]
    options = IdentifyOptions(
        fit=FitOptions(branches=branches, stiffness_degree=1, noise=noise),
        posterior=PosteriorOptions(sampler="emcee", draws=DRAWS),
    )
    return list(tissueid.identify(chosen, options=options).specimens)
