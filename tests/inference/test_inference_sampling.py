"""Chains and proposals against known densities, Pareto smoothing, diagnostics, and runs that are killed."""

from collections.abc import Callable

import numpy as np
import pytest
from arviz_stats.base.array import array_stats
from inference_cases import handles_of, identified, small_recipe

from tissueid.inference import sampling
from tissueid.inference.diagnostics import WORST_R_HAT, diagnose
from tissueid.inference.proposal import CHAINS, WIDER, _share, _truncated, cut_normal, learn_mixture
from tissueid.inference.sampling import STEPS, WALKERS, Checkpoint, sample, smoothed
from tissueid.inference.target import SpecimenTarget


class Density:
    """A density with a wall far away; the normal beside it is the standard one."""

    is_normal = False

    def __init__(self, size: int, log_density: Callable[[np.ndarray], np.ndarray]) -> None:
        self.size, self._log = size, log_density
        self.centre = np.zeros(size)
        self.rows, self.walls = np.eye(size)[:1], np.array([-50.0])
        self.likely = np.empty(0, dtype=np.int64)
        self.calls = 0

    def densities(self, z: np.ndarray) -> np.ndarray:
        self.calls += 1
        return self._log(z)

    walked = densities

    def bent(self, z: np.ndarray) -> np.ndarray:
        return z


MEAN = np.array([0.5, -0.3, 0.2, 0.0])
_ROOT = np.linalg.cholesky(
    np.array([[1.0, 0.8, 0.0, 0.1], [0.8, 1.5, 0.3, 0.0], [0.0, 0.3, 0.7, -0.4], [0.1, 0.0, -0.4, 1.2]])
)
COVARIANCE = _ROOT @ _ROOT.T


def correlated() -> Density:
    inverse = np.linalg.inv(_ROOT)
    return Density(4, lambda z: -0.5 * (((z - MEAN) @ inverse.T) ** 2).sum(axis=1))


def banana() -> Density:
    """Standard normal first coordinate; the second about its square less one, within 0.4."""
    return Density(2, lambda z: -0.5 * z[:, 0] ** 2 - 0.5 * ((z[:, 1] - z[:, 0] ** 2 + 1.0) / 0.4) ** 2)


DRAWS = 1_500


@pytest.fixture(autouse=True)
def _every_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "EVERY_S", 0.0)


def test_a_normal_has_its_moments_within_their_errors():
    found = sample(correlated(), draws=DRAWS, seed=1)
    assert found.converged
    assert (found.chain.shape, found.log_density.shape) == ((WALKERS, STEPS, 4), (WALKERS, STEPS))
    assert 0.2 < found.acceptance < 0.95
    draws = found.chain.reshape(-1, 4)
    sd = np.sqrt(np.diag(COVARIANCE))
    # 1,500 effective draws and more: four errors of a mean and of an sd
    assert (np.abs(draws.mean(axis=0) - MEAN) <= 4.0 * sd / np.sqrt(DRAWS)).all()
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4.0 / np.sqrt(2.0 * DRAWS))
    np.testing.assert_allclose(np.corrcoef(draws.T), COVARIANCE / sd / sd[:, None], atol=4.0 / np.sqrt(DRAWS))
    np.testing.assert_allclose(found.log_density, correlated().densities(draws).reshape(WALKERS, STEPS))


def test_a_banana_has_its_moments():
    """Far tails are reached late: spreads may lack a twentieth, where the normal at the top lacks a half."""
    x, y = np.vstack([sample(banana(), draws=DRAWS, seed=seed).chain.reshape(-1, 2) for seed in range(6)]).T
    assert x.mean() == pytest.approx(0.0, abs=0.08)
    assert x.std() == pytest.approx(1.0, abs=0.1)
    assert y.mean() == pytest.approx(0.0, abs=0.2)
    # the skewness of a chi square: quantiles of y = x^2 - 1 + 0.4 e, from a million draws
    rng = np.random.default_rng(0)
    many = rng.standard_normal(1_000_000) ** 2 - 1.0 + 0.4 * rng.standard_normal(1_000_000)
    found, expected = (np.quantile(one, [0.1, 0.5, 0.9]) for one in (y, many))
    np.testing.assert_allclose(found, expected, atol=0.25)


