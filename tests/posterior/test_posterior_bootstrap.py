"""The bootstrap over logs: against refits of repeated logs, against the scatter it is to find."""

from __future__ import annotations

import numpy as np
import pytest
from instrument_factory import (
    DEPTH,
    TISSUE,
    Case,
    Specimen,
    drawn_theta,
    recorded,
    rigid_fit,
)

from tissueid.likelihood.knots import packed
from tissueid.likelihood.linearise import Optimum
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.bootstrap import CLUSTER, MIN_LOGS, ClusterBootstrap, cluster_bootstrap, refitted
from tissueid.posterior.budget import reported, reported_names
from tissueid.posterior.instrument import INSTRUMENT_NAMES
from tissueid.posterior.instrument_mode import instrument_mode
from tissueid.priors import CalibrationPrior, Priors

pytestmark = pytest.mark.needs_jit

EFFECTS = ("gain", "offset")
MODEL = KelvinVoigt(1, 1, DEPTH)
POWERS = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])


def one_specimen(seed: int, **case: float) -> Specimen:
    rng = np.random.default_rng([9, seed])
    how = Case(**case)  # type: ignore[arg-type]
    return recorded(how, drawn_theta(TISSUE, rng), {}, rng)


def bootstrap_of(specimen: Specimen, seed: int = 1, logs: slice = slice(None)) -> ClusterBootstrap | None:
    optimum, knots = rigid_fit(specimen)
    part = Optimum(
        optimum.theta, optimum.log_tau, optimum.gamma[logs], optimum.delta[logs], optimum.own[logs], DEPTH, 1
    )
    facts = specimen.case.facts
    known = type(facts)(
        facts.force_N, facts.speed_mm_s, facts.depth_mm, facts.log_tau_bounds,
        facts.offset_sd_mm[logs], facts.offset_mean_mm[logs],
    )  # fmt: skip
    return cluster_bootstrap(
        knots[logs], part, known, MODEL, Priors(), effects=EFFECTS,
        gain_sd=float(optimum.gamma.std(ddof=1)), seed=seed,
    )  # fmt: skip


def test_few_logs_say_nothing_of_their_scatter() -> None:
    assert bootstrap_of(one_specimen(1), logs=slice(0, MIN_LOGS - 1)) is None
    assert bootstrap_of(one_specimen(1), logs=slice(0, MIN_LOGS)) is not None


def test_rows_carry_no_share() -> None:
    found = bootstrap_of(one_specimen(2))
    assert found is not None
    assert found.names == reported_names(MODEL)
    assert {row.source for row in found.rows} == {CLUSTER}
    assert {row.share for row in found.rows} == {None}
    assert [row.sd for row in found.rows] == pytest.approx(found.sd.tolist())


def test_a_seed_repeats_it() -> None:
    one, two = bootstrap_of(one_specimen(3), seed=5), bootstrap_of(one_specimen(3), seed=5)
    assert one is not None
    assert two is not None
    assert np.array_equal(one.ci95, two.ci95)


def test_weights_are_repetitions_of_logs() -> None:
    """Weights of 0 and 2 are the fit without some logs and with others twice."""
    specimen = one_specimen(4)
    optimum, knots = rigid_fit(specimen)
    known = Priors(calibration={name: CalibrationPrior(0.0, 0.0) for name in INSTRUMENT_NAMES})

    def mode_of(rows: np.ndarray):
        part = Optimum(
            optimum.theta,
            optimum.log_tau,
            optimum.gamma[rows],
            optimum.delta[rows],
            optimum.own[rows],
            DEPTH,
            1,
        )
        facts = specimen.case.facts
        of_rows = type(facts)(
            facts.force_N, facts.speed_mm_s, facts.depth_mm, facts.log_tau_bounds,
            facts.offset_sd_mm[rows], facts.offset_mean_mm[rows],
        )  # fmt: skip
        chosen = [knots[k] for k in rows]
        return instrument_mode(
            packed(chosen, part, EFFECTS), part, of_rows, MODEL, known, EFFECTS,
            count=sum(one.count for one in chosen), gain_sd=0.02,
        )  # fmt: skip

    whole = mode_of(np.arange(10))
    rows = np.array([0, 0, 2, 3, 5, 5, 6, 7, 8, 9])
    weights = np.bincount(rows, minlength=10).astype(float)
    theta, log_tau = (one[0] for one in refitted(whole, weights[None]))
    expected = mode_of(rows)
    # what three steps leave, in units of what the weights moved
    moved = np.abs(expected.theta - whole.theta)
    assert theta == pytest.approx(expected.theta, abs=0.05 * moved.max())
    assert log_tau == pytest.approx(
        expected.mode[:1], abs=0.05 * abs(expected.mode[0] - whole.mode[0]) + 1e-4
    )


def test_scatter_of_gains_is_found() -> None:
    """The static curve follows a mean of ten gains of 5 %."""
    found = bootstrap_of(one_specimen(5, gain_sd=0.05))
    assert found is not None
    optimum, _ = rigid_fit(one_specimen(5, gain_sd=0.05))
    relative = found.sd[1] / (optimum.theta[0] / DEPTH)
    expected = optimum.gamma.std(ddof=1) / np.sqrt(10.0)
    # a1 has a little of its own beside the gain
    assert relative == pytest.approx(expected, rel=0.35)


def _coverage(specimens: int, **case: float) -> np.ndarray:
    hits = []
    for i in range(specimens):
        specimen = one_specimen(1000 + i, **case)
        found = bootstrap_of(specimen, seed=i)
        assert found is not None
        truth = reported(MODEL, specimen.theta[None])[0]
        hits.append((found.ci95[:, 0] <= truth) & (truth <= found.ci95[:, 1]))
    return np.mean(hits, axis=0)


def test_interval_covers_in_a_few_specimens() -> None:
    # of 8 at 90 % fewer than 5 are covered once in 200
    assert (_coverage(8) >= 5 / 8).all()


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_interval_covers_with_thirty_logs(phi: float) -> None:
    rates = _coverage(200, repeats=3, phi=phi)
    # 92 %, less 2.33 standard errors
    assert (rates >= 0.92 - 2.33 * np.sqrt(0.92 * 0.08 / 200)).all()
