"""Statistical bars: bias and spread of tau and eta against the fit's own Cramer-Rao standard error.

Contact is known here (the recordings start in contact); what the segmenter adds is tested with the
pipeline.  Seeds are fixed; every figure is printed before it is judged (``pytest -s`` shows them).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from inference_cases import by_name, draw, handles_for

from tissueid.inference.specimen import FitOptions, fit_with_state
from tissueid.synth import recipe

TAU, STIFFNESS = 0.021, 63.62
AT_HALF_DEPTH = {0: STIFFNESS, 1: STIFFNESS + 10.0 * 4.0}
NAMES = {"tau": "relaxation_time_s", "eta": "viscosity_N_s_per_mm"}
#: Bars: bias in Cramer-Rao sd, spread over them.
BIAS, SPREAD = 0.5, 1.3
EVERY = 3.0
#: Third column of the table of estimators, paper-a-30, sigma 1 N, 100 Hz, K degree 1 [relative].
PARTIAL_100_HZ = {"tau": 0.0333, "eta": 0.0089}
PARTIAL_1_KHZ = {"tau": 0.0110, "eta": 0.0031}


@dataclass(frozen=True)
class Figures:
    """Estimates and claimed standard errors over seeds: bias, spread and worst in claimed sd."""

    values: np.ndarray
    claims: np.ndarray
    truth: float

    @property
    def bias(self):
        return float((self.values.mean() - self.truth) / self.claims.mean())

    @property
    def spread(self):
        return float(self.values.std(ddof=1) / self.claims.mean())

    @property
    def worst(self):
        return float(np.abs((self.values - self.truth) / self.claims).max())


def figures(rate_Hz, seeds, *, static="partial", degree=0, **changes):
    """Figures of tau and eta of paper A's program, told before they are judged."""
    plan = replace(recipe("paper-a-30" if degree == 0 else "paper-a-30-k1"), rate_Hz=rate_Hz, **changes)
    found = {name: ([], []) for name in NAMES}
    for seed in seeds:
        options = FitOptions(branches=1, stiffness_degree=degree, static=static)
        # errors are those of noise: the machine, which has none here, is held
        fit = fit_with_state(
            "a", handles_for(draw(plan, seed), sd_mm=1e-4), options=options, machine=False
        ).fit
        for key, name in NAMES.items():
            detail = by_name(fit)[name].detail
            found[key][0].append(detail["estimate"])
            found[key][1].append(detail["estimate_stderr"])
    truth = {"tau": TAU, "eta": TAU * AT_HALF_DEPTH[degree]}
    out = {key: Figures(np.array(v), np.array(c), truth[key]) for key, (v, c) in found.items()}
    for key, one in out.items():
        print(  # noqa: T201
            f"\n{rate_Hz:.0f} Hz, K degree {degree}, {static}, {changes}: {key} truth {one.truth:.5g}, "
            f"mean {one.values.mean():.5g}, claimed {one.claims.mean():.3g}, bias {one.bias:+.2f} sd, "
            f"spread {one.spread:.2f}, worst {one.worst:.2f} sd, n {one.values.size}",
            end="",
        )
    return out


@pytest.mark.parametrize(
    ("rate", "seeds", "static", "degree"),
    [
        (100.0, 3, "partial", 0),
        pytest.param(100.0, 3, "shared", 0, marks=pytest.mark.slow),
        pytest.param(1000.0, 2, "partial", 0, marks=pytest.mark.slow),
        pytest.param(1000.0, 2, "partial", 1, marks=pytest.mark.slow),
    ],
)
def test_a_few_seeds_lie_within_three_standard_errors(rate, seeds, static, degree):
    for one in figures(rate, range(seeds), static=static, degree=degree).values():
        assert one.worst <= EVERY


@pytest.mark.slow
@pytest.mark.parametrize("static", ["partial", "shared", "scaled"])
@pytest.mark.parametrize("degree", [0, 1])
def test_fifty_seeds_at_100_hz_are_unbiased_and_spread_as_claimed(static, degree):
    for key, one in figures(100.0, range(50), static=static, degree=degree).items():
        assert abs(one.bias) <= BIAS, key
        assert one.spread <= SPREAD, key


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "bars"), [(100.0, PARTIAL_100_HZ), (1000.0, PARTIAL_1_KHZ)])
def test_partial_pooling_without_scatter_is_as_sharp_as_theory_allows(rate, bars):
    for key, one in figures(rate, range(3), degree=1).items():
        assert float(one.claims.mean() / one.truth) <= 1.15 * bars[key], key


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "changes"),
    # CV 15 % on static and branches together; a stop rounded over 30 ms, the displacement measured
    [(40, {"cv_both": 0.15}), (20, {"crosshead_rounding_s": 0.03})],
)
def test_scatter_of_specimens_and_a_rounded_stop_leave_the_relaxation_time_unbiased(seeds, changes):
    tau = figures(100.0, range(seeds), **changes)["tau"]
    error = abs(tau.values.mean() - TAU)
    assert error <= 0.05 * TAU
    if "cv_both" in changes:
        assert error <= 3.0 * tau.values.std(ddof=1) / np.sqrt(tau.values.size)
