"""Points side by side against the same points one by one."""

from __future__ import annotations

import numpy as np
import pytest
from instrument_factory import Case, every_sample, recorded

from tissueid.likelihood.instrument_kernels import EFFECTS, RELAXATION, TISSUE, Packed
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.knots import knot_sums, packed
from tissueid.likelihood.lanes import LANES, decays, gathered
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.term_lanes import Terms, integrated_terms

pytestmark = pytest.mark.needs_jit

DEPTH = 8.0
TISSUE_ONE = np.array([20.0, -1.2, 0.35, 63.62, 10.0, 0.021])


def test_what_a_step_leaves_is_exact_to_rounding() -> None:
    ratio = 10.0 ** np.linspace(-13.0, 2.5, LANES)
    kept, lost, power = np.empty((3, LANES))
    decays(ratio, kept, lost, power, power.view(np.int64))
    assert kept == pytest.approx(np.exp(-ratio), rel=5e-16, abs=0.0)
    assert lost == pytest.approx(-np.expm1(-ratio), rel=5e-16, abs=0.0)
    decays(np.full(LANES, np.inf), kept, lost, power, power.view(np.int64))
    assert (kept < 1e-300).all()
    assert (lost == 1.0).all()


def test_lanes_that_are_left_over_are_filled() -> None:
    points = np.arange(30.0).reshape(10, 3)
    found = gathered(points, np.array([4, 7]), 1, 2)
    assert found.shape == (2, LANES)
    assert found[:, 0].tolist() == points[4, 1:].tolist()
    assert (found[:, 1:] == points[7, 1:, None]).all()


def of_specimen(
    branches: int, effects: tuple[str, ...], phi: float, average: float
) -> tuple[Packed, Optimum]:
    """Four logs about a tissue with some branches, the residuals of another one."""
    rng = np.random.default_rng(5)
    logs = recorded(Case(hold_s=1.0, phi=phi), TISSUE_ONE, {}, rng).logs[4:8]
    free = "static" in effects
    static = np.zeros(0) if free else TISSUE_ONE[:3] * DEPTH ** np.arange(1.0, 4.0)
    branch = TISSUE_ONE[3:5] * DEPTH ** np.arange(2.0)
    optimum = Optimum(
        theta=np.concatenate([static, *([branch / branches] * branches)]),
        log_tau=np.log(0.021) + 2.0 * np.arange(branches),
        gamma=np.zeros(4),
        delta=np.zeros(4),
        own=np.outer([1.0, 1.1, 0.9, 1.0], [0.1, *TISSUE_ONE[:3]]) if free else np.zeros((4, 4)),
        scale=DEPTH,
        degree=1,
    )
    direct = every_sample(logs, optimum, effects)
    force = np.split(direct.base, direct.first[1:-1])
    sums = [
        knot_sums(log, log.force_N - one, phi=phi, reference_step_s=0.01, moving_average=average)
        for log, one in zip(logs, force, strict=True)
    ]
    return packed(sums, optimum, effects), optimum


@pytest.mark.parametrize("kind", [EFFECTS, TISSUE, RELAXATION])
@pytest.mark.parametrize(
    ("branches", "effects", "few", "phi", "average"),
    [
        (1, ("gain", "offset"), 0, 0.5, 0.0),
        (2, ("gain", "offset"), 3, 0.5, 0.3),
        (3, ("static",), 0, 0.0, 0.0),
        (1, (), 2, 0.5, 0.0),
    ],
)
def test_terms_are_those_of_each_point(
    branches: int, effects: tuple[str, ...], few: int, phi: float, average: float, kind: int
) -> None:
    rng = np.random.default_rng(branches)
    data, optimum = of_specimen(branches, effects, phi, average)
    logs, q = 4, len(effects) if "static" not in effects else 4
    theta = optimum.theta[:, None] * np.exp(0.1 * rng.standard_normal((optimum.theta.size, LANES)))
    log_tau = optimum.log_tau[:, None] + 0.3 * rng.standard_normal((branches, LANES))
    instrument = rng.standard_normal((3, LANES)) * np.array([[2e-3], [5e-3], [2e-3]])
    # early and late, with and without a filter and a frame
    instrument[1:] = np.maximum(instrument[1:], 0.0)
    gamma, delta = 0.05 * rng.standard_normal((2, logs, LANES))
    weight = rng.dirichlet(np.ones(logs), LANES).T * logs
    weight[2, ::3] = 0.0
    terms = Terms(
        gamma=gamma,
        delta=delta,
        share=rng.uniform(0.1, 1.0, (few, LANES)),
        pulls=rng.standard_normal((few, data.pull.size)),
        bands=np.concatenate([data.band[None] * k for k in range(1, few + 1)] or [np.zeros((0, 0, 0))]),
        squares=rng.uniform(1.0, 2.0, (few, logs)),
        precision=rng.uniform(10.0, 1000.0, (logs, q, LANES)),
        mean=0.01 * rng.standard_normal((logs, q, LANES)),
        weight=weight,
        sigma2=rng.uniform(0.5, 2.0, LANES),
    )
    found = integrated_terms(data, terms, theta, np.exp(log_tau), instrument, kind)
    for v in range(LANES):
        own = data._replace(gamma=gamma[:, v].copy(), delta=delta[:, v].copy())
        if few:
            share = terms.share[:, v]
            own = own._replace(
                pull=share @ terms.pulls,
                band=np.tensordot(share, terms.bands, 1),
                square=share @ terms.squares,
            )
        sums = log_terms(own, theta[:, v].copy(), log_tau[:, v].copy(), instrument[:, v].copy(), kind)
        expected = without_effects(
            *sums, weight[:, v].copy(), terms.precision[:, :, v].copy(), terms.mean[:, :, v].copy(),
            terms.sigma2[v],
        )  # fmt: skip
        size = np.sqrt(np.diag(expected[0]))
        away = np.abs(found[0][:, :, v] - expected[0])
        assert (away <= 1e-9 * np.outer(size, size)).all()
        assert found[1][:, v] == pytest.approx(expected[1], rel=1e-7, abs=1e-7 * size.max(initial=0.0))
        assert found[2][v] == pytest.approx(expected[2], rel=1e-10)
