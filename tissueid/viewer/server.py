"""The server: one page, its bundle, and a websocket that carries samples down and little up.

``/`` is the page, ``/static/`` its bundle, ``/ws`` the samples.  Every request passes
:class:`tissueid.viewer.security.Access` first.  A message that is none closes its connection with a code
and is logged: 1003 binary, 1007 no message, 1008 not allowed or too many, 1009 too long.

It runs in a process of its own: what strangers send is read where no device and no recording is.  That
loads no compiler.  It is sent the listening socket, a ring that it can only read and, in a simulation, the
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
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from msgspec import UNSET
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.viewer.bundling import BUNDLE, MISSING_BUNDLE
from tissueid.viewer.frames import Client, LiveFeed, Playback, Source, samples_of
from tissueid.viewer.protocols import LARGEST_MESSAGE, PunctualHttp, SparingWebSocket, parse_message
from tissueid.viewer.security import Access, RefusalLog

#: Between two looks at the ring [s]: half of it is the mean age it adds, its inverse the frames a second.
TURN_S = 0.01
#: A page that leads the hand answers a hundred frames a second; one that hangs, or whose machine is gone,
#: is heard of no more, and its connection may last for minutes [s].
SILENCE_S = 4.0


class Stage:
    """One session, for all clients, and the clock that says when there is something new to send."""

    def __init__(self) -> None:
        self.hello: str | None = None
        self.pointer: HandPointer | None = None
        self.log = RefusalLog()
        self.clients: set[object] = set()
        #: Who leads the hand, and when anything was heard of it last [s].
        self.leader: object = None
        self.leader_heard_s = 0.0
        self._source: Callable[[], Source] | None = None
        self._feed: LiveFeed | None = None
        self._known = asyncio.Event()
        #: Set, and replaced, where there may be something to send.
        self.news = asyncio.Event()
        self.statuses: list[str] = []

    def show_live(self, hello: Mapping[str, Any], feed: LiveFeed, pointer: HandPointer | None = None) -> None:
        """Show a running servo."""
        self._feed, self.pointer = feed, pointer
        self.show_log(hello, lambda: feed)

    def show_log(self, hello: Mapping[str, Any], source: Callable[[], Source]) -> None:
        """Show a log: a source of its own for each client."""
        self.hello, self._source = json.dumps(hello, allow_nan=False), source
        self._known.set()

    def end(self) -> None:
        """The servo has ended."""
        if self._feed is not None:
            self._feed.end()

    def tell(self, words: Mapping[str, Any]) -> None:
        """A status for all clients, now and later."""
        self.statuses.append(json.dumps({"type": "status", **words}, allow_nan=False))
        self._wake()

    async def source(self) -> Source:
        """A source for a new client, as soon as there is a session."""
        await self._known.wait()
        assert self._source is not None  # noqa: S101 -- set before the event
        if self._feed is not None:
            self._feed.pump()
        return self._source()

    def let_go(self) -> None:
        """A hand that nobody leads any more leaves the tissue."""
        if self.leader is not None and self.pointer is not None:
            self.pointer.lead(None)
        self.leader = None

    async def run(self) -> None:
        """Look for what is new, for ever; without a client nothing is looked for."""
        while True:
            await asyncio.sleep(TURN_S)
            if self.leader is not None and time.monotonic() - self.leader_heard_s > SILENCE_S:
                self.let_go()
            if self.pointer is not None:
                self.pointer.hand.stay()
            if self.clients:
                if self._feed is not None:
                    self._feed.pump()
                self._wake()

    def _wake(self) -> None:
        waiting, self.news = self.news, asyncio.Event()
        waiting.set()


#: How far beyond the workspace a hand may be led [m]: 6 N of a 300 N/m hand.
BEYOND_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class HandPointer:
    """Leads a hand within its workspace."""

    hand: SharedHand
    rest_m: NDArray[np.float64]  # (3,), where it goes when it is let go [m]
    #: (3,): corners of the workspace [m].
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]  # (3,)

    def lead(self, position_m: Sequence[float] | None) -> None:
        """Lead the hand to a point [m], cut to the workspace and 20 mm around it, or back to its rest."""
        wanted = self.rest_m if position_m is None else np.asarray(position_m, dtype=np.float64)
        self.hand.point_at(np.clip(wanted, self.low_m - BEYOND_M, self.high_m + BEYOND_M).tolist())


MOST_CLIENTS = 16
#: Messages a client may send in a second: answers at 100 frames/s, and a pointer at twice a screen's rate.
MOST_MESSAGES = 400
#: Connections at a time, pages and bundles included.
MOST_CONNECTIONS = 64
BINARY, NO_MESSAGE, NOT_ALLOWED, TOO_LONG = 1003, 1007, 1008, 1009
#: Nothing but the page's own files: what an injected text could load is nothing.
CONTENT_POLICY = (
    b"default-src 'self'; script-src 'self'; img-src 'self' data: blob:; style-src 'self'; "
    b"object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-cache"),
)


class Guarded:
    """Refuses what :class:`Access` refuses, or one websocket too many, before anything else sees it."""

    def __init__(
        self,
        app: ASGIApp,
        access: Access,
        log: RefusalLog,
        full: Callable[[], bool] = bool,
        policy: bytes = CONTENT_POLICY,
    ) -> None:
        self._app, self._access, self._log, self._full = app, access, log, full
        self._headers = ((b"content-security-policy", policy), *HEADERS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is welcome."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        why, websocket = self._refusal(scope), scope["type"] == "websocket"
        headed = send if websocket else self._with_headers(send)
        if why is None:
            await self._app(scope, receive, headed)
            return
        self._log.note(_name(scope), why)
        if websocket:
            # before it is accepted: the handshake is answered with 403
            await receive()
            await send({"type": "websocket.close", "code": NOT_ALLOWED, "reason": why[:100]})
        else:
            words = f"refused: {why}. Open the address that the terminal shows.\n"
            await PlainTextResponse(words, status_code=403)(scope, receive, headed)

    def _refusal(self, scope: Scope) -> str | None:
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if [name for name, _ in scope["headers"]].count(b"host") != 1:
            return "foreign Host, not one of them"
        websocket = scope["type"] == "websocket"
        if websocket and self._full():
            return "too many clients"
        # the bundle is no secret, and no address but the page's carries the token
        token = self._access.token if scope["path"].startswith("/static/") else _token(scope)
        # what changes something comes from the page itself, like what carries samples
        return self._access.refusal(headers, token, websocket=websocket or scope["method"] != "GET")

    def _with_headers(self, send: Send) -> Send:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._headers]
            await send(message)

        return sent


def _token(scope: Scope) -> str | None:
    from urllib.parse import parse_qs

    found = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=8).get("token", [])
    return found[0] if len(found) == 1 else None


def _name(scope: Scope) -> str:
    client = scope.get("client")
    return "a client" if client is None else f"{client[0]}:{client[1]}"


def viewer_app(stage: Stage, access: Access) -> ASGIApp:
    """The application: what a stage shows, to whom ``access`` lets in."""

    async def page(_request: object) -> Response:
        file = BUNDLE / "index.html"
        return FileResponse(file) if file.is_file() else HTMLResponse(MISSING_BUNDLE, status_code=503)

    @asynccontextmanager
    async def running(_app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(stage.run())
        yield
        task.cancel()

    app = Starlette(
        routes=[
            Route("/", page, methods=["GET"]),
            Mount("/static", StaticFiles(directory=BUNDLE, check_dir=False)),
            WebSocketRoute("/ws", partial(_serve_client, stage=stage)),
        ],
        lifespan=running,
    )
    return Guarded(app, access, stage.log, lambda: len(stage.clients) >= MOST_CLIENTS)


async def _serve_client(websocket: WebSocket, stage: Stage) -> None:
    """One client, from its welcome to its end."""
    name = _name(websocket.scope)
    await websocket.accept()
    stage.clients.add(websocket)
    sending = asyncio.create_task(_send(websocket, stage))
    try:
        await _hear(websocket, stage, name)
    except WebSocketDisconnect as gone:
        if gone.code == TOO_LONG:
            stage.log.note(name, f"too long a message, of more than {LARGEST_MESSAGE} bytes")
    finally:
        sending.cancel()
        stage.clients.discard(websocket)
        if stage.leader is websocket:
            stage.let_go()


async def _send(websocket: WebSocket, stage: Stage) -> None:
    """Hello, then frames as the client can take them."""
    websocket.state.client = client = Client(await stage.source())
    told = 0
    # gone while it was sent to: the hearing side ends the client
    with suppress(WebSocketDisconnect, RuntimeError):
        assert stage.hello is not None  # noqa: S101 -- known with its source
        await websocket.send_text(stage.hello)
        while True:
            for status in stage.statuses[told:]:
                told += 1
                await websocket.send_text(status)
            frame = client.next_frame()
            if frame is not None:
                await websocket.send_bytes(frame)
            await stage.news.wait()


async def _hear(websocket: WebSocket, stage: Stage, name: str) -> None:
    """Messages of a client, until one is none."""
    second, heard = time.monotonic(), 0
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code") or 1000)
        now = time.monotonic()
        if stage.leader is websocket:
            stage.leader_heard_s = now
        if now - second >= 1.0:
            second, heard = now, 0
        heard += 1
        code, why = (
            (NOT_ALLOWED, "too many messages") if heard > MOST_MESSAGES else _obey(websocket, stage, message)
        )
        if code:
            stage.log.note(name, why)
            await websocket.close(code, why[:100])
            return


def _obey(websocket: WebSocket, stage: Stage, message: Any) -> tuple[int, str]:
    """Do what a message asks for; else the code to close with, and why."""
    text = message.get("text")
    if text is None:
        return BINARY, "binary message: pages send text"
    asked = parse_message(text)
    client: Client | None = getattr(websocket.state, "client", None)
    if asked is not None and asked.pointer is not UNSET:
        if stage.pointer is None:
            return NOT_ALLOWED, "pointer refused: no simulated hand is led here"
        stage.leader, stage.leader_heard_s = websocket, time.monotonic()
        stage.pointer.lead(asked.pointer)
        return 0, ""
    if asked is None or client is None or (asked.answer is not UNSET and not client.answer(asked.answer)):
        return NO_MESSAGE, "malformed message"
    if asked.play is not UNSET:
        if not isinstance(client.source, Playback):
            return NOT_ALLOWED, "play refused: this is no log"
        client.source.play(asked.play)
        client.rewind()
    return 0, ""


def config(app: ASGIApp, **more: Any) -> uvicorn.Config:
    """Settings of every server here: silent about itself, and in no client's hand."""
    return uvicorn.Config(
        app,
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        http=PunctualHttp,
        loop="asyncio",
        timeout_graceful_shutdown=1,
        **more,
    )


