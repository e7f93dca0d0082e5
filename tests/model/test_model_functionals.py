"""Closed forms of quoted numbers and of rupture against the running model, and errors against Monte Carlo."""

import numpy as np
import pytest
from passive_tissues import of_law
from scipy.integrate import cumulative_trapezoid

from tissueid.model import functionals
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.functionals import complex_stiffness, force_after_ramp
from tissueid.model.grammar import parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.rupture import hardening_ratio, rupture_at_speed, rupture_measures, stored_energy_in
from tissueid.model.servo_law import servo_law
from tissueid.model.states import branch_states
from tissueid.rupture_law import CRITERIA

MODEL = kelvin_voigt(branches=2, stiffness_degree=2, depth_mm=4.0)
THETA = MODEL.join(
    np.array([5.0, 0.4, 0.1]), np.array([[8.0, 1.0, 0.3], [4.0, 0.5, 0.0]]), np.array([0.05, 1.2])
)


LINEAR = kelvin_voigt(1, 1, 4.0), np.array([5.0, 0.4, 0.1, 8.0, 1.0, 0.05])


@pytest.mark.parametrize("ramp_s", [0.0, 1.5])
@pytest.mark.parametrize("tissue", [(MODEL, THETA), LINEAR], ids=["quadratic", "linear"])
def test_force_after_a_step_or_a_ramp_is_that_of_the_recursion(tissue, ramp_s):
    model, theta = tissue
    time = np.array([0.0, ramp_s, ramp_s + 0.1, 5.0])
    force = model.force(theta, ContactPath(time, np.array([0.0, 3.0, 3.0, 3.0])))
    for k in (1, 2, 3):
        since = float(time[k] - ramp_s)
        found = force_after_ramp(model, theta, 3.0, 2.0 if ramp_s else None, since)
        assert found == pytest.approx(force[k], rel=1e-13)


def last_cycle(frequency, amplitude, n):
    """Phase, travel and force of a late period of a sine about 2 mm."""
    settle = int(np.ceil(12.0 * 1.2 * frequency)) + 1
    angle = 2.0 * np.pi * np.arange(0.0, settle + 1.0, 1.0 / n)
    x = 2.0 + amplitude * np.sin(angle)
    # from rest at the mean depth: F_s alone, no branch
    states = branch_states(angle / (2.0 * np.pi * frequency), x, np.array([0.05, 1.2]))
    force = MODEL.static_force(THETA, x) + (MODEL.stiffness(THETA, x) * states).sum(axis=0)
    return angle[-n - 1 :], x[-n - 1 :], force[-n - 1 :]


@pytest.mark.needs_jit
@pytest.mark.parametrize("frequency", [0.05, 0.7, 6.0])
def test_storage_and_loss_are_those_of_a_small_sine(frequency):
    angle, _, force = (one[1:] for one in last_cycle(frequency, 1e-4, 2000))
    found = complex_stiffness(MODEL, THETA, 2.0, frequency)
    # chords of a sine of 2000 samples: 1e-6; the amplitude's second order: 1e-5
    for part, wave in zip(found, (np.sin(angle), np.cos(angle)), strict=True):
        assert part == pytest.approx(2.0 * np.mean(force * wave) / 1e-4, rel=1e-4)


def test_energy_of_a_large_cycle_is_the_area_of_its_loop():
    _, x, force = last_cycle(0.7, 1.5, 4000)
    # trapezoids over 4000 samples: 1e-6; what is left of the start after 12 periods: 1e-6
    area = np.trapezoid(force, x)
    assert functionals.dissipated_per_cycle(MODEL, THETA, 2.0, 1.5, 0.7) == pytest.approx(area, rel=1e-4)


def test_stiffness_is_the_slope_of_slow_and_of_sudden_motion():
    secant, tangent = functionals.equilibrium_stiffness(MODEL, THETA, 3.0)
    assert secant == pytest.approx(5.0 + 0.4 * 3.0 + 0.1 * 9.0)
    assert tangent == pytest.approx(5.0 + 0.8 * 3.0 + 0.3 * 9.0)
    sudden_secant, sudden_tangent = functionals.instantaneous_stiffness(MODEL, THETA, 3.0)
    assert sudden_secant == pytest.approx(force_after_ramp(MODEL, THETA, 3.0, None, 0.0) / 3.0)
    # the limit of high frequency
    assert sudden_tangent == pytest.approx(complex_stiffness(MODEL, THETA, 3.0, 1e5)[0], rel=1e-8)


