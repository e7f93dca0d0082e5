"""Memory that processes share: the ring, the parameter block and the hand; whole, in order, or refused."""

import os
import resource
import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics import foreign
from tissueid.haptics import parameter_block as pb
from tissueid.haptics import ring as rings
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.parameter_block import ParameterBlock
from tissueid.haptics.ring import HEAD_BYTES, RECORD, Ring
from tissueid.haptics.shared_hand import SIM_PARAMETERS, SharedHand
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice, simulated_advance
from tissueid.rendering.servo import ServoPlan
from tissueid.rendering.servo_process import _share_hand


@pytest.fixture
def ring():
    with closing(Ring.create(16)) as made:
        yield made


@pytest.fixture
def block():
    with closing(ParameterBlock.create(5)) as made:
        yield made


@pytest.fixture
def hand():
    with closing(SharedHand.create()) as made:
        yield made


@pytest.mark.parametrize(
    ("attach", "content", "refusal"),
    [
        *((Ring.attach, content, "no ring") for content in (b"", b"x" * 63, b"\0" * 4096, b"x" * HEAD_BYTES)),
        *(
            (ParameterBlock.attach, content, "no parameter block")
            for content in (b"", b"x" * 63, b"\0" * 144, b"x" * 200)
        ),
        (SharedHand.attach, b"\0" * 64, "no hand"),
    ],
)
def test_a_descriptor_that_is_none_is_refused(tmp_path, attach, content, refusal):
    path = tmp_path / "file"
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DeviceError, match=refusal):
        attach(file.fileno())


def test_a_system_without_shared_memory_says_so(monkeypatch):
    monkeypatch.delattr(os, "memfd_create")
    for create in (Ring.create, SharedHand.create, lambda: ParameterBlock.create(5)):
        with pytest.raises(DeviceError, match="memfd"):
            create()


class TestOrder:
    @pytest.mark.parametrize("keeps_order", [True, False])
    def test_what_is_written_is_read_and_no_neighbour_is_touched(self, monkeypatch, keeps_order):
        monkeypatch.setattr(rings, "_KEEPS_ORDER", keeps_order)
        words = np.arange(8)
        rings.write_ordered(words, 2, 2**53 + 1)
        assert rings.read_ordered(words, 2) == 2**53 + 1
        np.testing.assert_array_equal(np.delete(words, 2), [0, 1, 3, 4, 5, 6, 7])

    def test_a_machine_that_reorders_takes_the_compiled_ways(self, monkeypatch):
        called = []
        monkeypatch.setattr(rings, "_KEEPS_ORDER", False)
        monkeypatch.setattr(foreign, "load_acquire", lambda cell: called.append("load") or cell[0])
        monkeypatch.setattr(foreign, "store_release", lambda *_: called.append("store"))
        words = np.zeros(2, np.int64)
        rings.write_ordered(words, 1, 5)
        rings.read_ordered(words, 1)
        assert called == ["store", "load"]


def write(ring: Ring, first: int, count: int) -> None:
    record = np.zeros((), RECORD)
    for tick in range(first, first + count):
        # more than one field of a record is the tick, so that a torn record shows
        record[["tick", "energy_J", "label"]] = tick, tick, tick % 2**16
        ring.records[ring.published % ring.records.size] = record
        rings.write_ordered(ring.head, rings.PUBLISHED_AT, ring.published + 1)


class TestRing:
    def test_no_page_of_a_new_ring_is_met_for_the_first_time_in_a_tick(self):
        made = Ring.create()
        pages = made.records.nbytes // os.sysconf("SC_PAGE_SIZE")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        made.records["tick"].fill(1)
        met = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
        made.close()
        assert pages == 2048
        # the interpreter meets a page of its own now and then
        assert met < pages // 20

    def test_a_record_has_128_bytes_and_a_ring_a_minute(self):
        assert (RECORD.itemsize, rings.CAPACITY) == (128, 65_536)
        assert RECORD.names[:9] == (
            "tick", "time_s", "dt_s", "position_m", "force_N", "depth_mm", "tissue_force_N", "speed_mm_per_s",
            "surface_mm",
        )  # fmt: skip

    def test_readers_get_every_record_once_in_order_at_their_own_pace(self, ring):
        write(ring, 0, 5)
        reader, slow = ring.reader(), ring.reader()
        got = []
        for first in range(5, 65, 6):
            write(ring, first, 6)
            records, overrun = reader.read_new()
            assert overrun == 0
            got += records["tick"].tolist()
            if first == 5:
                assert slow.read_new()[0]["tick"].tolist() == list(range(5, 11))
                assert ring.reader(from_start=True).read_new()[0]["tick"].tolist() == list(range(11))
        assert got == list(range(5, 65))
        assert reader.read_new()[0].size == 0

    def test_a_reader_that_is_too_slow_is_told_how_many_it_lost(self, ring):
        reader = ring.reader()
        write(ring, 0, 40)
        records, overrun = reader.read_new()
        # the slot after the newest may be being written: 15 of 16 are safe
        assert records["tick"].tolist() == list(range(25, 40))
        assert overrun == 25
        assert reader.read_new()[1] == 0

    def test_no_record_is_torn_or_lost_unseen_while_a_writer_runs(self):
        ring = Ring.create(64)
        reader = ring.reader()
        total = 20_000
        writer = threading.Thread(target=write, args=(ring, 0, total))
        writer.start()
        seen = lost = torn = 0
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

    def test_a_spawned_process_that_is_handed_it_reads_what_was_written(self, ring):
        assert not os.get_inheritable(ring.descriptor)
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

    def test_one_that_was_handed_out_for_reading_cannot_be_written(self, ring):
        write(ring, 7, 1)
        reading = Ring.attach(ring.read_only())
        assert reading.reader(from_start=True).read_new()[0]["tick"].tolist() == [7]
        with pytest.raises(ValueError, match="read-only"):
            reading.records[0] = ring.records[0]
        reading.close()