class ViewerServer(uvicorn.Server):
    """The server of one session; signals belong to whoever runs it."""

    def __init__(self, stage: Stage, access: Access, tls: tuple[str, str] | None = None) -> None:
        certificate, key = tls or (None, None)
        super().__init__(
            config(
                viewer_app(stage, access),
                ws=SparingWebSocket,
                ws_max_size=LARGEST_MESSAGE,
                ws_per_message_deflate=False,
                limit_concurrency=MOST_CONNECTIONS,
                ssl_certfile=certificate,
                ssl_keyfile=key,
            )
        )

    @contextmanager
    def capture_signals(self) -> Any:
        """Leave signals alone."""
        yield


#: Below the servo and its owner, above nothing of the user's that waits.
NICENESS = 5
LARGEST_READ = 1 << 16
#: A ring and a hand.
MOST_DESCRIPTORS = 4


class Owner:
    """The lines of the owner, and the descriptors that came with them."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.descriptors: list[int] = []  # those that came since the last were taken
        self._text = b""

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
        self.descriptors += descriptors
        *lines, self._text = (self._text + data).split(b"\n")
        return [json.loads(line) for line in lines]


def obey(stage: Stage, words: dict[str, Any], owner: Owner) -> None:
    """Do what a line of the owner says, with the descriptors that came with it."""
    if "live" in words:
        os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
        live, pointer = words["live"], None
        ring, *hand = owner.descriptors
        owner.descriptors = []
        if hand:
            low_m, high_m = np.array(live["workspace_m"]).T
            pointer = HandPointer(SharedHand.attach(hand[0]), np.array(live["rest_m"]), low_m, high_m)
        stage.show_live(live["hello"], LiveFeed(Ring.attach(ring)), pointer)
    elif "log" in words:
        from tissueid.store.session_log import read_session_log

        samples = samples_of(read_session_log(Path(words["log"]["path"])).records)
        stage.show_log(words["log"]["hello"], lambda: Playback(samples))
    elif "status" in words:
        stage.tell(words["status"])
    elif "end" in words:
        stage.end()


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
