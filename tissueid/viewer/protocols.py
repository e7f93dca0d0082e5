"""HTTP and websockets that no client can hold open for nothing, and the few messages a page may send.

::

    {"v": 1, "answer": 42}                     42 frames have arrived
    {"v": 1, "pointer": [0.0, 0.01, 0.12]}     lead the simulated hand there [m, device frame]
    {"v": 1, "pointer": null}                  let go: the hand leaves the tissue
    {"v": 1, "play": {"at_s": 3.5, "paused": false}}    where a log is read, and whether it goes on

There is no message that changes a tissue, a scale, a force or a file.
"""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Literal

import h11
import msgspec
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

#: Time for a whole request [s], and connections that may wait for one at a time.
REQUEST_S = 5.0
MOST_WAITING = 24
#: Pings that are answered within a second; browsers send none.
MOST_PINGS = 20
#: Time in which a client that is ended may read its code [s].
LINGER_S = 1.0
_NOT_ALLOWED = 1008
_WHOLE = frozenset({h11.DONE, h11.MUST_CLOSE, h11.CLOSED, h11.ERROR, h11.SWITCHED_PROTOCOL})


class PunctualHttp(H11Protocol):
    """HTTP/1.1 of uvicorn with a time for the whole of a request."""

    waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Give the first request its time, at the cost of whoever has waited longest."""
        super().connection_made(transport)
        self._wait()
        due = {
            one: one.waiting.when()
            for one in self.connections
            if isinstance(one, PunctualHttp) and one.waiting is not None
        }
        if len(due) > MOST_WAITING:
            min(due, key=due.__getitem__).cut_off()

    def data_received(self, data: bytes) -> None:
        """Give what is left of a request its time, until it is whole."""
        super().data_received(data)
        if self.conn.their_state in _WHOLE:
            self._rest()
        elif self.waiting is None and self in self.connections:
            self._wait()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Leave the connection to the websocket."""
        self._rest()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._rest()
        super().connection_lost(exc)

    def cut_off(self) -> None:
        """Close without an answer: there is no request."""
        self._rest()
        self.transport.abort()

    def _wait(self) -> None:
        self.waiting = self.loop.call_later(REQUEST_S, self.cut_off)

    def _rest(self) -> None:
        if self.waiting is not None:
            self.waiting.cancel()
            self.waiting = None


class SparingWebSocket(WebSocketsSansIOProtocol):
    """Websockets of uvicorn that end a client of many pings."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._second, self._pings, self._ended = 0.0, 0, False

    def data_received(self, data: bytes) -> None:
        """Hear the client, until it was told the end."""
        if not self._ended:
            super().data_received(data)

    def send_receive_event_to_app(self) -> None:
        """Leave text whose bytes are none to the application, which refuses it as no message."""
        if self.curr_msg_data_type == "text":
            self.frames = [b"".join(self.frames).decode(errors="replace").encode()]
        super().send_receive_event_to_app()

    def handle_ping(self) -> None:
        """Answer, up to a number a second."""
        now = self.loop.time()
        if now - self._second >= 1.0:
            self._second, self._pings = now, 0
        self._pings += 1
        if self._pings <= MOST_PINGS:
            super().handle_ping()
        elif not self._ended:
            self._ended = True
            self.conn.send_close(_NOT_ALLOWED, "too many pings")
            self.transport.write(b"".join(self.conn.data_to_send()))
            # closed at once, with pings unread, it would be reset before it reads why
            self.loop.call_later(LINGER_S, self.transport.close)


#: The longest of them takes half of this [bytes].
LARGEST_MESSAGE = 256
#: A pointer lies within this of the device's origin along each axis [m].
REACH_M = 0.3
#: A log is shorter than this [s]; a count of frames smaller than that.
LONGEST_LOG_S = 1e6
MOST_FRAMES = 2**53


class Play(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Place in a log [s from its begin], or None to stay, and if it stands still."""

    at_s: Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_LOG_S)] | None = None
    paused: bool = False


Coordinate = Annotated[float, msgspec.Meta(ge=-REACH_M, le=REACH_M)]


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Message of a page, which has one member beside its version."""

    v: Literal[1]
    answer: Annotated[int, msgspec.Meta(ge=0, lt=MOST_FRAMES)] | msgspec.UnsetType = msgspec.UNSET
    #: Goal of the hand [m], or None to let go.
    pointer: tuple[Coordinate, Coordinate, Coordinate] | msgspec.UnsetType | None = msgspec.UNSET
    play: Play | msgspec.UnsetType = msgspec.UNSET


def parse_message(text: str) -> Message | None:
    """Read a message of at most :data:`LARGEST_MESSAGE` characters; None for whatever is none."""
    if len(text) > LARGEST_MESSAGE:
        return None
    try:
        found = msgspec.json.decode(text, type=Message)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None
    return found if [found.answer, found.pointer, found.play].count(msgspec.UNSET) == 2 else None
