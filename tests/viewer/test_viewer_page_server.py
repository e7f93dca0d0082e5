"""The server of one page that is talked back to: who is heard, and what is answered."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest
from live_server import until

from tissueid.errors import UsageError
from tissueid.viewer.page_server import LARGEST_DECISION, PageServer


class Asked:
    """A page that remembers what it was asked."""

    def __init__(self) -> None:
        self.words: list[Mapping[str, Any]] = []
        self.broken = False

    def page(self) -> str:
        if self.broken:
            msg = "study.toml, line 3: no"
            raise UsageError(msg)
        return "<p>the page</p>"

    def decide(self, words: Mapping[str, Any]) -> str:
        if not words:
            msg = "nothing was decided"
            raise UsageError(msg)
        self.words.append(words)
        return "done"


SHOWN = Asked()


@contextmanager
def running(asked: Asked) -> Iterator[PageServer]:
    with PageServer(asked, None) as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            until(lambda: server.server.started)
            yield server
        finally:
            server.server.should_exit = True
            thread.join()


@pytest.fixture(scope="module")
def served() -> Iterator[PageServer]:
    with running(SHOWN) as server:
        yield server


def request(
    server: PageServer, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, str, Mapping[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", server.access.port, timeout=20)
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), dict(answer.getheaders())
    finally:
        connection.close()


def origin(server: PageServer) -> str:
    return f"http://127.0.0.1:{server.access.port}"


def test_the_address_that_is_printed_shows_the_page(served):
    assert served.url.startswith("http://127.0.0.1:")
    status, text, headers = request(served, "GET", served.url.removeprefix(origin(served)))
    assert (status, text) == (200, "<p>the page</p>")
    assert "connect-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("method", "path", "headers", "why"),
    [
        ("GET", "/", {}, "no token"),
        ("GET", "/?token=x", {}, "wrong token"),
        ("POST", "/decide", {}, "no token"),
        ("POST", "/decide?token=x", {}, "wrong token"),
        ("POST", "/decide?token={token}", {"Origin": "http://evil.example"}, "foreign Origin"),
        ("GET", "/?token={token}", {"Host": "evil.example"}, "foreign Host"),
    ],
)
def test_strangers_are_refused_before_anything_is_done(served, method, path, headers, why):
    before = len(SHOWN.words)
    path = path.format(token=served.access.token)
    status, text, _ = request(served, method, path, b'{"key": "exclude"}', **headers)
    assert status == 403
    assert why in text
    assert len(SHOWN.words) == before


@pytest.mark.parametrize(
    ("body", "status", "said"),
    [
        (b'{"key": "exclude", "value": true}', 200, "done"),
        (b"{}", 422, "nothing was decided"),
        (b"[1", 422, "this is no decision"),
        (b"[1]", 422, "this is no decision"),
        (b"\xff", 422, "this is no decision"),
        (b" " * (LARGEST_DECISION + 1), 413, "too long: shorten the reason"),
    ],
)
def test_a_decision_is_answered_in_one_sentence(served, body, status, said):
    path = f"/decide?token={served.access.token}"
    found, text, _ = request(served, "POST", path, body, Origin=origin(served))
    assert (found, json.loads(text)) == (status, {"said": said})


def test_a_page_that_cant_be_made_says_why(served):
    SHOWN.broken = True
    status, text, _ = request(served, "GET", f"/?token={served.access.token}")
    SHOWN.broken = False
    assert status == 422
    assert "line 3" in text


def test_a_second_one_takes_a_free_port_and_a_wanted_one_that_is_taken_is_refused(served):
    with PageServer(Asked()) as other:
        assert other.access.port != served.access.port
    with pytest.raises(UsageError, match="--viewer-port"):
        PageServer(Asked(), served.access.port)
