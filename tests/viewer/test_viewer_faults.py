"""Faults around the viewer: whoever dies or hangs, the session goes on, and nobody keeps a hand pressed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_server import Live, greeted, served, until
from rendered_session import Session
from session_heads import head_of

from tissueid.cli.view_command import telling_stop
from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import POINTER, SharedHand
from tissueid.store.session_log import read_session_log
from tissueid.viewer import server, serving
from tissueid.viewer.hello import hello
from tissueid.viewer.server import HandPointer
from tissueid.viewer.serving import ServedViewer, ViewerOptions

REST_M = [0.0, 0.0, 0.15]
WORKSPACE_M = [[-0.04, 0.04], [-0.04, 0.04], [0.09, 0.17]]
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
        """Place the hand is led to."""
        return float(self.hand.parameters[POINTER + 2])

    def press(self) -> None:
        with greeted(self.viewer.url.replace("http", "ws") + "ws") as page:
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
    ended = subprocess.run([sys.executable, "-c", owner], capture_output=True, text=True, check=False)
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
    deadline = time.monotonic() + PATIENCE_S
    while session.process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
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
