"""Hertz contact with the damping of Flores: restitution, latched speed, no tension."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import lambertw

from tissueid.model.base import ContactPath
from tissueid.model.channels import DampedModel, path_ratio
from tissueid.model.grammar import parsed
from tissueid.model.impact import IMPACT_SIZE, IMPACT_STATE, impact_step, pack_impact
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.restitution import damping_factor, damping_factors
from tissueid.model.servo_law import servo_law


def law(name: str = "power * impact") -> DampedModel:
    return parsed(name).model(8.0, 0.01, 10.0)


#: e asked for -> e that a free mass reaches under the printed damping (Lambert W).
REACHED = {0.3: 0.256, 0.5: 0.470, 0.7: 0.683, 0.9: 0.894}
MASS_KG = 0.6


def packed(*law: float, **given: float) -> tuple[np.ndarray, np.ndarray]:
    """The law's block, and a memory without a contact."""
    block = np.empty(IMPACT_SIZE)
    pack_impact(*law, block, 0, **{"slowest_mm_s": 1.0, **given})
    return block, np.zeros(IMPACT_STATE)


def drop(stiffness: float, exponent: float, chi: float, *, speed_mm_s: float, dt: float) -> float:
    """Speed after the contact of a free mass over that before it, by velocity Verlet."""
    block, memory = packed(stiffness, exponent, chi)
    depth, speed, force = -2.0 * speed_mm_s * dt, speed_mm_s, 0.0
    for _ in range(1_000_000):
        # N over kg in mm: a thousand mm a metre
        depth += speed * dt - 500.0 * force / MASS_KG * dt * dt
        after = impact_step(block, 0, memory, 0, depth, dt)
        speed -= 500.0 * (force + after) / MASS_KG * dt
        force = after
        if depth < 0.0 and speed < 0.0:
            return -speed / speed_mm_s
    raise AssertionError("the mass never left")


def rendered_drop(stiffness_SI: float, restitution: float, *, delay_ticks: int) -> float:
    """The same mass at 0.2 m/s against the law held from tick to tick at 1 kHz, its force some ticks late."""
    block, memory = packed(stiffness_SI * 1000.0**-1.5, 1.5, damping_factor(restitution))
    depth_m, speed, dt = -0.9 * 0.2 * 1e-3, 0.2, 1e-3
    waiting = [0.0] * delay_ticks
    for _ in range(100_000):
        waiting.append(impact_step(block, 0, memory, 0, 1e3 * depth_m, dt))
        acceleration = -waiting.pop(0) / MASS_KG
        depth_m += speed * dt + 0.5 * acceleration * dt * dt
        speed += acceleration * dt
        if depth_m < 0.0 and speed < 0.0 and not any(waiting):
            return -speed / 0.2
    raise AssertionError("the mass never left")


def test_the_speed_is_filtered_before_it_is_latched() -> None:
    block, memory = packed(10.0, 1.0, 1.0, filter_s=5e-3)
    for k in range(40):
        impact_step(block, 0, memory, 0, -4.0 + 0.1 * k, 1e-3)
    # 39 steps of 1 ms at 100 mm/s from rest
    assert memory[1] == pytest.approx(100.0 * (1.0 - math.exp(-39e-3 / 5e-3)))


def reached_restitution(chi: float) -> float:
    """Speed of a free mass after the contact over that before it, by Lambert's function."""
    return float((1.0 + lambertw(-(1.0 + chi) * math.exp(-(1.0 + chi))).real) / chi) if chi else 1.0


@pytest.mark.needs_jit
@pytest.mark.parametrize(("asked", "reached"), REACHED.items())
def test_a_drop_returns_with_what_the_printed_damping_gives(asked: float, reached: float) -> None:
    chi = damping_factor(asked)
    assert chi == pytest.approx(8.0 * (1.0 - asked) / (5.0 * asked))
    assert drop(600.0, 1.5, chi, speed_mm_s=200.0, dt=2e-6) == pytest.approx(reached, rel=0.01)
    assert reached_restitution(chi) == pytest.approx(reached, abs=6e-4)


@pytest.mark.needs_jit
@pytest.mark.parametrize("asked", REACHED)
@pytest.mark.parametrize(("stiffness", "exponent"), [(160.0, 1.0), (6000.0, 2.2)])
def test_the_exact_law_returns_what_was_asked_for(asked: float, stiffness: float, exponent: float) -> None:
    chi = damping_factor(asked, "exact")
    assert drop(stiffness, exponent, chi, speed_mm_s=100.0, dt=1e-6) == pytest.approx(asked, rel=0.01)


CHATTER = [-0.2, -0.1, 0.1, -0.01, 0.01]


