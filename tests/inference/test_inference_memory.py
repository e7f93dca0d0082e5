"""Correlation of residuals that is found under a fit: of white noise, with memory, and of both."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.inference.evidence import scan_memory
from tissueid.synth import Hold, Log, Move

STEP = 0.01
LOGS = tuple(Log(f"hold-{v:.0f}", (Move(4.0, v), Hold(8.0))) for v in (60.0, 240.0))


def scanned(model="auto", seed=1, logs=LOGS, **noise):
    ours = identified(handles_for(draw(small_recipe(logs=logs, **noise), seed)), noise="white")
    parts = ours.system.derivatives(ours.optimum.point, machine=False)
    return scan_memory(
        ours.system, ours.optimum.point, parts, ours.optimum.prior,
        step_s=STEP, rough_N=ours.optimum.noise.sigma_N, model=model,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_has_no_memory(seed):
    found = scanned(seed=seed, sigma_N=0.5)
    assert found.noise.memory.time_s == 0.0
    assert found.noise.sigma_N == pytest.approx(0.5, rel=0.1)
    assert found.gain < 5.0


@pytest.mark.parametrize("phi", [0.5, 0.9, 0.98])
def test_an_ar1_is_found_with_its_correlation_and_size(phi):
    found = [scanned(seed=seed, sigma_N=0.0, ar1_sigma_N=0.5, ar1_phi=phi) for seed in range(4)]
    # 2,000 samples: 20 independent ones at 0.98
    mean = np.mean([np.log(one.noise.memory.time_s) for one in found])
    assert mean == pytest.approx(np.log(-STEP / np.log(phi)), abs=0.3)
    assert np.mean([one.noise.sigma_N for one in found]) == pytest.approx(0.5, rel=0.25)
    assert all(one.noise.memory.white <= 0.3 for one in found)
    # of a memory shorter than most blocks only the shortest ones tell
    assert all(one.gain > (5.0 if phi == 0.5 else 20.0) for one in found)


def test_white_noise_beside_an_ar1_is_told_apart():
    found = scanned(sigma_N=0.4, ar1_sigma_N=0.3, ar1_phi=0.95)
    assert found.noise.memory.white == pytest.approx(0.64, abs=0.2)
    assert found.noise.memory.phi(STEP) == pytest.approx(0.95, abs=0.04)
    assert found.noise.sigma_N == pytest.approx(0.5, rel=0.15)


def test_what_is_asked_for_is_what_is_looked_for():
    noise = {"sigma_N": 0.0, "ar1_sigma_N": 0.5, "ar1_phi": 0.9}
    assert scanned("white", **noise).noise.memory.time_s == 0.0
    assert scanned("ar1", sigma_N=0.5).noise.memory.white == 0.0
    assert scanned("ar1", sigma_N=0.5).noise.memory.time_s > 0.0


def test_samples_in_blocks_show_the_same_memory_as_all_of_them():
    """Blocks keep means; the memory of their samples is read off these."""
    noise = {"sigma_N": 0.0, "ar1_sigma_N": 0.5, "ar1_phi": 0.9}
    short = tuple(Log(f"a-{k}", (Move(4.0, 240.0), Hold(2.8))) for k in range(6))
    by_samples = [scanned(seed=seed, logs=short, **noise).noise for seed in range(3)]
    by_blocks = [scanned(seed=seed, **noise).noise for seed in range(3)]
    apart = np.mean([np.log(one.memory.time_s) for one in by_samples]) - np.mean(
        [np.log(one.memory.time_s) for one in by_blocks]
    )
    assert abs(apart) < 0.35
