"""Who is let in, what may be said, and that nothing said reaches a device; a page that is talked back to."""

import json
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import until
from live_server import Live, client, fetched, frame_of, greeted, served
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from tissueid.errors import UsageError
from tissueid.viewer import protocols
from tissueid.viewer.page_server import LARGEST_DECISION, PageServer
from tissueid.viewer.protocols import LARGEST_MESSAGE, Play, parse_message
from tissueid.viewer.security import MOST_TOLD, Access, RefusalLog, new_token
from tissueid.viewer.server import HEADERS, MOST_CLIENTS, MOST_CONNECTIONS, MOST_MESSAGES, HandPointer
from tissueid.viewer.serving import ServedViewer, ViewerOptions

TOKEN = "T0ken" * 8
OPEN = Access("127.0.0.1", 8765)
REMOTE = Access("192.0.2.7", 8765, TOKEN)
ALL = Access("0.0.0.0", 8765, TOKEN)


@pytest.mark.parametrize(
    ("access", "welcome", "foreign"),
    [
        (
            OPEN,
            ("127.0.0.1:8765", "localhost:8765", "[::1]:8765"),
            (
                "localhost", "127.0.0.1:80", "evil.example:8765", "127.0.0.1.evil.example:8765", "",
                "192.0.2.7:8765",
            ),
        ),
        (REMOTE, ("192.0.2.7:8765",), ("192.0.2.8:8765", "rebound.example:8765")),
        (
            ALL,
            ("192.0.2.7:8765", "[2001:db8::1]:8765"),
            ("rebound.example:8765", "192.0.2.7:999999", "192.0.2.7:٨٧٦٥"),
        ),
    ],
    ids=("loopback", "one address", "every address"),
)  # fmt: skip
def test_only_its_own_address_is_a_host(access, welcome, foreign):
    for host in (*welcome, *foreign):
        assert access.names(host) is (host in welcome), host
        refusal = access.refusal({"host": host}, access.token, websocket=True)
        assert (refusal is None) is (host in welcome), host


def test_a_websocket_comes_from_the_own_page_or_from_no_browser():
    own = {"host": "127.0.0.1:8765"}
    for headers in (own, own | {"origin": "http://127.0.0.1:8765"}):
        assert OPEN.refusal(headers, None, websocket=True) is None
    for origin in (
        "https://127.0.0.1:8765", "http://127.0.0.1:8766", "http://evil.example", "null", "",
        "http://127.0.0.1:8765.evil.example",
    ):  # fmt: skip
        assert "foreign Origin" in OPEN.refusal(own | {"origin": origin}, None, websocket=True)


def test_another_machine_needs_the_token_and_is_served_by_none_without():
    for token, why in ((None, "no token"), ("", "wrong token"), (TOKEN[:-1], "wrong token"), (TOKEN, None)):
        assert REMOTE.refusal({"host": "192.0.2.7:8765"}, token, websocket=False) == why
    with pytest.raises(ValueError, match="a token is needed"):
        Access("192.0.2.7", 8765)
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32


def refused(live: Live, url: str, code: int = 403, **options: object) -> None:
    with pytest.raises(InvalidStatus) as status, client(url, **options):
        pass
    assert status.value.response.status_code == code
    assert not live.stage.clients


def test_handshakes_of_strangers_are_refused_and_logged(capfd):
    with served(token=TOKEN) as live:
        refused(live, live.ws)
        refused(live, f"{live.ws}?token=wrong")
        refused(live, f"{live.ws}?token={TOKEN}&token={TOKEN}")
        refused(live, f"{live.ws}?token={TOKEN}", origin="http://evil.example")
        rebound = socket.create_connection(("127.0.0.1", live.access.port))
        refused(live, f"ws://evil.example:{live.access.port}/ws?token={TOKEN}", sock=rebound)
        with greeted(f"{live.ws}?token={TOKEN}", origin=f"http://127.0.0.1:{live.access.port}"):
            pass
    said = capfd.readouterr().err
    for why in (
        "no token",
        "wrong token",
        "foreign Origin 'http://evil.example'",
        "foreign Host 'evil.example:",
    ):
        assert why in said
    assert TOKEN not in said


def test_the_page_needs_the_token_and_forbids_everything_foreign():
    with served(token=TOKEN) as live:
        base = f"http://127.0.0.1:{live.access.port}"
        status, headers, body = fetched(f"{base}/")
        assert (status, b"no token" in body) == (403, True)
        for name, value in HEADERS:
            assert headers[name.decode()] == value.decode()
        assert fetched(f"{base}/?token={TOKEN}")[0] in {200, 503}
        assert fetched(f"{base}/?token={TOKEN}", Host="evil.example")[0] == 403
        for path in ("static/../server.py", "static/%2e%2e/server.py", "ws"):
            assert fetched(f"{base}/{path}?token={TOKEN}")[0] == 404, path