def test_error_of_a_function_is_the_spread_over_draws():
    rng = np.random.default_rng(20261121)
    half = rng.standard_normal((THETA.size, THETA.size)) * (0.004 * THETA)[:, None]
    covariance = half @ half.T
    unknown = np.zeros(THETA.size, dtype=bool)

    def relaxed(theta):
        after, peak = (force_after_ramp(MODEL, theta, 3.0, None, since) for since in (0.5, 0.0))
        return 1.0 - after / peak

    value, stderr = functionals.delta_method(relaxed, THETA, covariance, unknown)
    draws = [relaxed(theta) for theta in rng.multivariate_normal(THETA, covariance, size=4000)]
    assert value == relaxed(THETA)
    # 4000 draws know their spread to 1.1 %; the second order of a 1 % change is as large
    assert stderr == pytest.approx(float(np.std(draws)), rel=0.05)


def test_a_number_that_hangs_on_an_unknown_parameter_or_has_no_slope_has_no_finite_error():
    unknown, covariance = np.arange(THETA.size) == THETA.size - 1, np.diag((0.01 * THETA) ** 2)
    for function, finite in (
        (lambda theta: functionals.equilibrium_stiffness(MODEL, theta, 2.0)[0], True),
        (lambda theta: complex_stiffness(MODEL, theta, 2.0, 0.3)[1], False),
    ):
        assert np.isfinite(functionals.delta_method(function, THETA, covariance, unknown)[1]) == finite

    def beside_a_pole(theta):
        return float(theta[0]) if theta[0] <= 1.0 else float("inf")

    assert functionals.delta_method(beside_a_pole, np.ones(1), np.eye(1), np.zeros(1, bool)) == (1.0, np.inf)


def test_a_shape_that_nothing_determines_leaves_no_error_of_a_number() -> None:
    law = parsed("power * prony").model(4.0, 0.01, 8.0)
    theta, covariance = np.array([1e-3, 4.0, 1.0, 0.1]), np.diag([1.0, 1e40, 1.0, 1.0])

    def deepest(one: np.ndarray) -> float:
        return float(law.static_force(one, np.array([4.0]))[0])

    value, stderr = functionals.delta_method(deepest, theta, covariance, np.zeros(4, bool))

    assert value == pytest.approx(1e-3 * 4.0**4)
    assert np.isinf(stderr)


def test_a_depth_just_above_the_surface_has_no_force() -> None:
    law = parsed("power * stretched").model(4.0, 0.01, 8.0)

    force = law.static_force(np.array([2.0, 1.5, 1.0, 0.1, 0.5]), np.array([-1e-9, 0.0, 1.0]))

    assert force.tolist() == [0.0, 0.0, 2.0]


HARDENING = (0.0, 0.0, 0.43)
TABLE_1 = (47.42, -5.577, 0.3804)
STIFFNESS, TAU_S = 63.62, 0.021


def hard_tissue(static: tuple[float, ...]) -> tuple[ChannelModel, np.ndarray]:
    return kelvin_voigt(1, 0, 9.0), np.array([*static, STIFFNESS, TAU_S])


def stretched(stiffness, x: np.ndarray, state: np.ndarray) -> np.ndarray:
    """int_{x - s}^{x} K dy of a polynomial K."""
    return sum(k / (p + 1) * (x ** (p + 1) - (x - state) ** (p + 1)) for p, k in enumerate(stiffness))


def test_a_weight_of_one_is_the_force_and_of_zero_the_static_force() -> None:
    (model, theta), x = hard_tissue(HARDENING), np.linspace(0.0, 5.0, 501)
    force = loading_force(model, theta, x, speed_mm_s=8.0)
    for weight, expected in ((1.0, force), (0.0, 0.43 * x**3)):
        found = rupture_measures(model, theta, ContactPath(x / 8.0, x), weight=weight)["weighted-force"]
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.needs_jit
@pytest.mark.parametrize("criterion", CRITERIA)
def test_a_ramp_ruptures_where_its_measure_is_the_threshold(criterion: str) -> None:
    model, theta = hard_tissue(TABLE_1)
    x = np.linspace(0.0, 9.0, 90_001)
    measures = rupture_measures(model, theta, ContactPath(x / 8.0, x))
    threshold = float(measures[criterion][50_000])
    point = rupture_at_speed(model, theta, criterion, threshold, speed_mm_s=8.0)
    assert point["depth"] == pytest.approx(x[50_000], abs=1e-5)
    assert point["force"] == pytest.approx(measures["force"][50_000], rel=1e-5)
    assert point["work"] == pytest.approx(measures["work"][50_000], rel=1e-5)
    assert point["dynamic"] == pytest.approx(STIFFNESS * 8.0 * TAU_S, rel=1e-6)


def test_a_threshold_beyond_the_depth_is_no_rupture_and_an_unknown_criterion_refused() -> None:
    model, theta = hard_tissue(HARDENING)
    assert rupture_at_speed(model, theta, "work", 1e6, speed_mm_s=1.0) is None
    assert rupture_at_speed(model, theta, "depth", 9.5, speed_mm_s=1.0) is None
    with pytest.raises(ValueError, match="no criterion of rupture 'torque'; there are work, weighted-force"):
        rupture_at_speed(model, theta, "torque", 1.0, speed_mm_s=1.0)


