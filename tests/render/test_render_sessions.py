"""Thousands of seeded sessions: a hand, an arm, encoders, a delayed wire, the servo's tick, a fitted tissue.

Energy is counted at the true port of the arm (unquantised position, force felt, its own damping and
friction), from the beginning of each touch, so that what air dissipated pays for nothing.
"""

from __future__ import annotations

import closed_loop as loop
import numpy as np
import pytest

from tissueid.haptics.arm import Arm
from tissueid.haptics.hand import PRESETS as HANDS
from tissueid.haptics.hand import preset
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.sim import SimulatedDevice
from tissueid.haptics.states import Fault, State
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rendering.options import ASSUMED_DEVICE, PRESETS
from tissueid.rendering.precheck import check_before_force
from tissueid.rendering.tissue_block import Tissue

pytestmark = pytest.mark.needs_jit

#: Hands that rest at the end of a session; a limit cycle would show in them.
RESTING = ("step", "slow press", "hold")
#: Rise of force a tick that the guard allows [N], and rounding.
SLEW_N = 0.5 + 1e-9
#: One session in five lies within a tenth of the passivity bound.
NEAR_EVERY = 5


def judged(count: int, *, pool_size: int, controller: bool = False) -> tuple[list[loop.Setting], np.ndarray]:
    """Settings and figures of sessions 0 to count - 1."""
    sessions = [
        loop.drawn_session(seed, near=seed % NEAR_EVERY == 0, pool_size=pool_size, controller=controller)
        for seed in range(count)
    ]
    return [setting for setting, _ in sessions], np.array([figures for _, figures in sessions])


def told(settings: list[loop.Setting], figures: np.ndarray) -> str:
    """Margins by tissue and hand."""
    head = "tissue    hand        sessions  least energy  share kept  largest rise  swing  largest force"
    lines = [f"{head}  quantised ledger"]
    for tissue in PRESETS:
        for hand in HANDS:
            rows = figures[[one.tissue == tissue and one.hand == hand for one in settings]]
            if rows.size == 0:
                continue
            swing = f"{rows[:, loop.SWING].max():5.0f}" if hand in RESTING else "    -"
            lines.append(
                f"{tissue:9s} {hand:11s} {len(rows):8d} {1e6 * rows[:, loop.LEAST_J].min():10.3f} uJ "
                f"{rows[:, loop.KEPT].min():11.3f} {rows[:, loop.RISE_N].max():11.3f} N {swing} "
                f"{rows[:, loop.LARGEST_N].max():12.2f} N {1e6 * rows[:, loop.LEDGER_J].min():14.1f} uJ"
            )
    return "\n".join(lines)


def must_be_passive_quiet_and_gentle(settings: list[loop.Setting], figures: np.ndarray) -> None:
    """At the true port, in holds, and in every rise; without a fault."""
    resting = np.array([setting.hand in RESTING for setting in settings])
    assert figures[:, loop.MARGIN_J].min() >= 0.0
    assert figures[resting, loop.SWING].max() <= 1.0
    assert figures[:, loop.RISE_N].max() <= SLEW_N
    assert set(figures[:, loop.FAULT_AT_END]) == {float(Fault.NONE)}


def test_sessions_are_passive_at_the_true_port_quiet_in_holds_and_rise_gently():
    settings, figures = judged(300, pool_size=3)
    near = np.array([setting.near for setting in settings])
    must_be_passive_quiet_and_gentle(settings, figures)
    assert (figures[:, loop.DEEPEST_MM] > 0.0).all()
    assert set(figures[:, loop.STATE_AT_END]) == {float(State.ENGAGED)}
    shares = np.array([setting.share_of_bound for setting in settings])
    assert ((shares[near] >= 0.9) & (shares[near] <= 1.0)).all()
    # every touch that ended had cost the hand something
    assert figures[:, loop.KEPT].min() > 0.0


def test_the_controller_never_kicks_and_leaves_a_passive_rendering_alone():
    _, figures = judged(40, pool_size=3, controller=True)
    _, without = judged(40, pool_size=3)
    assert figures[:, loop.KICK_N].max() <= 0.5
    assert figures[:, loop.MARGIN_J].min() >= 0.0
    np.testing.assert_allclose(figures[:, loop.LARGEST_N], without[:, loop.LARGEST_N], atol=0.5)


def wall(*, controller: bool) -> np.ndarray:
    """Figures of a light hand that taps an elastic wall far beyond the bound of its device."""
    tissue = Tissue(
        kelvin_voigt(branches=0, stiffness_degree=0, depth_mm=8.0), np.array([250.0, 0.0, 0.0]), (1.0, 10.0)
    )
    device = SimulatedDevice(
        GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False, ramp_s=0.5),
        arm=Arm(damping_N_s_per_m=0.0, friction_N=0.0),
        hand=preset(
            "tap",
            surface_m=loop.SURFACE,
            inward=loop.INWARD,
            depth_m=0.004,
            stiffness_N_per_m=200.0,
            damping_N_s_per_m=0.1,
            rest_s=0.6,
        ),
        delay_ticks=2.0,
    )
    return loop.in_closed_loop(device, tissue, 0.02, np.full(2300, 1e-3), controller=controller)


def test_a_wall_beyond_the_bound_gives_energy_and_is_caught_by_the_same_bars():
    figures = wall(controller=False)
    assert figures[loop.MARGIN_J] < -1e-3
    assert figures[loop.KEPT] < 0.0
    restrained = wall(controller=True)
    assert 0.0 < restrained[loop.KICK_N] <= 0.5
    assert restrained[loop.MARGIN_J] > figures[loop.MARGIN_J]


@pytest.mark.parametrize("name", list(PRESETS))
def test_the_bound_of_the_pool_is_the_one_that_the_check_computes(name):
    tissue, needs = loop.pool(name, 3)[0]
    of_pool = check_before_force(tissue, ASSUMED_DEVICE)
    assert needs[1.5] * of_pool.scaling.force == pytest.approx(of_pool.required_damping_N_s_per_m, rel=1e-9)


@pytest.mark.slow
def test_ten_thousand_sessions_within_the_posteriors(capsys):
    settings, figures = judged(10_000, pool_size=40)
    _, braked = judged(1_000, pool_size=40, controller=True)
    near = np.array([setting.near for setting in settings])
    shares = np.array([setting.share_of_bound for setting in settings])
    with capsys.disabled():
        print(f"\n{told(settings, figures)}")  # noqa: T201
        codes = figures[:, loop.FAULT_AT_END].astype(int)
        faults = {Fault(code).name: int((codes == code).sum()) for code in np.unique(codes)}
        print(  # noqa: T201
            f"{near.sum()} sessions with the bound at {100 * shares[near].min():.0f} to "
            f"{100 * shares[near].max():.0f} % of the damping; margin to the bar "
            f"{1e6 * figures[:, loop.MARGIN_J].min():.3f} uJ of {1e6 * loop.ALLOWANCE_J:.0f} uJ; "
            f"controller: largest change {braked[:, loop.KICK_N].max():.3f} N a tick; ends: {faults}"
        )
    assert (near & (shares >= 0.9) & (shares <= 1.0)).sum() >= 1_000
    must_be_passive_quiet_and_gentle(settings, figures)
    assert braked[:, loop.KICK_N].max() <= 0.5