def test_a_seed_repeats_its_draws_another_does_not_and_progress_is_told():
    said = []
    first = sample(correlated(), draws=300, seed=3, progress=lambda *told: said.append(told))
    same, other = (sample(correlated(), draws=300, seed=seed) for seed in (3, 4))
    np.testing.assert_array_equal(first.chain, same.chain)
    assert not np.array_equal(first.chain, other.chain)
    assert said[-1][1] == 1.0
    # looks of importance sampling, then rounds of the walkers
    points = [points for points, _ in said]
    assert points[0] == 1_000
    assert points == sorted(points)
    assert points[-1] >= 1_000 + WALKERS * STEPS


def test_a_killed_run_goes_on_to_the_same_draws(tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "GOOD_TAILS", -np.inf)  # one look does not tell
    kept_in = {"checkpoint": tmp_path / "chains" / "liver.npz", "key": "liver"}

    def told(points, share):
        if points >= 3_000:
            raise KilledError

    with pytest.raises(KilledError):
        sample(correlated(), draws=4_000, seed=5, progress=told, **kept_in)
    resumed, again = correlated(), correlated()
    found = sample(resumed, draws=4_000, seed=5, **kept_in)
    whole = sample(again, draws=4_000, seed=5)
    np.testing.assert_array_equal(found.chain, whole.chain)
    np.testing.assert_array_equal(found.log_density, whole.log_density)
    # looks that were kept were not taken again
    assert resumed.calls <= again.calls - 2


def test_a_density_that_no_proposal_meets_is_refused():
    spike = Density(2, lambda z: np.where(np.abs(z[:, 0] - 3.0) < 1e-6, 0.0, -np.inf))
    with pytest.raises(ArithmeticError, match="none of 12000 proposals"):
        sample(spike, draws=300, seed=1)


def test_draws_of_a_thin_ridge_stay_on_it_and_are_no_convergence():
    """Proposals are worth next to nothing: walkers alone draw from the density, and say how far apart."""

    def off(z):
        return (z[:, 1::2] - z[:, ::2] ** 2) / 0.01

    ridge = Density(6, lambda z: -0.5 * (z[:, ::2] ** 2).sum(axis=1) - 0.5 * (off(z) ** 2).sum(axis=1))
    found = sample(ridge, draws=500, seed=1)
    assert off(found.chain.reshape(-1, 6)).std() == pytest.approx(1.0, abs=0.05)
    assert not found.converged
    assert "walkers apart by R-hat" in found.detail["reason"]


def test_too_few_draws_are_no_convergence_and_say_so(monkeypatch):
    monkeypatch.setattr(sampling, "MOST_LOOKS", 1)
    monkeypatch.setattr(sampling, "MORE_ROUNDS", 5)
    monkeypatch.setattr(sampling, "ENOUGH", 20_000.0)
    found = sample(correlated(), draws=50_000, seed=1)
    assert not found.converged
    assert "of 50000 effective draws" in found.detail["reason"]


@pytest.mark.parametrize("is_normal", [False, True])
def test_a_normal_is_walked_by_its_own_draws_and_its_medians_hardly_depend_on_the_seed(is_normal):
    """A Sobol sequence: 2,048 independent draws would differ by 0.04 standard deviations of a median."""
    target = Density(4, lambda z: -0.5 * (z**2).sum(axis=1))
    target.is_normal = is_normal
    chains = [sample(target, draws=2_000, seed=seed) for seed in (0, 1)]
    # nearly every draw is a new one: the least coordinate of 3,840 is worth most of them
    assert all(one.acceptance > 0.75 for one in chains)
    enough = 2_000 if is_normal else 0.5 * WALKERS * STEPS
    assert all(one.detail["effective_draws"] > enough for one in chains)
    apart = np.subtract(*(np.median(one.chain.reshape(-1, 4), axis=0) for one in chains))
    assert not is_normal or np.abs(apart).max() <= 0.015


