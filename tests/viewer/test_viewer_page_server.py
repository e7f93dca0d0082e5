"""The server of one page that is talked back to: who is heard, and what is answered."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest
from command_line import until
from live_server import fetched

from tissueid.errors import UsageError
from tissueid.viewer.page_server import LARGEST_DECISION, PageServer


class Asked:
    """A page that remembers what it was asked."""

    def __init__(self) -> None:
        self.words: list[Mapping[str, Any]] = []
        self.broken = False

    def page(self) -> str:
        if self.broken:
            raise UsageError("study.toml, line 3: no")
        return "<p>the page</p>"

    def decide(self, words: Mapping[str, Any]) -> str:
        if not words:
            raise UsageError("nothing was decided")
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


def origin(server: PageServer) -> str:
    return f"http://127.0.0.1:{server.access.port}"


def test_the_address_that_is_printed_shows_the_page(served):
    assert served.url.startswith("http://127.0.0.1:")
    status, headers, body = fetched(served.url)
    assert (status, body) == (200, b"<p>the page</p>")
    assert "connect-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("path", "headers", "why"),
    [
        ("/", {}, "no token"),
        ("/?token=x", {}, "wrong token"),
        ("/decide", {}, "no token"),
        ("/decide?token=x", {}, "wrong token"),
        ("/decide?token={token}", {"Origin": "http://evil.example"}, "foreign Origin"),
        ("/?token={token}", {"Host": "evil.example"}, "foreign Host"),
    ],
)
def test_strangers_are_refused_before_anything_is_done(served, path, headers, why):
    before = len(SHOWN.words)
    body = b'{"key": "exclude"}' if "decide" in path else None
    status, _, said = fetched(origin(served) + path.format(token=served.access.token), body, **headers)
    assert status == 403
    assert why.encode() in said
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
    path = f"{origin(served)}/decide?token={served.access.token}"
    found, _, answer = fetched(path, body, Origin=origin(served))
    assert (found, json.loads(answer)) == (status, {"said": said})


def test_a_page_that_cant_be_made_says_why(served):
    SHOWN.broken = True
    status, _, body = fetched(served.url)
    SHOWN.broken = False
    assert status == 422
    assert b"line 3" in body


def test_a_second_one_takes_a_free_port_and_a_wanted_one_that_is_taken_is_refused(served):
    with PageServer(Asked()) as other:
        assert other.access.port != served.access.port
    with pytest.raises(UsageError, match="--viewer-port"):
        PageServer(Asked(), served.access.port)
