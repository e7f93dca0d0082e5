"""A real Falcon for tests: opt-in by ``--falcon``, a person who answers, a report of the readings."""

import contextlib
import json
import os
import platform
import select
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from tissueid import __version__
from tissueid.haptics.falcon.calibration import load_calibration
from tissueid.haptics.falcon.device import FalconDevice, limits_of

FOLDER = Path(__file__).resolve().parent
TERMINAL = Path("/dev/tty")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave everything here out unless asked for, and say so."""
    if config.getoption("--falcon"):
        return
    left_out = pytest.mark.skip(reason="moves a real Falcon: give --falcon (docs/hardware-checklist.md)")
    for item in items:
        if FOLDER in item.path.parents:
            item.add_marker(left_out)


@pytest.fixture(scope="session")
def readings(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    """Readings and answers; written to the report when the session ends, also after a failure."""
    found: dict[str, Any] = {
        "tissueid": __version__,
        "platform": platform.platform(),
        "port": request.config.getoption("--falcon-port") or "USB",
        "calibration": asdict(load_calibration()),
        "passed": {},
    }
    yield found
    path = Path(request.config.getoption("--falcon-report"))
    path.write_text(json.dumps(found, indent=2, sort_keys=True) + "\n", encoding="utf-8")


@pytest.fixture(scope="session")
def falcon(request: pytest.FixtureRequest) -> Iterator[FalconDevice]:
    """The device, open; with the limits of an unconfirmed machine: at most 2 N, dead-man button on."""
    calibration = load_calibration()
    limits = limits_of(calibration)
    assert limits.clamp_N <= 2.0 or calibration.confirmed
    assert limits.dead_man
    port, firmware = map(request.config.getoption, ("--falcon-port", "--falcon-firmware"))
    device = FalconDevice(limits, port=port, firmware=firmware, calibration=calibration)
    device.tell = tell
    with device:
        yield device


@pytest.fixture(scope="session")
def homed(falcon: FalconDevice) -> FalconDevice:
    """The device, homed by the person and pulled out."""
    falcon.home()
    return falcon


def tell(sentence: str) -> None:
    """A line for the person, past pytest's capturing; nowhere without a terminal."""
    with contextlib.suppress(OSError), TERMINAL.open("w", encoding="utf-8") as terminal:
        terminal.write(f"\n  {sentence}\n")


@pytest.fixture
def ask(falcon: FalconDevice) -> Callable[..., str]:
    """Ask the person; the test is skipped, visibly, where there is no terminal.

    Meanwhile the device gets its commands, with zero force: nobody knows how long it bears silence.
    """

    def question(sentence: str, *, idle: bool = True) -> str:
        try:
            terminal = os.open(TERMINAL, os.O_RDWR | os.O_NOCTTY)
        except OSError:
            pytest.skip("needs a person at a terminal")
        try:
            os.write(terminal, f"\n  {sentence} ".encode())
            while not select.select([terminal], [], [], 1e-3)[0]:
                if idle:
                    falcon.read()
                    falcon.write_force([0.0, 0.0, 0.0], 1e-3)
            return os.read(terminal, 1024).decode(errors="replace").strip().lower()
        finally:
            os.close(terminal)

    return question


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Note in the report which checks passed."""
    outcome = yield
    result = outcome.get_result()
    found = getattr(item, "funcargs", {}).get("readings")
    if result.when == "call" and found is not None:
        found["passed"][item.name] = result.outcome
