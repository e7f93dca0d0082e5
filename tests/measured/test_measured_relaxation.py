"""The relaxation table against closed forms and curve_fit; exponentials as mixtures of a few."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

from tissueid.measured import relaxation
from tissueid.trial import Contact, Phase, Protocol, Segmentation, Trial

TIME = np.arange(1500) * 0.02


def decay(time, plateau, amplitudes, taus):
    return plateau + sum(a * np.exp(-time / tau) for a, tau in zip(amplitudes, taus, strict=True))


def fit_exponentials(time, force, count):
    """Relaxation times of the fit with so many exponentials, and its curve."""
    tau = relaxation.ExponentialSums.of(time, force).ladder(count)[-1]
    return tau, relaxation.curve_of(time, force, tau)


@pytest.mark.parametrize(
    ("amplitudes", "taus"),
    [
        ([5.0], [0.1]),
        ([5.0], [3.0]),
        ([4.0, 2.0], [0.2, 4.0]),
        pytest.param([3.0, 2.0, 1.5], [0.05, 0.6, 7.0], marks=pytest.mark.needs_jit),
    ],
)
def test_sums_of_exponentials_without_noise_are_recovered(amplitudes, taus):
    force = decay(TIME, 12.0, amplitudes, taus)
    found, model = fit_exponentials(TIME, force, len(taus))
    np.testing.assert_allclose(found, taus, rtol=1e-4)
    np.testing.assert_allclose(model, force, atol=1e-5 * sum(amplitudes))


def test_one_exponential_equals_curve_fit_on_noisy_data():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        tau = float(np.exp(rng.uniform(np.log(0.05), np.log(8.0))))
        force = decay(TIME, 20.0, [6.0], [tau]) + 0.1 * rng.normal(size=TIME.size)
        (found,), model = fit_exponentials(TIME, force, 1)

        def law(t, c, a, v):
            return c + a * np.exp(-t / v)

        best, _ = curve_fit(law, TIME, force, p0=[20.0, 6.0, tau], xtol=1e-14, ftol=1e-14)
        assert found == pytest.approx(best[2], rel=1e-5)
        ours, theirs = (float(((force - one) ** 2).sum()) for one in (model, law(TIME, *best)))
        assert ours == pytest.approx(theirs, rel=1e-9)


@pytest.mark.needs_jit
def test_two_and_three_exponentials_fit_no_worse_than_curve_fit_from_the_truth():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        taus, amplitudes = [0.08, 0.9, 7.0], [4.0, 3.0, 3.0]
        for count in (2, 3):
            truth = (taus[-count:], amplitudes[-count:])
            force = decay(TIME, 20.0, truth[1], truth[0]) + 0.05 * rng.normal(size=TIME.size)
            _, model = fit_exponentials(TIME, force, count)

            def law(t, c, *rest, count=count):
                return decay(t, c, rest[:count], rest[count:])

            best, _ = curve_fit(law, TIME, force, p0=[20.0, *truth[1], *truth[0]], maxfev=20000)
            assert ((force - model) ** 2).sum() <= ((force - law(TIME, *best)) ** 2).sum() * (1 + 1e-8)


def test_irregular_sampling_changes_nothing():
    rng = np.random.default_rng(1)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.005, 0.02, size=800))])
    (found,), _ = fit_exponentials(time, decay(time, 3.0, [2.0], [0.7]), 1)
    assert found == pytest.approx(0.7, rel=1e-5)


def test_a_force_that_does_not_relax_has_no_relaxation_time():
    rising = 5.0 + 0.1 * TIME
    found, model = fit_exponentials(TIME, rising, 1)
    assert found.size == 0
    np.testing.assert_allclose(model, rising.mean())


def test_fewer_exponentials_are_returned_than_asked_for_where_fewer_are_there():
    found, _ = fit_exponentials(TIME, decay(TIME, 12.0, [5.0], [1.0]), 2)
    assert found.size in (1, 2)
    assert np.abs(np.log(found)).min() <= 1e-3


def hold_trial(force_of_hold, *, step=0.05, ramp_s=1.0, hold_s=30.0, sigma=0.0, seed=0):
    """Ramp of the given time with a straight rise, then the hold's force from its corner on."""
    corner = round(ramp_s / step)
    time = np.arange(corner + round(hold_s / step) + 1) * step
    depth = np.minimum(time / ramp_s, 1.0) * 4.0
    held = force_of_hold(np.maximum(time - ramp_s, 0.0))
    force = np.where(time < ramp_s, force_of_hold(0.0) * time / ramp_s, held)
    force = force + sigma * np.random.default_rng(seed).normal(size=time.size)
    return Trial("s", time, depth, force, Protocol(speed_mm_s=4.0 / ramp_s, depth_mm=4.0, hold_s=hold_s))


