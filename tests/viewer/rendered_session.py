"""A session in a process of its own, as a user begins it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

START_S = 90.0


class Session:
    """``tissueid render``, with what it prints."""

    def __init__(self, *args: str | Path, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.printed = folder / "printed.txt"
        command = [sys.executable, "-m", "tissueid", "render", "--no-browser", *map(str, args)]
        with self.printed.open("w") as out:
            self.process = subprocess.Popen(command, stderr=out, stdin=subprocess.DEVNULL)
        self.url = ""
        deadline = time.monotonic() + START_S
        while not self.url:
            assert time.monotonic() < deadline, self.said
            assert self.process.poll() is None, self.said
            self.url = next((line.split()[1] for line in self.said.splitlines() if "://" in line), "")
            time.sleep(0.02)

    @property
    def said(self) -> str:
        return self.printed.read_text(encoding="utf-8")

    def end(self) -> int:
        """End it as Ctrl-C does; a signal that a shell in the background does not take away."""
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGTERM)
        return self.process.wait(30)


def now(page: Any) -> Any:
    """Contents of a page."""
    return page.evaluate("window.tissueid ? window.tissueid.read() : null")


def wait(page: Any, true: Any, meanwhile: Any = lambda: None) -> Any:
    """Contents of a page once that is so; meanwhile something goes on."""
    deadline = time.monotonic() + START_S
    while True:
        meanwhile()
        found = now(page)
        if found is not None and true(found):
            return found
        assert time.monotonic() < deadline, found
        time.sleep(0.05)


def drag_down(page: Any, pixels: int) -> None:
    """Press the left button on the scene and go down; it stays pressed."""
    box = page.locator("#scene").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for part in range(1, 16):
        page.mouse.move(x, y + pixels * part / 15)
        time.sleep(0.05)


def heard(page: Any) -> list[str]:
    """Errors that a page says from now on."""
    said: list[str] = []
    page.on("console", lambda one: said.append(one.text) if one.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    return said