class KilledError(Exception):
    pass


def kept(path, key="key", seed=31, count=7):
    rng = np.random.default_rng(seed)
    points, weights = rng.standard_normal((count, 3)), rng.standard_normal(count)
    Checkpoint(path, key).write(rng, points, weights)
    return rng, points, weights


def test_points_weights_and_generator_come_back_bit_for_bit(tmp_path):
    path = tmp_path / "liver.npz"
    rng, points, weights = kept(path)
    other = np.random.default_rng(1)
    found, log_weight = Checkpoint(path, "key").resume(other, 3)
    np.testing.assert_array_equal(found, points)
    np.testing.assert_array_equal(log_weight, weights)
    np.testing.assert_array_equal(other.standard_normal(5), rng.standard_normal(5))


@pytest.mark.parametrize(
    "how", ["another key", "another size", "cut", "empty", "noise", "objects", "missing", "other"]
)
def test_what_cannot_be_gone_on_from_is_left_aside(tmp_path, how):
    path = tmp_path / "liver.npz"
    kept(path)
    content = path.read_bytes()
    spoiled = {
        "cut": content[: len(content) // 2],
        "empty": b"",
        "noise": np.random.default_rng(32).bytes(5000),
    }
    if how in spoiled:
        path.write_bytes(spoiled[how])
    elif how == "objects":
        np.savez(path, key=np.array("key"), points=np.array([{"any": "object"}], dtype=object))
    elif how == "missing":
        path.unlink()
    elif how == "other":
        np.savez(path, points=np.zeros(3))
    rng, size = np.random.default_rng(8), 4 if how == "another size" else 3
    points, weights = Checkpoint(path, "other" if how == "another key" else "key").resume(rng, size)
    assert (points.shape, weights.size) == ((0, size), 0)
    np.testing.assert_array_equal(rng.standard_normal(3), np.random.default_rng(8).standard_normal(3))


def test_without_a_path_or_a_folder_that_can_be_written_nothing_is_kept_or_stopped(tmp_path):
    kept(None)
    assert list(tmp_path.iterdir()) == []
    assert Checkpoint(None, "key").resume(np.random.default_rng(1), 2)[0].shape == (0, 2)
    (tmp_path / "taken").write_text("a file where the folder should be")
    kept(tmp_path / "taken" / "liver.npz")
    assert (tmp_path / "taken").read_text() == "a file where the folder should be"


def test_a_write_is_due_once_an_interval(tmp_path, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(sampling, "EVERY_S", 1.0)
    monkeypatch.setattr(sampling.time, "monotonic", lambda: clock[0])
    path, rng = tmp_path / "liver.npz", np.random.default_rng(1)
    keeper = Checkpoint(path, "key")
    keeper.write(rng, np.zeros((1, 3)), np.zeros(1))
    assert not path.exists()
    clock[0] = 101.0
    keeper.write(rng, np.zeros((2, 3)), np.zeros(2))
    clock[0] = 101.5
    keeper.write(rng, np.zeros((3, 3)), np.zeros(3))
    assert len(Checkpoint(path, "key").resume(rng, 3)[0]) == 2


def test_equal_weights_are_worth_all_their_draws_and_none_outside():
    found = smoothed(np.full(500, 3.0))
    np.testing.assert_allclose(found.weights, 1.0 / 500)
    assert found.worth == pytest.approx(500.0)
    assert found.pareto < 0.0
    log_weight = np.where(np.arange(400) % 2, 0.0, -np.inf)
    found = smoothed(log_weight)
    assert (found.weights[::2] == 0.0).all()
    assert found.worth == pytest.approx(200.0)
    log_weight[40:] = -np.inf
    none = smoothed(log_weight)
    assert (none.worth, none.pareto) == (0.0, np.inf)


def test_a_proposal_that_is_wide_enough_gives_the_moments():
    z = 1.5 * np.random.default_rng(1).standard_normal(20_000)
    found = smoothed(-0.5 * z**2 + 0.5 * (z / 1.5) ** 2)
    # weights of a normal under one of sd s are bounded: E w^2 = s^2 / sqrt(2 s^2 - 1), worth 0.83
    assert found.worth / 20_000 == pytest.approx(np.sqrt(2.0 * 2.25 - 1.0) / 2.25, rel=0.02)
    assert found.pareto < 0.2
    assert found.weights.sum() == pytest.approx(1.0)
    assert float(found.weights @ z) == pytest.approx(0.0, abs=0.03)
    assert float(found.weights @ z**2) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("shape", [0.3, 0.7, 1.2])
def test_the_shape_of_a_pareto_tail_is_found(shape):
    # weights u^-k have a generalised Pareto tail of shape k
    found = [smoothed(-shape * np.log(np.random.default_rng(s).random(20_000))).pareto for s in range(12)]
    # 420 points of the tail, drawn towards 0.5 by ten
    assert np.mean(found) == pytest.approx(shape, abs=0.06)
    assert np.std(found) < 0.12


def test_a_single_giant_is_cut_down_to_its_tail():
    log_weight = np.append(0.3 * np.random.default_rng(3).standard_normal(1_000), 12.0)
    found = smoothed(log_weight)
    raw = np.exp(log_weight - log_weight.max())
    assert 1.0 / ((raw / raw.sum()) ** 2).sum() < 1.5
    assert found.pareto > 0.7
    # weights keep their order
    order = np.argsort(log_weight)
    assert (np.diff(found.weights[order]) >= -1e-15).all()


CORNERS = {
    "a wedge": (np.array([1.0, -2.0]), np.array([[1.0, 0.0], [-0.8, 0.6]]), np.array([0.0, -0.5])),
    "a slab": (np.array([0.3, 0.2]), np.array([[1.0, 1.0], [-1.0, -1.0]]), np.array([-0.4, -0.9])),
    "a corner": (np.array([-0.5, -0.5, 0.7]), np.eye(3), np.array([-0.2, 0.0, -1.0])),
    "a skewed cone": (
        np.array([0.2, -0.4, 0.1]),
        np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.2], [-1.0, 0.3, 1.0], [0.0, -1.0, 2.0]]),
        np.zeros(4),
    ),
}


