"""Noise: whitening, correlation found under a fit, and what a recording shows of it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inference_cases import handles_of, identified, small_recipe, state_of
from scipy.signal import lfilter

from tissueid import FitOptions, IdentifyOptions, identify, read_trials
from tissueid.inference import evidence
from tissueid.inference.evidence import LogEvidence, _quiet
from tissueid.inference.noise import Memory, whitener
from tissueid.inference.optimum import Noise
from tissueid.inference.window import fitted_log
from tissueid.segment import segment
from tissueid.signal_noise import white_noise_sd
from tissueid.synth import Hold, Log, Move
from tissueid.trial import Trial

STEP = 0.01


def dense(count, first_s, step_s, chain, memory):
    """Covariance of block means of an AR(1) and white noise of unit variance together."""
    times = [t + h * np.arange(n) for t, h, n in zip(first_s, step_s, count, strict=True)]
    of = np.cumsum(chain)
    out = np.zeros((count.size, count.size))
    for i, one in enumerate(times):
        for j, other in enumerate(times):
            if of[i] != of[j]:
                continue
            apart = np.abs(one[:, None] - other)
            lasting = np.exp(-apart / memory.time_s) if memory.time_s > 0.0 else apart == 0
            out[i, j] = ((1.0 - memory.white) * lasting + memory.white * (apart == 0.0)).mean()
    return out


COUNT = np.array([3, 1, 4, 1, 5, 9, 2])
#: Samples of each block, a chain that starts, and a block that comes late.
CASES = {
    "samples": (np.ones(40, dtype=int), None, None),
    "alike": (np.full(12, 5), None, None),
    "growing": (np.array([1, 1, 2, 3, 1, 5, 8, 13, 40, 7, 1]), None, None),
    "gap": (COUNT, 3, None),
    "late": (COUNT, None, 4),
    "steps": (np.random.default_rng(2).integers(1, 9, 15), None, None),
}


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.parametrize(
    "memory", [Memory(), Memory(0.005), Memory(0.1), Memory(1.0), Memory(0.1, 0.3), Memory(1.0, 0.9)]
)
def test_determinant_and_quadratic_form_are_those_of_the_dense_covariance(case, memory):
    count, starts, late = CASES[case]
    rng, chain = np.random.default_rng(1), np.isin(np.arange(count.size), [0, starts or 0])
    step = np.full(count.size, STEP) * (rng.uniform(0.3, 3.0, count.size) if case == "steps" else 1.0)
    gap = step * (rng.uniform(1.0, 4.0, count.size) if case == "steps" else 1.0)
    if late is not None:
        gap[late] = 7.3 * STEP
    first = np.append(0.0, np.cumsum((count[:-1] - 1) * step[:-1] + gap[1:]))
    covariance = dense(count, first, step, chain, memory)
    columns = rng.standard_normal((count.size, 3))
    white = whitener(count.astype(float), step, gap, chain, memory)
    whitened = white(columns)
    assert white.log_det == pytest.approx(float(np.linalg.slogdet(covariance)[1]), abs=1e-9)
    expected = columns.T @ np.linalg.solve(covariance, columns)
    np.testing.assert_allclose(whitened.T @ whitened, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(white(columns[:, 0]), whitened[:, 0])


def test_noise_that_lasts_for_ever_divides_by_nothing() -> None:
    count, step = np.ones(6), np.full(6, 0.01)
    chain = np.array([True, False, False, False, False, False])

    white = whitener(count, step, step, chain, Memory(time_s=1e18, white=0.0))

    assert np.isfinite(white(np.arange(6.0)[:, None])).all()
    assert np.isfinite(white.log_det)


SLOW_STEP = 0.1


def autoregression(rng: np.random.Generator, count: int, phi: float, sigma: float) -> np.ndarray:
    fresh = rng.standard_normal(count) * sigma * np.sqrt(1.0 - phi * phi)
    return lfilter([1.0], [1.0, -phi], fresh, zi=[phi * sigma * rng.standard_normal()])[0]


def noise_of(residual: np.ndarray) -> Noise:
    """White, or an AR(1), by the likelihood of the samples."""
    count, best = residual.size, (-np.inf, Noise(float(residual.std())))
    for phi in (0.0, *np.linspace(0.05, 0.999, 60)):
        new = np.append(np.sqrt(1.0 - phi * phi) * residual[0], residual[1:] - phi * residual[:-1])
        variance = float(new @ new) / count
        value = -0.5 * count * np.log(variance) + 0.5 * np.log(1.0 - phi * phi)
        if value > best[0] + (5.0 if best[1].memory.time_s == 0.0 and phi > 0.0 else 0.0):
            memory = Memory(-SLOW_STEP / np.log(phi)) if phi > 0.0 else Memory()
            best = (value, Noise(float(np.sqrt(variance / (1.0 - phi * phi))), memory))
    return best[1]


def judged(
    residual: np.ndarray, quiet: slice | None, *, quantum: float = 0.0, alone: bool = False
) -> evidence.NoiseVerdict:
    count = residual.size
    time = SLOW_STEP * np.arange(count)
    stretches = () if quiet is None else (_quiet(time[quiet], residual[quiet], evidence.HOLD_DEGREE),)
    log = LogEvidence(stretches, white_noise_sd(time, residual), quantum, count)
    return evidence.verdict_on_noise(noise_of(residual), [log], step_s=SLOW_STEP, alone=alone)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.99])
def test_noise_with_any_memory_is_refuted_in_at_most_three_per_cent(phi: float) -> None:
    rng = np.random.default_rng(41)
    refuted = sum(judged(autoregression(rng, 300, phi, 0.2), slice(150, 300)).refuted for _ in range(33))
    assert refuted <= 1


@pytest.mark.parametrize("size", [0.02, 0.1, 1.0])
def test_a_smooth_miss_of_a_model_is_no_noise(size: float) -> None:
    # a ramp and the start of its hold are missed by far more than what the late hold shows
    rng, time = np.random.default_rng(5), SLOW_STEP * np.arange(150)
    for _ in range(20):
        miss = size * np.sin(2.0 * time) * np.exp(-((time - 3.0) ** 2))
        verdict = judged(miss + 0.001 * rng.standard_normal(150), slice(75, 150))
        assert verdict.refuted
        assert verdict.measured_N == pytest.approx(0.001, rel=0.5)


def test_noise_that_is_louder_in_the_ramp_is_told_by_its_size_and_digits_set_a_floor() -> None:
    rng = np.random.default_rng(6)
    residual = rng.standard_normal(400) * np.where(np.arange(400) < 200, 30.0, 0.1)
    assert judged(residual, slice(200, 400)).refuted
    line = np.linspace(0.0, 5.0, 300)
    residual = np.round(line + 0.02 * rng.standard_normal(300), 1) - line
    residual[150:] = 0.1 / 4.0
    assert not judged(residual, slice(150, 300), quantum=0.1).refuted


def test_one_log_without_a_quiet_stretch_does_not_bend_to_correlation() -> None:
    rng = np.random.default_rng(8)
    residual = autoregression(rng, 300, 0.95, 0.2)
    assert judged(residual, None, alone=True).refuted
    assert not judged(residual, None).refuted
    assert not judged(rng.standard_normal(300), None, alone=True).refuted


def test_the_restricted_likelihood_is_that_of_contrasts_under_a_dense_covariance() -> None:
    rng = np.random.default_rng(10)
    time, memory = SLOW_STEP * np.arange(40), Memory(0.4, 0.25)
    noise = rng.standard_normal(40)
    phi = np.exp(-SLOW_STEP / 0.4)
    lag = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    covariance = 0.75 * phi**lag + 0.25 * np.eye(40)
    slow = np.linalg.qr(np.vander(time, 4))[0]
    contrasts = np.linalg.qr(np.hstack([slow, rng.standard_normal((40, 36))]))[0][:, 4:]
    inner = contrasts.T @ covariance @ contrasts
    square, log_det = _quiet(time, noise, 3).restricted(memory)
    assert square == pytest.approx(float(noise @ contrasts @ np.linalg.solve(inner, contrasts.T @ noise)))
    assert log_det == pytest.approx(float(np.linalg.slogdet(inner)[1]))


LOGS = tuple(Log(f"hold-{v:.0f}", (Move(4.0, v), Hold(8.0))) for v in (60.0, 240.0))


def scanned(model="auto", seed=1, logs=LOGS, **noise):
    ours = identified(handles_of(small_recipe(logs=logs, **noise), seed), noise="white")
    parts = ours.system.derivatives(ours.optimum.point, machine=False)
    return evidence.scan_memory(
        ours.system, ours.optimum.point, parts, ours.optimum.prior,
        step_s=STEP, rough_N=ours.optimum.noise.sigma_N, model=model,
    )  # fmt: skip


@pytest.mark.parametrize("model", ["white", "auto"])
def test_noise_stays_where_priors_pull_logs_far_from_where_they_are(model):
    """A step takes more off the priors there than the residuals have; what is left of these is the noise."""
    recipe = small_recipe(logs=LOGS, sigma_N=0.5, cv_both=0.05)
    ours = identified(handles_of(recipe, 1), noise="white", pooling="scaled")
    best = ours.optimum
    own = best.point.own.copy()
    own[:, 0] += 0.2
    away = best.point.moved(best.point.shared, own)
    parts = ours.system.derivatives(away, machine=False)
    tight = replace(best.prior, own=1e8 * np.ones(own.shape))
    asked = {"step_s": STEP, "rough_N": best.noise.sigma_N, "model": model}
    found = evidence.scan_memory(ours.system, away, parts, tight, **asked)
    assert found.sigma_N > 0.1 * best.noise.sigma_N


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_has_no_memory(seed):
    found = scanned(seed=seed, sigma_N=0.5)
    assert found.memory.time_s == 0.0
    assert found.sigma_N == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("phi", [0.5, 0.9, 0.98])
def test_an_ar1_is_found_with_its_correlation_and_size(phi):
    found = [scanned(seed=seed, sigma_N=0.0, ar1_sigma_N=0.5, ar1_phi=phi) for seed in range(4)]
    # 2,000 samples: 20 independent ones at 0.98
    mean = np.mean([np.log(one.memory.time_s) for one in found])
    assert mean == pytest.approx(np.log(-STEP / np.log(phi)), abs=0.3)
    assert np.mean([one.sigma_N for one in found]) == pytest.approx(0.5, rel=0.25)
    assert all(one.memory.white <= 0.3 for one in found)


def test_white_noise_beside_an_ar1_is_told_apart():
    found = scanned(sigma_N=0.4, ar1_sigma_N=0.3, ar1_phi=0.95)
    assert found.memory.white == pytest.approx(0.64, abs=0.2)
    assert found.memory.phi(STEP) == pytest.approx(0.95, abs=0.04)
    assert found.sigma_N == pytest.approx(0.5, rel=0.15)


def test_what_is_asked_for_is_what_is_looked_for():
    noise = {"sigma_N": 0.0, "ar1_sigma_N": 0.5, "ar1_phi": 0.9}
    assert scanned("white", **noise).memory.time_s == 0.0
    assert scanned("ar1", sigma_N=0.5).memory.white == 0.0
    assert scanned("ar1", sigma_N=0.5).memory.time_s > 0.0


SPECIMENS = 200


@pytest.mark.slow
@pytest.mark.parametrize(("phi", "scatter"), [(0.0, 0.0), (0.9, 0.0), (0.99, 0.0), (0.9, 0.02), (0.9, 0.15)])
@pytest.mark.parametrize("logs", [1, 3])
def test_true_noise_is_refuted_in_at_most_three_per_cent(phi: float, scatter: float, logs: int) -> None:
    size = {"sigma_N": 0.0, "ar1_sigma_N": 0.2, "ar1_phi": phi} if phi else {"sigma_N": 0.2}
    recipe = small_recipe(**size, cv_both=scatter) if scatter else small_recipe(**size)
    refuted = 0
    for seed in range(SPECIMENS):
        handles = handles_of(recipe, 7_000 + seed)[-logs:]
        refuted += state_of(handles, machine=True).identified.discrepant
    sys.stdout.write(f"\nphi {phi}, scatter {scatter}, {logs} logs: {refuted} of {SPECIMENS} refuted\n")
    assert refuted <= 0.03 * SPECIMENS


@pytest.mark.slow
def test_one_branch_on_meat_misses_more_than_noise_in_nine_of_ten_sheets(shared_data: Path) -> None:
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    fit = FitOptions(branches=1, stiffness_degree=0)
    said = []
    for trial in read_trials(path):
        (found,) = identify([trial], options=IdentifyOptions(fit=fit)).specimens
        said.append(any(flag.code == "discrepancy" for flag in found.flags))
    sys.stdout.write(f"\none branch on {len(said)} sheets: {sum(said)} miss more than the noise\n")
    assert sum(said) >= 0.9 * len(said)


def test_the_corner_of_the_retract_is_no_noise_of_the_hold() -> None:
    sigma, time = 1e-4, np.arange(0.0, 40.0, 0.1)
    # the tool turns back between two samples
    depth = np.interp(time, [0.0, 5.0, 10.0, 30.04, 32.0, 40.0], [-1.0, -1.0, 3.0, 3.0, -1.0, -1.0])
    into, held = np.maximum(depth, 0.0), np.clip(time - 10.0, 0.0, None)
    force = into * (1.0 + 0.2 * np.exp(-held))
    force += sigma * np.random.default_rng(2).standard_normal(time.size)
    trial = Trial("cut", time, depth, force)
    segmentation = segment(trial)
    log = fitted_log(trial, segmentation)
    (stretch,) = evidence.log_evidence(trial, segmentation, log).quiet
    assert np.std(stretch.left_N) == pytest.approx(sigma, rel=0.2)
