"""UDP bridge for other programs: positions and forces out, parameters in; docs/render.md has the datagrams.

Forces are never taken from outside.  What comes in is heard on the loopback interface alone, is checked
against the token that the session printed, and dropped and counted otherwise.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
import socket
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tissueid.errors import printable, refuse
from tissueid.haptics.states import Lamp, State
from tissueid.rendering.tissue_block import Plane

VERSION = 1
LARGEST_DATAGRAM = 1200
#: Datagrams heard a turn: a flood must not keep the session from its heartbeat.
MOST_A_TURN = 32
#: Time between two datagrams out [s].
INTERVAL_S = 0.004
LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 4
#: A surface lies within this of the device's axis [m].
REACH_M = 0.3


@dataclass(frozen=True, slots=True)
class BridgeRequest:
    """Request of a datagram; None where it asks for nothing."""

    tissue: int | None = None
    plane: Plane | None = None
    engage: bool | None = None
    stop: bool = False


_Coordinate = Annotated[float, msgspec.Meta(ge=-REACH_M, le=REACH_M)]


class _Plane(msgspec.Struct, forbid_unknown_fields=True):
    point_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    normal: tuple[float, float, float]


class _Datagram(msgspec.Struct, forbid_unknown_fields=True):
    v: float  # 1; programs write numbers as they like
    token: str | int
    tissue: Annotated[int, msgspec.Meta(ge=0, lt=65536)] | None = None
    plane: _Plane | msgspec.UnsetType = msgspec.UNSET
    engage: bool | None = None
    stop: bool = False


def parse_address(text: str) -> tuple[str, int]:
    """Read ``HOST:PORT`` or ``PORT``, then on loopback; UsageError without a port between 1 and 65535."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        refuse(f"--bridge {printable(text)!r}: give a port, or HOST:PORT, e.g. 5005")
    return host or LOOPBACK, int(port)


def parse_request(data: bytes, token: str) -> BridgeRequest | None:
    """Read a datagram that carries the token; None for whatever is no request."""
    if len(data) > LARGEST_DATAGRAM:
        return None
    try:
        found = msgspec.json.decode(data, type=_Datagram)
        given = found.plane
        plane = None if given is msgspec.UNSET else Plane(given.point_m, given.normal)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None
    if found.v != VERSION or not hmac.compare_digest(str(found.token).encode(), token.encode()):
        return None
    return BridgeRequest(found.tissue, plane, found.engage, found.stop)


class UdpBridge:
    """Sockets of a bridge: out to a port, in on the next one, on loopback; UsageError where it is taken."""

    def __init__(self, send_to: tuple[str, int], token: str | None = None) -> None:
        self.token = token or secrets.token_hex(TOKEN_BYTES)
        #: Datagrams that were dropped because they were no requests.
        self.dropped = 0
        self._last_s = -math.inf
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for one in (self._in, self._out):
            one.setblocking(False)
        try:
            self._target = socket.getaddrinfo(*send_to, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
            self._in.bind((LOOPBACK, send_to[1] + 1))
        except (OSError, OverflowError) as error:
            self.close()
            refuse(f"--bridge {printable(send_to[0])}:{send_to[1]}: {error}; choose another port")

    def send(self, records: NDArray[Any]) -> None:
        """Send the newest record, unless the last was sent a moment ago; never waits."""
        if not records.size or records["time_s"][-1] - self._last_s < INTERVAL_S:
            return
        newest = records[-1]
        self._last_s = float(newest["time_s"])
        document = {
            "v": VERSION,
            "tick": int(newest["tick"]),
            "time_s": self._last_s,
            "position_m": np.round(newest["position_m"], 7).tolist(),
            "force_N": np.round(newest["force_N"], 5).tolist(),
            "depth_mm": round(float(newest["depth_mm"]), 5),
            "tissue_force_N": round(float(newest["tissue_force_N"]), 5),
            "state": State(int(newest["state"])).name.lower(),
            "lamps": [str(lamp.name).lower() for lamp in Lamp(int(newest["lamps"]))],
            "tissue": int(newest["label"]),
        }
        try:
            self._out.sendto(json.dumps(document).encode(), self._target)
        except OSError:
            # nobody listens, or the network is slow: a picture may be lost, the force may not wait
            self.dropped += 1

    def requests(self) -> list[BridgeRequest]:
        """Requests since the last call."""
        found = []
        for _ in range(MOST_A_TURN):
            try:
                data = self._in.recv(LARGEST_DATAGRAM + 1)
            except OSError:
                break
            request = parse_request(data, self.token)
            if request is None:
                self.dropped += 1
            else:
                found.append(request)
        return found

    def close(self) -> None:
        """Give both ports back."""
        self._out.close()
        self._in.close()
