"""Who may see a session: this machine by default; another one with a secret that the terminal shows."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from tissueid.errors import printable

LOOPBACK = "127.0.0.1"
#: Names of this machine for itself.
LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
TOKEN_BYTES = 24
#: Refusals of one kind that are told one by one: a flood must not fill a disk.
MOST_TOLD = 20
#: What is quoted of a header at most.
MOST_QUOTED = 120


def is_loopback(host: str) -> bool:
    """True where an address is reached from this machine alone."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def new_token() -> str:
    """A secret of 192 random bits, fit for an address."""
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True, slots=True)
class Access:
    """The rules of one server."""

    host: str  # address that is listened on; ``0.0.0.0`` and ``::`` are all of this machine
    port: int
    token: str | None = None  # none on loopback alone
    tls: bool = False

    def __post_init__(self) -> None:
        if self.token is None and not is_loopback(self.host):
            raise ValueError(f"{self.host} is reached from other machines: a token is needed")

    def refusal(self, headers: Mapping[str, str], token: str | None, *, websocket: bool) -> str | None:
        """Why a request is refused, in words for the log; None where it is welcome.

        ``headers``: names in small letters; ``websocket``: it carries data, and an ``Origin``; so does a
        request that changes something.
        """
        host = headers.get("host", "")
        if not self.names(host):
            return f"foreign Host {quoted(host)}"
        if websocket:
            origin = headers.get("origin")
            # a program that is no browser sends none, and needs the token all the same
            if origin is not None and origin.lower() != f"{'https' if self.tls else 'http'}://{host.lower()}":
                return f"foreign Origin {quoted(origin)}"
        if self.token is None:
            return None
        if token is None:
            return "no token"
        return None if hmac.compare_digest(token.encode(), self.token.encode()) else "wrong token"

    def names(self, host: str) -> bool:
        """True where a ``Host`` header names this server: an address it listens on, and its port."""
        name, port = _split(host.lower())
        if port != self.port:
            return False
        if is_loopback(self.host):
            return name in LOCAL_NAMES or name == self.host
        if name == self.host.lower():
            return True
        # any other name could have been turned to this machine by somebody else's DNS
        address = _address(name)
        every = self.host in {"0.0.0.0", "::"}  # noqa: S104
        return address is not None and (every or address == _address(self.host))


def _split(host: str) -> tuple[str, int | None]:
    """Name and port of a ``Host`` header; None for a port that is none."""
    name, colon, port = host.rpartition(":")
    if not colon or name.endswith(":") or (name.startswith("[") and not name.endswith("]")):
        return host, None
    return name.strip("[]"), int(port) if port.isascii() and port.isdigit() and len(port) < 6 else None


def quoted(text: str) -> str:
    """A header's value for a log: one line, cut."""
    return repr(printable(text[:MOST_QUOTED]))


class RefusalLog:
    """Counts what was refused, and tells the first of each kind on standard error."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, client: str, why: str) -> None:
        """Note why a client is refused; the first two words are the kind."""
        kind = " ".join(why.split()[:2])
        self.counts[kind] += 1
        if self.counts[kind] <= MOST_TOLD:
            last = "; further ones are counted only" if self.counts[kind] == MOST_TOLD else ""
            print(f"viewer: refused {printable(client)}: {why}{last}", file=sys.stderr, flush=True)  # noqa: T201
