"""Tests up to the rupture, or to the deepest point of one without, and the measures of their loading.

The tissue broke between the last sample before the force falls and the next: all is taken in the middle,
and the interval over sqrt(12) is its uncertainty.  What relaxes or is stored is a share, by the law, of
what was measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.rupture import Limit, Measures
from tissueid.documents.rupture import Test as Failure
from tissueid.manifest import FrameCurve
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.frame import deflection
from tissueid.model.rupture import hardening_ratio, rupture_measures
from tissueid.rupture_law import CRITERIA, DEFAULT_WEIGHT
from tissueid.trial import Segmentation, Trial, contact_frame

#: Samples kept of a path: the branch state is exact for any number, its corners apart.
PATH_SAMPLES = 1500
#: Fewest samples from contact to the end.
FEWEST_SAMPLES = 6
#: The force at the end is read off a line through the samples from this share of the depth on.
LINE_FROM = 0.97
FEWEST_IN_LINE = 3


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTest:
    """Loading of the tissue until it broke or the test ended."""

    #: Of the recording.
    path: str
    sheet: str | None
    ruptured: bool  # false: censored
    #: (n,): from contact (depth 0) to the end, thinned.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    #: At the end; work from contact.
    force_N: float
    work_N_mm: float
    force_sd_N: float  # noise of the force
    step_mm: float  # depth between two samples at the end, 0 where the test is censored
    contact_sd_mm: float
    speed_mm_s: float  # over the second half of the depth
    residual: float | None  # share of the force that was left, where it ruptured


def loaded_test(
    trial: Trial, segmentation: Segmentation, frame: FrameCurve | None = None
) -> LoadedTest | None:
    """A test up to its first rupture, or to its deepest point; ``None`` without contact or loading.

    ``frame``: of the machine, whose deflection is none of the tissue's depth.
    """
    if segmentation.contact is None:
        return None
    depth, force = contact_frame(trial, segmentation)
    if frame is not None:
        depth = depth - deflection(frame, np.maximum(force, 0.0))
    event = next((one for one in segmentation.events if one.kind == "rupture"), None)
    last = int(np.argmax(depth)) if event is None else event.index
    below = np.flatnonzero(depth[segmentation.contact.index : last + 1] > 0.0)
    first = segmentation.contact.index + int(below[0]) if below.size else last
    if last - first + 1 < FEWEST_SAMPLES or not depth[last] > 0.0:
        return None
    time, x, f = (values[first : last + 1] for values in (trial.time_s, depth, force))
    middle = min(int(np.searchsorted(x, 0.5 * x[-1])), x.size - 2)
    speed = float((x[-1] - x[middle]) / (time[-1] - time[middle])) if time[-1] > time[middle] else 0.0
    if not speed > 0.0:
        return None
    # from contact to the first sample after it, and from the last before a rupture half-way to the next
    work = float(np.trapezoid(f, x)) + 0.5 * float(f[0] * x[0])
    slope, peak = _end_line(x, f)
    step, residual = 0.0, None
    if event is not None:
        step = speed * float(trial.time_s[last + 1] - trial.time_s[last])
        half = 0.5 * step
        work += half * (peak + 0.5 * half * slope)
        peak += half * slope
        residual = min(max(1.0 - event.values["drop_N"] / event.values["force_before_N"], 0.0), 1.0)
    keep = evenly(x.size, PATH_SAMPLES)
    return LoadedTest(
        path=trial.source.path,
        sheet=trial.source.sheet,
        ruptured=event is not None,
        time_s=np.concatenate([[time[0] - x[0] / speed], time[keep], [time[-1] + 0.5 * step / speed]]),
        depth_mm=np.concatenate([[0.0], x[keep], [x[-1] + 0.5 * step]]),
        force_N=peak,
        work_N_mm=work,
        force_sd_N=segmentation.force_noise_N,
        step_mm=step,
        contact_sd_mm=segmentation.contact.sd_mm,
        speed_mm_s=speed,
        residual=residual,
    )


def _end_line(depth_mm: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Slope [N/mm] and value [N] at the end of a straight line through the last samples."""
    recent = max(int((depth_mm >= LINE_FROM * depth_mm[-1]).sum()), FEWEST_IN_LINE)
    x, f = depth_mm[-recent:] - depth_mm[-1], force_N[-recent:]
    if not np.ptp(x) > 0.0:
        return 0.0, float(f.mean())
    slope, value = np.polyfit(x, f, 1)
    return float(slope), float(value)


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

    def some_draws(self) -> FloatArray:
        """Passive draws of the law's normal, shape (at most LAW_DRAWS, p)."""
        if not self.covariance.any():
            return np.empty((0, self.theta.size))
        # the same draws each time: a result must not depend on the order of specimens
        rng = np.random.default_rng(0)
        spread = rng.multivariate_normal(self.theta, self.covariance, size=LAW_DRAWS, method="eigh")
        kept = spread[self.model.passive(spread)]
        return np.array(kept).reshape(-1, self.theta.size)


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
    """Tests of one specimen, each with its contact's offset [mm], with their measures under its law."""
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

    step_sd = test.step_mm / SQRT_12
    weighted_sd = spread([np.log(_weighted(one, weight)) for one in drawn])
    stored_sd = spread([np.log(max(one.stored_share, LEAST_SHARE)) for one in drawn])
    # value, and sd of its logarithm by the measurement and by the law
    rows = {
        "work": (test.work_N_mm, 0.0, 0.0),
        "weighted-force": (
            test.force_N * _weighted(found, weight),
            test.force_sd_N / test.force_N,
            weighted_sd,
        ),
        "stored-energy": (test.work_N_mm * max(found.stored_share, LEAST_SHARE), 0.0, stored_sd),
        "depth": (depth_mm, test.contact_sd_mm / depth_mm, 0.0),
    }
    measures = {}
    for name, (value, own_sd, law_sd) in rows.items():
        growth = found.growth[name]
        sd_ln = float(np.sqrt((growth * step_sd / depth_mm) ** 2 + own_sd**2 + law_sd**2))
        measures[name.replace("-", "_")] = Limit(value=value, sd_ln=sd_ln, growth=growth)
    slope = test.force_N * found.growth["weighted-force"] / depth_mm
    slowest_mm = SETTLED * test.speed_mm_s * float(law.model.times(law.theta).max(initial=0.0))
    return Failure(
        path=test.path,
        sheet=test.sheet,
        specimen=law.specimen,
        ruptured=test.ruptured,
        speed_mm_s=test.speed_mm_s,
        force_N=test.force_N,
        force_sd_N=float(np.hypot(test.force_sd_N, slope * step_sd)),
        depth_mm=depth_mm,
        depth_sd_mm=float(np.hypot(test.contact_sd_mm, step_sd)),
        work_N_mm=test.work_N_mm,
        work_sd_N_mm=test.work_N_mm * measures["work"].sd_ln,
        dynamic_share=found.dynamic_share,
        hardening=found.hardening,
        hardening_sd=spread([one.hardening for one in drawn]),
        # exponentials outside the convolution, after many v tau, as the sign test supposes
        settled=law.model.viscous and depth_mm >= slowest_mm,
        residual=test.residual,
        measures=Measures(**measures),
    )