@pytest.mark.parametrize("case", list(CORNERS))
@pytest.mark.parametrize("likely", [True, False])
def test_moments_are_those_of_plain_rejection(case, likely):
    centre, rows, least = CORNERS[case]
    chosen = np.arange(len(rows)) if likely else np.empty(0, dtype=np.int64)
    found = cut_normal(centre, rows, least, chosen, np.random.default_rng(5)).pool
    assert (found @ rows.T >= least - 1e-9).all()
    rng, expected = np.random.default_rng(99), np.empty((0, centre.size))
    while len(expected) < 6_000:
        z = centre + WIDER * rng.standard_normal((200_000, centre.size))
        expected = np.vstack([expected, z[(z @ rows.T >= least).all(axis=1)]])[:24_000]
    sd = expected.std(axis=0)
    # a thousand independent chains: four standard errors of a mean, of an sd and of a correlation
    assert (np.abs(found.mean(axis=0) - expected.mean(axis=0)) <= 4.0 * sd / np.sqrt(CHAINS)).all()
    assert found.std(axis=0) == pytest.approx(sd, rel=4.0 * 0.75 / np.sqrt(CHAINS))
    np.testing.assert_allclose(np.corrcoef(found.T), np.corrcoef(expected.T), atol=4.0 / np.sqrt(CHAINS))


