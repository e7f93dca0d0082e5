"""The parameter block: whole versions only, taken when the servo wants, and signs of life."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics import parameter_block as pb
from tissueid.haptics.parameter_block import ParameterBlock


@pytest.fixture
def block():
    made = ParameterBlock.create(5)
    yield made
    made.close()


def test_what_was_written_is_taken_with_its_version(block):
    out = np.zeros(5)
    assert not pb.waiting(block.head)
    for version in (1, 2, 3):
        assert block.write(np.arange(5.0) + version) == version
        assert pb.waiting(block.head)
        assert pb.take(block.head, block.values, out) == version
        assert out.tolist() == (np.arange(5.0) + version).tolist()
        assert block.taken == version


def test_a_version_that_waits_is_not_overwritten(block):
    block.write(np.ones(5))
    with pytest.raises(DeviceError, match="still waiting"):
        block.write(np.zeros(5))
    out = np.zeros(5)
    pb.take(block.head, block.values, out)
    assert out.tolist() == [1.0] * 5


@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((5, 1)), np.array([1, 2, np.nan, 4, 5.0])])
def test_parameters_that_are_no_numbers_or_too_few_are_refused(block, bad):
    with pytest.raises(ValueError, match="5 finite numbers"):
        block.write(bad)
    assert block.published == 0


def test_signs_of_life_are_counted_and_orders_seen(block):
    for count in (1, 2, 3):
        block.beat()
        assert pb.beats(block.head) == count
    for order in (pb.COMMAND_ENGAGE, pb.COMMAND_STOP, pb.COMMAND_DISENGAGE):
        block.order(order)
        assert pb.command(block.head) == order


def test_another_mapping_of_the_same_memory_sees_everything(block):
    other = ParameterBlock.attach(block.descriptor)
    block.write(np.arange(5.0))
    out = np.zeros(5)
    assert pb.take(other.head, other.values, out) == 1
    assert out.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert block.taken == 1


def test_no_version_is_torn_while_owner_and_servo_run():
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


@pytest.mark.parametrize("content", [b"", b"x" * 63, b"\0" * 144, b"x" * 200])
def test_a_descriptor_that_is_no_block_is_refused(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DeviceError, match="no parameter block"):
        ParameterBlock.attach(file.fileno())


def test_a_system_without_shared_memory_says_so(monkeypatch):
    monkeypatch.delattr(os, "memfd_create")
    with pytest.raises(DeviceError, match="memfd"):
        ParameterBlock.create(5)
