"""``--viewer`` and ``tissueid view``: what is refused, what is printed, and what opens by itself."""

from __future__ import annotations

import signal
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run, start
from session_heads import head_of, records_of, summary_of

from tissueid.cli import view_command
from tissueid.cli.render_command import RenderFlags, _demonstrated
from tissueid.cli.view_command import open_browser, telling_stop
from tissueid.rendering.recorder import Recorder


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
        (("view", "no-such.h5"), 6, "no-such.h5"),
        (("view", "127.0.0.1:1"), 2, "nothing answers"),
    ],
)
def test_what_cannot_be_shown_is_refused(args: tuple[str, ...], code: int, said: str) -> None:
    run(*args, code=code, said=said)


def test_a_log_is_served_until_it_is_told_to_end(tmp_path: Path) -> None:
    process = start("view", recorded(tmp_path), "--no-browser")
    assert process.stderr is not None
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


def test_nothing_asked_for_opens_a_tissue_without_motors() -> None:
    asked = flags()
    found = _demonstrated(asked)
    assert (found.preset, found.name, found.viewer) == ("paper-a", "sim", True)


@pytest.mark.parametrize(
    "given", [{"bundle": Path("b.h5")}, {"name": "falcon"}, {"name": "sim"}, {"draw": 3}, {"virtual": True}]
)
def test_whatever_was_asked_for_is_not_replaced(given: dict[str, Any]) -> None:
    asked = flags(**given)
    assert _demonstrated(asked) == flags(**given)


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    import webbrowser

    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(opened.append(url)))
    monkeypatch.setattr(view_command.sys, "platform", "linux")
    for name in view_command.SCREENS:
        monkeypatch.delenv(name, raising=False)
    open_browser("http://127.0.0.1:1/")
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    open_browser("http://127.0.0.1:1/")
    assert opened == ["http://127.0.0.1:1/"]


def test_a_recording_that_stopped_is_told_once() -> None:
    class Stopped:
        stopped: str | None = None

    class Viewer:
        def __init__(self) -> None:
            self.told: list[dict[str, Any]] = []

        def tell(self, **words: Any) -> None:
            self.told.append(words)

        def tend(self) -> bool:
            return False

    viewer, recorder, shown = Viewer(), Stopped(), []
    show = telling_stop(viewer, recorder, lambda record, _summary: shown.append(record))  # type: ignore[arg-type]
    show(1, None)
    recorder.stopped = "the disk is full"
    show(2, None)
    show(3, None)
    assert viewer.told == [{"recording_stopped": "the disk is full"}]
    assert shown == [1, 2, 3]


def test_the_token_is_printed_with_a_remark_on_encryption() -> None:
    process = start(
        "render", "--preset", "meat", "--device", "sim", "--viewer", "--no-browser", "--host", "0.0.0.0"
    )
    assert process.stderr is not None
    said = [process.stderr.readline() for _ in range(2)]
    process.kill()
    process.communicate()
    assert "/?token=" in said[0]
    assert "unencrypted" in said[1]