def test_a_wall_far_in_the_tail_leaves_an_exponential():
    rng = np.random.default_rng(6)
    ends = np.full(4_000, 40.0)
    z = _truncated(np.zeros(4_000), 1.0, ends, np.full(4_000, np.inf), rng.random(4_000))
    assert (z >= 40.0).all()
    # beyond 40 sd the normal falls with rate 40
    assert (z - 40.0).mean() == pytest.approx(1.0 / 40.0, rel=0.08)


def test_the_density_is_that_of_the_draws():
    cut = cut_normal(*CORNERS["a slab"], np.arange(2), np.random.default_rng(7))
    a, b = np.array([[0.3, 0.2], [0.8, -0.1]])
    ratio = cut.log_density(a[None]) - cut.log_density(b[None])
    assert ratio[0] == pytest.approx(0.5 * ((b - [0.3, 0.2]) ** 2).sum() / WIDER**2)


def weighed(target, seed=1, count=6_000):
    rng = np.random.default_rng(seed)
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    mixture, efficiency = learn_mixture(target, cut, rng)
    z = mixture.draw(count, rng)
    return z, smoothed(target.densities(z) - mixture.log_density(z)), efficiency


def test_a_mixture_learns_a_banana():
    """In the median of ten: of one mixture luck with the tail decides."""
    rows = []
    for seed in range(10):
        z, found, efficiency = weighed(banana(), seed, 20_000)
        moments = [found.weights @ z[:, k] ** power for k in (0, 1) for power in (1, 2)]
        rows.append([efficiency, found.worth / len(z), found.pareto, *moments])
    efficiency, worth, pareto, *moments = np.median(rows, axis=0)
    # the normal at the top of it covers a fifth of its curvature
    assert efficiency > 0.7
    assert worth > 0.5
    assert pareto < 1.0
    # E y = 0, var y = 2 + 0.16
    np.testing.assert_allclose(moments[:3], [0.0, 1.0, 0.0], atol=0.12)
    assert moments[3] == pytest.approx(2.16, abs=0.5)


def test_a_density_that_misses_half_is_worth_little_once_the_other_half_is_known():
    rng = np.random.default_rng(4)
    z = np.concatenate([rng.standard_normal(4000) - 6.0, rng.standard_normal(4000) + 6.0])
    near, far = (-0.5 * (z - at) ** 2 - 0.5 * np.log(2.0 * np.pi) for at in (-6.0, 6.0))
    both = np.logaddexp(near, far) - np.log(2.0)
    assert _share(both, both, both) == pytest.approx(1.0)
    assert _share(both, near, both) < 1e-6
    # of what it alone has found it looks like the density
    assert _share(both[:4000], near[:4000], near[:4000]) == pytest.approx(1.0, abs=1e-3)


def test_a_mixture_of_a_normal_is_about_that_normal():
    z, found, efficiency = weighed(correlated())
    assert efficiency > 0.5
    mean = found.weights @ z
    covariance = (z - mean).T @ ((z - mean) * found.weights[:, None])
    np.testing.assert_allclose(mean, MEAN, atol=0.1)
    np.testing.assert_allclose(covariance, COVARIANCE, atol=0.15)


def test_the_density_of_a_mixture_is_normalised():
    target = banana()
    rng = np.random.default_rng(3)
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    mixture, _ = learn_mixture(target, cut, rng)
    edge = np.linspace(-40.0, 40.0, 401)
    grid = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    # six degrees of freedom leave 1e-5 beyond
    assert np.exp(mixture.log_density(grid)).sum() * 0.04 == pytest.approx(1.0, abs=2e-3)


