"""The model is that of compiled Gibbs chains of earlier versions: numbers of 64,000 of their sweeps."""

from __future__ import annotations

import numpy as np
import pytest
from cohort_factory import monte_carlo_errors, normal_stage

from tissueid.population.sampler import PopulationDraws, SamplerOptions, sample_population
from tissueid.population.stage_one import Design, StageOne

SPECIMENS, SIZE, OUTLIER = 24, 3, 13


def stage_and_design(own: np.ndarray) -> tuple[StageOne, Design]:
    """Specimens of eight donors along a covariate, one of them far off, known to ``own``."""
    rng = np.random.default_rng(61)
    x = np.linspace(-1.5, 1.5, SPECIMENS)
    donor = np.arange(SPECIMENS) // 3
    places = np.array([1.0, -2.0, 0.5]) + np.outer(x, [0.2, 0.0, -0.1])
    places = places + 0.15 * rng.standard_normal((8, SIZE))[donor]
    common = rng.standard_normal((SPECIMENS, 1))
    places = places + 0.1 * (0.8 * common + 0.6 * rng.standard_normal((SPECIMENS, SIZE)))
    places[OUTLIER] += [0.9, -0.9, 0.9]
    names = tuple(f"d{k}" for k in range(8))
    design = Design(
        np.column_stack([np.ones(SPECIMENS), x]), ("mean", "x"), donor[None, :], ("donor",), (names,)
    )
    return normal_stage(places, own, rng, draws=1500), design


#: Means, then standard deviations, of what :func:`numbers` gives; errors are 3 % of the latter.
EXPECTED = {
    "held": """
1.024 -2.045 0.546 0.195 0.117 -0.097 -1.569 -2.656 -2.032 -2.340 -2.037 -2.439 0.194 0.633 0.380 1.209
0.084 0.046 0.058 0.082 0.050 0.062 0.275 0.521 0.360 0.242 0.226 0.249 0.251 0.186 0.237 0.431
""",
    "mixed": """
1.017 -2.059 0.533 0.194 0.145 -0.088 -1.691 -2.636 -1.881 -2.178 -1.958 -2.327 -0.085 0.630 0.162 1.394
0.078 0.051 0.067 0.080 0.054 0.072 0.341 0.534 0.372 0.281 0.250 0.280 0.280 0.234 0.297 0.500
""",
    "smooth": """
1.027 -2.056 0.493 0.208 0.109 -0.141 -1.564 -2.669 -2.424 -2.159 -1.901 -2.260 -0.016 0.142 -0.117 1.478
0.089 0.049 0.098 0.093 0.054 0.107 0.308 0.536 0.624 0.284 0.240 0.504 0.270 0.364 0.373 0.579
""",
}
#: Probability that the outlier, and that another specimen, is far from the others.
FAR = {"held": (1.0, 0.579), "mixed": (1.0, 0.535), "smooth": (0.999, 0.579)}
OTHER = 3
#: Recordings that place all specimens well, five of them badly, and all badly in one number.
OWN = {
    "held": np.tile([0.02, 0.02, 0.03], (SPECIMENS, 1)),
    "mixed": np.where(np.arange(SPECIMENS)[:, None] % 5 == 1, [0.3, 0.3, 0.6], [0.02, 0.02, 0.03]),
    "smooth": np.tile([0.03, 0.05, 0.4], (SPECIMENS, 1)),
}


def numbers(found: PopulationDraws) -> np.ndarray:
    """Draws of mean, effects, ln spreads, correlations and ln tails; shape (chains, sweeps, 16)."""
    shape = found.nu.shape
    below = np.tril_indices(SIZE, -1)
    parts = [found.coefficient, np.log(found.level_sd), np.log(found.sd), found.correlation[:, :, *below]]
    return np.concatenate([*(one.reshape(*shape, -1) for one in parts), np.log(found.nu)[..., None]], axis=2)


@pytest.mark.parametrize(("name", "smooth"), [("held", 0), ("mixed", 5), ("smooth", SPECIMENS)])
def test_numbers_are_those_of_long_chains_of_another_sampler(name, smooth):
    stage, design = stage_and_design(OWN[name])
    found = sample_population(stage, design, None, SamplerOptions(draws=9600, blocks=1))
    assert found.smoothed.size == smooth
    draws = numbers(found)
    mean, sd = np.loadtxt(EXPECTED[name].split("\n")[1:-1])
    errors = [monte_carlo_errors(draws[:, :, k]) for k in range(draws.shape[2])]
    # four errors of each of 96 differences
    for k, one in enumerate(errors):
        known = 0.03 * sd[k]
        assert draws[:, :, k].mean() == pytest.approx(mean[k], abs=4.0 * np.hypot(one.mean, known)), k
        assert draws[:, :, k].std() == pytest.approx(sd[k], abs=4.0 * np.hypot(one.sd, known)), k
    # some 150 effective draws of a share of a half: an error of 0.04
    assert found.far[[OUTLIER, OTHER]] == pytest.approx(FAR[name], abs=0.12)
