"""Findings of a measuring machine at the grip of an emulated Falcon: is it the tissue that was rendered?

Position and force are the arm's true ones: behind them lie encoder counts, the wire, both kinematics, motor
units and the delay.  With the scales undone they are a recording, of which `tissueid fit` must find the time.
A force that comes late is a relaxation that seems longer: 1.5 ticks of delay and half a tick of holding are
2 ms of 21 ms.  The delay is a number that a session states, so that it is undone as the scales are.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from emulated_session import HOMED_S, TICK_S, EmulatedSession

from tissueid.cli.main import main
from tissueid.haptics.hand import parse_script, scripted_hand
from tissueid.haptics.states import Fault, State
from tissueid.rendering.options import ASSUMED_DEVICE, preset_tissue
from tissueid.store.session_log import raw_head, read_session_log

pytestmark = pytest.mark.needs_jit

SCRIPT = "indent 8 mm at 250 mm/min; hold 2 s"
TAU_S = float(preset_tissue("paper-a").theta[4])
#: From a position to the middle of the force it causes [ticks].
LATE_TICKS = ASSUMED_DEVICE.delay_ticks + 0.5
QUICK = ("--branches", "1", "--stiffness-degree", "0", "--sampler", "none", "--quiet")
#: Rest before the script, longer than the start-up ramp [s].
REST_S = 0.7


def at_the_grip(seed: int) -> np.ndarray:
    """Time [s], depth [mm] and force [N] of the tissue, by the arm's truth."""
    rng = np.random.default_rng([44, seed])
    surface = np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.1445 + rng.uniform(-1e-3, 1e-3)])
    where = {"surface_m": surface, "inward": np.array([0.0, 0.0, -1.0])}
    hand = scripted_hand(parse_script(SCRIPT), motion_scale=5.0, rest_s=REST_S, **where)
    with EmulatedSession(hand=hand, surface_z=float(surface[2])) as session:
        scale = session.scale
        assert scale.motion == 5.0
        truth = []
        while session.falcon.time_s < HOMED_S + REST_S + 0.12 + 8.0 * 60.0 / 250.0 + 2.0:
            session.tick()
            depth = (surface[2] - session.falcon.position_m[2]) / scale.motion * 1e3
            truth.append((session.falcon.time_s, depth, session.falcon.force_N[2] / scale.force))
        assert session.states()[-1] is State.ENGAGED
        assert session.first(Fault.ENCODER_JUMP) == -1
    # the guard's ramp and the rest above the tissue are no recording
    skipped = round((REST_S - 0.1) / TICK_S)
    return np.array(truth)[skipped:]


def earlier(recording: np.ndarray, ticks: float) -> np.ndarray:
    """The recording with its force moved to an earlier time."""
    time, depth, force = recording.T
    moved = np.column_stack([time, depth, np.interp(time + ticks * TICK_S, time, force)])
    return moved[: -round(ticks + 1)]


def fitted_tau(recording: np.ndarray, folder: Path) -> float:
    """Relaxation time [s] that `tissueid fit` finds in a recording of time, depth and force."""
    folder.mkdir()
    file = folder / "grip.csv"
    rows = "\n".join(f"{time:.6f},{depth:.7f},{force:.6f}" for time, depth, force in recording)
    file.write_text(f"Time (s),Displacement (mm),Force (N)\n{rows}\n", encoding="utf-8")
    assert main(["fit", str(file), "-o", str(folder / "out"), *QUICK]) == 0
    found = json.loads((folder / "out" / "identification.json").read_text(encoding="utf-8"))
    parameters = found["specimens"][0]["parameters"]
    return float(next(one["value"] for one in parameters if one["name"] == "relaxation_time_s"))


@pytest.mark.parametrize(("which", "factor"), [("force_scale", 1.02), ("motion_scale", 0.98)])
def test_a_log_that_states_a_wrong_scale_is_detected(tmp_path, capsys, which, factor):
    log, wrong = tmp_path / "out.h5", tmp_path / "wrong.part"
    render = ["render", "--preset", "paper-a", "--device", "sim", "--virtual", "--quiet"]
    assert main([*render, "--script", "indent 1 mm at 500 mm/min", "--log", str(log)]) == 0
    kept = read_session_log(log)
    stated = {**kept.head["scale"], which: kept.head["scale"][which] * factor}
    head = {key: value for key, value in kept.head.items() if key not in {"schema", "record", "summary"}}
    wrong.write_bytes(raw_head({**head, "scale": stated}, kept.records.dtype) + kept.records.tobytes())
    capsys.readouterr()
    assert main(["fit", str(wrong), "-o", str(tmp_path / "fit"), *QUICK]) == 3
    assert f"the {which.split('_')[0]} scale that the log states" in capsys.readouterr().err


@pytest.mark.slow
def test_twenty_sessions_have_the_relaxation_time_of_the_tissue_in_the_mean(tmp_path, capsys):
    undone, raw = [], []
    for seed in range(20):
        truth = at_the_grip(seed)
        undone.append(fitted_tau(earlier(truth, LATE_TICKS), tmp_path / f"{seed}"))
        raw.append(fitted_tau(truth, tmp_path / f"raw-{seed}"))
    with capsys.disabled():
        for what, found in (("delay undone", undone), ("delay left in", raw)):
            off = 100.0 * (np.array(found) / TAU_S - 1.0)
            error = off.std(ddof=1) / np.sqrt(off.size)
            print(f"\n{what}: mean tau {off.mean():+.1f} +- {error:.1f} % (sd {off.std(ddof=1):.1f} %)")  # noqa: T201
    assert np.mean(undone) == pytest.approx(TAU_S, rel=0.05)
    # what the delay alone does to a relaxation time, and no more
    assert np.mean(raw) - np.mean(undone) == pytest.approx(LATE_TICKS * TICK_S, rel=0.5)
