"""The ring: every record is read once and whole, or counted as lost."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics.ring import CAPACITY, HEAD_BYTES, RECORD, Ring


@pytest.fixture
def ring():
    made = Ring.create(16)
    yield made
    made.close()


def write(ring: Ring, first: int, count: int) -> None:
    record = np.zeros((), RECORD)
    for tick in range(first, first + count):
        # every field of a record is the tick, so that a torn record shows
        for name in ("tick", "time_s", "dt_s", "energy_J", "label"):
            record[name] = tick
        ring.append(record)


def test_no_page_of_a_new_ring_is_met_for_the_first_time_in_a_tick():
    made = Ring.create()
    pages = made.records.nbytes // os.sysconf("SC_PAGE_SIZE")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    made.records["tick"].fill(1)
    met = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    made.close()
    assert pages == 2048
    # the interpreter meets a page of its own now and then
    assert met < pages // 20


def test_a_record_has_128_bytes_and_a_ring_a_minute():
    assert RECORD.itemsize == 128
    assert CAPACITY == 65_536
    assert RECORD.names[:9] == (
        "tick", "time_s", "dt_s", "position_m", "force_N", "depth_mm", "tissue_force_N", "speed_mm_per_s",
        "surface_mm",
    )  # fmt: skip


def test_a_reader_gets_every_record_once_in_order(ring):
    reader = ring.reader()
    got = []
    for first in range(0, 60, 6):
        write(ring, first, 6)
        records, overrun = reader.read_new()
        assert overrun == 0
        got += records["tick"].tolist()
    assert got == list(range(60))
    assert reader.read_new()[0].size == 0


def test_a_reader_that_starts_late_gets_only_what_is_new(ring):
    write(ring, 0, 5)
    reader = ring.reader()
    write(ring, 5, 2)
    assert reader.read_new()[0]["tick"].tolist() == [5, 6]
    assert ring.reader(from_start=True).read_new()[0]["tick"].tolist() == list(range(7))


def test_a_reader_that_is_too_slow_is_told_how_many_it_lost(ring):
    reader = ring.reader()
    write(ring, 0, 40)
    records, overrun = reader.read_new()
    # the slot after the newest may be being written: 15 of 16 are safe
    assert records["tick"].tolist() == list(range(25, 40))
    assert overrun == 25
    assert reader.read_new()[1] == 0


def test_several_readers_keep_their_own_pace(ring):
    fast, slow = ring.reader(), ring.reader()
    write(ring, 0, 4)
    assert fast.read_new()[0].size == 4
    write(ring, 4, 4)
    assert fast.read_new()[0]["tick"].tolist() == [4, 5, 6, 7]
    assert slow.read_new()[0]["tick"].tolist() == list(range(8))


def test_no_record_is_torn_or_lost_unseen_while_a_writer_runs():
    ring = Ring.create(64)
    reader = ring.reader()
    total = 20_000
    writer = threading.Thread(target=write, args=(ring, 0, total))
    writer.start()
    seen = lost = 0
    torn = 0
    while seen + lost < total:
        records, overrun = reader.read_new()
        expected = np.arange(seen + lost + overrun, seen + lost + overrun + records.size)
        torn += int(np.sum(records["tick"] != expected) + np.sum(records["energy_J"] != expected))
        torn += int(np.sum(records["label"] != expected % 2**16))
        seen, lost = seen + records.size, lost + overrun
    writer.join()
    ring.close()
    assert torn == 0
    assert seen + lost == total


def test_a_spawned_process_reads_what_was_written(ring):
    write(ring, 0, 3)
    program = (
        "import sys; from tissueid.haptics.ring import Ring\n"
        "ring = Ring.attach(int(sys.argv[1]))\n"
        "print(ring.reader(from_start=True).read_new()[0]['tick'].tolist(), ring.records.size)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, str(ring.descriptor)],
        pass_fds=(ring.descriptor,), capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert ended.stdout == "[0, 1, 2] 16\n"


def test_a_ring_is_not_inherited_unasked(ring):
    assert not os.get_inheritable(ring.descriptor)


@pytest.mark.parametrize("content", [b"", b"x" * 63, b"\0" * 4096, b"x" * HEAD_BYTES])
def test_a_descriptor_that_is_no_ring_is_refused(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DeviceError, match="no ring"):
        Ring.attach(file.fileno())


def test_a_system_without_shared_memory_says_so(monkeypatch):
    monkeypatch.delattr(os, "memfd_create")
    with pytest.raises(DeviceError, match="memfd"):
        Ring.create()
