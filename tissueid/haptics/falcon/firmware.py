"""Firmware of a Falcon: is it running, and if not, load the user's file into the device's RAM.

None is shipped or downloaded: the vendor's licence does not allow it.  The order of rates, lines and bytes is
that of open drivers; uploads are known to fail at the first try, and are tried again on a new transport.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.packets import PacketParser, encode_command
from tissueid.haptics.falcon.transport import (
    BAUD_HELLO,
    BAUD_RUN,
    BAUD_UPLOAD,
    LATENCY_RUN_MS,
    LATENCY_UPLOAD_MS,
    Transport,
)

Progress = Callable[[str, int, int], None]

#: Environment variable that names the file.
VARIABLE = "TISSUEID_FALCON_FIRMWARE"
#: Uploads tried, each on a newly opened transport.
TRIES = 10
#: First and last digits of the SHA-256 of files that users report to work, with their size [bytes].
KNOWN = {("1119e39c", "96a1", 8492)}  # nvent_firmware.bin
#: No firmware of a Falcon is near this long; a wrong file is refused before it is sent [bytes].
LONGEST = 65_536

HELLO = b"\x0aC\x0d"
#: Some units put a zero before their answer.
HELLO_REPLY = b"\x0aD,\x0d"
HELLO_TRIES = 100
READY = b"A"
#: The device echoes every byte; this many are sent before the echo is compared.
CHUNK = 62
#: Longest wait for an answer to hello, and for an echo [s]; 4 bytes at 9600 baud behind a latency of 16 ms
#: take 20 ms.
HELLO_WAIT_S = 0.04
ECHO_WAIT_S = 1.0
#: A device from which not one byte came for this long gets no further try [s].
SILENT_S = 8.0
#: Presence test: commands sent, and how long each may stay unanswered [s].
PRESENCE_TRIES = 10
PRESENCE_WAIT_S = 0.1


class UploadError(DeviceError):
    """One try of an upload failed; another may succeed."""


class NoLoaderError(UploadError):
    """The loader answered none of the calls."""


@dataclass(frozen=True)
class Firmware:
    """A firmware file."""

    path: Path
    content: bytes
    warning: str | None  # of a file nobody knows


def find_firmware(path: str | os.PathLike[str] | None = None) -> Firmware:
    """The file that was named here or by :data:`VARIABLE`; DeviceError if none is, or it can't be one."""
    named = os.fspath(path) if path is not None else os.environ.get(VARIABLE)
    if not named:
        raise DeviceError(
            "the Falcon runs no firmware, and no firmware file was named. It can't be shipped with tissueid:"
            f" take the one of your vendor's driver and name it with --firmware FILE or ${VARIABLE}"
        )
    file = Path(named)
    try:
        content = file.read_bytes()
    except OSError as error:
        msg = f"firmware file {file}: {error.strerror or error}; name another with --firmware FILE"
        raise DeviceError(msg) from error
    if not 0 < len(content) <= LONGEST:
        what = "is empty" if not content else f"has {len(content)} bytes, far more than a firmware"
        raise DeviceError(f"firmware file {file} {what}; name another with --firmware FILE")
    digest = hashlib.sha256(content).hexdigest()
    known = (digest[:8], digest[-4:], len(content)) in KNOWN
    warning = (
        f"{file} is no firmware known to work ({len(content)} bytes, sha256 {digest[:12]}...);"
        " it is sent as it is, since you named it"
    )
    return Firmware(file, content, None if known else warning)


def is_running(transport: Transport) -> bool:
    """Ask with zero torque in homing mode, which a homed device stays in, whether commands are answered."""
    parser = PacketParser()
    command = encode_command((0, 0, 0), leds=0, homing=True)
    transport.purge()
    for _ in range(PRESENCE_TRIES):
        transport.write(command)
        deadline = time.monotonic() + PRESENCE_WAIT_S
        while (left := deadline - time.monotonic()) > 0.0:
            if parser.feed(transport.read(left)):
                return True
    return False


def upload(transport: Transport, content: bytes, progress: Progress) -> None:
    """One try to load firmware, told as message, bytes done and in all; UploadError: open the device anew."""
    _say_hello(transport)
    transport.set_dtr(on=False)
    transport.set_baud(BAUD_UPLOAD)
    transport.write(READY)
    # a late answer to an earlier call may stand before it, and has no such byte
    received = _read_until(transport, lambda got: got.endswith(READY), ECHO_WAIT_S)
    if not received.endswith(READY):
        raise UploadError(f"the loader answered {received!r} to {READY!r}")
    for start in range(0, len(content), CHUNK):
        chunk = content[start : start + CHUNK]
        transport.write(chunk)
        # called at once, while the chunk is this one
        if _read_until(transport, lambda got: len(got) >= len(chunk), ECHO_WAIT_S) != chunk:  # noqa: B023
            raise UploadError(
                f"the echo of bytes {start} to {start + len(chunk) - 1} of the firmware is missing or differs"
            )
        progress("firmware", start + len(chunk), len(content))
    transport.set_latency(LATENCY_RUN_MS)
    transport.set_baud(BAUD_RUN)
    transport.purge()


def ensure_running(
    open_transport: Callable[[], Transport], firmware: Callable[[], Firmware], progress: Progress
) -> Transport:
    """A transport, which the caller closes, to a device whose firmware runs, loaded where it did not.

    ``open_transport``: called anew after each failed upload; ``firmware``: called only where one is needed.
    Raises DeviceError: after so many tries or :data:`SILENT_S` of silence, or what opening raised.
    """
    transport = open_transport()
    try:
        if is_running(transport):
            return transport
        content = firmware().content
        reason = ""
        heard_s = time.monotonic()
        for attempt in range(1, TRIES + 1):
            if attempt > 1:
                transport.close()
                transport = open_transport()
            try:
                upload(transport, content, progress)
            except UploadError as error:
                reason = str(error)
                heard_s = heard_s if isinstance(error, NoLoaderError) else time.monotonic()
            else:
                if is_running(transport):
                    return transport
                reason = "the device took the firmware but does not answer"
                heard_s = time.monotonic()
            progress(f"firmware, try {attempt} of {TRIES}: {reason}", 0, len(content))
            if time.monotonic() - heard_s >= SILENT_S:
                break
    except BaseException:
        transport.close()
        raise
    transport.close()
    raise DeviceError(
        f"the firmware could not be loaded in {attempt} tries; the last: {reason}. Take the Falcon off its "
        "power for ten seconds, plug it into a port of the computer itself (no hub), and try again"
    )


def _say_hello(transport: Transport) -> None:
    """Reset the device by its modem lines and ask for its loader."""
    transport.purge()
    transport.set_latency(LATENCY_UPLOAD_MS)
    transport.set_baud(BAUD_HELLO)
    transport.set_frame()
    transport.set_dtr(on=False)
    transport.set_dtr(on=True)
    received = b""
    for _ in range(HELLO_TRIES):
        transport.write(HELLO)
        # the zero that some units send first stands before it and does not matter
        received = _read_until(transport, lambda got: HELLO_REPLY in got, HELLO_WAIT_S, received)
        if HELLO_REPLY in received:
            return
        received = received[-len(HELLO_REPLY) :]
    raise NoLoaderError(f"no answer to {HELLO_TRIES} calls of the loader")


def _read_until(
    transport: Transport, done: Callable[[bytes], bool], wait_s: float, received: bytes = b""
) -> bytes:
    """Bytes up to those that were waited for, or what came in time."""
    deadline = time.monotonic() + wait_s
    while not done(received) and (left := deadline - time.monotonic()) > 0.0:
        received += transport.read(left)
    return received