CLOSED = [
    ("not JSON", 1007), ("[]", 1007), ('{"v": 1}', 1007), ('{"v": 2, "answer": 0}', 1007),
    ('{"v": 1, "answer": 99}', 1007), ('{"v": 1, "answer": -1}', 1007),
    ('{"v": true, "pointer": null}', 1007), ('{"v": 1, "force_N": [0, 0, 9]}', 1007),
    ('{"v": 1, "pointer": [0, 0, 1e9]}', 1007), ('{"v": 1, "pointer": null}', 1008),
    ('{"v": 1, "pointer": [0, 0, 0.1]}', 1008), ('{"v": 1, "play": {"at_s": 0}}', 1008),
    (b"\x00\x01\x02", 1003), ("x" * (LARGEST_MESSAGE + 1), 1009), (b"x" * 1_000_000, 1009),
]  # fmt: skip


def code_of(connection: ClientConnection) -> int | None:
    try:
        while True:
            connection.recv(10)
    except ConnectionClosed as closed:
        return None if closed.rcvd is None else closed.rcvd.code


def test_what_is_no_message_closes_with_its_code_and_harms_no_other(capfd, caplog):
    with served() as live, greeted(live.ws) as other:
        for message, code in CLOSED:
            with greeted(live.ws) as bad:
                bad.send(message)
                assert code_of(bad) == code, message[:60]
        with greeted(live.ws) as bad:
            bad.send(b"\xff\xfe", text=True)
            assert code_of(bad) == 1007
        # a stranger fills no terminal with what went wrong inside
        assert caplog.records == []
        live.write(3)
        assert frame_of(other).samples["tick"].tolist()[-1] <= 2
    said = capfd.readouterr().err
    for why in ("malformed message", "pointer refused", "too long a message", "binary message"):
        assert why in said


def test_a_flood_of_messages_is_ended(hand):
    corner = np.full(3, 0.1)
    with served(pointer=HandPointer(hand, corner, corner, corner)) as live, greeted(live.ws) as one:
        with suppress(ConnectionClosed):
            for _ in range(20 * MOST_MESSAGES):
                one.send('{"v": 1, "pointer": null}')
        assert code_of(one) == 1008


def test_more_clients_than_places_are_refused():
    with served() as live:
        with ExitStack() as opened:
            for _ in range(MOST_CLIENTS):
                opened.enter_context(client(live.ws))
            with pytest.raises(InvalidStatus):
                opened.enter_context(client(live.ws))
        until(lambda: not live.stage.clients)
        with greeted(live.ws):
            pass


@pytest.mark.parametrize(("count", "seed"), [(2000, 1), pytest.param(100_000, 2, marks=pytest.mark.slow)])
def test_messages_of_noise_leave_the_server_as_it_was(count, seed):
    """Random and nearly right messages to a server whose device nothing may lead, while another looks on."""
    chance = np.random.default_rng(seed)
    right = ['{"v": 1, "answer": 1}', '{"v": 1, "pointer": [0, 0, 0.1]}', '{"v": 1, "play": {"at_s": 1}}']
    with served() as live, greeted(live.ws) as watcher:
        live.stage.log.note = lambda _client, _why: None
        sent = 0
        while sent < count:
            with client(live.ws) as one:
                try:
                    for _ in range(50):
                        data = bytearray(right[chance.integers(3)].encode())
                        for _ in range(chance.integers(1, 8)):
                            data[chance.integers(len(data))] = chance.integers(256)
                        noise = chance.bytes(int(chance.integers(0, 300)))
                        one.send([bytes(data), bytes(data).decode("latin-1"), noise][chance.integers(3)])
                        sent += 1
                except ConnectionClosed:
                    pass
        live.write(5)
        # the first of the records that are written afterwards
        assert frame_of(watcher).samples["tick"][0] == 0
        assert live.server.started


def test_noise_is_never_taken_for_a_message_that_moves_anything():
    chance = np.random.default_rng(3)
    for _ in range(5000):
        assert parse_message(chance.bytes(int(chance.integers(0, 80))).decode("latin-1")) is None
    assert parse_message("[" * 200) is None
    assert parse_message('{"v": 1, "answer": 3}').answer == 3
    assert parse_message('{"v": 1, "pointer": [0, 0.1, -0.2]}').pointer == (0.0, 0.1, -0.2)
    assert parse_message('{"v": 1, "pointer": [NaN, 0, 0]}') is None
    assert parse_message('{"v": 1, "play": {"at_s": Infinity}}') is None
    assert parse_message('{"v": 1, "play": {"paused": true}}').play == Play(None, paused=True)


def test_a_pointer_leads_the_hand_within_the_workspace_and_is_let_go_with_its_page(hand):
    rest, low, high = np.array([0.0, 0.0, 0.15]), np.full(3, -0.04), np.full(3, 0.17)
    with served(pointer=HandPointer(hand, rest, low, high)) as live:
        with greeted(live.ws) as one:
            one.send('{"v": 1, "pointer": [0.01, 0.02, 0.12]}')
            until(lambda: hand.parameters[13] == 1.0)
            assert hand.parameters[14:17].tolist() == [0.01, 0.02, 0.12]
            one.send('{"v": 1, "pointer": [0.01, 0.02, -0.3]}')
            until(lambda: hand.parameters[16] < 0.1)
            assert hand.parameters[16] == pytest.approx(-0.06)
        until(lambda: hand.parameters[16] == 0.15)
        assert hand.parameters[14:17].tolist() == rest.tolist()