def _autoregressive(phi: float, chains: int, draws: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.empty((chains, draws))
    out[:, 0] = rng.standard_normal(chains)
    for k in range(1, draws):
        out[:, k] = phi * out[:, k - 1] + np.sqrt(1.0 - phi**2) * rng.standard_normal(chains)
    return out


@pytest.mark.parametrize("rounded", [False, True], ids=["continuous", "with ties"])
def test_diagnostics_are_those_of_arviz_stats(rounded: bool) -> None:
    draws = _autoregressive(0.7, 12, 400, seed=1) ** 3
    if rounded:
        draws = np.round(4.0 * draws)
    found = diagnose({"x": draws})["x"]
    # one table of normal scores instead of one a call: the same operations, to rounding
    assert found.ess_bulk == pytest.approx(float(array_stats.ess(draws, method="bulk")), rel=1e-9)
    tail = float(array_stats.ess(draws, method="tail", prob=(0.05, 0.95)))
    assert found.ess_tail == pytest.approx(tail, rel=1e-9)
    assert found.r_hat == pytest.approx(float(array_stats.rhat(draws, method="rank")), rel=1e-9)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_an_autoregressive_chain_has_its_closed_form_effective_size(phi: float) -> None:
    draws = _autoregressive(phi, 16, 4000, seed=2)
    expected = draws.size * (1.0 - phi) / (1.0 + phi)
    # the estimate sums a few noisy lags: 10 % at 3,400 to 64,000 effective draws
    assert diagnose({"x": draws})["x"].ess_bulk == pytest.approx(expected, rel=0.1)


def test_walkers_that_disagree_are_told_by_r_hat() -> None:
    draws = _autoregressive(0.0, 8, 500, seed=3)
    draws[0] += 1.0
    wider = _autoregressive(0.0, 8, 500, seed=3)
    wider[0] *= 3.0
    found = diagnose({"shifted": draws, "wider": wider, "same": _autoregressive(0.0, 8, 500, seed=4)})
    assert found["shifted"].r_hat > 1.03
    assert found["wider"].r_hat > 1.03
    assert found["same"].r_hat < 1.01


def test_independent_draws_in_one_chain_are_diagnosed() -> None:
    draws = np.random.default_rng(5).standard_normal(4002)
    found = diagnose({"flat": draws, "row": draws[None], "short": draws[:100]})
    assert found["flat"] == found["row"]
    assert found["short"] == diagnose({"short": draws[:100]})["short"]
    assert found["flat"].ess_bulk == pytest.approx(4000, rel=0.1)
    assert found["flat"].r_hat < 1.01


def test_draws_that_never_differ_are_known_exactly_and_chains_that_never_moved_not_at_all() -> None:
    apart = np.repeat(np.arange(6.0)[:, None], 50, axis=1)
    found = diagnose({"same": np.full((4, 100), 2.5), "apart": apart})
    assert (found["same"].ess_bulk, found["same"].ess_tail, found["same"].r_hat) == (400.0, 400.0, 1.0)
    assert found["apart"].r_hat == WORST_R_HAT
    assert found["apart"].ess_bulk < 15


def test_draws_that_say_nothing_are_refused_by_name() -> None:
    draws = np.random.default_rng(8).standard_normal((4, 100))
    draws[2, 7] = np.nan
    with pytest.raises(ValueError, match="tau: 1 draws are not finite"):
        diagnose({"tau": draws})
    with pytest.raises(ValueError, match="tau: draws of shape"):
        diagnose({"tau": draws[:, :3]})


@pytest.mark.parametrize("seed", [0, 1])
def test_gains_that_agree_to_the_noise_are_drawn_by_good_proposals(seed):
    """Two holds alike to 1e-4, behind an unknown machine: the scatter may be anything below a half."""
    alike = handles_of(small_recipe(sigma_N=0.02, logs=small_recipe().logs[-2:]), 2, sd_mm=0.02)
    target = SpecimenTarget(identified(alike, pooling="scaled", noise="white", machine=True))
    drawn = sample(target, draws=2_000, seed=seed)
    assert drawn.converged
    assert drawn.detail["pareto_k"] < 0.7
    assert drawn.detail["steps"] <= 200
    scatter = target.vectors(drawn.chain.reshape(-1, target.size))[:, target.places["ln_gain_sd"]]
    low, high = np.quantile(scatter, [0.025, 0.975])
    assert low < -7.0
    assert high > -1.5
