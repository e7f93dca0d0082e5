"""The server in a process of its own: what strangers send is read where no device and no recording is.

It loads no compiler.  It is sent the listening socket, a ring that it can only read and, in a simulation, the
hand; it lives as long as the socket to its owner.  Lines of JSON from the owner::

    {"access": {"host": ..., "port": ..., "token": ...}, "tls": [certificate, key] or null}
    {"live": {"hello": {...}, "rest_m": [...] or null, "workspace_m": [...]}}    with the descriptors
    {"log": {"hello": {...}, "path": ...}}    {"status": {...}}    {"end": true}
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.viewer.frames import LiveFeed, Playback, samples_of
from tissueid.viewer.security import Access
from tissueid.viewer.server import HandPointer, Stage, ViewerServer

#: Below the servo and its owner, above nothing of the user's that waits.
NICENESS = 5
LARGEST_READ = 1 << 16
#: A ring and a hand.
MOST_DESCRIPTORS = 4


class Owner:
    """The lines of the owner, and the descriptors that came with them."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self._text = b""
        self._descriptors: list[int] = []

    def read(self) -> list[dict[str, Any]] | None:
        """Whole lines that have come; None where the owner is gone."""
        try:
            data, descriptors, _, _ = socket.recv_fds(self.link, LARGEST_READ, MOST_DESCRIPTORS)
        except BlockingIOError:
            return []
        except OSError:
            return None
        if not data:
            return None
        self._descriptors += descriptors
        *lines, self._text = (self._text + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def descriptors(self) -> list[int]:
        """Those that came since the last call."""
        found, self._descriptors = self._descriptors, []
        return found


def obey(stage: Stage, words: dict[str, Any], owner: Owner) -> None:
    """Do what a line of the owner says, with the descriptors that came with it."""
    if "live" in words:
        _show_live(stage, words["live"], owner.descriptors())
    elif "log" in words:
        from tissueid.store.session_log import read_session_log

        samples = samples_of(read_session_log(Path(words["log"]["path"])).records)
        stage.show_log(words["log"]["hello"], lambda: Playback(samples))
    elif "status" in words:
        stage.tell(words["status"])
    elif "end" in words:
        stage.end()


def _show_live(stage: Stage, words: dict[str, Any], descriptors: list[int]) -> None:
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
    pointer = None
    if len(descriptors) > 1:
        low_m, high_m = np.array(words["workspace_m"]).T
        pointer = HandPointer(SharedHand.attach(descriptors[1]), np.array(words["rest_m"]), low_m, high_m)
    stage.show_live(words["hello"], LiveFeed(Ring.attach(descriptors[0])), pointer)


async def _serve(link: socket.socket, listening: socket.socket) -> None:
    owner = Owner(link)
    first = owner.read()
    if not first:
        return
    stage = Stage()
    server = ViewerServer(stage, Access(**first[0]["access"]), first[0]["tls"])

    def heard() -> None:
        lines = owner.read()
        for words in lines or ():
            obey(stage, words, owner)
        if lines is None:
            server.should_exit = True
            asyncio.get_running_loop().remove_reader(link)

    for words in first[1:]:
        obey(stage, words, owner)
    link.setblocking(False)
    asyncio.get_running_loop().add_reader(link, heard)
    await server.serve(sockets=[listening])


def main(arguments: list[str]) -> int:
    """The spawned process: two descriptors, the owner's socket and the listening one."""
    link, listening = (socket.socket(fileno=int(word)) for word in arguments)
    asyncio.run(_serve(link, listening))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
