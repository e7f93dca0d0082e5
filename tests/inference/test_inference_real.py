"""Real recordings: intervals grow with what is unknown, and bands hold the data."""

from pathlib import Path

import numpy as np
import pytest

import tissueid
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.ingest.options import ReadOptions
from tissueid.pipeline import IdentifyOptions

pytestmark = pytest.mark.slow

#: Effective draws: the ends of an interval are then good to 7 % of the standard deviation.
DRAWS = 2_000


def half(interval: tuple[float, float]) -> float:
    return 0.5 * (interval[1] - interval[0])


#: Ends of an interval from a thousand draws are good to 0.07 sd each, 5 % of a half-width in all; a filter
#: takes its share of a relaxation time, whose spread goes with it.
NO_NARROWER = 0.85
#: One piece of meat, or all of them pooled; branches.
CASES = [
    *((None, sheet, 2) for sheet in ("230403-FF1A", "230403-RDG1A", "230403-FF2A")),
    ("(230403)", None, 1),
]


@pytest.mark.parametrize(("specimen_by", "sheet", "branches"), CASES)
def test_intervals_of_meat(shared_data: Path, specimen_by: str | None, sheet: str | None, branches: int):
    (workbook,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    trials = tissueid.read_trials(workbook, ReadOptions(specimen_by=specimen_by))
    options = IdentifyOptions(
        fit=FitOptions(branches=branches, stiffness_degree=1),
        posterior=PosteriorOptions(sampler="emcee", draws=DRAWS),
    )
    chosen = [one for one in trials if sheet in {None, one.source.sheet}]
    (found,) = tissueid.identify(chosen, options=options).specimens
    for one in found.parameters:
        known = one.uncertainty
        if known is not None and known.ci95_total is not None:
            # knowing less of the machine can't tell more of the tissue
            assert half(known.ci95_total) >= NO_NARROWER * half(known.ci95), one.name
    if specimen_by is None:
        held = []
        for trial in found.trials:
            (low, _, high), on = found.posterior.bands[trial.path, trial.sheet], trial.curve.fitted
            held.append(((trial.curve.force_N >= low) & (trial.curve.force_N <= high))[on])
        # bands are pointwise 95 %; errors of one log follow each other, so that the share itself scatters
        assert np.concatenate(held).mean() >= 0.9
        return
    # meat relaxes at many rates: the intervals of one relaxation time are no statement about it, and an
    # interval stands on enough draws about the right point, or there is none and the reason is told
    codes = {flag.code for flag in found.flags}
    assert "misfit" in codes
    assert found.posterior is not None or "sampler_not_converged" in codes
