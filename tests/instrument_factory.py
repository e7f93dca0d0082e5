"""Specimens recorded through an instrument with a delay, a filter, a frame that gives, and wrong gains.

The simulation knows nothing of knots: a frame's deflection is solved sample by sample on a grid ten times
finer than the recording, the force is filtered and delayed there, and then sampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tissueid.likelihood.knots import KnotSums, knot_sums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import LogData
from tissueid.model.kelvin_voigt import KelvinVoigt, constant_speed_force
from tissueid.posterior.calibration import NUISANCES, TotalPosterior, total_posterior
from tissueid.posterior.instrument import INSTRUMENT_NAMES
from tissueid.posterior.instrument_mode import instrument_mode
from tissueid.posterior.linear_priors import Facts
from tissueid.priors import CalibrationPrior, Priors, SpreadPrior

FloatArray = NDArray[np.float64]

SPEEDS = np.array([10.0, 70.0, 100.0, 150.0, 250.0, 500.0]) / 60.0
HOLD_SPEED = 250.0 / 60.0
HOLD_DEPTHS = (2.0, 4.0, 6.0, 8.0)
DEPTH = 8.0
FINER = 10
PERFECT = dict(zip(NUISANCES, (1.0, 1.0, 0.0, 0.0, 0.0), strict=True))
#: Proper priors of the tissue from which truths are drawn, and which the posterior is given.
TISSUE = Priors(
    linear={
        "static_1_N_per_mm": (20.0, 2.0),
        "static_2_N_per_mm2": (-1.2, 0.15),
        "static_3_N_per_mm3": (0.35, 0.04),
        "stiffness_0_N_per_mm": (63.6, 8.0),
        "stiffness_1_N_per_mm2": (10.0, 2.0),
    },
    relaxation_time_s=(SpreadPrior(0.021, 0.3),),
)


@nb.njit(cache=False, error_model="numpy")
def _behind_frame(time_s, x_mm, static, stiffness, tau, compliance, offset):
    """Force of a tissue behind a frame, by Newton's method at every sample."""
    n = time_s.size
    force = np.zeros(n)
    state = 0.0
    w = 0.0
    for i in range(n):
        h = time_s[i] - time_s[i - 1] if i else 0.0
        keep = np.exp(-h / tau)
        gain = (1.0 - keep) * tau / h if h > 0.0 else 0.0
        f = force[i - 1] if i else 0.0
        for _ in range(60):
            z = x_mm[i] - compliance * f - offset
            moved = keep * state + gain * (x_mm[i] - compliance * f - w)
            k = stiffness[0] + z * stiffness[1]
            law = z * (static[0] + z * (static[1] + z * static[2])) + k * moved
            slope = static[0] + z * (2.0 * static[1] + 3.0 * z * static[2]) + k
            step = (law - f) / (1.0 + compliance * slope)
            f += step
            if abs(step) < 1e-12:
                break
        here = x_mm[i] - compliance * f
        state = keep * state + gain * (here - w)
        w = here
        force[i] = f
    return force


@dataclass(frozen=True)
class Case:
    """How a specimen is recorded."""

    rate_Hz: float = 100.0
    hold_s: float = 5.0
    repeats: int = 1
    sigma_N: float = 1.0
    phi: float = 0.0
    gain_sd: float = 0.02
    offset_sd_mm: float = 0.02
    priors: Priors = TISSUE

    @property
    def program(self) -> list[tuple[float, float, float]]:
        """Speed, depth and hold of every log."""
        ramps = [(float(v), DEPTH, 0.0) for v in SPEEDS]
        return (ramps + [(HOLD_SPEED, d, self.hold_s) for d in HOLD_DEPTHS]) * self.repeats

    @property
    def facts(self) -> Facts:
        program = np.array(self.program)
        logs = len(program)
        return Facts(
            force_N=230.0,
            speed_mm_s=program[:, 0],
            depth_mm=program[:, 1],
            log_tau_bounds=(float(np.log(0.2 / self.rate_Hz)), float(np.log(480.0))),
            offset_sd_mm=np.full(logs, self.offset_sd_mm),
            offset_mean_mm=np.zeros(logs),
        )


@dataclass(frozen=True)
class Specimen:
    """Recordings and what is true of them."""

    case: Case
    logs: list[LogData]
    theta: FloatArray
    instrument: Mapping[str, float] = field(default_factory=dict)


def drawn_theta(priors: Priors, rng: np.random.Generator) -> FloatArray:
    """A passive tissue from its priors: static (3), stiffness (2), relaxation time."""
    model = KelvinVoigt(1, 1, DEPTH)
    time = priors.relaxation_time_s[0]
    while True:
        linear = [mean + sd * rng.standard_normal() for mean, sd in priors.linear.values()]
        theta = np.array([*linear, time.median * np.exp(time.sd_ln * rng.standard_normal())])
        if model.is_passive(theta):
            return theta


def drawn_instrument(priors: Priors, rng: np.random.Generator) -> dict[str, float]:
    """Calibration defects from their priors."""
    out = {}
    for name in NUISANCES:
        prior = priors.calibration[name]
        value = prior.mean + prior.sd * rng.standard_normal()
        while value < prior.lower:
            value = prior.mean + prior.sd * rng.standard_normal()
        out[name] = float(value)
    return out


