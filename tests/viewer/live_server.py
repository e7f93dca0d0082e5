"""A server on a free port of this machine with a ring that the test writes, and clients of it."""

import asyncio
import json
import socket
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from command_line import until
from session_heads import head_of
from websockets.sync.client import ClientConnection, connect

from tissueid.haptics.ring import PUBLISHED_AT, RECORD, Ring, write_ordered
from tissueid.viewer.frames import Frame, LiveFeed, read_frame
from tissueid.viewer.hello import hello
from tissueid.viewer.security import Access
from tissueid.viewer.server import HandPointer, Stage, ViewerServer

PATIENCE_S = 20.0


@dataclass
class Live:
    ring: Ring
    stage: Stage
    access: Access
    server: ViewerServer

    @property
    def ws(self) -> str:
        return f"ws://127.0.0.1:{self.access.port}/ws"

    def write(self, count: int, first: int = 0) -> None:
        """Append records whose numbers can be told from their tick."""
        for number in range(first, first + count):
            append(self.ring, record(number))


def append(ring: Ring, one: Any) -> None:
    """Write one record, as the servo does compiled."""
    count = ring.published
    ring.records[count % ring.records.size] = one
    write_ordered(ring.head, PUBLISHED_AT, count + 1)


def record(number: int) -> Any:
    """A record: tick, depth and force follow from its number."""
    one = np.zeros((), RECORD)
    one["tick"], one["time_s"], one["dt_s"] = number, time.monotonic(), 1e-3
    one["depth_mm"], one["tissue_force_N"] = 0.001 * number, 0.01 * number
    one["force_N"] = (0.0, 0.0, 0.0001 * number)
    return one


@contextmanager
def served(*, token: str | None = None, pointer: HandPointer | None = None, port: int = 0) -> Iterator[Live]:
    """Serve until the test is over."""
    listening = socket.create_server(("127.0.0.1", port))
    access = Access("127.0.0.1", listening.getsockname()[1], token)
    stage, ring = Stage(), Ring.create()
    stage.show_live(hello(head_of(), pointer=pointer is not None), LiveFeed(ring), pointer)
    server = ViewerServer(stage, access)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[listening])))
    thread.start()
    try:
        until(lambda: server.started)
        yield Live(ring, stage, access, server)
    finally:
        server.should_exit = True
        thread.join()
        listening.close()
        ring.close()


@contextmanager
def client(url: str, **options: Any) -> Iterator[ClientConnection]:
    """A client that is no browser; pings are answered by a thread of its own."""
    with connect(url, max_size=None, open_timeout=PATIENCE_S, compression=None, **options) as connection:
        yield connection


@contextmanager
def greeted(url: str, **options: Any) -> Iterator[ClientConnection]:
    """A client that has heard its hello."""
    with client(url, **options) as connection:
        assert json.loads(connection.recv(PATIENCE_S))["type"] == "hello"
        yield connection


def frame_of(connection: ClientConnection) -> Frame:
    """The next frame, answered by nobody."""
    data = connection.recv(PATIENCE_S)
    return read_frame(data)


def fetched(
    url: str, body: bytes | None = None, *, context: ssl.SSLContext | None = None, **headers: str
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body of an answer; with a body to a POST."""
    asked = urllib.request.Request(url, body, headers)
    try:
        with urllib.request.urlopen(asked, timeout=20, context=context) as answer:
            return answer.status, dict(answer.headers), answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, dict(error.headers), error.read()
