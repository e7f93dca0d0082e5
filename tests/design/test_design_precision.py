"""The path of an indentation and its predicted precision, against fits of recordings and closed forms."""

import sys
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from design_cases import (
    CASES,
    ETA,
    PAPER_A,
    TAU,
    TWO,
    Case,
    correlated,
    paper_a,
    recorded_logs,
    simulated_errors,
    two_branches,
)
from law_cases import LAWS, SPECTRUM, law_of

from tissueid.design.machine import PRESETS, Machine, Setting
from tissueid.design.precision import Chain, Indentation, information, ramp_of, relative_sd, seconds_of
from tissueid.model.channels import ChannelModel
from tissueid.selfcheck.truth import ProtocolLog, low_pass, recorded_force

MACHINE = PRESETS["paper-a"]


@pytest.mark.parametrize("acceleration", [20.0, 200.0, 5e4])
@pytest.mark.parametrize("speed", [10.0, 250.0, 500.0])
@pytest.mark.parametrize("depth", [0.05, 2.0, 8.0])
def test_the_ramp_keeps_speed_and_acceleration_and_ends_at_the_depth(acceleration, speed, depth):
    machine = replace(MACHINE, acceleration_mm_s2=acceleration)
    ramp = ramp_of(Indentation(speed, depth), machine)
    time = np.linspace(0.0, ramp.seconds, 20_001)
    x = ramp.depth(time)
    v = np.diff(x) / np.diff(time)
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(depth, rel=1e-9)
    assert ramp.depth(np.array([ramp.seconds + 5.0]))[0] == pytest.approx(depth, rel=1e-9)
    # differences of a parabola carry rounding errors of 1e-16 over steps of microseconds
    assert v.max() <= speed / 60.0 * (1.0 + 1e-6)
    assert v.min() >= -1e-9
    assert np.abs(np.diff(v)).max() <= acceleration * (time[1] - time[0]) * (1.0 + 1e-6) + 1e-7


def test_a_short_way_does_not_reach_the_speed_and_all_of_a_log_counts_as_machine_time():
    machine = replace(MACHINE, acceleration_mm_s2=10.0, standoff_mm=0.1)
    ramp = ramp_of(Indentation(500.0, 1.0), machine)
    # from rest over 1.1 mm and to rest again: the way is halved between them
    assert ramp.top_mm_s == pytest.approx(np.sqrt(10.0 * 1.1), rel=1e-9)
    machine = replace(MACHINE, acceleration_mm_s2=1e9, standoff_mm=2.0, return_speed_mm_min=300.0)
    seconds = seconds_of(Indentation(120.0, 4.0, 30.0), machine)
    # 2 mm and 4 mm at 2 mm/s, 30 s, 6 mm at 5 mm/s
    assert seconds == pytest.approx(1.0 + 2.0 + 30.0 + 1.2, rel=1e-6)


pytestmark = pytest.mark.needs_jit

#: Shallower samples take no part in a fit.
GUARD_SD = 3.0
#: Runs of the slow test, and the band that simulated over predicted sd must keep: 5 % is one standard error.
SLOW_RUNS, SLOW_BAND = 200, (0.85, 1.15)
#: The same by default: one standard error is 14 %.
RUNS, BAND = 25, (0.55, 1.5)


def at_100_Hz() -> Case:
    case = paper_a()
    return replace(case, setting=case.machine.settings[1])


@pytest.mark.parametrize(
    "made",
    [correlated, *(pytest.param(made, marks=pytest.mark.slow) for made in (at_100_Hz, two_branches))],
    ids=lambda made: made.__name__,
)
def test_estimates_of_simulated_recordings_scatter_as_predicted(made):
    case = made()
    predicted, errors = case.predicted(), simulated_errors(case, RUNS)
    for name, sd in predicted.items():
        assert BAND[0] <= float(errors[name].std(ddof=1) / sd) <= BAND[1], name


