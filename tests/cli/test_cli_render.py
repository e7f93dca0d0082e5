"""``tissueid render`` and ``view``: a log that fits back, refusals before any force, what opens by itself."""

import json
import signal
import webbrowser
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest
from command_line import QUICK, read_json, run, start, until
from rendered_tissues import PAPER_A, bundle_of
from session_heads import head_of, records_of, summary_of

from tissueid.cli import view_command
from tissueid.cli.render_command import RenderFlags, _demonstrated
from tissueid.cli.view_command import open_browser, telling_stop
from tissueid.documents.session import Session
from tissueid.errors import InputError
from tissueid.haptics.states import Lamp, State
from tissueid.ingest import read_trials, session
from tissueid.rendering.recorder import Recorder
from tissueid.store.bundle import write_bundle
from tissueid.store.schema import check
from tissueid.store.session_log import read_session_log

#: Thousands of ticks in each test: without compilation they take minutes.
pytestmark = pytest.mark.needs_jit

PRESS = "indent 8 mm at 250 mm/min; hold 2 s"
SHORT = "indent 1 mm at 500 mm/min; retract at 500 mm/min"
PRESSED = ("--device", "sim", "--virtual", "--script", SHORT)
TAU = PAPER_A.theta[4]


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "bundle.h5"
    spread = 1.0 + 0.02 * np.random.default_rng(3).standard_normal((40, 1))
    write_bundle(bundle_of(PAPER_A, draws=PAPER_A.theta * np.append(np.ones((1, 4)), [[1.0]]) * spread), path)
    return path


