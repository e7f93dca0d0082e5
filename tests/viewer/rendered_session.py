"""A session in a process of its own, as a user begins it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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
