"""Cohorts with a known truth: places of specimens, normal stage-1 likelihoods, and specimens of the model."""

import numpy as np

from tissueid.inference.diagnostics import _effective_size
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.population.coordinates import Coordinates
from tissueid.population.members import Member, TrialRow
from tissueid.population.stage_one import Design, StageOne
from tissueid.result import Curve, ModelChoice

#: Typical tissue: paper A's order of magnitude, K constant, 8 mm.
TYPICAL = np.array([20.0, -1.2, 0.35, 63.62, 0.021])
COORDINATES = Coordinates(kelvin_voigt(1, 0, 8.0))
UNITS = {"length": "mm", "force": "N", "time": "s"}


def plain_design(count: int) -> Design:
    """No covariates and no levels."""
    return Design(np.ones((count, 1)), ("mean",), np.zeros((0, count), dtype=np.int64))


def lkj_factor(rng: np.random.Generator, size: int, shape: float) -> np.ndarray:
    """Cholesky factor of a correlation matrix drawn from the LKJ distribution (C-vine, row by row)."""
    low = np.zeros((size, size))
    for i in range(size):
        left = 1.0
        for j in range(i):
            b = shape + 0.5 * (size - 2 - j)
            w = 2.0 * rng.beta(b, b) - 1.0
            low[i, j] = w * np.sqrt(left)
            left *= 1.0 - w * w
        low[i, i] = np.sqrt(left)
    return low


def normal_stage(
    places: np.ndarray, own_sd: np.ndarray, rng: np.random.Generator, *, draws: int = 2000
) -> StageOne:
    """Stage-1 draws under a flat prior, from recordings that place each specimen with an error of its sd."""
    measured = places + own_sd * rng.standard_normal(places.shape)
    sd = np.broadcast_to(own_sd, places.shape)
    phi = tuple(y + s * rng.standard_normal((draws, y.size)) for y, s in zip(measured, sd, strict=True))
    size = places.shape[1]
    return StageOne(phi, tuple(np.zeros(draws) for _ in phi), np.zeros(size, bool), np.zeros(0, np.int64))


def monte_carlo_errors(draws: np.ndarray) -> np.ndarray:
    """Standard errors of mean and deviation of a number's draws (chains, draws), by Geyer's sequence."""
    squares = (draws - draws.mean()) ** 2
    mean = draws.std() / np.sqrt(_effective_size(draws))
    variance = squares.std() / np.sqrt(_effective_size(squares))
    return np.array([mean, variance / (2.0 * draws.std())])


def ramp(theta: np.ndarray, *, speed_mm_s: float = 4.0, gain: float = 1.0, sigma_N: float = 0.0) -> Curve:
    """A ramp to the common depth, sampled 200 times."""
    time = np.linspace(0.0, COORDINATES.depth_mm / speed_mm_s, 200)
    depth = speed_mm_s * time
    force = gain * COORDINATES.model.force(theta, ContactPath(time, depth))
    noise = sigma_N * np.random.default_rng(11).standard_normal(200)
    return Curve(time, depth, force + noise, force, np.ones(200, bool))


def members(
    count: int,
    *,
    seed: int = 0,
    between: float = 0.15,
    own: tuple[float, ...] = (0.01, 0.01, 0.01, 0.02, 0.2),
    repeats: int = 3,
    draws: int = 1000,
    common: float = 0.9,
) -> tuple[Member, ...]:
    """Specimens around the typical tissue; ``common`` is the correlation between logarithms of quantities."""
    rng = np.random.default_rng(seed)
    centre, ratios = COORDINATES.to_phi(TYPICAL)[0][0], np.linalg.inv(COORDINATES.logs).T
    made = []
    for i in range(count):
        shared = np.sqrt(common) * rng.standard_normal() + np.sqrt(1.0 - common) * rng.standard_normal(5)
        place = centre + between * (shared * np.ones(5)) @ ratios
        truth = COORDINATES.to_theta(place)[0]
        phi = place + np.array(own) * (rng.standard_normal(5) + rng.standard_normal((draws, 5))) @ ratios
        theta = COORDINATES.to_theta(phi)
        good = COORDINATES.passive(theta)
        gains = np.exp(0.03 * rng.standard_normal(repeats))
        rows = tuple(
            TrialRow(f"{i}-{k}.csv", None, float(gain), 4.0, 8.0, k + 1, None, ramp(truth, gain=float(gain)))
            for k, gain in enumerate(gains)
        )
        made.append(
            Member(
                specimen=f"head {i + 1}",
                model=ModelChoice("kelvin-voigt", 1, 3, 0, "partial"),
                depth_mm=8.0,
                draws=theta[good],
                # flat in phi
                log_prior=-COORDINATES.log_jacobian(phi[good]),
                covariates={"sex": "fm"[i % 2], "age_years": 60.0 + i, "donor": f"d{i // 2}"},
                trials=rows,
                speeds_mm_s=(4.0, 4.0),
                sigma_N=0.5,
                units=UNITS,
            )
        )
    return tuple(made)
