"""The owner's side of a viewer: an address, a process that serves it, or the session of another."""

from __future__ import annotations

import json
import socket
import ssl
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tissueid.errors import printable, refuse
from tissueid.own_process import own_process
from tissueid.viewer.security import LOOPBACK, Access, is_loopback, new_token

if TYPE_CHECKING:
    from pathlib import Path

#: Taken where it is free, so that a page finds a session that was started again.
DEFAULT_PORT = 8765
#: The server closes its connections in this time [s], or is killed.
REAP_S = 3.0
#: A server that leads a hand says a hundred times a second that it is there; after this it hangs [s].
SILENCE_S = 4.0


@dataclass(frozen=True, slots=True)
class ViewerOptions:
    """Options of a served viewer."""

    host: str = LOOPBACK  # address to listen on
    port: int | None = None  # none for :data:`DEFAULT_PORT`, or any that is free
    #: Files for TLS, both or none.
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        if (self.certificate is None) != (self.key is None):
            refuse("TLS needs two files: --certificate FILE and --certificate-key FILE")
        for file in (self.certificate, self.key):
            if file is not None and not file.is_file():
                refuse(f"{printable(str(file))}: there is no such file")
        if self.certificate is None:
            return
        # files that the server could not use
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(
                str(self.certificate), str(self.key), password=_no_password
            )
        except (OSError, ValueError) as error:
            refuse(
                f"{printable(str(self.certificate))} and its key can't be used "
                f"({getattr(error, 'reason', None) or error}); give a certificate and its own key, as PEM, "
                "without a password"
            )


class ServedViewer(AbstractContextManager["ServedViewer"]):
    """A running server, before and while there is a session; UsageError: no such address, or a taken port."""

    def __init__(self, options: ViewerOptions) -> None:
        listening = listening_socket(options)
        port = listening.getsockname()[1]
        self.access = Access(
            options.host,
            port,
            None if is_loopback(options.host) else new_token(),
            tls=options.certificate is not None,
        )
        #: Called where the server dies or hangs: what it led is led by nobody.
        self.let_go: Callable[[], None] = lambda: None
        #: How long nothing was heard of a server that leads a hand [s].
        self.silent_s: Callable[[], float] = lambda: 0.0
        self._lost = False
        theirs, self._link = socket.socketpair()
        command = own_process("tissueid.viewer.server", str(theirs.fileno()), str(listening.fileno()))
        try:
            # our own interpreter and module; a session of its own, so that Ctrl-C is the owner's alone
            self._process = subprocess.Popen(  # noqa: S603
                command,
                pass_fds=(theirs.fileno(), listening.fileno()),
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        finally:
            theirs.close()
            listening.close()
        access = {"host": options.host, "port": port, "token": self.access.token, "tls": self.access.tls}
        tls = None if options.certificate is None else [str(options.certificate), str(options.key)]
        self._send({"access": access, "tls": tls})

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        host = {"0.0.0.0": _own_name(), "::": _own_name()}.get(self.access.host, self.access.host)  # noqa: S104
        host = f"[{host}]" if ":" in host else host
        token = "" if self.access.token is None else f"?token={self.access.token}"
        return f"{'https' if self.access.tls else 'http'}://{host}:{self.access.port}/{token}"

    def show_live(
        self,
        hello: Mapping[str, Any],
        descriptors: list[int],
        *,
        rest_m: list[float] | None,
        workspace_m: list[list[float]],
    ) -> None:
        """Show a servo: a ring to be read and, where a page may lead it, the simulated hand."""
        self._send({"live": {"hello": hello, "rest_m": rest_m, "workspace_m": workspace_m}}, descriptors)

    def show_log(self, hello: Mapping[str, Any], path: Path) -> None:
        """Play a log."""
        self._send({"log": {"hello": hello, "path": str(path)}})

    def tell(self, **words: Any) -> None:
        """A status for all pages."""
        self._send({"status": words})

    def wait(self) -> int:
        """Until the server ends; its exit code."""
        return self._process.wait()

    @property
    def runs(self) -> bool:
        """True where the server is there."""
        return self._process.poll() is None

    def tend(self) -> bool:
        """Look after the server; True once, where it died; one that died or hangs keeps no hand."""
        if self._lost:
            return False
        if self.runs:
            if self.silent_s() > SILENCE_S:
                self.let_go()
            return False
        self._lost = True
        self.let_go()
        return True

    def _send(self, words: Mapping[str, Any], descriptors: list[int] | None = None) -> None:
        data = json.dumps(words, allow_nan=False).encode() + b"\n"
        try:
            sent = socket.send_fds(self._link, [data], descriptors or [])
            self._link.sendall(data[sent:])
        except OSError:
            # a server that died takes the picture away and nothing else: the session goes on
            return

    def close(self) -> None:
        """End the server; harmless when called twice."""
        if self._link.fileno() < 0:
            return
        self._send({"end": True})
        self._link.close()
        try:
            self._process.wait(REAP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __exit__(self, *_: object) -> None:
        self.close()


def _no_password() -> str:
    """A key that asks for one can't be used by a process that nobody answers."""
    raise ValueError("the key has a password")


def listening_socket(options: ViewerOptions) -> socket.socket:
    """A socket that listens, on the port wanted or on a free one."""
    wanted = [options.port] if options.port is not None else [DEFAULT_PORT, 0]
    for port in wanted:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                options.host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            listening = socket.socket(family, kind, protocol)
        except (OSError, OverflowError) as error:
            refuse(f"--host {printable(options.host)}: {error}")
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            listening.listen()
        except (OSError, OverflowError) as error:
            listening.close()
            if port == wanted[-1]:
                refuse(
                    f"the viewer can't listen on {printable(options.host)}, port {port} "
                    f"({getattr(error, 'strerror', error)}); choose another with --viewer-port or --host"
                )
        else:
            return listening
    raise AssertionError  # the last port is returned or refused


def _own_name() -> str:
    """An address of this machine that others may reach: that of its default way out."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            # no packet is sent: a datagram socket that is connected knows its own address
            asked.connect(("192.0.2.1", 9))
        except OSError:
            return LOOPBACK
        return str(asked.getsockname()[0])


TIMEOUT_S = 5.0


def reach(what: str, token: str | None) -> str:
    """Address of a page that answers at ``HOST:PORT``, or at an address with or without its token.

    Raises UsageError: it is no address, nothing answers there, or the token is missing or wrong.
    """
    url = what if "//" in what else f"http://{what}/"
    parts = urllib.parse.urlsplit(url)
    if parts.scheme not in {"http", "https"} or parts.hostname is None:
        refuse(f"{printable(what)!r} is neither a log nor HOST:PORT")
    if token is not None and "token=" not in parts.query:
        url = urllib.parse.urlunsplit(parts._replace(query=urllib.parse.urlencode({"token": token})))
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S):  # noqa: S310 -- the scheme was checked
            return url
    except urllib.error.HTTPError as error:
        words = error.read(300).decode("utf-8", "replace").strip().splitlines()
        refuse(f"{printable(what)}: {printable(words[0]) if words else error.reason}")
    except (urllib.error.URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", error)
        refuse(
            f"{printable(what)}: nothing answers ({reason}); start it there with "
            "`tissueid render ... --viewer --host ADDRESS`"
        )