def recorded(
    case: Case, theta: FloatArray, instrument: Mapping[str, float], rng: np.random.Generator
) -> Specimen:
    """A specimen's logs; ``theta`` = (a1, a2, a3, b0, b1, tau) is true of true depths and forces."""
    said = {**PERFECT, **instrument}
    logs = []
    for speed, depth, hold in case.program:
        gain = np.exp(case.gain_sd * rng.standard_normal())
        offset = case.offset_sd_mm * rng.standard_normal()
        time = np.arange(int((depth / speed + hold) * case.rate_Hz) + 1) / case.rate_Hz
        fine = np.arange(-FINER * case.rate_Hz // 10, FINER * (time.size + case.rate_Hz // 10)) / (
            FINER * case.rate_Hz
        )
        # the crosshead goes on where there is no hold: what it did later is not recorded
        x = np.minimum(speed * fine, depth if hold > 0.0 else np.inf)
        force = np.zeros(fine.size)
        after = fine >= 0.0
        force[after] = _behind_frame(
            fine[after], x[after], gain * theta[:3], gain * theta[3:5], theta[5],
            said["frame_compliance_mm_per_N"], offset,
        )  # fmt: skip
        if said["force_filter_s"] > 0.0:
            ratio = 1.0 / (FINER * case.rate_Hz * said["force_filter_s"])
            rise = np.diff(force, prepend=force[0])
            force = force - lfilter([-np.expm1(-ratio) / ratio], [1.0, -np.exp(-ratio)], rise)
        shown = said["force_gain"] * np.interp(time - said["skew_s"], fine, force)
        noise = rng.standard_normal(time.size)
        noise[1:] *= np.sqrt(1.0 - case.phi**2)
        shown += case.sigma_N * lfilter([1.0], [1.0, -case.phi], noise)
        depth_shown = said["displacement_gain"] * np.minimum(speed * time, depth)
        include = depth_shown >= 3.0 * case.offset_sd_mm
        logs.append(LogData(time, depth_shown, shown, include, np.zeros(time.size, dtype=np.int64)))
    return Specimen(case, logs, theta, said)


def every_sample(logs: list[LogData], optimum: Optimum, effects: tuple[str, ...]):
    """The samples themselves as knots: the model on them is the direct one."""
    plain = [
        KnotSums(log.time_s, log.depth_mm, np.zeros(log.time_s.size), np.ones((log.time_s.size, 1)), 0.0, 0)
        for log in logs
    ]
    return packed(plain, optimum, effects)


def knots_about(specimen: Specimen, optimum: Optimum, effects: tuple[str, ...]) -> list[KnotSums]:
    """Sums of the residuals of an optimum."""
    case = specimen.case
    direct = every_sample(specimen.logs, optimum, effects)
    force = np.split(direct.base, direct.first[1:-1])
    return [
        knot_sums(log, log.force_N - one, phi=case.phi, reference_step_s=1.0 / case.rate_Hz)
        for log, one in zip(specimen.logs, force, strict=True)
    ]


def rigid_fit(
    specimen: Specimen, effects: tuple[str, ...] = ("gain", "offset")
) -> tuple[Optimum, list[KnotSums]]:
    """The best fit that knows of no instrument, and sums about it; started from the priors' means."""
    case = specimen.case
    logs = len(specimen.logs)
    means = np.array([mean for mean, _ in case.priors.linear.values()])
    optimum = Optimum(
        theta=means * DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0]),
        log_tau=np.log([case.priors.relaxation_time_s[0].median]),
        gamma=np.zeros(logs),
        delta=np.zeros(logs),
        own=np.zeros((logs, 4)),
        scale=DEPTH,
        degree=1,
    )
    perfect = {name: CalibrationPrior(0.0, 0.0) for name in INSTRUMENT_NAMES}
    for _ in range(3):
        knots = knots_about(specimen, optimum, effects)
        found = instrument_mode(
            packed(knots, optimum, effects), optimum, case.facts, KelvinVoigt(1, 1, DEPTH),
            Priors(calibration=perfect), effects, count=sum(one.count for one in knots), gain_sd=case.gain_sd,
        )  # fmt: skip
        optimum = replace(
            optimum, theta=found.theta, log_tau=found.mode[:1].copy(), gamma=found.data.gamma,
            delta=found.data.delta,
        )  # fmt: skip
    return optimum, knots_about(specimen, optimum, effects)


def total_of(specimen: Specimen, seed: int, draws: int = 2_000) -> TotalPosterior:
    """Fit a specimen and draw its total posterior."""
    effects = ("gain", "offset")
    optimum, knots = rigid_fit(specimen, effects)
    return total_posterior(
        knots, optimum, specimen.case.facts, KelvinVoigt(1, 1, DEPTH), specimen.case.priors,
        effects=effects, gain_sd=float(optimum.gamma.std(ddof=1)), seed=seed, draws=draws,
    )  # fmt: skip


#: Depths [mm] and speeds [mm/s] at which the force is asked for.
FORCES = ((2.0, 10.0 / 60.0), (4.0, 150.0 / 60.0), (8.0, 500.0 / 60.0))
QUANTITIES = (
    "a1", "a2", "a3", "b0", "b1", "tau", "eta", "force 2 mm", "force 4 mm", "force 8 mm",
)  # fmt: skip


def quantities(theta: FloatArray) -> FloatArray:
    """What is judged, shape (n, 10), of draws of shape (n, 6)."""
    theta = np.atleast_2d(theta)
    model = KelvinVoigt(1, 1, DEPTH)
    eta = (theta[:, 3] + 0.5 * DEPTH * theta[:, 4]) * theta[:, 5]
    force = np.array(
        [
            [float(constant_speed_force(model, one, np.array([x]), speed_mm_s=v)[0]) for x, v in FORCES]
            for one in theta
        ]
    )
    return np.column_stack([theta, eta, force])


def covered(draws: FloatArray, truth: FloatArray) -> NDArray[np.bool_]:
    """Whether central 95 % intervals hold the truth."""
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return (low <= truth) & (truth <= high)