@pytest.mark.parametrize(
    ("depths", "hysteresis_mm", "at", "expected"),
    [
        # in at 1 mm/s, then 100 mm/s: the factor stays within 1 + chi; v0 is the floor of 20 mm/s
        ([-1e-3, 0.0, 1e-3, 0.101, 0.201], 0.0, -1, 10.0 * 0.201 * 3.0),
        ([-1e-3, 0.0, 1e-3], 0.0, -1, 10.0 * 1e-3 * (1.0 + 2.0 * 1.0 / 20.0)),
        # out at half the speed it came in with: 1 - chi / 2 = 0 of the elastic force
        ([-0.1, 0.0, 0.1, 0.2, 0.15, 0.05, -0.05], 0.0, 4, 0.0),
        # 200 mm/s in; after a hair's breadth outside the second entry, at 20 mm/s, is latched anew or not
        (CHATTER, 0.05, -1, 0.1 * (1.0 + 2.0 * 20.0 / 200.0)),
        (CHATTER, 0.0, -1, 0.1 * 3.0),
    ],
)
def test_force_follows_the_speed_latched_at_contact_and_never_pulls(depths, hysteresis_mm, at, expected):
    """Ticks of 1 ms, k = 10 N/mm, chi = 2."""
    block, memory = packed(10.0, 1.0, 2.0, slowest_mm_s=20.0, hysteresis_mm=hysteresis_mm)
    found = [float(impact_step(block, 0, memory, 0, depth, 1e-3)) for depth in depths]
    assert found[at] == pytest.approx(expected, abs=1e-12)
    assert min(found) == 0.0


@pytest.mark.parametrize("restitution", [0.0, 0.049, 1.01, math.nan])
def test_a_restitution_without_a_bounded_force_is_refused(restitution: float) -> None:
    with pytest.raises(ValueError, match=r"within 0\.05 and 1"):
        damping_factor(restitution)
    assert not law().is_passive(np.array([1.0, 1.5, restitution]))


def test_a_servo_s_contact_is_right_where_it_is_soft_and_makes_energy_where_it_is_stiff() -> None:
    # a contact of some 90 ms: a tick is a phase of a few percent
    assert rendered_drop(2e3, 0.5, delay_ticks=0) == pytest.approx(REACHED[0.5], rel=0.06)
    assert rendered_drop(2e5, 1.0, delay_ticks=0) > 1.05


@pytest.mark.slow
def test_what_a_servo_at_1_khz_makes_of_restitution() -> None:
    sys.stdout.write("\nreached restitution, 0.6 kg at 0.2 m/s, k in N/m^1.5, at 1 kHz; fine steps first\n")
    for restitution in (0.3, 0.5, 0.7, 0.9, 1.0):
        row = [f"e {restitution:.1f}  fine {reached_restitution(damping_factor(restitution)):.3f}"]
        for stiffness in (5e3, 2e4, 5e4, 2e5):
            found = [rendered_drop(stiffness, restitution, delay_ticks=ticks) for ticks in (0, 1)]
            row.append(f"k {stiffness:.0e}: {found[0]:.3f}, a tick late {found[1]:.3f}")
            assert 0.0 < found[0] < 2.0
        sys.stdout.write("  ".join(row) + "\n")


def test_each_contact_has_its_own_speed() -> None:
    depth, theta = np.array([-1.0, 1.0, 2.0, 2.0, -1.0, 3.0, 4.0]), np.array([1.0, 1.0, 0.5])
    # in at 2 mm/s, on at 1, held; in again at 4 mm/s, on at 1; or a ratio that is given
    told = np.array([0.0, 1.0, 0.5, 0.0, 0.0, 1.0, 0.25])
    for given, ratio in ((None, told), (np.full(7, 0.5), 0.5)):
        found = law().force(theta, ContactPath(np.arange(7.0), depth, given))
        np.testing.assert_allclose(found, np.maximum(depth, 0.0) * (1.0 + damping_factor(0.5) * ratio))


@pytest.mark.parametrize("name", ["power * impact", "power * impact-exact"])
def test_a_compiled_tick_is_the_law(name: str) -> None:
    model, theta = law(name), np.array([12.0, 1.5, 0.6])
    servo = replace(servo_law(model, theta), own=np.array([[model.factor(theta), 1e-3, 0.0, 0.0]]))
    packed, state = servo.packed(), np.zeros(STATE_SIZE)
    time = np.arange(0.0, 0.4, 1e-3)
    depth = np.interp(time, [0.0, 0.1, 0.2, 0.3, 0.4], [-1.0, 7.0, 7.0, 4.0, -1.0])
    felt = [
        tissue_step_in(packed, 0, state, 0, x, h)
        for x, h in zip(depth, np.diff(time, prepend=0.0), strict=True)
    ]
    static = np.array([tissue_step_in(packed, 0, np.zeros(STATE_SIZE), 0, x, 0.0) for x in depth])
    expected = static * np.maximum(1.0 + model.factor(theta) * path_ratio(ContactPath(time, depth)), 0.0)
    np.testing.assert_allclose(felt, expected, rtol=1e-12, atol=1e-12)
    # cubic pieces of the power
    truth = model.force(theta, ContactPath(time, depth))
    assert np.abs(felt - truth).max() < 2e-3 * truth.max()


def test_the_exact_factor_is_that_of_its_restitution_and_none_at_one() -> None:
    values = np.linspace(0.05, 1.0, 40)
    reached = [reached_restitution(chi) for chi in damping_factors(values, "exact")]
    np.testing.assert_allclose(reached, values, atol=1e-6)
    assert damping_factor(1.0, "exact") == pytest.approx(0.0, abs=1e-7)
