"""How often the evidence of a recording refutes the noise of its fit: by hand, with -m slow."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from inference_cases import draw, handles_for, small_recipe

from tissueid import FitOptions, IdentifyOptions, identify, read_trials
from tissueid.inference.specimen import fit_with_state

SPECIMENS = 200


@pytest.mark.slow
@pytest.mark.parametrize(("phi", "scatter"), [(0.0, 0.0), (0.9, 0.0), (0.99, 0.0), (0.9, 0.02), (0.9, 0.15)])
@pytest.mark.parametrize("logs", [1, 3])
def test_true_noise_is_refuted_in_at_most_three_per_cent(phi: float, scatter: float, logs: int) -> None:
    size = {"sigma_N": 0.0, "ar1_sigma_N": 0.2, "ar1_phi": phi} if phi else {"sigma_N": 0.2}
    recipe = small_recipe(**size, cv_both=scatter) if scatter else small_recipe(**size)
    refuted = 0
    for seed in range(SPECIMENS):
        handles = handles_for(draw(recipe, 7_000 + seed))[-logs:]
        options = FitOptions(branches=1, stiffness_degree=0)
        refuted += fit_with_state("a", handles, options=options).identified.discrepant
    sys.stdout.write(f"\nphi {phi}, scatter {scatter}, {logs} logs: {refuted} of {SPECIMENS} refuted\n")
    assert refuted <= 0.03 * SPECIMENS


@pytest.mark.slow
def test_one_branch_on_meat_misses_more_than_noise_in_nine_of_ten_sheets(shared_data: Path) -> None:
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    fit = FitOptions(branches=1, stiffness_degree=0)
    said = []
    for trial in read_trials(path):
        (found,) = identify([trial], options=IdentifyOptions(fit=fit)).specimens
        said.append(any(flag.code == "discrepancy" for flag in found.flags))
    sys.stdout.write(f"\none branch on {len(said)} sheets: {sum(said)} miss more than the noise\n")
    assert sum(said) >= 0.9 * len(said)
