"""Measures of loading at the end of each test: what was measured, split by the fitted law where it must be.

Work and depth are read off the recording.  How much of the force relaxes, and how much of the work is stored,
the specimen's law says, as a share: it multiplies what was measured, so that the gain of a log drops out.
Uncertainty comes from the contact point, the sampling step, the noise, and draws of the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.rupture import hardening_ratio, rupture_measures
from tissueid.rupture.loading import LoadedTest
from tissueid.rupture_law import CRITERIA, DEFAULT_WEIGHT

#: Draws of the law behind an uncertainty: it is then known to 11 %.
LAW_DRAWS = 40
#: Fewest passive draws that say anything.
FEWEST_DRAWS = 8
#: Share of the depth over which the growth of a measure is taken.
GROWTH_OVER = 0.02
#: A measure that hardly grows with depth at the end can hardly have ended there.
LEAST_GROWTH = 0.02
#: A share of the law is no less: its logarithm is taken.
LEAST_SHARE = 1e-6
#: A depth of so many v tau finds every branch near its steady state.
SETTLED = 10.0
SQRT_12 = 12.0**0.5


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenLaw:
    """The fitted law of one specimen."""

    specimen: str
    model: ChannelModel
    theta: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    draws: FloatArray | None = None  # (n, p), posterior draws, where there are any

    def some_draws(self) -> FloatArray:
        """Passive draws of the law, shape (at most LAW_DRAWS, p); of its normal where nothing was sampled."""
        if self.draws is not None:
            return np.asarray(self.draws[np.linspace(0, len(self.draws) - 1, LAW_DRAWS).astype(int)])
        if not self.covariance.any():
            return np.empty((0, self.theta.size))
        # the same draws each time: a result must not depend on the order of specimens
        rng = np.random.default_rng(0)
        spread = rng.multivariate_normal(self.theta, self.covariance, size=LAW_DRAWS, method="eigh")
        kept = spread[self.model.passive(spread)]
        return np.array(kept).reshape(-1, self.theta.size)


@dataclass(frozen=True, slots=True)
class Measure:
    """One measure at the end of a test."""

    #: [:data:`~tissueid.rupture_law.THRESHOLD_UNITS`]; a lower bound of the threshold where censored.
    value: float
    sd_ln: float  # of the measurement
    growth: float  # d ln(value) / d ln(depth) at the end of the test


@dataclass(frozen=True, slots=True)
class Failure:
    """One test with its measures."""

    test: LoadedTest
    specimen: str
    measures: Mapping[str, Measure]  # by criterion
    depth_mm: float  # below the refined contact point
    depth_sd_mm: float
    force_sd_N: float
    work_sd_N_mm: float
    dynamic_share: float  # part of the force that relaxes, by the law
    #: x F_s'/F.
    hardening: float
    hardening_sd: float
    settled: bool  # the depth is many times v tau, as the sign test supposes

    @property
    def ruptured(self) -> bool:
        """False: censored."""
        return self.test.ruptured


@dataclass(frozen=True, slots=True)
class _AtEnd:
    """Response of the law on one path: measures and their growth, shares, hardening."""

    values: Mapping[str, float]
    growth: Mapping[str, float]
    dynamic_share: float
    stored_share: float
    hardening: float


def _at_end(model: ChannelModel, theta: FloatArray, path: ContactPath, weight: float) -> _AtEnd:
    measures = rupture_measures(model, theta, path, weight=weight)
    x = path.depth_mm
    before = min(int(np.searchsorted(x, (1.0 - GROWTH_OVER) * x[-1])), x.size - 2)
    # a crosshead that stops repeats its last depth: growth is over a part of the way that was gone
    before = max(min(before, int(np.argmax(x >= x[-1])) - 1), 1)
    over = float(np.log(x[-1] / x[before]))
    force, work = float(measures["force"][-1]), float(measures["work"][-1])
    growth = {}
    for name in CRITERIA:
        last, earlier = float(measures[name][-1]), float(measures[name][before])
        grows = np.log(last / earlier) / over if min(last, earlier, over) > 0.0 else 0.0
        growth[name] = max(float(grows), LEAST_GROWTH)
    return _AtEnd(
        values={name: float(measures[name].max()) for name in CRITERIA},
        growth=growth,
        dynamic_share=float(measures["dynamic"][-1]) / force,
        stored_share=float(measures["stored-energy"].max()) / work,
        hardening=hardening_ratio(model, theta, float(x[-1]), force),
    )


def _weighted(found: _AtEnd, weight: float) -> float:
    """Weighted force over the force."""
    return max(1.0 + (weight - 1.0) * found.dynamic_share, LEAST_SHARE)


def _path(test: LoadedTest, offset_mm: float) -> ContactPath:
    """The path below the refined contact point, from depth 0."""
    depth = test.depth_mm - offset_mm
    inside = depth > 0.0
    first = float(depth[inside][0])
    time = test.time_s[inside]
    start = float(time[0]) - first / test.speed_mm_s
    return ContactPath(np.concatenate([[start], time]), np.concatenate([[0.0], depth[inside]]))


def failures_of(
    law: SpecimenLaw, tests: Sequence[tuple[LoadedTest, float]], *, weight: float = DEFAULT_WEIGHT
) -> list[Failure]:
    """Tests of one specimen with their measures under its law.

    ``tests``: each with the offset of its refined contact point [mm]; ``weight``: w of the weighted force.
    """
    draws = law.some_draws()
    return [_failure(law, draws, test, offset_mm, weight) for test, offset_mm in tests]


def _failure(
    law: SpecimenLaw, draws: FloatArray, test: LoadedTest, offset_mm: float, weight: float
) -> Failure:
    path = _path(test, offset_mm)
    depth_mm = float(path.depth_mm[-1])
    found = _at_end(law.model, law.theta, path, weight)
    drawn = [_at_end(law.model, theta, path, weight) for theta in draws]

    def spread(values: Sequence[float]) -> float:
        return float(np.std(values)) if len(values) >= FEWEST_DRAWS else 0.0

    values = {
        "work": test.work_N_mm,
        "weighted-force": test.force_N * _weighted(found, weight),
        "stored-energy": test.work_N_mm * max(found.stored_share, LEAST_SHARE),
        "depth": depth_mm,
    }
    law_sd = {
        "work": 0.0,
        "weighted-force": spread([np.log(_weighted(one, weight)) for one in drawn]),
        "stored-energy": spread([np.log(max(one.stored_share, LEAST_SHARE)) for one in drawn]),
        "depth": 0.0,
    }
    step_sd = test.step_mm / SQRT_12
    noise = test.force_sd_N / test.force_N
    own = {"work": 0.0, "weighted-force": noise, "stored-energy": 0.0, "depth": test.contact_sd_mm / depth_mm}
    measures = {
        name: Measure(
            value=values[name],
            sd_ln=float(
                np.sqrt((found.growth[name] * step_sd / depth_mm) ** 2 + own[name] ** 2 + law_sd[name] ** 2)
            ),
            growth=found.growth[name],
        )
        for name in CRITERIA
    }
    slope = test.force_N * found.growth["weighted-force"] / depth_mm
    return Failure(
        test=test,
        specimen=law.specimen,
        measures=measures,
        depth_mm=depth_mm,
        depth_sd_mm=float(np.hypot(test.contact_sd_mm, step_sd)),
        force_sd_N=float(np.hypot(test.force_sd_N, slope * step_sd)),
        work_sd_N_mm=test.work_N_mm * measures["work"].sd_ln,
        dynamic_share=found.dynamic_share,
        hardening=found.hardening,
        hardening_sd=spread([one.hardening for one in drawn]),
        settled=depth_mm >= SETTLED * test.speed_mm_s * float(law.model.split(law.theta)[2].max(initial=0.0)),
    )