@pytest.fixture(scope="module")
def log(bundle, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "out.h5"
    run("render", bundle, "--device", "sim", "--script", PRESS, "--virtual", "--log", path, code=0)
    return path


def identified(path: Path, out: Path) -> dict[str, Any]:
    run("fit", path, "-o", out, *QUICK, code=0)
    return read_json(out / "identification.json")["specimens"][0]


def test_the_log_fits_back_to_the_tissue_that_was_rendered(log, tmp_path):
    specimen = identified(log, tmp_path / "again")
    tau = next(one["value"] for one in specimen["parameters"] if one["name"] == "relaxation_time_s")
    assert tau == pytest.approx(TAU, rel=0.02)
    assert specimen["nrmsd"]["range"] <= 0.01
    assert specimen["specimen"] == "paper-a"
    assert "rendered" in {flag["code"] for trial in specimen["trials"] for flag in trial["flags"]}


def test_forces_at_the_limit_of_the_device_are_told_as_clipped(bundle, tmp_path, monkeypatch):
    log, script = tmp_path / "deep.h5", "indent 16 mm at 250 mm/min; hold 1 s"
    run("render", bundle, "--device", "sim", "--script", script, "--virtual", "--log", log, code=0)
    whole = read_session_log(log)
    at_limit = whole.records["lamps"] & Lamp.CLIPPED != 0
    records = whole.records.copy()
    # lengths of vectors of one length differ in the last digit
    records["force_N"][np.flatnonzero(at_limit)[::2]] *= 1.0 - 2.0**-52
    monkeypatch.setattr(session, "read_session_log", lambda *_, **__: replace(whole, records=records))
    (trial,) = read_trials(log)
    (clipped,) = [flag for flag in trial.flags if flag.code == "clipped_force"]
    assert np.count_nonzero(trial.force_N == clipped.values["force_N"]) == np.count_nonzero(at_limit) > 1000


@pytest.mark.parametrize("lamp", [Lamp.RAMPING, Lamp.SILENT, Lamp.LATENCY])
def test_a_pause_of_the_force_in_contact_is_no_part_of_the_recording(log, monkeypatch, lamp):
    whole = read_session_log(log)
    records = whole.records.copy()
    engaged = np.flatnonzero(records["state"] == State.ENGAGED)
    pause = engaged[len(engaged) // 2 :][:300]
    assert (records["depth_mm"][pause] > 0.0).all()
    records["force_N"][pause] *= np.linspace(0.0, 1.0, pause.size)[:, None]
    records["lamps"][pause] |= np.uint32(lamp)
    monkeypatch.setattr(session, "read_session_log", lambda *_, **__: replace(whole, records=records))
    (paused,) = read_trials(log)
    # what the flag says is of the whole session
    (flag,) = (one for one in paused.flags if one.code == "rendered")
    assert max(flag.values.get(f"{word}_share", 0.0) for word in ("ramping", "silent", "late")) > 0.0
    monkeypatch.undo()
    (trial,) = read_trials(log)
    assert trial.time_s.size - paused.time_s.size == pause.size
    assert np.isin(paused.force_N, trial.force_N).all()


def test_a_log_without_a_tick_of_the_tissues_force_is_refused(log, monkeypatch):
    whole = read_session_log(log)
    records = whole.records[whole.records["depth_mm"] > 0.0].copy()
    records["lamps"] |= np.uint32(Lamp.LATENCY)
    monkeypatch.setattr(session, "read_session_log", lambda *_, **__: replace(whole, records=records))
    with pytest.raises(InputError, match="silent or late all the time"):
        read_trials(log)


def test_the_numbers_of_scale_and_stability_are_printed_before_and_kept_in_the_log(bundle, tmp_path):
    path = tmp_path / "out.h5"
    ended = run("render", bundle, *PRESSED, "--log", path, "--json", code=0)
    document = ended.json()
    scale = document["scale"]
    assert scale["required_damping_N_s_per_m"] <= scale["device_damping_N_s_per_m"]
    assert f"felt force = measured/{1.0 / scale['force_scale']:.4g}" in ended.stderr
    head = read_session_log(path).head
    assert head["scale"] == scale
    check(dict(head), Session, where="log")
    assert document["summary"]["deepest_mm"] == pytest.approx(1.0, abs=0.01)
    assert document["summary"]["shares"]["clipped"] == 0.0


@pytest.mark.parametrize("seconds", [1, 20])
def test_a_simulated_grip_that_nobody_moves_pushes_until_the_time_is_over(bundle, seconds):
    ended = run("render", bundle, "--device", "sim", "--virtual", "--seconds", seconds, "--json", code=0)
    summary = ended.json()["summary"]
    # virtual time ends with a whole block of ticks
    assert seconds <= summary["seconds"] <= seconds + 1.0
    if seconds > 1:
        # 6 mm at the fastest speed, held and taken back, takes 4 s: several pushes
        assert summary["deepest_mm"] == pytest.approx(6.0, abs=0.1)
        assert summary["peak_device_force_N"] > 0.1
        assert 0.4 < summary["contact_share"] < 0.95


def in_real_time(path: Path, *args: object) -> Any:
    """A session in real time; one that a busy processor ended or limited is tried again, four times."""
    for _ in range(5):
        path.unlink(missing_ok=True)
        ended = run("render", *args, "--log", path, code=0)
        log = read_session_log(path)
        whole = log.summary is not None and log.summary["deepest_mm"] > 0.98
        if whole and untouched(log.records)["tissue_force_N"].max(initial=0.0) > 10.0:
            break
    return ended


def untouched(records: np.ndarray) -> np.ndarray:
    """Ticks that no limit touched."""
    return records[(records["lamps"] & 0x5A5) == 0]


def test_the_servo_process_renders_in_real_time_and_names_the_log(bundle, tmp_path):
    path = tmp_path / "live.h5"
    ended = in_real_time(path, bundle, "--device", "sim", "--script", SHORT)
    assert str(path) in ended.stderr
    assert "period error" in ended.stderr
    records = read_session_log(path).records
    assert (np.diff(records["tick"]) == 1).all()
    felt = untouched(records)
    scale = read_session_log(path).head["scale"]["force_scale"]
    # every tick that no limit touched carries the tissue's force at the stated scale
    assert felt["force_N"][:, 2] == pytest.approx(felt["tissue_force_N"] * scale, rel=1e-9, abs=1e-9)
    assert felt["tissue_force_N"].max() > 10.0


def test_a_fault_in_virtual_time_says_its_reason(bundle):
    script = "indent 5 mm at 200 mm/s; retract at 200 mm/s"
    asked = ("--device", "sim", "--virtual", "--motion-scale", "10", "--script", script)
    run("render", bundle, *asked, code=5, said="the servo took the force away: the grip moved faster")


@pytest.mark.usefixtures("empty_usb")
def test_auto_says_what_it_took_and_without_a_device_the_refusal_names_the_simulated_one(bundle):
    said = "device sim, simulated: no haptic device was found"
    run("render", bundle, "--script", SHORT, "--virtual", code=0, said=said)
    run("render", bundle, "--device", "falcon", code=5, said=("no falcon was found", "--device sim"))


def test_a_device_that_cannot_be_reached_is_refused_before_anybody_is_asked(bundle, tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEID_LIBUSB", str(tmp_path / "none.so"))
    said = ("can't be loaded, and a Falcon needs it", "--device sim")
    assert "consent" not in run("render", bundle, "--device", "falcon", code=5, said=said).stderr
    port = ("--port", "/dev/no-such-port")
    ended = run("render", bundle, "--device", "falcon", *port, code=5)
    assert "/dev/no-such-port: there is no such device" in ended.stderr
    assert "dead-man" not in ended.stderr


@pytest.mark.parametrize(
    ("code", "args", "said"),
    [
        (2, ("--script", "indent 8 mm"), "no stroke of a script"),
        (2, ("--script", "indent 2 mm at 250 mm/min; switch"), "retract first"),
        (2, ("--quantile", "2"), "must lie within 0 and 1"),
        (2, ("--draw", "4000"), "draws 0 to 39"),
        (2, ("--quantile", "0.5", "--draw", "1"), "give one of"),
        (2, ("--quantile", "0.5", "--of", "stiffness"), "is not understood"),
        (2, ("--quantile", "0.5", "--of", "force at 20 mm, 250 mm/min"), "deeper than"),
        (2, ("--device", "nope"), "no device named"),
        (2, ("--surface", "cube"), "sphere 60 mm"),
        (2, ("--motion-scale", "0"), "must lie within"),
        (2, ("--blind",), "--against"),
        (2, ("--against-draw", "1", "--blind"), "add --log"),
        (2, ("--against-draw", "1", "--blind", "--pseudonym", "Anna Smith"), "could be a name"),
        (2, ("--pseudonym", "P1"), "belong to --blind"),
        (2, ("--bridge", "99999", "--seconds", "1"), "give a port"),
        (2, ("--environment", "nope"), "takes the place of a tissue"),
        (2, ("--preset", "paper-a"), "not both"),
        (2, ("--seconds", "-1"), "must be above 0"),
        (2, ("--virtual", "--bridge", "47110"), "--script"),
        (2, ("--port", "/dev/null"), "belongs to falcon"),
        (2, ("--host", "0.0.0.0"), "add --viewer"),
        (2, ("--bridge-token", "abc"), "add --bridge"),
        (2, ("--key", "key.json"), "add --blind"),
        (2, ("--out", "twin"), "add --twin"),
        (2, ("--replay", "log.h5"), "leave --device out"),
        (5, ("--force-scale", "0.05"), ("would be unstable", "the largest that fits")),
        (6, ("--tip-radius", "5"), "identified with a tip of 2 mm"),
        (6, ("--surface", "sphere 5 mm"), "too small"),
    ],
)
def test_what_cannot_be_is_answered_with_the_way_out(bundle, tmp_path, code, args, said):
    device = () if "--device" in args else ("--device", "sim")
    log = () if "--blind" in args else ("--log", tmp_path / "out.h5")
    run("render", bundle, *device, *args, *log, code=code, said=said)
    # a refused option leaves no log behind
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_a_fit_stands_for_its_bundle(bundle, tmp_path):
    felt = run("render", bundle.parent, *PRESSED, code=0)
    assert felt.stdout == run("render", bundle, *PRESSED, code=0).stdout
    assert f"'{tmp_path / 'bundle.h5'}' does not exist" in run("render", tmp_path, *PRESSED, code=2).stderr


def test_a_script_beyond_the_identified_depth_is_told_before_it_is_felt(bundle):
    script = ("--script", "indent 40 mm at 50 mm/s")
    deep = run("render", bundle, "--device", "sim", "--virtual", *script, code=0)
    assert "the script goes 40 mm deep, the tissue is identified to" in deep.stdout + deep.stderr
    assert "the script goes" not in run("render", bundle, *PRESSED, code=0).stdout


def test_two_tissues_are_compared_and_exchanged_out_of_contact(bundle, tmp_path):
    path = tmp_path / "out.h5"
    script = f"{SHORT}; switch; hold 0.6 s; {SHORT}"
    asked = ("--against-quantile", "0.99", "--device", "sim", "--script", script, "--virtual", "--log", path)
    run("render", bundle, *asked, code=0, said="times the just-noticeable difference")
    records = read_session_log(path).records
    swapped = np.flatnonzero(np.diff(records["label"].astype(int)) != 0)
    assert swapped.size == 1
    assert records["depth_mm"][swapped[0]] < 0.0
    peaks = [records["tissue_force_N"][records["label"] == label].max() for label in (0, 1)]
    assert peaks[1] > 1.01 * peaks[0]


def test_a_blind_session_keeps_its_answers_apart(bundle, tmp_path):
    path, key = tmp_path / "P3.h5", tmp_path / "answers.json"
    strokes = f"{SHORT}; switch; hold 0.6 s"
    ended = run(
        "render", bundle, "--against-quantile", "0.99", "--blind", "--presentations", "4", "--yes",
        "--pseudonym", "P3", "--key", key, "--device", "sim", "--virtual", "--log", path,
        "--script", "; ".join([strokes] * 3 + [SHORT]), code=0, said="You may stop at any time",
    )  # fmt: skip
    answers = read_json(key)
    assert sorted(one["tissue"] for one in answers["presentations"]) == [0, 0, 1, 1]
    assert key.stat().st_mode & 0o077 == 0
    log = read_session_log(path)
    assert sorted(set(log.records["label"])) == [1, 2, 3, 4]
    shown = json.dumps(log.head) + ended.stderr
    for secret in ("paper-a", str(bundle), "posterior draw", "quantile"):
        assert secret not in shown
    stiffer = {one["number"] for one in answers["presentations"] if one["tissue"] == 1}
    peaks = {
        label: log.records["tissue_force_N"][log.records["label"] == label].max() for label in (1, 2, 3, 4)
    }
    assert stiffer == set(sorted(peaks, key=lambda label: peaks[label])[-2:])


def test_consent_is_asked_for_where_somebody_can_answer(bundle, tmp_path):
    asked = ("--against-draw", "1", "--blind", "--presentations", "2", "--device", "sim")
    said = "give --yes where it was given"
    ended = run("render", bundle, *asked, "--log", tmp_path / "out.h5", code=2, said=said)
    # what is agreed to is read line by line
    assert "kept in a file apart." in ended.stderr.splitlines()
    assert "\\n" not in ended.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_replay_renders_the_motion_of_a_log_at_its_scale(bundle, tmp_path):
    first, second = tmp_path / "first.h5", tmp_path / "second.h5"
    run("render", bundle, *PRESSED, "--log", first, code=0)
    run("render", bundle, "--replay", first, "--script", SHORT, code=2, said="leave --script or --replay out")
    in_real_time(second, bundle, "--replay", first)
    one, other = read_session_log(first), read_session_log(second)
    assert other.head["scale"]["force_scale"] == one.head["scale"]["force_scale"]
    assert other.summary["deepest_mm"] == pytest.approx(one.summary["deepest_mm"], abs=0.02)
    # the same path in real time: the force differs by what the ticks' jitter moves along the ramp
    assert other.summary["peak_tissue_force_N"] == pytest.approx(one.summary["peak_tissue_force_N"], rel=0.02)


def test_an_interrupt_ends_a_session_with_zero_force_and_a_whole_log(bundle, tmp_path):
    path = tmp_path / "out.h5"
    process = start("render", bundle, "--device", "sim", "--script", "hold 60 s", "--log", path)
    part = tmp_path / "out.h5.part"
    until(lambda: part.exists() and part.stat().st_size > 100_000)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, out + err
    log = read_session_log(path)
    assert log.records.size > 500
    assert (log.records["force_N"][-1] == 0.0).all()
    assert log.summary is not None


def test_a_session_that_was_killed_leaves_whole_records_that_can_be_read(bundle, tmp_path):
    path = tmp_path / "out.h5"
    process = start("render", bundle, "--device", "sim", "--script", PRESS, "--log", path)
    part = tmp_path / "out.h5.part"
    until(lambda: part.exists() and part.stat().st_size > 300_000)
    process.kill()
    process.communicate()
    assert read_session_log(part).summary is None
    run("inspect", part, "-v", code={0, 7}, shown="session-log")


def recorded(folder: Path) -> Path:
    records = records_of(np.linspace(-0.5, 4.0, 1000))
    recorder = Recorder(folder / "out.h5", head_of())
    recorder.append(records)
    return recorder.finish(summary_of(records))


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (("render", "--preset", "meat", "--viewer", "--virtual", "--device", "sim"), 2, "tissueid view FILE"),
        (("render", "--preset", "meat", "--viewer", "--host", "203.0.113.9"), 2, "--host"),
        (("render", "--viewer", "--certificate", "c.pem"), 2, "TLS needs two files"),
        (("render", "--preset", "meat2", "--viewer", "--no-browser"), 2, "meat2"),
        (("render", "--device", "sim"), 2, ()),
        (("view", "no-such.h5"), 6, "no-such.h5"),
        (("view", "127.0.0.1:1"), 2, "nothing answers"),
    ],
)
def test_what_cannot_be_shown_or_felt_is_refused(args, code, said):
    assert "http://" not in run(*args, code=code, said=said).stderr  # no page of a session that isn't


def test_a_log_is_served_until_it_is_told_to_end(tmp_path):
    process = start("view", recorded(tmp_path), "--no-browser")
    line = process.stderr.readline()
    assert line.startswith("viewer     http://127.0.0.1:")
    while "Ctrl-C" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 0


def flags(**given: Any) -> RenderFlags:
    asked: dict[str, Any] = dict.fromkeys(one.name for one in fields(RenderFlags))
    return RenderFlags(**asked | {"name": "auto", "virtual": False, "viewer": False} | given)


def test_nothing_asked_for_opens_a_tissue_without_motors_and_what_was_is_not_replaced():
    assert _demonstrated(flags()) == flags(preset="paper-a", name="sim", viewer=True)
    asked = {"bundle": Path("b.h5"), "name": "falcon", "draw": 3, "virtual": True}
    for given in ({"name": "sim"}, *({key: value} for key, value in asked.items())):
        assert _demonstrated(flags(**given)) == flags(**given)


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch):
    opened = Mock()
    monkeypatch.setattr(webbrowser, "open", opened)
    monkeypatch.setattr(view_command.sys, "platform", "linux")
    for name in view_command.SCREENS:
        monkeypatch.delenv(name, raising=False)
    open_browser("http://127.0.0.1:1/")
    opened.assert_not_called()
    monkeypatch.setenv("DISPLAY", ":0")
    open_browser("http://127.0.0.1:1/")
    opened.assert_called_once_with("http://127.0.0.1:1/")


def test_a_recording_that_stopped_is_told_once():
    viewer, recorder, shown = Mock(tend=Mock(return_value=False)), SimpleNamespace(stopped=None), Mock()
    show = telling_stop(viewer, recorder, shown)  # type: ignore[arg-type]
    for number, stopped in enumerate((None, "the disk is full", "the disk is full")):
        recorder.stopped = stopped
        show(number, None)
    viewer.tell.assert_called_once_with(recording_stopped="the disk is full")
    assert shown.call_args_list == [call(0, None), call(1, None), call(2, None)]


def test_the_token_is_printed_with_a_remark_on_encryption():
    process = start(
        "render", "--preset", "meat", "--device", "sim", "--viewer", "--no-browser", "--host", "0.0.0.0"
    )
    said = [process.stderr.readline() for _ in range(2)]
    process.kill()
    process.communicate()
    assert "/?token=" in said[0]
    assert "unencrypted" in said[1]
