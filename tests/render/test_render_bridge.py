"""The bridge hears requests that are whole and bounded, and nothing else; it never waits."""

import json
import socket
from contextlib import suppress

import numpy as np
import pytest
from session_heads import indentation, records_of

from tissueid.errors import UsageError
from tissueid.rendering.bridge import LARGEST_DATAGRAM, BridgeRequest, UdpBridge, parse_address, parse_request
from tissueid.rendering.tissue_block import Plane

TOKEN = "8f3a61c2"


def with_token(data: bytes) -> bytes:
    """The datagram with its token, where it is an object."""
    return data.replace(b"{", b'{"token": "8f3a61c2", ', 1)


@pytest.mark.parametrize("token", [b"", b'"token": "8f3a61c3", ', b'"token": null, ', b'"token": 8361, '])
def test_a_request_without_the_token_is_dropped(token):
    assert parse_request(b"{" + token + b'"v": 1, "stop": true}', TOKEN) is None
    assert parse_request(with_token(b'{"v": 1, "stop": true}'), TOKEN) == BridgeRequest(stop=True)


def test_requests_are_read():
    plane = Plane((0.0, 0.0, 0.12), (0.0, 1.0, 1.0))
    for data, asked in (
        (b'{"v": 1, "tissue": 1}', BridgeRequest(tissue=1)),
        (b'{"v": 1, "engage": false, "stop": true}', BridgeRequest(engage=False, stop=True)),
        (b'{"v": 1, "plane": {"point_m": [0, 0, 0.12], "normal": [0, 1, 1]}}', BridgeRequest(plane=plane)),
    ):
        assert parse_request(with_token(data), TOKEN) == asked


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\xff\xfe", b"[1]", b'{"tissue": 1}', b'{"v": 2, "tissue": 1}',
        b'{"v": 1, "force_N": [0, 0, 5]}', b'{"v": 1, "tissue": -1}', b'{"v": 1, "tissue": true}',
        b'{"v": 1, "tissue": 1.5}', b'{"v": 1, "engage": 1}', b'{"v": 1, "stop": "yes"}',
        b'{"v": 1, "plane": {"point_m": [0, 0, 9], "normal": [0, 0, 1]}}',
        b'{"v": 1, "plane": {"point_m": [0, 0, NaN], "normal": [0, 0, 1]}}',
        b'{"v": 1, "plane": {"point_m": [0, 0, 0.1], "normal": [0, 0, 0]}}',
        b'{"v": 1, "plane": {"point_m": [0, 0], "normal": [0, 0, 1]}}', b'{"v": 1, "plane": null}',
        b"[" * 1000, b'{"v": 1, "tissue": 1}' + b" " * LARGEST_DATAGRAM,
    ],
)  # fmt: skip
def test_whatever_is_no_request_is_dropped(data):
    assert parse_request(with_token(data), TOKEN) is None


def test_addresses_are_read_and_refused():
    assert parse_address("5005") == ("127.0.0.1", 5005)
    assert parse_address("lab-pc:5005") == ("lab-pc", 5005)
    for text in ("", "x", "0", "70000", "host:", "5005x"):
        with pytest.raises(UsageError, match="give a port"):
            parse_address(text)


@pytest.fixture
def pair() -> object:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5.0)
        bridge = UdpBridge(("127.0.0.1", listener.getsockname()[1]))
        yield listener, bridge
        bridge.close()


def test_the_newest_record_goes_out_and_not_too_often(pair):
    listener, bridge = pair
    records = records_of(indentation(2.0))
    bridge.send(records[:0])
    for k in range(400, 420):
        bridge.send(records[k : k + 1])
    listener.settimeout(0.2)
    seen = []
    with suppress(TimeoutError):
        while True:
            seen.append(json.loads(listener.recv(4096)))
    # 20 ms of records, one datagram every 4 ms; a tick more where their times are rounded
    assert seen[0]["tick"] == 400
    assert 4 <= len(seen) <= 5
    assert set(np.diff([one["tick"] for one in seen])) <= {4, 5}
    assert seen[0]["depth_mm"] == pytest.approx(records["depth_mm"][400], abs=1e-5)
    assert seen[0]["position_m"] == pytest.approx(records["position_m"][400], abs=1e-7)
    assert seen[0]["state"] == "engaged"
    assert max(len(json.dumps(one)) for one in seen) < LARGEST_DATAGRAM


def test_requests_are_heard_on_loopback_and_a_flood_is_bounded(pair):
    _, bridge = pair
    assert bridge._in.getsockname()[0] == "127.0.0.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"nonsense", bridge._in.getsockname())
        request = json.dumps({"v": 1, "token": bridge.token, "tissue": 0}).encode()
        for _ in range(100):
            sender.sendto(request, bridge._in.getsockname())
    first = bridge.requests()
    assert len(first) == 31
    assert bridge.dropped == 1
    assert first[0] == BridgeRequest(tissue=0)


def test_nobody_listening_is_no_error(pair):
    listener, bridge = pair
    listener.close()
    records = records_of(indentation(2.0))
    for k in range(0, 200, 10):
        bridge.send(records[k : k + 1])
    assert np.isfinite(bridge.dropped)


def test_a_port_that_is_taken_is_named(pair):
    _, bridge = pair
    with pytest.raises(UsageError, match="choose another port"):
        UdpBridge(("127.0.0.1", bridge._in.getsockname()[1] - 1))