def true_segmentation(trial, *, noise_N=0.0):
    """Contact at the first sample, the corner at 1 s."""
    time, n = trial.time_s, trial.time_s.size
    corner = int(np.searchsorted(time, trial.protocol.depth_mm / trial.protocol.speed_mm_s - 1e-9))
    at, end = float(time[corner]), float(time[-1])
    ramp = Phase("ramp", 0, corner + 1, float(time[0]), at, trial.protocol.speed_mm_s)
    phases = (ramp, Phase("hold", corner, n, at, end, 0.0))
    return Segmentation(1, 1, Contact(0, 0.0, 1e-4), phases, noise_N)


#: One relaxation of 10 N in 2 s down to 20 N.
PLAIN = hold_trial(lambda t: decay(t, 20.0, [10.0], [2.0]))


def row_of(amplitudes, taus, *, noise_N=0.0, **made):
    """The one row of a hold that relaxes to 20 N, and its flags."""
    trial = hold_trial(lambda t: decay(t, 20.0, amplitudes, taus), **made)
    (row,) = relaxation.relaxation_rows(trial, true_segmentation(trial, noise_N=noise_N))
    return row, {flag.code: flag for flag in row.flags}


def test_window_runs_from_the_stop_to_the_end_of_the_hold():
    (row,) = relaxation.relaxation_rows(PLAIN, true_segmentation(PLAIN))
    assert row.window_s == pytest.approx((1.0, 31.0))
    assert row.peak_force_N == pytest.approx(30.0)
    assert row.tau_single_s == pytest.approx(2.0, rel=1e-5)
    assert row.nrmsd_single <= 1e-6
    assert row.path == PLAIN.source.path


def test_a_peak_before_the_stop_is_the_peak_and_not_in_the_window():
    early = replace(PLAIN, force_N=np.where(np.arange(PLAIN.time_s.size) == 19, 31.0, PLAIN.force_N))
    (row,) = relaxation.relaxation_rows(early, true_segmentation(early))
    assert row.window_s[0] == pytest.approx(1.0)
    assert row.tau_single_s == pytest.approx(2.0, rel=1e-5)
    assert row.peak_force_N == pytest.approx(31.0)


def test_forces_recorded_with_the_other_sign_and_a_baseline_give_the_same_row():
    (row,) = relaxation.relaxation_rows(PLAIN, true_segmentation(PLAIN))
    flipped = replace(PLAIN, displacement_mm=-PLAIN.displacement_mm, force_N=3.0 - PLAIN.force_N)
    phases = true_segmentation(PLAIN).phases
    segmentation = Segmentation(-1, -1, Contact(0, 0.0, 1e-4, baseline_N=3.0), phases, 0.0)
    (same,) = relaxation.relaxation_rows(flipped, segmentation)
    assert same.tau_single_s == pytest.approx(row.tau_single_s, rel=1e-9)
    assert same.peak_force_N == pytest.approx(row.peak_force_N)


@pytest.mark.parametrize(("sigma", "noise_N"), [(0.05, 0.05), (0.16, 0.08)])
def test_a_clean_single_exponential_has_no_flag_though_its_noise_was_underrated(sigma, noise_N):
    # one sample of 3,000 is nearly four sd off: a twentieth of the range, six times the stated noise
    assert row_of([10.0], [2.0], sigma=sigma, noise_N=noise_N)[1] == {}


def test_relaxation_longer_than_a_third_of_its_window_is_flagged_with_both():
    flag = row_of([10.0], [15.0])[1]["tau_exceeds_window"]
    assert flag.values["tau_s"] == pytest.approx(15.0, rel=1e-3)
    assert flag.values["window_length_s"] == pytest.approx(30.0)


def test_two_relaxations_make_one_inadequate_and_dependent_on_its_window():
    row, flags = row_of([6.0, 6.0], [0.3, 9.0])
    assert flags["one_tau_inadequate"].values["nrmsd_ratio"] > 2.0
    shift = flags["window_dependent"].values
    assert abs(shift["tau_half_window_s"] / shift["tau_s"] - 1.0) > 0.2
    np.testing.assert_allclose(row.tau_double_s, [0.3, 9.0], rtol=1e-3)


def test_relaxation_faster_than_sampling_is_flagged():
    assert row_of([10.0], [0.06])[1]["tau_below_resolution"].values["step_s"] == pytest.approx(0.05)


def test_no_hold_or_no_contact_no_row():
    time = np.arange(200) * 0.01
    trial = Trial("s", time, time * 2.0, time * 10.0, Protocol(speed_mm_s=2.0, depth_mm=3.98))
    assert relaxation.relaxation_rows(trial, true_segmentation(trial)) == ()
    segmentation = Segmentation(1, 1, None, true_segmentation(PLAIN).phases, 0.0)
    assert relaxation.relaxation_rows(PLAIN, segmentation) == ()