@pytest.mark.parametrize("static", [HARDENING, TABLE_1], ids=["cubic", "table 1"])
def test_the_force_at_rupture_changes_with_speed_as_the_sign_test_says(static: tuple[float, ...]) -> None:
    model, theta = hard_tissue(static)
    speed = 0.3  # v tau = 0.0063 mm, a thousandth of the depth
    work = sum(a * 6.0 ** (k + 2) / (k + 2) for k, a in enumerate(static))
    slower, point, faster = (
        rupture_at_speed(model, theta, "work", work, speed_mm_s=share * speed) for share in (0.8, 1.0, 1.2)
    )
    ratio = hardening_ratio(model, theta, point["depth"], point["force"])
    slope = (faster["force"] - slower["force"]) / (0.4 * speed)
    # dF/dv = K tau (1 - x F_s'/F), to the first order in v tau / x
    assert slope == pytest.approx(STIFFNESS * TAU_S * (1.0 - ratio), rel=0.02)


OF_EVERY_KIND = (
    "power * tangent * prony", "power * tangent * fung", "polynomial * tangent * prony:2",
    "hertz * linear * stretched", "flat * fractional", "sneddon * quadratic * power-law",
    "flat * poroelastic", "power * spectrum", "polynomial * quadratic * prony:3",
)  # fmt: skip


def heat_of(model: ChannelModel, theta: np.ndarray, path: ContactPath) -> np.ndarray:
    """Heat that the dampers of every exponential have made, (n,) [N mm]."""
    x, elastic, power = path.depth_mm, model.static_force(theta, path.depth_mm), np.zeros(path.time_s.size)
    fine = np.linspace(0.0, x.max(), 20_001)
    force = model.static_force(theta, fine)
    for part in model.parts:
        weights, tau = model.exponentials(theta, part)
        for weight, time, state in zip(
            weights, tau, branch_states(path.time_s, elastic if model.inside else x, tau), strict=True
        ):
            if part.ratio is not None:
                way = x - np.interp(elastic - state, force, fine)
                power += theta[part.ratio] * weight * state * way / time
                continue
            power += weight * state / time * stretched(theta[part.stiffness], x, state)
    return cumulative_trapezoid(power, path.time_s, initial=0.0)


@pytest.mark.needs_jit
@pytest.mark.parametrize("name", OF_EVERY_KIND)
def test_stored_energy_and_heat_make_up_the_work_under_any_law(name: str) -> None:
    model, theta = of_law(name, 6.0, 2.0)
    time = np.linspace(0.0, 1.0, 20_001)
    # forth, a little back, and forth again
    path = ContactPath(time, 4.0 * time * (1.0 + 0.3 * np.sin(20.0 * time)))
    measures = rupture_measures(model, theta, path)
    stored = measures["stored-energy"] + heat_of(model, theta, path)
    assert stored == pytest.approx(measures["work"], rel=1e-3, abs=1e-4 * measures["work"].max())
    assert (measures["stored-energy"] >= 0.0).all()


@pytest.mark.needs_jit
@pytest.mark.parametrize("name", OF_EVERY_KIND)
def test_the_servo_stores_the_energy_of_the_law(name: str) -> None:
    model, theta = of_law(name, 6.0, 2.0)
    time = np.arange(0.0, 1.0, 1e-3)
    path = ContactPath(time, 5.0 * time * (1.0 + 0.2 * np.sin(12.0 * time)))
    expected = rupture_measures(model, theta, path)["stored-energy"]
    law, state = servo_law(model, theta).packed(), np.zeros(STATE_SIZE)
    found = np.zeros(time.size)
    for k, depth in enumerate(path.depth_mm[1:], 1):
        tissue_step_in(law, 0, state, 0, float(depth), 1e-3)
        found[k] = stored_energy_in(law, 0, state, 0)
    assert found == pytest.approx(expected, rel=2e-3, abs=2e-3 * expected.max())


def test_a_damped_law_stores_its_static_work_alone() -> None:
    model = parsed("power * impact").model(6.0, 0.01, 2.0)
    x = np.linspace(0.0, 4.0, 2001)
    theta = np.array([12.0, 1.4, 0.8])
    measures = rupture_measures(model, theta, ContactPath(x / 8.0, x))
    assert measures["stored-energy"] == pytest.approx(12.0 * x**2.4 / 2.4, rel=1e-5, abs=1e-6)
    assert measures["dynamic"] == pytest.approx(model.factor(theta) * 12.0 * x**1.4, rel=1e-9, abs=1e-9)