def test_refusals_of_a_kind_are_told_up_to_a_number(capfd):
    log = RefusalLog()
    for _ in range(10 * MOST_TOLD):
        log.note("a\nb", "wrong token")
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == MOST_TOLD
    assert "a\\nb" in lines[0]
    assert log.counts["wrong token"] == 10 * MOST_TOLD


def test_an_address_that_is_not_ours_is_refused_with_the_way_out():
    with pytest.raises(UsageError, match="--host"):
        ServedViewer(ViewerOptions("192.0.2.7"))
    with pytest.raises(UsageError, match="TLS needs two files"):
        ViewerOptions(certificate=Path("a.pem"))
    with pytest.raises(UsageError, match="no such file"):
        ViewerOptions(certificate=Path("no.pem"), key=Path("no.key"))


def test_a_page_is_served_by_tls_where_files_are_given(tmp_path):
    certificate, key = tmp_path / "c.pem", tmp_path / "k.pem"
    made = subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1",
         "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        capture_output=True, check=False,
    )  # fmt: skip
    if made.returncode:
        pytest.skip("openssl makes no certificate here")
    trusting = ssl.create_default_context(cafile=certificate)
    with ServedViewer(ViewerOptions(certificate=certificate, key=key)) as viewer:
        assert viewer.url.startswith("https://127.0.0.1:")
        begun, status = time.monotonic(), 0
        while not status:
            assert time.monotonic() - begun < 20.0
            with suppress(OSError):
                status, _, _ = fetched(viewer.url, context=trusting)
            time.sleep(0.05)
        assert status in {200, 503}
        assert viewer.runs
    assert not viewer.runs


def test_half_open_requests_shut_the_page_for_nobody():
    with served() as live:
        half = []
        for _ in range(3 * MOST_CONNECTIONS):
            one = socket.create_connection(("127.0.0.1", live.access.port))
            one.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nX-Slow: " % live.access.port)
            half.append(one)
        with greeted(live.ws):
            pass
        assert fetched(f"http://127.0.0.1:{live.access.port}/")[0] == 200
        for one in half:
            one.close()


def test_a_request_that_never_ends_is_cut_off_in_time(monkeypatch):
    monkeypatch.setattr(protocols, "REQUEST_S", 0.3)
    with served() as live:
        silent = socket.create_connection(("127.0.0.1", live.access.port))
        dripping = socket.create_connection(("127.0.0.1", live.access.port))
        begun = time.monotonic()
        with suppress(ConnectionError):
            while time.monotonic() - begun < 5.0:
                dripping.sendall(b"G" if time.monotonic() - begun < 0.1 else b"E")
                time.sleep(0.05)
        assert 0.2 <= time.monotonic() - begun < 3.0
        silent.settimeout(3.0)
        with suppress(ConnectionError):
            assert silent.recv(1) == b""
        # a page that asked for what it wanted, and waits with its connection open, is none of these
        with greeted(live.ws) as one:
            time.sleep(0.6)
            live.write(3)
            assert frame_of(one).samples["tick"].size
        silent.close()
        dripping.close()


def test_a_flood_of_pings_ends_its_own_client_alone():
    with served() as live, greeted(live.ws) as watcher, greeted(live.ws) as one:
        with suppress(ConnectionClosed):
            for _ in range(50 * protocols.MOST_PINGS):
                one.ping()
        assert code_of(one) == 1008
        live.write(5)
        assert frame_of(watcher).samples["tick"].size


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


@pytest.fixture(scope="module")
def page() -> Iterator[PageServer]:
    with PageServer(SHOWN, None) as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            until(lambda: server.server.started)
            yield server
        finally:
            server.server.should_exit = True
            thread.join()


def origin(server: PageServer) -> str:
    return f"http://127.0.0.1:{server.access.port}"


def test_the_address_that_is_printed_shows_the_page(page):
    assert page.url.startswith("http://127.0.0.1:")
    status, headers, body = fetched(page.url)
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
def test_strangers_are_refused_before_anything_is_done(page, path, headers, why):
    before = len(SHOWN.words)
    body = b'{"key": "exclude"}' if "decide" in path else None
    status, _, said = fetched(origin(page) + path.format(token=page.access.token), body, **headers)
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
def test_a_decision_is_answered_in_one_sentence(page, body, status, said):
    path = f"{origin(page)}/decide?token={page.access.token}"
    found, _, answer = fetched(path, body, Origin=origin(page))
    assert (found, json.loads(answer)) == (status, {"said": said})


def test_a_page_that_cant_be_made_says_why(page):
    SHOWN.broken = True
    status, _, body = fetched(page.url)
    SHOWN.broken = False
    assert status == 422
    assert b"line 3" in body


def test_a_second_one_takes_a_free_port_and_a_wanted_one_that_is_taken_is_refused(page):
    with PageServer(Asked()) as other:
        assert other.access.port != page.access.port
    with pytest.raises(UsageError, match="--viewer-port"):
        PageServer(Asked(), page.access.port)