def test_every_hold_has_its_row():
    time = np.arange(401) * 0.05
    force = np.where(time < 1.0, 10.0 * time, 0.0)
    force[20:200] = decay(time[20:200] - 1.0, 6.0, [4.0], [1.0])
    force[200:220] = np.linspace(6.0, 24.0, 20)
    force[220:] = decay(time[220:] - 11.0, 15.0, [10.0], [2.0])
    depth = np.interp(time, [0.0, 1.0, 10.0, 11.0, 20.0], [0.0, 2.0, 2.0, 4.0, 4.0])
    trial = Trial("s", time, depth, force)
    phases = (
        Phase("ramp", 0, 21, 0.0, 1.0, 2.0),
        Phase("hold", 20, 201, 1.0, 10.0, 0.0),
        Phase("ramp", 200, 221, 10.0, 11.0, 2.0),
        Phase("hold", 220, 401, 11.0, 20.0, 0.0),
    )
    rows = relaxation.relaxation_rows(trial, Segmentation(1, 1, Contact(0, 0.0, 1e-4), phases, 0.0))
    assert len(rows) == 2
    assert rows[0].window_s == pytest.approx((1.0, 10.0), abs=0.051)
    assert rows[1].window_s == pytest.approx((11.0, 20.0), abs=0.051)
    assert rows[1].tau_single_s == pytest.approx(2.0, rel=1e-3)


def test_a_hold_of_a_few_samples_or_of_constant_force_has_no_row():
    trial = hold_trial(lambda t: decay(t, 20.0, [10.0], [2.0]), hold_s=0.25)
    assert relaxation.relaxation_rows(trial, true_segmentation(trial)) == ()


def bounds(step_s, length_s):
    """Range of ln tau that recordings of a step and a length are fitted in."""
    return np.log(step_s / relaxation.TAU_BELOW_STEP), np.log(length_s * relaxation.TAU_ABOVE_LENGTH)


def decays(basis, time_s, tau_s):
    """Exponentials as the basis mixes them: each times the mean over the step that it is averaged over."""
    return np.exp(-time_s[:, None] / tau_s) * basis.mean_over_step(tau_s)


@pytest.mark.parametrize(
    ("step_s", "length_s"), [(1e-3, 5.0), (1e-3, 48.0), (0.01, 50.0), (0.1, 500.0), (0.5, 4.0)]
)
def test_exponentials_of_any_relaxation_time_follow_from_the_nodes(step_s, length_s):
    basis = relaxation.kernel_basis(step_s=step_s, length_s=length_s)
    log_tau = np.linspace(*bounds(step_s, length_s), 61)
    time = np.concatenate([np.arange(0.0, length_s, max(step_s, length_s / 5000)), [length_s]])
    value, slope = (decays(basis, time, basis.tau_s) @ weights for weights in basis.weights(log_tau))
    # pivots are dropped below 1e-10
    np.testing.assert_allclose(value, decays(basis, time, np.exp(log_tau)), atol=1e-9)
    h = 1e-4
    changed = decays(basis, time, np.exp(log_tau + h)) - decays(basis, time, np.exp(log_tau - h))
    np.testing.assert_allclose(slope, changed / (2 * h), atol=1e-7)


def test_recordings_of_nearly_the_same_step_and_length_share_one_basis():
    first = relaxation.kernel_basis(step_s=0.0100, length_s=30.0)
    assert relaxation.kernel_basis(step_s=0.0101, length_s=30.2) is first
    assert relaxation.kernel_basis(step_s=0.02, length_s=30.0) is not first


def test_rounding_of_step_and_length_is_outwards():
    rng = np.random.default_rng(7)
    for _ in range(20):
        step = float(np.exp(rng.uniform(-8.0, 0.0)))
        length = step * float(np.exp(rng.uniform(1.0, 8.0)))
        found, wanted = relaxation.kernel_basis(step_s=step, length_s=length).log_bounds, bounds(step, length)
        assert found[0] <= wanted[0] + 1e-12
        assert found[1] >= wanted[1] - 1e-12


@pytest.mark.parametrize(
    ("step", "length"),
    [(0.0, 1.0), (-0.1, 1.0), (1.0, 1.0), (2.0, 1.0), (0.1, float("inf")), (float("nan"), 1.0)],
)
def test_step_and_length_out_of_order_are_refused_with_both_numbers(step, length):
    with pytest.raises(ValueError, match=r"0 < step < length.*step .* s and length"):
        relaxation.kernel_basis(step_s=step, length_s=length)