@pytest.mark.slow
@pytest.mark.parametrize("made", CASES, ids=lambda made: made.__name__)
def test_estimates_scatter_as_predicted_over_many_runs(made):
    case = made()
    predicted, errors = case.predicted(), simulated_errors(case, SLOW_RUNS)
    found = {name: float(errors[name].std(ddof=1) / predicted[name]) for name in predicted}
    protocol = "; ".join(f"{count} x {test.words}" for test, count in case.protocol.items())
    lines = [
        f"\n{case.name}: {protocol}",
        f"  {case.setting.words}; {case.ledger.duration(case.protocol):.0f} s",
    ]
    lines += [
        f"  {name}: predicted sd {100 * predicted[name]:.3g} %, simulated / predicted {ratio:.3f}, "
        f"mean error {errors[name].mean() / predicted[name]:+.2f} sd"
        for name, ratio in found.items()
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    for name, ratio in found.items():
        assert SLOW_BAND[0] <= ratio <= SLOW_BAND[1], name


def published(rate_Hz: float) -> tuple[float, float]:
    """sd of tau and eta [%] for paper A's 30 logs at 1 N of white noise, one static curve, contact known."""
    case = paper_a()
    machine = replace(case.machine, acceleration_mm_s2=1e7, contact_sd_mm=1e-9)
    asked = replace(case.asked, gain_sd=0.0, time_sd=0.0)
    case = replace(case, machine=machine, setting=Setting(rate_Hz, 1.0), asked=asked)
    found = case.predicted()
    return 100.0 * found[TAU], 100.0 * found[ETA]


def test_the_bounds_of_the_design_papers_come_out():
    # worked out there by two other programs: 1.24 and 0.10 % at 1 kHz for K constant
    assert published(1000.0) == pytest.approx((1.24, 0.10), rel=0.03)


def curves_moved(log: ProtocolLog, filter_s: float) -> np.ndarray:
    """Derivative of the force of PAPER_A by its contact point as plans have it: curves move, motion does not.

    A contact that lies deeper also begins later, which a log forgets within its first relaxation time.
    """
    static = PAPER_A.theta[0, :3]
    x = np.maximum(log.depth_mm, 0.0)
    slope = static[0] + 2.0 * static[1] * x + 3.0 * static[2] * x**2
    return -low_pass(log.time_s, slope, filter_s)


def slopes(
    force: Callable[[np.ndarray], np.ndarray], theta: np.ndarray, logarithms: Collection[int]
) -> list[np.ndarray]:
    """Central differences of a force by theta, of some by their logarithm."""
    columns = []
    for k, value in enumerate(theta):
        step = 1e-4 * value * np.eye(theta.size)[k]
        by_logarithm = (force(theta + step) - force(theta - step)) / 2e-4
        columns.append(by_logarithm if k in logarithms else by_logarithm / value)
    return columns


def fitted_force(
    model: ChannelModel, test: Indentation, machine: Machine, setting: Setting
) -> tuple[ProtocolLog, np.ndarray, Callable[..., np.ndarray]]:
    """A recorded log, the samples that a fit takes, and their force by theta and calibration."""
    (log,) = recorded_logs(test, machine, setting, 1, "log")
    fitted = log.depth_mm >= GUARD_SD * machine.contact_sd_mm

    def force(theta: np.ndarray, **calibration: float) -> np.ndarray:
        made = recorded_force(model, theta, log, gain=1.0, offset_mm=0.0, calibration=calibration)
        return np.asarray(made[fitted])

    return log, fitted, force


def numerical_information(setting: Setting, hold_s: float, *, gain_sd: float, time_sd: float) -> np.ndarray:
    """Information by differences of the simulated force, and the inverse of its covariance matrix."""
    test, machine = Indentation(250.0, 2.0, hold_s), PRESETS["paper-a"]
    model, theta = PAPER_A.model, PAPER_A.theta[0]
    log, fitted, recorded = fitted_force(model, test, machine, setting)
    force = partial(recorded, force_filter_s=setting.filter_s)
    z = np.column_stack(slopes(force, theta, model.shape_places))
    gain = force(theta)
    offset = curves_moved(log, setting.filter_s)[fitted]
    apart = np.abs(np.subtract.outer(np.arange(gain.size), np.arange(gain.size)))
    covariance = setting.noise_N**2 * setting.phi**apart
    covariance += gain_sd**2 * np.outer(gain, gain)
    slower = z[:, model.time_places].sum(axis=1)
    covariance += time_sd**2 * np.outer(slower, slower)
    covariance += machine.contact_sd_mm**2 * np.outer(offset, offset)
    return np.asarray(z.T @ np.linalg.solve(covariance, z))


@pytest.mark.parametrize(
    "setting",
    [Setting(200.0, 0.5), Setting(200.0, 0.5, noise_correlation_s=0.02), Setting(200.0, 0.5, filter_s=0.02)],
    ids=["white", "ar1", "filter"],
)
def test_information_is_that_of_the_whole_covariance_matrix(setting):
    chain = Chain(PRESETS["paper-a"], setting, 0.05, 0.03, total=False)
    # two holds in one pass, the second beyond the point from where its samples are all alike
    holds = [0.4, 1.2]
    found = information(PAPER_A.model, PAPER_A.theta[0], Indentation(250.0, 2.0), chain, holds)
    gradient = np.eye(PAPER_A.theta.shape[1])[:, None, :]
    for one, hold in zip(found, holds, strict=True):
        # a single log does not tell a cubic and K apart well: the data of a weak prior stand beside it
        prior = np.diag(1.0 / np.array([1.0, 0.5, 0.1, 30.0, 1.0]) ** 2)
        exact = relative_sd(
            numerical_information(setting, hold, gain_sd=0.05, time_sd=0.03) + prior, gradient
        )[:, 0]
        # the filter is followed on finer steps than the recording's, and not on the same
        assert relative_sd(one + prior, gradient)[:, 0] == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize(("name", "tissue"), [*LAWS.items(), SPECTRUM])
def test_information_of_any_law_is_that_of_its_simulated_forces(name, tissue):
    setting, test = Setting(200.0, 0.5), Indentation(250.0, 2.0, 3.0)
    machine = replace(PRESETS["paper-a"], contact_sd_mm=1e-4)
    model, theta = law_of(name), np.array(tissue)
    _, _, force = fitted_force(model, test, machine, setting)
    z = np.column_stack(slopes(force, theta, model.shape_places))

    found = information(model, theta, test, Chain(machine, setting, 0.0, 0.0, total=False), [test.hold_s])[0]

    exact, prior = z.T @ z / setting.noise_N**2, np.diag(4.0 / np.maximum(np.abs(theta), 0.1) ** 2)
    gradient = np.eye(theta.size)[:, None, :]
    wanted = relative_sd(exact + prior, gradient)[:, 0]
    # relaxations that are no exponentials are looked at ever more seldom along a hold
    assert relative_sd(found + prior, gradient)[:, 0] == pytest.approx(wanted, rel=0.01)


def test_a_long_hold_is_looked_at_ever_more_seldom_and_says_what_all_its_samples_say(monkeypatch):
    setting, test = Setting(100.0, 0.5), Indentation(250.0, 2.0, 200.0)
    machine, theta = replace(PRESETS["paper-a"], contact_sd_mm=1e-4), TWO.theta[0]
    _, _, force = fitted_force(TWO.model, test, machine, setting)
    z = np.column_stack(slopes(force, theta, TWO.model.shape_places))
    sizes, whole = [], ChannelModel.force
    monkeypatch.setattr(
        ChannelModel, "force", lambda self, of, path: sizes.append(path.time_s.size) or whole(self, of, path)
    )

    found = information(
        TWO.model, theta, test, Chain(machine, setting, 0.0, 0.0, total=False), [test.hold_s]
    )[0]

    assert max(sizes) < 0.1 * z.shape[0]
    prior, gradient = np.diag(4.0 / np.maximum(np.abs(theta), 0.1) ** 2), np.eye(theta.size)[:, None, :]
    wanted = relative_sd(z.T @ z / setting.noise_N**2 + prior, gradient)
    assert relative_sd(found + prior, gradient) == pytest.approx(wanted, rel=0.001)


#: Calibration nuisance -> its value, and the step of its numerical derivative.
NUISANCES = {
    "force_gain": (1.0, 1e-4),
    "displacement_gain": (1.0, 1e-4),
    "skew_s": (0.0, 2e-4),
    "force_filter_s": (0.01, 1e-4),
    "frame_compliance_mm_per_N": (0.0005, 1e-5),
}


def test_nuisances_of_the_instrument_act_as_in_a_recording():
    # little noise and next to no knowledge: what the data say is what is compared
    setting = Setting(400.0, 0.01, filter_s=0.01, filter_sd_s=0.1)
    frame = {"frame_stiffness_N_per_mm": 2000.0, "frame_stiffness_N_per_mm_sd": 2000.0}
    machine = replace(PRESETS["paper-a"], contact_sd_mm=0.01, skew_sd_s=0.1, **frame)
    chain = Chain(machine, setting, 0.0, 0.0, total=True)
    model, theta = PAPER_A.model, PAPER_A.theta[0]
    centre = {name: value for name, (value, _) in NUISANCES.items()}
    found, exact = np.zeros((10, 10)), np.zeros((10, 10))
    # together two speeds and two holds determine all ten
    for test in (Indentation(60.0, 3.0, 0.3), Indentation(400.0, 4.0, 0.6)):
        found += information(model, theta, test, chain, [test.hold_s])[0]
        log, fitted, force = fitted_force(model, test, machine, setting)
        columns = slopes(partial(force, **centre), theta, model.shape_places)
        for name, (value, step) in NUISANCES.items():
            above, below = (force(theta, **{**centre, name: value + sign * step}) for sign in (1.0, -1.0))
            columns.append((above - below) / (2.0 * step))
        offset = curves_moved(log, setting.filter_s)[fitted]
        z = np.column_stack(columns)
        covariance = setting.noise_N**2 * np.eye(offset.size) + 0.01**2 * np.outer(offset, offset)
        exact += z.T @ np.linalg.solve(covariance, z)
    prior = chain.prior(theta.size)
    gradient = np.eye(10)[:, None, :]
    sd, expected = (relative_sd(one + prior, gradient)[:, 0] for one in (found, exact))
    # the frame's own derivative is taken at the force that was recorded, which gives 5 % here
    assert sd == pytest.approx(expected, rel=0.08)


def test_a_filter_and_correlated_noise_cost_precision():
    base = paper_a()
    white = base.predicted()[TAU]
    slow = replace(base, setting=Setting(1000.0, 1.0, filter_s=0.05)).predicted()[TAU]
    total = replace(base, asked=replace(base.asked, total=True)).predicted()
    assert slow > 1.3 * white
    assert total[TAU] > white
    # the force channel's gain is known to 1 %, and no number of logs betters that
    assert total[ETA] > 0.01
