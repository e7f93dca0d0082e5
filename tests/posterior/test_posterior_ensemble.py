"""The ensemble sampler: right draws, the same ones for a seed, and plain words where it fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from closed_form_targets import AtBound, Banana, Holed, LogSpread, Normal, Plain
from numpy.typing import NDArray
from scipy import stats

from tissueid.posterior.checkpoint import Checkpoint, discard
from tissueid.posterior.diagnostics import MonteCarloErrors, monte_carlo_errors
from tissueid.posterior.ensemble import EnsembleChain, sample_ensemble

FloatArray = NDArray[np.float64]

TARGETS = {
    "normal 1": lambda: Normal(1),
    "normal 3": lambda: Normal(3),
    "normal 5": lambda: Normal(5),
    "banana": Banana,
    "at a bound": AtBound,
    "ln of a spread": LogSpread,
}


def _errors(found: EnsembleChain) -> dict[str, MonteCarloErrors]:
    return monte_carlo_errors(dict(zip(found.names, found.points.transpose(2, 0, 1), strict=True)))


@pytest.mark.parametrize("name", TARGETS)
def test_moments_and_bounds_are_the_closed_form_within_four_standard_errors(name: str) -> None:
    target = TARGETS[name]()
    found = sample_ensemble(target, draws=4000, seed=42)
    assert found.converged, found.reason
    mean, sd = target.moments()
    draws = found.points.reshape(-1, len(target.mode))
    for k, errors in enumerate(_errors(found).values()):
        assert abs(draws[:, k].mean() - mean[k]) < 4.0 * errors.mean
        assert abs(draws[:, k].std() - sd[k]) < 4.0 * errors.sd
        assert abs(np.quantile(draws[:, k], 0.025) - target.quantile(k, 0.025)) < 4.0 * errors.q025
        assert abs(np.quantile(draws[:, k], 0.975) - target.quantile(k, 0.975)) < 4.0 * errors.q975


def test_regions_without_density_or_where_it_cannot_be_worked_out_are_left_out() -> None:
    target = Holed()
    found = sample_ensemble(target, draws=4000, seed=43)
    draws = found.points.reshape(-1, 2)
    assert np.hypot(draws[:, 0] - 1.5, draws[:, 1]).min() >= 1.0
    assert draws[:, 1].min() >= -3.0
    mean, sd = target.moments()
    errors = _errors(found)["x0"]
    assert abs(draws[:, 0].mean() - mean[0]) < 4.0 * errors.mean
    assert abs(draws[:, 0].std() - sd[0]) < 4.0 * errors.sd


def test_ranks_of_true_values_are_uniform_over_seeds() -> None:
    # truth and draws come from one normal: the rank of the truth among independent draws is uniform
    target, ranks = Normal(2), []
    truths = np.random.default_rng(44).multivariate_normal(target.mode, target.covariance, size=60)
    for seed, truth in enumerate(truths):
        found = sample_ensemble(target, draws=300, seed=seed)
        apart = found.points[:, :: max(1, int(3.0 * found.tau.max()))].reshape(-1, 2)
        ranks.append((apart < truth).mean(axis=0))
    assert stats.kstest(np.array(ranks)[:, 0], stats.uniform.cdf).pvalue > 1e-3
    assert stats.kstest(np.array(ranks)[:, 1], stats.uniform.cdf).pvalue > 1e-3


def test_density_of_each_draw_is_kept() -> None:
    target = Banana()
    found = sample_ensemble(target, draws=1000, seed=45)
    again = target.log_density(found.points.reshape(-1, 2)).reshape(found.log_density.shape)
    assert np.array_equal(found.log_density, again)


def test_the_same_seed_gives_the_same_draws_whatever_the_workers() -> None:
    class Batched(Normal):
        """Sums whose rounding depends on the size of the batch, as those of a linear algebra library may."""

        def log_density(self, points: FloatArray) -> FloatArray:
            return super().log_density(points) + 1e-13 * len(points)

    runs = [sample_ensemble(Batched(3), draws=2000, seed=46, workers=workers) for workers in (1, 2, 3)]
    other = sample_ensemble(Batched(3), draws=2000, seed=47)
    assert np.array_equal(runs[0].points, runs[1].points)
    assert np.array_equal(runs[0].points, runs[2].points)
    assert runs[0].report() == runs[2].report()
    assert not np.array_equal(runs[0].points[:, :10], other.points[:, :10])


class _StopError(Exception):
    """Instead of a kill."""


class _Interrupted(Normal):
    """Stops after so many batches."""

    def __init__(self, size: int, batches: int) -> None:
        super().__init__(size)
        self.left = batches

    def log_density(self, points: FloatArray) -> FloatArray:
        self.left -= 1
        if self.left < 0:
            raise _StopError
        return super().log_density(points)


@pytest.mark.parametrize("batches", [30, 280, 600])
def test_an_interrupted_chain_goes_on_to_the_same_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batches: int
) -> None:
    path = tmp_path / "chains" / "liver.npz"
    whole = sample_ensemble(Normal(3), draws=4000, seed=48)
    with monkeypatch.context() as every_step:
        every_step.setattr(Checkpoint, "due", property(lambda _: True))
        with pytest.raises(_StopError):
            sample_ensemble(_Interrupted(3, batches), draws=4000, seed=48, checkpoint=path, key="a")
    # the warm-up of 120 steps is too short to be worth a file
    assert path.exists() == (batches > 240)
    resumed = _Interrupted(3, 10_000)
    found = sample_ensemble(resumed, draws=4000, seed=48, checkpoint=path, key="a")
    assert np.array_equal(found.points, whole.points)
    assert np.array_equal(found.log_density, whole.log_density)
    assert found.report() == whole.report()
    assert found.remarks == ()
    # what had been sampled was not sampled again
    fresh = _Interrupted(3, 10_000)
    sample_ensemble(fresh, draws=4000, seed=48)
    assert (resumed.left > fresh.left) == (batches > 240)


def test_a_longer_kept_chain_serves_fewer_draws_as_a_fresh_run_would(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "liver.npz"
    # one write near the start makes it worth a last one
    monkeypatch.setattr(Checkpoint, "due", property(lambda kept: not kept.written))
    sample_ensemble(Normal(2), draws=3000, seed=49, checkpoint=path, key="a")
    fewer = sample_ensemble(Normal(2), draws=1500, seed=49, checkpoint=path, key="a")
    fresh = sample_ensemble(Normal(2), draws=1500, seed=49)
    assert np.array_equal(fewer.points, fresh.points)


@pytest.mark.parametrize("change", ["key", "seed", "coordinates", "optimum"])
def test_a_chain_of_another_run_is_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    path = tmp_path / "liver.npz"
    # one write near the start makes it worth a last one
    monkeypatch.setattr(Checkpoint, "due", property(lambda kept: not kept.written))
    sample_ensemble(Normal(2), draws=1000, seed=50, checkpoint=path, key="a")
    target = Normal(3 if change == "coordinates" else 2, 0.95 if change != "optimum" else 0.95 + 1e-12)
    seed, key = 51 if change == "seed" else 50, "b" if change == "key" else "a"
    found = sample_ensemble(target, draws=1000, seed=seed, checkpoint=path, key=key)
    assert np.array_equal(found.points, sample_ensemble(target, draws=1000, seed=seed).points)


def test_a_damaged_checkpoint_costs_only_time(tmp_path: Path) -> None:
    path = tmp_path / "liver.npz"
    path.write_bytes(b"PK\x03\x04 cut")
    found = sample_ensemble(Normal(2), draws=1000, seed=52, checkpoint=path)
    assert np.array_equal(found.points, sample_ensemble(Normal(2), draws=1000, seed=52).points)
    assert len(found.remarks) == 1
    assert "can't be read" in found.remarks[0]


def _saved_steps(path: Path) -> int:
    if not path.exists():
        return 0
    with np.load(path) as file:
        return len(file["points"])


def test_a_killed_process_loses_nothing_but_time(tmp_path: Path) -> None:
    path = tmp_path / "chains" / "liver.npz"
    script = Path(__file__).with_name("sampling_to_kill.py")
    process = subprocess.Popen([sys.executable, str(script), str(path)], env={**os.environ})
    try:
        until = time.monotonic() + 60.0
        while process.poll() is None and time.monotonic() < until and _saved_steps(path) < 100:
            time.sleep(0.05)
        assert process.poll() is None, "sampled to its end before it could be killed"
        process.send_signal(signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    saved = _saved_steps(path)
    found = sample_ensemble(Normal(3), draws=8_000, seed=41, checkpoint=path, key="kill")
    whole = sample_ensemble(Normal(3), draws=8_000, seed=41)
    assert 100 <= saved < whole.steps
    assert np.array_equal(found.points, whole.points)
    assert np.array_equal(found.log_density, whole.log_density)
    discard(path)
    assert list(tmp_path.iterdir()) == []


def test_a_chain_that_is_too_short_is_kept_and_says_what_it_lacks() -> None:
    found = sample_ensemble(Banana(2.0), draws=10_000, seed=53, max_steps=100)
    assert not found.converged
    assert found.steps == 100
    assert found.points.shape[0] == 32
    assert found.points.shape[1] >= 16
    assert found.reason.startswith("after 100 steps of 32 walkers: ")
    assert "of 10000 asked for" in found.reason
    report = found.report()
    assert (report.name, report.converged, report.detail["reason"]) == ("emcee", False, found.reason)
    assert report.draws == found.points.shape[0] * found.points.shape[1]


def test_an_absurdly_low_limit_still_gives_a_chain() -> None:
    found = sample_ensemble(Normal(2), draws=10_000, seed=54, max_steps=1)
    assert not found.converged
    assert np.isfinite(found.points).all()


def test_the_default_limit_has_room_for_slow_chains() -> None:
    found = sample_ensemble(Banana(2.0), draws=200, seed=55)
    assert found.converged or found.steps >= 200 * 100 / 32


def test_walkers_never_start_where_there_is_no_density() -> None:
    class Slit(Plain):
        """Far narrower than its Laplace covariance says."""

        def log_density(self, points: FloatArray) -> FloatArray:
            return np.where(np.abs(points[:, 0]) < 1e-3, 0.0, -np.inf)

    found = sample_ensemble(Slit(np.zeros(1), np.eye(1)), draws=1000, seed=56)
    assert found.converged, found.reason
    sd = 1e-3 / np.sqrt(3.0)
    assert found.points.std() == pytest.approx(sd, abs=4.0 * _errors(found)["x0"].sd)


def test_a_flat_direction_is_sampled_to_its_bounds() -> None:
    class Flat(Plain):
        """Uniform from -2 to 5 in x0, normal in x1; its Laplace covariance is as wide as rounding lets it."""

        def log_density(self, points: FloatArray) -> FloatArray:
            inside = (points[:, 0] > -2.0) & (points[:, 0] < 5.0)
            return np.where(inside, -0.5 * points[:, 1] ** 2, -np.inf)

    found = sample_ensemble(Flat(np.zeros(2), np.diag([1e12, 1.0])), draws=3000, seed=57)
    assert found.converged, found.reason
    low, high = np.quantile(found.points[:, :, 0], [0.025, 0.975])
    errors = _errors(found)["x0"]
    assert low == pytest.approx(-2.0 + 0.025 * 7.0, abs=4.0 * errors.q025)
    assert high == pytest.approx(5.0 - 0.025 * 7.0, abs=4.0 * errors.q975)


@pytest.mark.parametrize("kind", ["singular", "not a number", "negative"])
def test_a_laplace_covariance_that_is_none_is_no_obstacle(kind: str) -> None:
    target = Normal(2, correlation=0.5)
    target.covariance = {
        "singular": np.array([[1e-4, 1e-2], [1e-2, 1.0]]),
        "not a number": np.full((2, 2), np.nan),
        "negative": np.diag([-1e-4, 1.0]),
    }[kind]
    found = sample_ensemble(target, draws=1000, seed=58)
    assert found.converged, found.reason
    errors = _errors(found)
    for k, (mean, sd) in enumerate(zip(target.mode, (0.01, 1.0), strict=True)):
        assert found.points[:, :, k].mean() == pytest.approx(mean, abs=4.0 * errors[f"x{k}"].mean)
        assert found.points[:, :, k].std() == pytest.approx(sd, abs=4.0 * errors[f"x{k}"].sd)


def test_a_mode_without_density_around_it_is_refused() -> None:
    class Nowhere(Plain):
        """No density at all."""

        def log_density(self, points: FloatArray) -> FloatArray:
            return np.full(len(points), -np.inf)

    with pytest.raises(ValueError, match="no finite density near the mode"):
        sample_ensemble(Nowhere(np.zeros(2), np.eye(2)), draws=100, seed=59)


def test_progress_tells_effective_draws() -> None:
    told: list[tuple[int, int]] = []
    sample_ensemble(Normal(2), draws=2000, seed=60, progress=lambda done, of: told.append((done, of)))
    assert [of for _, of in told] == [2000] * len(told)
    assert 0 < told[0][0] < told[-1][0] == 2000


def test_the_ensemble_grows_with_the_coordinates() -> None:
    found = [sample_ensemble(Normal(size), draws=100, seed=61, max_steps=64) for size in (1, 4, 6)]
    assert [one.points.shape[0] for one in found] == [32, 32, 48]