class TestParameterBlock:
    def test_what_was_written_is_taken_with_its_version_and_not_overwritten_before(self, block):
        out, other = np.zeros(5), ParameterBlock.attach(block.descriptor)
        assert not pb.waiting(block.head)
        for version in (1, 2, 3):
            assert block.write(np.arange(5.0) + version) == version
            assert pb.waiting(block.head)
            with pytest.raises(DeviceError, match="still waiting"):
                block.write(np.zeros(5))
            # another mapping of the memory sees everything
            assert pb.take(other.head, other.values, out) == version
            assert out.tolist() == (np.arange(5.0) + version).tolist()
            assert block.taken == version

    @pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((5, 1)), np.array([1, 2, np.nan, 4, 5.0])])
    def test_parameters_that_are_no_numbers_or_too_few_are_refused(self, block, bad):
        with pytest.raises(ValueError, match="5 finite numbers"):
            block.write(bad)
        assert block.published == 0

    def test_signs_of_life_are_counted_and_orders_seen(self, block):
        for count in (1, 2, 3):
            block.beat()
            assert pb.beats(block.head) == count
        for order in (pb.COMMAND_ENGAGE, pb.COMMAND_STOP, pb.COMMAND_DISENGAGE):
            block.order(order)
            assert pb.command(block.head) == order

    def test_no_version_is_torn_while_owner_and_servo_run(self):
        block = ParameterBlock.create(200)
        last, torn = 200, []

        def servo() -> None:
            out = np.zeros(200)
            while block.taken < last:
                if pb.waiting(block.head):
                    version = pb.take(block.head, block.values, out)
                    if not np.all(out == version):
                        torn.append(version)
                time.sleep(0.0)

        thread = threading.Thread(target=servo)
        thread.start()
        for version in range(1, last + 1):
            while block.published != block.taken:
                time.sleep(0.0)
            block.write(np.full(200, float(version)))
        thread.join()
        block.close()
        assert torn == []


class TestSharedHand:
    def test_one_that_is_led_from_another_mapping_arrives_and_no_faster_than_it_may(self, hand):
        elsewhere = SharedHand.attach(os.dup(hand.descriptor))
        device = SimulatedDevice()
        device.share(hand)
        assert elsewhere.parameters.shape == (SIM_PARAMETERS,)
        assert (elsewhere.parameters == device.parameters).all()
        elsewhere.point_at((0.02, 0.0, CENTRE_M[2]))
        furthest = 0.0
        for _ in range(1000):
            before = device.true_position_m
            simulated_advance(device.memory, device.parameters, 1e-3)
            furthest = max(furthest, float(np.abs(device.true_position_m - before).max()))
        # within Coulomb friction over the hand's stiffness: 0.1 N / 300 N/m
        assert device.true_position_m == pytest.approx([0.02, 0.0, CENTRE_M[2]], abs=4e-4)
        # 0.5 m/s of the target, and what half-critical damping overshoots
        assert furthest < 1e-3
        elsewhere.close()

    @pytest.mark.parametrize("point", [(0.0, 0.0), (0.0, float("nan"), 0.0), (float("inf"), 0.0, 0.0)])
    def test_a_pointer_that_is_no_point_is_refused(self, hand, point):
        with pytest.raises(ValueError, match="three finite coordinates"):
            hand.point_at(point)

    def test_no_device_but_the_simulated_one_can_be_led(self, hand):
        with pytest.raises(DeviceError, match="the simulated device alone"):
            _share_hand(FalconDevice(), hand)
        device = SimulatedDevice()
        _share_hand(device, hand)
        assert device.parameters is hand.parameters
        assert not ServoPlan("falcon").shared_hand
