"""A browser that draws without a graphics card, and a session that it looks at."""

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rendered_session import Session

from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.viewer.bundling import BUNDLE

CHROMIUM = Path("/usr/bin/chromium")
#: A software renderer, and nothing that leaves this machine.
FLAGS = (
    "--no-sandbox", "--no-first-run", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
)  # fmt: skip


@pytest.fixture
def ring() -> Iterator[Ring]:
    with closing(Ring.create()) as made:
        yield made


@pytest.fixture
def hand() -> Iterator[SharedHand]:
    with closing(SharedHand.create()) as made:
        yield made


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
