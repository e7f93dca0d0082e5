"""The log density of a specimen and its priors against the same written out, and integrals."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import draw, handles_for, handles_of, identified, small_recipe
from scipy.stats import multivariate_normal

from tissueid.inference.conditional import conditional, holding
from tissueid.inference.law import bernstein
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import Noise
from tissueid.inference.prior import coordinate, quantile
from tissueid.inference.reported import log_theta_prior, prior_table
from tissueid.inference.sampling import sample
from tissueid.inference.target import NormalTarget, SpecimenTarget
from tissueid.model.grammar import candidates
from tissueid.model.states import branch_states
from tissueid.priors import WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior
from tissueid.synth import Branch, Hold, Log, Move

#: Half the logs are short: they are kept sample by sample.
SHORT = small_recipe(rate_Hz=50.0)


def one_log(**asked):
    ours = identified(handles_of(replace(SHORT, logs=SHORT.logs[-1:]), 1, sd_mm=0.02), **asked)
    return ours, SpecimenTarget(ours, machine=asked.get("machine", False))


def points(at, n=8, seed=3, size=0.5):
    return at.vectors(size * np.random.default_rng(seed).standard_normal((n, at.size)))


def test_a_single_log_has_the_likelihood_of_its_samples_and_its_priors():
    ours, at = one_log(noise="white")
    x = points(at)
    found = at.density(x)
    prior = ours.optimum.prior
    expected = []
    for one in x:
        shared, contact = at.shared(one), one[at.places["contact"]]
        point = ours.optimum.point.moved(shared, np.array([[contact]]))
        ours.system.guess = ours.system.tip_force(point)[0]
        left = ours.system.force - ours.system.predict(point)
        sigma = np.exp(one[at.places["ln_sigma"]])
        # priors are of the coefficients times the largest states
        value = -0.5 * ((prior.rows @ one[: at.n_shared] - prior.target) ** 2).sum()
        value -= 0.5 * prior.own[0, 0] * contact**2
        value += -0.5 * float(left @ left) / sigma**2 - left.size * np.log(sigma)
        expected.append(value)
    inside = np.isfinite(found)
    assert inside.sum() >= 4
    found, expected = found[inside], np.array(expected)[inside]
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-7, atol=1e-6)


def test_a_common_scale_is_as_likely_as_the_gains_that_undo_it():
    ours = identified(handles_of(SHORT, 2, sd_mm=0.02), pooling="scaled", noise="white")
    at = SpecimenTarget(ours, machine=False)
    gains, linear = ours.optimum.point.own[:, 0], slice(at.law.times + 3, at.n_shared)
    ln_scale = np.array([-0.5, -0.1, 0.0, 0.1, 0.5])
    x = np.tile(at.mode, (ln_scale.size, 1))
    x[:, linear] *= np.exp(ln_scale)[:, None]
    for sd in (0.05, 0.3):
        x[:, at.places["ln_gain_sd"]] = np.log(sd)
        found = at.density(x) - at._log_prior(x, at.shared(x))
        expected = -0.5 * np.sum((gains - ln_scale[:, None]) ** 2, axis=1) / sd**2
        np.testing.assert_allclose(found - found[2], expected - expected[2], rtol=0.02, atol=0.2)
    # and it is drawn as wide: the density in the coordinates of the walkers has the volume of their map
    for z in np.random.default_rng(2).standard_normal((4, at.size)):
        there = np.array([z, np.zeros(at.size)])
        change = np.subtract(*(at.densities(there) - at.density(at.vectors(there))))
        assert change == pytest.approx(volume(at, there[0]) - volume(at, there[1]), abs=1e-4)


def test_correlated_noise_has_its_dense_covariance():
    ours, _ = one_log(noise="white")
    noise = Noise(ours.optimum.noise.sigma_N, Memory(0.08, 0.2))
    at = SpecimenTarget(replace(ours, optimum=replace(ours.optimum, noise=noise)), machine=False)
    mid, n = ours.system.mid, ours.system.force.size
    assert at.samples == n
    x = np.array([at.mode, at.mode])
    x[1, at.places["ln_memory"]] += np.log(2.0)
    x[1, at.places["ln_sigma"]] += 0.1
    left = ours.system.force - ours.system.predict(ours.optimum.point)
    expected = []
    for one in x:
        # ln memory is taken to the nearest twentieth
        time = np.exp(0.05 * round(float(one[at.places["ln_memory"]]) / 0.05))
        covariance = 0.8 * np.exp(-np.abs(np.subtract.outer(mid, mid)) / time) + 0.2 * np.eye(n)
        covariance = covariance * np.exp(2.0 * one[at.places["ln_sigma"]])
        expected.append(multivariate_normal.logpdf(left, cov=covariance))
    assert np.diff(at.density(x))[0] == pytest.approx(expected[1] - expected[0], abs=1e-6)


def test_what_logs_have_for_themselves_is_integrated():
    """Gains, contacts, times and shapes are linear about the optimum: a normal of the whole covariance."""
    ours = identified(handles_of(SHORT, 2, sd_mm=0.02), pooling="scaled", noise="white")
    at = SpecimenTarget(ours, machine=False)
    system, own = ours.system, ours.optimum.point.own
    x = np.array([at.mode, at.mode])
    x[1, at.places["ln_sigma"]] += 0.2
    x[1, at.places["ln_gain_sd"]] += 0.5
    force = system.near(ours.optimum.point)
    columns = at.by_own(force[None])[:, 0].T
    logs, q = own.shape
    wide = np.zeros((len(force), logs * q))
    for i in range(logs):
        wide[system.log == i, i * q : (i + 1) * q] = columns[system.log == i]
    # shapes have mean zero
    about = np.eye(logs) - 1.0 / logs
    expected = []
    for one in x:
        sigma, gain = np.exp(one[at.places["ln_sigma"]]), np.exp(one[at.places["ln_gain_sd"]])
        value = 0.5 * -((gain / at.priors.gain_sd) ** 2) + np.log(gain)
        shape, time = ours.scatter.shape, ours.scatter.time
        size, shapes = np.array([gain, 0.02 / system.depth_mm, time, shape, shape]), [0, 0, 0, 1, 1]
        free = np.kron(np.eye(logs), np.diag(1 - np.array(shapes))) + np.kron(about, np.diag(shapes))
        prior = free * np.tile(size, logs) ** 2
        covariance = wide @ prior @ wide.T + sigma**2 * np.diag(1.0 / system.count)
        # the force where logs have nothing of their own, linearly
        mean = force - wide @ own.ravel()
        value += multivariate_normal.logpdf(system.force, mean, covariance, allow_singular=True)
        value -= 0.5 * system.within_N2 / sigma**2 + system.within_freedom * np.log(sigma)
        expected.append(value)
    assert np.diff(at.density(x))[0] == pytest.approx(expected[1] - expected[0], abs=1e-4)


def test_whitened_coordinates_are_those_of_the_curvature_within_the_passive_set():
    _, at = one_log(noise="white")
    outside = at.mode.copy()
    outside[at.law.times + 3 + 3] = -1.0
    assert np.isfinite(at.density(np.array([outside, at.mode]))).tolist() == [False, True]
    step = 0.3
    z = np.vstack([np.zeros((1, at.size)), step * np.eye(at.size), -step * np.eye(at.size)])
    middle, up, down = np.split(at.densities(z), [1, 1 + at.size])
    second = (up + down - 2.0 * middle) / step**2
    # of directions that no wall cuts
    inside = np.isfinite(second)
    assert inside.sum() >= at.size - 3
    assert np.median(second[inside]) == pytest.approx(-1.0, abs=0.1)


@pytest.mark.parametrize(("mean", "sd", "lower"), [(0.0, 0.004, 0.0), (0.01, 0.002, 0.0)])
def test_a_machine_by_quantiles_has_its_prior_and_keeps_its_digits(mean, sd, lower):
    z, prior = np.linspace(-6.0, 6.0, 41), CalibrationPrior(mean, sd, lower)
    values = quantile(prior, z)
    assert (np.diff(values) > 0.0).all()
    assert (values >= prior.lower).all()
    middle = np.abs(z) < 4.5
    np.testing.assert_allclose(coordinate(prior, values)[middle], z[middle], atol=1e-5)
    if mean == lower == 0.0:
        # the median of a half normal
        assert quantile(prior, np.zeros(1)) == pytest.approx(0.6745 * sd, rel=1e-4)


def volume(at, z):
    """Ln of the volume of the map from whitened coordinates at a point."""
    step = 1e-5 * np.eye(at.size)
    return np.linalg.slogdet((at.vectors(z + step) - at.vectors(z - step))[:, at.free] / 2e-5)[1]


@pytest.mark.parametrize("case", ["one log", "memory", "two logs"])
def test_the_density_does_not_depend_on_how_coordinates_are_given(case):
    """A change of variables: density times its Jacobian."""
    if case == "two logs":
        at = SpecimenTarget(identified(handles_of(SHORT, 2, sd_mm=0.02), pooling="scaled", noise="white"))
    else:
        _, at = one_log(noise="white" if case == "one log" else "ar1", machine=True)
    assert ("ln_memory" in at.places, "ln_gain_sd" in at.places) == (case == "memory", case == "two logs")
    z = at.bent(np.zeros((1, at.size))) + 0.3 * np.random.default_rng(5).standard_normal((8, at.size))
    found, x = at.densities(z), at.vectors(z)
    for k, place in enumerate(at.cut_places):
        # of what bounds cut, by quantiles of the prior
        values = quantile(at.priors.calibration[at.names[place]], z[:, k])
        np.testing.assert_allclose(x[:, place], values, atol=1e-9)
    inside = np.isfinite(found)
    assert inside.sum() >= 2
    expected = at.density(x[inside]) + np.array([volume(at, one) for one in z[inside]])
    np.testing.assert_allclose(np.diff(found[inside]), np.diff(expected), atol=1e-3)


def test_a_normal_target_is_normal_within_the_walls():
    _, at = one_log(noise="white")
    covariance = at.root @ at.root.T * 4.0
    centre = at.vectors(at.centre[None])[0, at.free]
    found = NormalTarget(at, covariance)
    assert found.is_normal
    z = 0.5 * np.random.default_rng(6).standard_normal((40, found.size))
    x = at.vectors(z)[:, at.free]
    inside = np.isfinite(found.densities(z))
    expected = -0.5 * np.einsum("ni,ni->n", x - centre, np.linalg.solve(covariance, (x - centre).T).T)
    np.testing.assert_allclose(found.densities(z)[inside], expected[inside], rtol=1e-4, atol=1e-4)
    rows = at.optimum.prior.cone[at.optimum.prior.least > -1e200]
    least = at.optimum.prior.least[at.optimum.prior.least > -1e200]
    passive = (at.vectors(z)[:, : at.n_shared] @ rows.T >= least - 1e-6).all(axis=1)
    assert (passive == inside).mean() > 0.95


def test_points_of_the_normal_within_the_walls_are_passive_tissues_wherever_contact_is():
    at = one_log(noise="white", machine=True)[1]
    found = NormalTarget(at, 25.0 * at.root @ at.root.T)
    drawn = found.centre + np.random.default_rng(8).standard_normal((300, found.size))
    inside = found.passive(drawn)
    central = found.at_mean_machine(drawn, inside)
    for z in (inside, central):
        linear = at.shared(at.vectors(z))[:, at.law.times + 3 :]
        walls = at.law.cone @ linear.T
        assert (walls >= -1e-10 * np.abs(linear).max()).all()
    moved = (inside != drawn).any(axis=1)
    assert moved.mean() > 0.1
    # at the mean of the machine, and nothing but what a wall asks for is moved
    np.testing.assert_allclose(central[:, :3], np.broadcast_to(inside[:, :3].mean(axis=0), (300, 3)))
    assert np.ptp(at.vectors(inside)[:, at.places["contact"]]) > 0.0


RECIPE = small_recipe(logs=small_recipe().logs[-1:])
THETA = np.array([[20.0, -1.2, 0.35, 63.0, 0.2], [25.0, -2.0, 0.4, 10.0, 1.5], [15.0, 0.5, 0.1, 90.0, 0.04]])
STATED = Priors(
    linear={"static_1_N_per_mm": (20.0, 5.0), "stiffness_0_N_per_mm": (60.0, 20.0)},
    relaxation_time_s=(SpreadPrior(0.2, 0.5),),
)


def target(priors=None, **asked):
    (log,) = draw(RECIPE, 1)
    ours = identified(handles_for([log]), noise="white", priors=priors or Priors(), **asked)
    return log, SpecimenTarget(ours, machine=asked.get("machine", False))


def weak(log, force, theta):
    """Bernstein coefficients of F_s/x by depth, and K at the largest state: normal around 0."""
    a1, a2, a3, k, tau = theta
    state = float(branch_states(log.time_s, log.displacement_mm, np.array([tau]))[0].max()) / 4.0
    sd, static = WEAK_FACTOR * force, bernstein(3) @ np.array([a1 * 4.0, a2 * 16.0, a3 * 64.0])
    # uniform in ln tau is 1 / tau in tau
    return -0.5 * (static @ static) / sd**2 - 0.5 * (k * 4.0 * state / sd) ** 2 + np.log(state / tau)


def test_weak_and_stated_priors_are_their_densities():
    log, plain = target()
    expected = np.array([weak(log, plain.force, theta) for theta in THETA])
    found = log_theta_prior(plain, THETA)
    # the largest state is read off a table of 48 times
    assert found - found[0] == pytest.approx(expected - expected[0], abs=0.03)
    more = log_theta_prior(target(STATED)[1], THETA) - found
    expected = -0.5 * ((THETA[:, 0] - 20.0) / 5.0) ** 2 - 0.5 * ((THETA[:, 3] - 60.0) / 20.0) ** 2
    expected -= 0.5 * (np.log(THETA[:, 4] / 0.2) / 0.5) ** 2
    assert more - more[0] == pytest.approx(expected - expected[0], abs=1e-9)


@pytest.mark.parametrize(
    "stated", [{}, {"static_N_per_mm_n": (12.0, 4.0), "stiffness_0_N_per_mm": (30.0, 9.0)}]
)
@pytest.mark.parametrize(
    "name",
    ["power * stretched", "exponential * linear * fung", "polynomial * tangent * prony:2", "power * prony:2"],
)
def test_the_prior_of_any_law_is_that_of_the_sampled_vectors(name: str, stated: dict) -> None:
    (log,) = draw(RECIPE, 1)
    priors = Priors(linear=stated)
    ours = identified(handles_for([log]), noise="white", candidates=candidates(name), priors=priors)
    at = SpecimenTarget(ours, machine=False)
    tissue = np.r_[np.arange(at.law.times), at.law.times + 3 + np.arange(at.law.linear)]

    def theta(x):
        point = at.point(x)
        return at.law.theta(point.log_times, point.linear, exact=True)[0]

    points = np.repeat(at.mode[None], 4, axis=0)
    low, high = at.law.bounds(-5.0, 5.0)
    points[:, : at.law.times] = np.clip(points[:, : at.law.times], low + 0.5, high - 0.5)
    # times of branches that coincide at the mode would change places within a difference
    points[:, : at.law.branches] += 0.3 * np.arange(at.law.branches)
    points[1, tissue[: at.law.times]] += 0.05
    points[2, tissue[at.law.times :]] *= 1.2
    points[3, tissue] *= 1.03
    sampled = at._log_prior(points, at.shared(points))
    volume = []
    for x in points:
        steps = 1e-5 * np.maximum(np.abs(x[tissue]), 1.0)
        columns = [
            (theta(x + step * unit) - theta(x - step * unit)) / (2.0 * step)
            for step, unit in zip(steps, np.eye(x.size)[tissue], strict=True)
        ]
        volume.append(np.linalg.slogdet(columns)[1])

    found = log_theta_prior(at, np.array([theta(x) for x in points]))

    expected = sampled - np.array(volume)
    # the largest state is read off a table of 48 times
    assert found - found[0] == pytest.approx(expected - expected[0], abs=0.01)


def test_the_table_names_every_prior_and_what_the_data_added():
    _, at = target(STATED, machine=True)
    rng = np.random.default_rng(1)
    n = 400
    vectors = at.mode + 0.01 * rng.standard_normal((n, at.mode.size))
    theta = THETA[0] * (1.0 + 0.01 * rng.standard_normal((n, 5)))
    gains = 1.0 + 0.005 * rng.standard_normal((n, 2))
    rows = {row.name: row for row in prior_table(at, vectors, theta, gains)}
    assert set(rows) == {
        "static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3", "stiffness_0_N_per_mm",
        "ln_relaxation_time_1", "ln_sigma", "force_gain", "displacement_gain", "frame_compliance_mm_per_N",
        "skew_s", "force_filter_s",
    }  # fmt: skip
    assert [name for name, row in rows.items() if row.stated] == [
        "static_1_N_per_mm", "stiffness_0_N_per_mm", "ln_relaxation_time_1",
    ]  # fmt: skip
    one = rows["static_1_N_per_mm"]
    assert "normal, 20" in one.prior
    assert one.posterior_sd == pytest.approx(0.2, rel=0.15)
    assert one.shrinkage == pytest.approx(1.0 - one.posterior_sd / 5.0)
    assert "weak" in rows["static_2_N_per_mm2"].prior
    assert "log-normal" in rows["ln_relaxation_time_1"].prior
    assert rows["force_gain"].shrinkage == pytest.approx(0.5, abs=0.1)
    plain = {row.name for row in prior_table(target()[1], vectors, theta, None)}
    assert not {"force_gain", "skew_s"} & plain


def held_behind_an_unknown_frame():
    """One ramp of 1 mm/s to 5 mm and a hold of 20 s at 50 Hz; nothing is known of the machine."""
    plan = small_recipe(rate_Hz=50.0, sigma_N=0.2, logs=(Log("one", (Move(5.0, 60.0), Hold(20.0))),))
    return SpecimenTarget(identified(handles_of(plan, 1, sd_mm=0.02), machine=True))


def test_linear_parameters_of_a_log_are_normal_given_all_else():
    at, rng = held_behind_an_unknown_frame(), np.random.default_rng(2)
    p = at.law.linear
    for first in 0.5 * rng.standard_normal((3, at.size - p)):
        z = np.hstack([np.tile(first, (20, 1)), rng.standard_normal((20, p))])
        x = at.vectors(z)
        assert (np.ptp(x[:, : at.law.times + 3], axis=0) == 0.0).all()
        found = at.density(x) + 0.5 * (z[:, -p:] ** 2).sum(axis=1)
        assert np.ptp(found[np.isfinite(found)]) < 1e-4
        assert np.isfinite(found).sum() > 10
        assert at.levels(x, 0.0 * z)[0] == pytest.approx(at.levels(np.roll(x, 1, axis=0), 0.0 * z)[0])


@pytest.mark.parametrize("lean", [-0.2, 0.6])
def test_linear_parameters_within_walls_are_drawn_by_their_own_density(lean: float) -> None:
    """Weighted draws have the moments of a normal cut by walls that its mean is 1 and 0 sd behind."""
    rng = np.random.default_rng(3)
    columns, rows = rng.standard_normal((3, 1, 12)), np.array([[1.0, lean, 0.0], [0.0, 1.0, -0.4]])
    target = rng.standard_normal((1, 1, 12))
    empty = np.zeros((0, 3)), np.zeros((1, 0))
    whole = conditional(np.vstack([target, columns]), np.zeros(1), *empty, (rows[:0], np.zeros(0)))
    cov = np.linalg.inv(whole.factor[0] @ whole.factor[0].T)
    sds = np.sqrt(np.diagonal(rows @ cov @ rows.T))
    least = rows @ whole.mean[0] + np.array([1.0, 0.0]) * sds
    z = rng.standard_normal((20_000, 3))
    many = np.repeat(np.vstack([target, columns]), len(z), axis=1)
    given = conditional(many, np.zeros(len(z)), empty[0], np.zeros((len(z), 0)), (rows, least))
    values, ln_volume = given.drawn(z)
    assert (values @ rows.T > least).all()
    off = values - whole.mean[0]
    ln_weight = ln_volume + 0.5 * (z**2).sum(axis=1) - 0.5 * (off * np.linalg.solve(cov, off.T).T).sum(axis=1)
    weight = np.exp(ln_weight - ln_weight.max())
    weight /= weight.sum()
    plain = rng.multivariate_normal(whole.mean[0], cov, 1_000_000)
    plain = plain[(plain @ rows.T >= least).all(axis=1)]
    assert len(plain) > 1000
    error = plain.std(axis=0) / np.sqrt(min(len(plain), 1.0 / (weight**2).sum()))
    assert np.abs(weight @ values - plain.mean(axis=0)).max() < 5.0 * error.max()
    spread = np.sqrt(weight @ (values - weight @ values) ** 2)
    assert spread == pytest.approx(plain.std(axis=0), rel=0.05)


def test_walls_that_hold_are_near_and_none_follows_from_others():
    rows = np.array([[1, 0, 0], [1, 1e-3, 0], [0, 0, 1], [0, 1, 0], [-1, 1e-3, 0], [0, 0, 0]])
    assert holding(np.eye(3), rows, np.array([0.0, 0.01, 0.3, -1e-9, 9.0, 0.0])).tolist() == [3, 0]
    # opposite ones leave a corner between them
    assert holding(np.eye(3), rows, np.array([0.0, 0.01, 0.3, 1e200, 0.01, 0.0])).tolist() == [0, 4]
    assert holding(np.eye(3), rows[:0], np.zeros(0)).size == 0


def test_linear_parameters_keep_off_the_wall_that_holds_the_optimum():
    logs = (Log("one", (Move(5.0, 60.0), Hold(5.0))),)
    plan = small_recipe(rate_Hz=50.0, sigma_N=0.1, branches=(Branch((0.0, 6.0), 1.0),), logs=logs)
    for seed in range(8):
        at = SpecimenTarget(identified(handles_of(plan, seed, sd_mm=0.02), machine=True, degrees=(1,)))
        rows, least = at._walls_held
        if len(rows):
            break
    assert len(rows) == 1
    z = np.random.default_rng(seed).standard_normal((50, at.size))
    slack = at.vectors(z)[:, at.linear_places] @ rows.T - least
    assert (slack > 0.0).all()


def test_draws_reach_the_end_of_the_frames_valley():
    """One hold says of the frame little: nearly as good a fit lies far from the optimum, along a curve."""
    found = []
    for follows in (True, False):
        at = held_behind_an_unknown_frame()
        if not follows:
            at.follows = False
            at._whiten()
        drawn = sample(at, draws=2_000, seed=0)
        vectors = at.vectors(drawn.chain.reshape(-1, at.size))
        np.testing.assert_allclose(drawn.vectors.reshape(vectors.shape), vectors, rtol=1e-9, atol=1e-12)
        found.append(float(np.quantile(vectors[:, at.law.times], 0.975)))
    following, straight = found
    assert following > 0.002 > 0.001 > straight
