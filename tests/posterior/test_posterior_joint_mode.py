"""A posterior far from the optimum of the fit is linearised where it is, or there is none."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.lag_sums import LagSums, lag_sums
from tissueid.likelihood.linearise import Optimum, centre
from tissueid.likelihood.sums import LogData
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior import building
from tissueid.posterior.building import NotLinearError, specimen_target
from tissueid.posterior.joint_mode import joint_mode
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.remarks import not_linear
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors
from tissueid.uncertainty import MisfitAlarm, MisfitCheck

STEP, DEPTH, TAU, SIGMA, CONTACT = 0.02, 4.0, 0.25, 0.01, 0.15
STATIC, STIFFNESS = (0.4, -0.1, 0.05), (0.3, 0.5)
MODEL = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
TRUTH = np.array([*STATIC, *STIFFNESS, TAU])
BASIS = kernel_basis(step_s=STEP, length_s=12.0)


def recorded() -> LogData:
    """A ramp and a hold, its contact found 0.15 mm early."""
    time = np.arange(0.0, 10.0, STEP)
    depth = np.minimum(2.0 * time, DEPTH)
    force = force_of(TRUTH, CONTACT, time, depth)
    force += SIGMA * np.random.default_rng(20261130).standard_normal(time.size)
    include = depth > 2.0 * CONTACT
    return LogData(time, depth, force, include, np.zeros(time.size, dtype=np.int64))


def force_of(theta: np.ndarray, offset: float, time: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The model's own force: nothing is linear in the contact point."""
    static, _, tau = MODEL.split(theta)
    del static
    states = MODEL.states(tau, ContactPath(time, depth))
    x = depth - offset
    return MODEL.static_force(theta, x) + (MODEL.stiffness(theta, x) * states).sum(axis=0)


def at(theta: np.ndarray, offset: float) -> Optimum:
    return Optimum(
        theta=np.concatenate(
            [theta[:3] * DEPTH ** np.arange(1.0, 4.0), theta[3:5] * DEPTH ** np.arange(2.0)]
        ),
        log_tau=np.log(theta[5:]),
        gamma=np.zeros(1),
        delta=np.array([offset]),
        own=np.zeros((1, 4)),
        scale=DEPTH,
        degree=1,
    )


#: A fit that ended at the lower bound of the relaxation time, with a K twenty times too high.
FAR = at(np.array([0.6, -0.3, 0.09, 9.0, 2.0, STEP / 5.0]), 0.0)


def target_from(optimum: Optimum, log: LagSums, centred: Optimum) -> SpecimenTarget:
    facts = Facts(
        force_N=6.0,
        speed_mm_s=np.array([2.0]),
        depth_mm=np.array([DEPTH]),
        log_tau_bounds=(np.log(STEP / 5.0), np.log(100.0)),
        offset_sd_mm=np.array([0.4]),
        offset_mean_mm=np.zeros(1),
    )
    return specimen_target(
        [log],
        BASIS,
        optimum,
        centred=centred,
        facts=facts,
        priors=Priors(),
        pooling="shared",
        correlated=False,
        start=np.array([optimum.log_tau[0], np.log(SIGMA)]),
        start_sd=np.array([1.0, 0.05]),
    )


def sums_about(optimum: Optimum) -> LagSums:
    return lag_sums(recorded(), BASIS, degree=1, reference_step_s=STEP, center=centre(BASIS, 1, optimum, 0))


@pytest.mark.needs_jit
def test_draws_of_a_posterior_far_from_the_optimum_predict_the_recording() -> None:
    data, log = recorded(), sums_about(FAR)
    target = target_from(FAR, log, FAR)
    drawn = target.redraw(np.tile(target.mode, (40, 1)), np.random.default_rng(3))
    left = np.array(
        [
            (data.force_N - force_of(theta, offset[0], data.time_s, data.depth_mm))[data.include]
            for theta, offset in zip(drawn.theta, drawn.offset_mm, strict=True)
        ]
    )
    # the noise, and what 7 unknowns of 400 samples add; linear about the first optimum only: 5.7 sigma
    assert np.sqrt((left**2).mean()) <= 1.1 * SIGMA


@pytest.mark.needs_jit
def test_where_the_search_begins_does_not_matter() -> None:
    truth = at(TRUTH, CONTACT)
    near = target_from(truth, sums_about(truth), truth)
    far = target_from(FAR, sums_about(FAR), FAR)
    sd = np.sqrt(np.diag(near.covariance))
    # both stop within a tenth of a standard deviation of the noise
    assert np.abs((near.mode - far.mode) / sd).max() <= 0.3


@pytest.mark.needs_jit
def test_linear_force_departs_by_what_the_samples_say(monkeypatch: pytest.MonkeyPatch) -> None:
    # what is linearised about a point far off, once
    monkeypatch.setattr(building, "SAME_POINT", np.inf)
    log = sums_about(FAR)
    target = target_from(FAR, log, FAR)
    found = joint_mode(target, [log], BASIS)
    data, about, there = recorded(), target.optimum, found.optimum

    def force(optimum: Optimum, offset: float) -> np.ndarray:
        theta = np.concatenate(
            [
                optimum.theta[:3] / DEPTH ** np.arange(1.0, 4.0),
                optimum.theta[3:] / DEPTH ** np.arange(2.0),
                np.exp(optimum.log_tau),
            ]
        )
        return force_of(theta, offset, data.time_s, data.depth_mm)[data.include]

    offset, small = float(about.delta[0]), 1e-5
    slope = (force(about, offset + small) - force(about, offset - small)) / (2.0 * small)
    assert found.departure > 10.0
    change = float(there.delta[0]) - offset
    linear = force(there, offset) + change * slope
    off = force(there, float(there.delta[0])) - linear
    expected = np.sqrt((off**2).sum()) / np.exp(target.mode[1])
    # states stand between nodes to 1e-4 of the force
    assert found.departure == pytest.approx(expected, rel=0.01)


@pytest.mark.needs_jit
def test_a_mode_that_is_not_reached_is_no_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, "ROUNDS", 1)
    with pytest.raises(NotLinearError, match="standard deviations of the noise away"):
        target_from(FAR, sums_about(FAR), FAR)


def test_what_is_said_without_a_posterior_keeps_the_alarm() -> None:
    check = MisfitCheck("early hold", 9.0, 1e-4, "early in holds the force is off", raised=True)
    flags = not_linear(NotLinearError("too far"), MisfitAlarm(raised=True, checks=(check,)))
    assert [flag.code for flag in flags] == ["sampler_not_converged", "misfit"]
    assert flags[0].values["reason"] == "too far"
    assert [flag.code for flag in not_linear(NotLinearError("x"), MisfitAlarm(raised=False))] == [
        "sampler_not_converged"
    ]
