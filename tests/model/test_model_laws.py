"""Every registered law against references written here; the servo's law of any model, and the yardstick."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from law_cases import of_kind, typical
from passive_tissues import DEPTH_MM, TICK, assert_no_energy, assert_stiffer_scales_forces, of_law, walked
from scipy.integrate import quad
from scipy.special import exp1

from tissueid import extras
from tissueid.documents import typed
from tissueid.documents.identification import Model
from tissueid.model import grammar
from tissueid.model.base import ContactPath, ParameterSpec, scaled_theta
from tissueid.model.channels import nodes_for
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import LAW_SIZE, pack_law
from tissueid.model.law import About
from tissueid.model.servo_law import servo_law
from tissueid.model.yardstick import INSIDE, OUTSIDE, presents, yardstick_of
from tissueid.result import ModelChoice

RESOLUTION, WINDOW = 0.01, 30.0
STATIC, RELAXATIONS = of_kind("static"), of_kind("relaxation", "prony", "spectrum")
TIMES = (0.003, 0.05, 1.0, 20.0, 300.0)


def mittag_leffler(alpha: float, x: float) -> float:
    """E_alpha(-x) by its power series where that converges well, by its integral elsewhere."""
    if x < 1.0:
        return sum((-x) ** k / math.gamma(alpha * k + 1.0) for k in range(120))
    ln_t = math.log(x) / alpha

    def integrand(w: float) -> float:
        decay = math.exp(-math.exp(min(w / alpha + ln_t, 7.0)))
        return decay / (2.0 * math.cosh(w) + 2.0 * math.cos(alpha * math.pi))

    ends = [-40.0, min(-alpha * ln_t, 39.0), 40.0]
    value = sum(quad(integrand, a, b, limit=400)[0] for a, b in itertools.pairwise(ends))
    return value * math.sin(alpha * math.pi) / (math.pi * alpha)


CLOSED = {
    "power-law": lambda t, tau, alpha: (1.0 + t / tau) ** -alpha,
    "stretched": lambda t, tau, beta: math.exp(-((t / tau) ** beta)),
    "fractional": lambda t, tau, alpha: mittag_leffler(alpha, (t / tau) ** alpha) if t > 0.0 else 1.0,
    "fung": lambda t, tau, span: (
        1.0 if t == 0.0 else (exp1(t / (tau * span)) - exp1(t / tau)) / math.log(span)
    ),
    "poroelastic": lambda t, tau: (
        0.491 * math.exp(-0.908 * math.sqrt(t / tau)) + 0.509 * math.exp(-1.679 * t / tau)
    ),
}


def shapes_of(law):
    """Ends and starts of every shape but the time."""
    return list(itertools.product(*[(one.spec.lower, *one.starts, one.spec.upper) for one in law.shapes[1:]]))


@pytest.mark.parametrize("key", RELAXATIONS)
def test_a_relaxation_is_its_closed_form(key):
    law = grammar.known_laws()[key]()
    times = [0.0, *np.logspace(-2.0, 2.0, 9)]
    for tau in (0.05, 1.0, 20.0):
        for shape in shapes_of(law):
            expected = [CLOSED[key](t, tau, *shape) for t in times]
            np.testing.assert_allclose(law.value(np.array(times), tau, *shape), expected, atol=2e-5)


@pytest.mark.parametrize("key", RELAXATIONS)
def test_nodes_hold_a_relaxation_from_the_resolution_to_ten_windows(key):
    law, nodes = grammar.known_laws()[key](), nodes_for(RESOLUTION, WINDOW)
    times = np.append(0.0, np.geomspace(RESOLUTION, 10.0 * WINDOW, 300))
    for tau in TIMES:
        for shape in shapes_of(law):
            weights = nodes.project @ law.value(nodes.time_s, tau, *shape)
            found = weights @ np.exp(-times / nodes.tau_s[:, None])
            assert np.abs(found - law.value(times, tau, *shape)).max() < 1e-4, (tau, shape)


@pytest.mark.parametrize("key", STATIC)
def test_a_static_law_has_its_slope_and_no_force_at_the_surface(key):
    law = grammar.known_laws()[key]()
    x = np.linspace(0.2, 9.0, 40)
    for shape in itertools.product(*[(*one.starts,) for one in law.shapes]):
        step = 1e-6
        expected = (law.basis(x + step, *shape) - law.basis(x - step, *shape)) / (2.0 * step)
        np.testing.assert_allclose(law.slope(x, *shape), expected, rtol=1e-6)
        assert np.abs(law.basis(np.zeros(1), *shape)).max() == 0.0
        assert law.basis(x, *shape).shape == (len(law.coefficients), x.size)


def test_every_law_is_described_and_has_its_source(monkeypatch):
    # not those that another test has registered in this process
    monkeypatch.setattr("tissueid.model.grammar._OWN", {})
    rows = grammar.described()
    assert {row["kind"] for row in rows} == {"static", "stiffness", "relaxation", "damping", "whole"}
    assert grammar.KELVIN_VOIGT in {row["key"] for row in rows}
    for row in rows:
        assert row["source"].startswith("10."), row["key"]
        assert all(row[key] for key in ("equation", "purpose", "refuses")), row["key"]


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("polynomial * prony", (1, 0)),
        ("polynomial:3*linear*prony:3", (3, 1)),
        (" polynomial *quadratic* prony:2 ", (2, 2)),
    ],
)
def test_names_of_the_papers_law_are_that_law(name, order):
    found = grammar.parsed(name)
    assert (found.branches, found.degree, found.parts) == (*order, None)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        *((name, "is no model") for name in ("", "polynomial", "a * b * c * d")),
        ("cubic * prony", "no static law 'cubic'; there are"),
        ("prony * polynomial", "no static law 'prony'"),
        ("polynomial * stiff * prony", "no stiffness law 'stiff'"),
        ("polynomial * tangent * maxwell", "no relaxation law 'maxwell'"),
        ("polynomial:7 * prony", "degree 7"),
        ("power * prony:9", "9 branches"),
        ("power * prony:x", "takes a number"),
        ("hertz:2 * prony", "takes no argument"),
        ("power * tangent * spectrum", "has a stiffness at each time"),
        ("power * linear * impact", "leave linear out"),
        ("impact * power", "no static law 'impact'"),
    ],
)
def test_a_name_that_is_none_says_what_there_is(name, says):
    with pytest.raises(grammar.ModelNameError, match=says):
        grammar.parsed(name)


def model(name: str):
    return grammar.parsed(name).model(8.0, RESOLUTION, WINDOW)


def test_inside_the_convolution_the_relaxed_force_is_that_of_the_integral():
    law = model("polynomial * tangent * prony")
    theta = np.array([20.0, -1.2, 0.35, 1.5, 0.4])
    speed, depth = 4.0, 6.0

    def rate(y: float) -> float:
        return 1.5 * (20.0 - 2.4 * y + 1.05 * y * y) * math.exp(-(depth - y) / (speed * 0.4))

    expected, _ = quad(rate, 0.0, depth)
    assert law.relaxing(theta, depth, np.zeros(1), speed)[0] == pytest.approx(expected, rel=1e-9)
    (one,) = law.loading(theta, np.full(1, depth), speed)
    assert law.loading(theta, np.full(2, depth), np.full(2, speed)).tolist() == [one, one]
    time = np.linspace(0.0, depth / speed, 4001)
    force = law.force(theta, ContactPath(time, speed * time))[-1]
    assert force - law.static_force(theta, np.array([depth]))[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    "name", [*(f"{key} * linear * fractional" for key in STATIC), "power * tangent * fung"]
)
def test_a_tissue_is_put_right_for_gains_of_force_and_travel(name):
    law = model(name)
    theta, time = typical(law), np.linspace(0.0, 3.0, 60)
    depth = np.minimum(2.0 * time, 3.0)
    right = scaled_theta(law.parameters, theta[None], np.array([2.0]), np.array([1.1]))[0]
    read = law.force(theta, ContactPath(time, 1.1 * depth))
    np.testing.assert_allclose(law.force(right, ContactPath(time, depth)), read / 2.0, rtol=1e-9)


def test_a_model_is_rebuilt_from_what_a_file_holds():
    choice = ModelChoice("power*fung", 1, 1, 0, "scaled", "power*fung", (RESOLUTION, WINDOW))
    again = grammar.rebuilt(ModelChoice.of(typed(choice.as_json(), Model)), 8.0)
    assert again == model("power*fung")
    assert grammar.rebuilt(ModelChoice("kelvin-voigt", 2, 3, 1, "scaled"), 8.0) == kelvin_voigt(2, 1, 8.0)
    with pytest.raises(ValueError, match="are missing"):
        grammar.rebuilt(ModelChoice("power*fung", 1, 1, 0, "scaled", "power*fung"), 8.0)


@pytest.mark.parametrize("theta", [[-1.0, 1.5, 30.0, 0.4], [10.0, 1.5, -30.0, 0.4], [10.0, 1.5, 30.0, -0.4]])
def test_what_would_put_out_energy_is_not_passive(theta):
    law = model("power * prony")
    assert law.is_passive(np.array([10.0, 1.5, 30.0, 0.4]))
    assert not law.is_passive(np.array(theta))
    falling = np.array([20.0, -6.0, 0.45, 1.5, 0.4])
    inside = model("polynomial * tangent * prony")
    assert inside.static_force(falling, np.linspace(0.1, 8.0, 50)).min() > 0.0
    assert not inside.is_passive(falling)


class Toe:
    """A law of another package: nothing up to a toe of 1 mm that grows, in a dozen lines."""

    about = About("toe", "static", "F_s = c x^3", "10.1000/none", "a toe region", "nothing")
    polynomial, shapes = False, ()
    coefficients = (ParameterSpec("static_toe_N_per_mm3", "c", "N/mm^3", 0.0, np.inf, "of x^3"),)

    def basis(self, depth_mm):
        return np.asarray(depth_mm**3)[None]

    def slope(self, depth_mm):
        return np.asarray(3.0 * depth_mm**2)[None]


@pytest.fixture
def installed(monkeypatch):
    """Laws of other packages, behind their entry points; none of this process alone."""
    monkeypatch.setattr(grammar, "_OWN", {})

    def install(*laws):
        one = {"name": "other-package", "value": "a:b"}
        points = {"tissueid.models": [SimpleNamespace(**one, load=lambda law=law: law) for law in laws]}
        monkeypatch.setattr(extras, "entry_points", lambda group: points.get(group, []))
        grammar._installed.cache_clear()

    yield install
    grammar._installed.cache_clear()


def test_a_law_of_another_package_is_one_of_ours(installed):
    installed(Toe)
    law, theta = model("toe * tangent * fung"), np.array([0.5, 1.2, 0.4, 100.0])
    assert law.parameter_names[0] == "static_toe_N_per_mm3"
    assert "toe" in {row["key"] for row in grammar.described()}
    time = np.linspace(0.0, 2.0, 400)
    path = ContactPath(time, np.minimum(4.0 * time, 6.0))
    expected = law.force(theta, path)
    assert np.abs(walked(law, theta, time, path.depth_mm) - expected).max() < 0.01 * expected.max()


def test_a_key_is_registered_once_and_an_unknown_one_lists_what_there_is(installed):
    with pytest.raises(grammar.ModelNameError, match="'maxwell' is no model: STATIC"):
        grammar.rebuilt(ModelChoice("maxwell", 1, 3, 0, "shared", "maxwell", (RESOLUTION, WINDOW)), 8.0)
    installed(grammar.known_laws()["prony"])
    assert "'prony' is registered already" in grammar.faulty_laws()[0]


def test_an_entry_point_that_is_no_law_hides_no_other_and_is_named_where_it_is_asked_for(installed):
    installed(len, Toe)
    assert grammar.parsed("toe * fung").parts is not None
    (remark,) = grammar.faulty_laws()
    assert "'other-package' (a:b) can't be used: TypeError" in remark
    with pytest.raises(
        grammar.ModelNameError, match=r"no relaxation law 'other-package'.*\(a:b\) can't be used"
    ):
        grammar.parsed("power * other-package")
    with pytest.raises(grammar.ModelNameError, match=r"no relaxation law 'creep'.*Install the package"):
        grammar.rebuilt(ModelChoice("creep", 1, 3, 0, "shared", "power * creep", (RESOLUTION, WINDOW)), 8.0)


NAMES = [
    *(f"{static} * linear * fractional" for static in STATIC),
    *(f"power * quadratic * {relaxation}" for relaxation in of_kind("relaxation")),
    *(f"exponential * tangent * {one}" for one in of_kind("relaxation", "spectrum")),
    "polynomial * tangent * prony:3",
    "flat * prony:2",
]
DAMPED = [f"power * {one}" for one in of_kind("damping")]


@pytest.mark.parametrize("name", NAMES)
def test_ticks_follow_the_force_of_the_model(name):
    """A ramp, a hold and a slow return to half depth, in lasting contact: within 0.01 % of the most."""
    model, theta = of_law(name)
    time = np.arange(0.0, 3.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0, 3.0], [0.0, DEPTH_MM, DEPTH_MM, 0.7 * DEPTH_MM])
    expected = model.force(theta, ContactPath(time, depth))
    assert expected.min() >= 0.0
    assert np.abs(walked(model, theta, time, depth) - expected).max() < 1e-4 * expected.max()


@pytest.mark.parametrize("name", NAMES)
def test_a_projection_says_what_it_misses(name):
    model, theta = of_law(name)
    law = servo_law(model, theta)
    assert law.tau_s.size <= 12
    assert (law.stiffness[:, 0] > 0.0).all()
    # on a fixed grid of as many times the springpot is 7e-4 off, with times and weights fitted at once 1e-4
    assert law.error < 6e-5
    if model.relaxation.branches or model.fixed_s.size:
        assert law.error == 0.0


@pytest.mark.parametrize(
    "name", [NAMES[0], *(pytest.param(one, marks=pytest.mark.needs_jit) for one in NAMES[1:]), *DAMPED]
)
def test_loops_put_out_no_energy(name):
    """Random closed loops: the work done on the tissue is never negative."""
    rng = np.random.default_rng([7, *name.encode()])
    model, theta = of_law(name)
    for _ in range(6):
        assert_no_energy(model, theta, rng, turns=7)


def test_a_kelvin_voigt_law_is_packed_as_it_is():
    model, theta = kelvin_voigt(2, 1, DEPTH_MM), np.array([20.0, -1.2, 0.35, 30.0, 4.0, 0.1, 12.0, 0.5, 2.0])
    expected = np.zeros(LAW_SIZE)
    static, stiffness, tau = model.split(theta)
    pack_law(np.array([0.0, *static]), stiffness, tau, DEPTH_MM, expected, 0)
    np.testing.assert_array_equal(servo_law(model, theta).packed(), expected)


@pytest.mark.parametrize("name", ["power * linear * fractional", "polynomial * tangent * prony"])
def test_a_tissue_made_stiffer_has_all_its_forces_times_that(name):
    model, theta = of_law(name)
    assert_stiffer_scales_forces(model, theta, 6.0 * np.arange(0.0, 1.0, TICK))


INSIDE_S, OUTSIDE_S = (0.05, 1.2), (0.02, 0.7)


def drawn(seed=0):
    """A yardstick with weights of which some are nothing."""
    model, rng = yardstick_of(DEPTH_MM, INSIDE_S, OUTSIDE_S), np.random.default_rng(seed)
    theta = rng.exponential(20.0, len(model.parameters)) * (rng.random(len(model.parameters)) < 0.6)
    theta[0] = 15.0
    return model, theta


def test_curves_grow_and_presents_add_up_to_one():
    model, x = yardstick_of(DEPTH_MM, INSIDE_S, OUTSIDE_S), np.linspace(0.0, DEPTH_MM, 200)
    parts = model.static.basis(x)
    assert parts.shape == (INSIDE, 200)
    assert (np.diff(parts, axis=1) >= -1e-12).all()
    np.testing.assert_allclose(parts[:, [0, -1]], [[0.0, 1.0]] * INSIDE, atol=1e-12)
    by_hand = np.gradient(parts, x, axis=1)[:, 2:-2]
    np.testing.assert_allclose(model.static.slope(x)[:, 2:-2], by_hand, atol=2e-3)
    shares = presents(x / DEPTH_MM)
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)


def test_force_is_that_of_the_integral():
    """Convolution by quadrature on a fine grid, written here."""
    model, theta = drawn()
    fine = np.linspace(0.0, 2.0, 40_001)
    x = np.interp(fine, [0.0, 1.0, 2.0], [0.0, DEPTH_MM, 0.8 * DEPTH_MM])
    force = model.static_force(theta, x)
    middle, step = 0.5 * (fine[1:] + fine[:-1]), np.diff
    for j, tau in enumerate((*INSIDE_S, *OUTSIDE_S)):
        part = theta[model.parts[j].stiffness]
        inside = j < len(INSIDE_S)
        curve = part @ model.static.basis(x) if inside else x
        left = np.exp(-(fine[-1] - middle) / tau) @ step(curve)
        force[-1] += left * (1.0 if inside else part @ presents(np.array([x[-1] / DEPTH_MM]))[:, 0])
    coarse = np.linspace(0.0, 2.0, 8001)
    found = model.force(theta, ContactPath(coarse, np.interp(coarse, fine, x)))
    assert found[-1] == pytest.approx(force[-1], rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_ticks_follow_the_force_of_the_yardstick(seed):
    model, theta = drawn(seed)
    time = np.arange(0.0, 2.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0], [0.0, DEPTH_MM, DEPTH_MM])
    expected = model.force(theta, ContactPath(time, depth))
    assert np.abs(walked(model, theta, time, depth) - expected).max() < 0.01 * expected.max()
    assert_stiffer_scales_forces(model, theta, depth[:50])


@pytest.mark.parametrize("seed", range(6))
def test_loops_of_the_yardstick_put_out_no_energy(seed):
    model, theta = drawn(seed)
    assert_no_energy(model, theta, np.random.default_rng(seed), turns=9)


def test_stiffness_is_the_slope_of_a_small_sudden_move():
    model, theta = drawn(2)
    at, step = 5.0, 1e-5
    time = np.concatenate([np.linspace(0.0, 1.0, 500), np.linspace(1.0, 300.0, 3000)[1:]])
    depth = np.concatenate([np.linspace(0.0, at, 500), np.full(2999, at)])
    before = model.force(theta, ContactPath(time, depth))[-1]
    moved = ContactPath(np.append(time, time[-1] + 1e-9), np.append(depth, at + step))
    rise = (model.force(theta, moved)[-1] - before) / step
    expected = model.static_slope(theta, np.array([at]))[0] + model.stiffness(theta, np.array([at])).sum()
    assert rise == pytest.approx(expected, rel=1e-3)


def test_it_is_built_again_from_its_nodes_and_refuses_negative_weights():
    choice = ModelChoice("yardstick", 4, 3, 2, "shared", "yardstick", (0.02, 1.2), INSIDE_S, OUTSIDE_S)
    model, theta = drawn()
    again = grammar.rebuilt(ModelChoice.of(typed(choice.as_json(), Model)), DEPTH_MM)
    assert again.parameter_names == model.parameter_names
    assert len(model.parameters) == INSIDE * (1 + len(INSIDE_S)) + OUTSIDE * len(OUTSIDE_S)
    assert again.is_passive(theta)
    assert not again.is_passive(np.where(np.arange(theta.size) == 3, -1.0, theta))


def test_names_of_choices():
    assert grammar.parsed("yardstick").mark
    auto = grammar.candidates("auto")
    assert auto.choose
    assert auto.paper is not None
    assert [one.mark for one in auto.laws] == [False, False, True]
    assert not grammar.candidates("kelvin-voigt").choose
    several = grammar.candidates("power * fung | polynomial * prony:2|flat*stretched")
    assert several.choose
    assert several.paper.branches == 2
    assert [one.name for one in several.laws] == ["power * fung", "flat*stretched"]
    with pytest.raises(grammar.ModelNameError, match="are one law"):
        grammar.candidates("kelvin-voigt | polynomial * prony:1")
    with pytest.raises(grammar.ModelNameError, match="'auto' is no model"):
        grammar.candidates("auto | power * fung")
    assert len(grammar.described()) == len({row["key"] for row in grammar.described()})
