"""A browser that draws without a graphics card, and a session that it looks at."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tissueid.viewer.bundling import BUNDLE

CHROMIUM = Path("/usr/bin/chromium")
#: A software renderer, and nothing that leaves this machine.
FLAGS = (
    "--no-sandbox",
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
START_S = 90.0


class Session:
    """``tissueid render``, with what it prints."""

    def __init__(self, *args: str | Path, port: int | None = None, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.printed = folder / "printed.txt"
        port_args = () if port is None else ("--viewer-port", str(port))
        command = [sys.executable, "-m", "tissueid", "render", "--no-browser", *map(str, args), *port_args]
        with self.printed.open("w") as out:
            self.process = subprocess.Popen(command, stderr=out, stdin=subprocess.DEVNULL)
        self.url = ""
        deadline = time.monotonic() + START_S
        while not self.url:
            assert time.monotonic() < deadline, self.said
            assert self.process.poll() is None, self.said
            self.url = next((line.split()[1] for line in self.said.splitlines() if "://" in line), "")
            time.sleep(0.02)
        self.port = int(self.url.split(":")[2].split("/")[0])

    @property
    def said(self) -> str:
        """Everything printed so far."""
        return self.printed.read_text(encoding="utf-8")

    def end(self) -> int:
        """End it as Ctrl-C does; a signal that a shell in the background does not take away."""
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGTERM)
        return self.process.wait(30)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}: install chromium to run this test")
    if not (BUNDLE / "index.html").is_file():
        pytest.skip("the viewer's page is not built: python -m tissueid.viewer.bundling")
    playwright = pytest.importorskip("playwright.sync_api")
    # a picture that is computed takes both cores of a small machine: it may wait, the session may not
    patient = tmp_path_factory.mktemp("browser") / "chromium"
    patient.write_text(f'#!/bin/sh\nexec nice -n 10 {CHROMIUM} "$@"\n', encoding="utf-8")
    patient.chmod(0o755)
    with playwright.sync_playwright() as engine:
        running = engine.chromium.launch(executable_path=str(patient), args=list(FLAGS))
        yield running
        running.close()


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Session]]:
    """Starts a session; one more where a machine with other work starved the last one of its heartbeat."""
    started: list[Session] = []

    def start() -> Session:
        folder = tmp_path_factory.mktemp("session")
        started.append(Session("--log", folder / "out.h5", "--seconds", "240", folder=folder))
        return started[-1]

    yield start
    for one in started:
        one.end()
