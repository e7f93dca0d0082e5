"""Words that other processes see in order: the plain way and the compiled one are the same to both sides."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.haptics import atomic, ring
from tissueid.haptics.ring import read_ordered, write_ordered


@pytest.mark.parametrize("keeps_order", [True, False])
def test_what_is_written_is_read_and_no_neighbour_is_touched(monkeypatch, keeps_order):
    monkeypatch.setattr(ring, "_KEEPS_ORDER", keeps_order)
    words = np.arange(8)
    write_ordered(words, 2, 2**53 + 1)
    assert read_ordered(words, 2) == 2**53 + 1
    np.testing.assert_array_equal(np.delete(words, 2), [0, 1, 3, 4, 5, 6, 7])


def test_a_machine_that_reorders_takes_the_compiled_ways(monkeypatch):
    called = []
    monkeypatch.setattr(ring, "_KEEPS_ORDER", False)
    monkeypatch.setattr(atomic, "load_acquire", lambda cell: called.append("load") or cell[0])
    monkeypatch.setattr(atomic, "store_release", lambda *_: called.append("store"))
    words = np.zeros(2, np.int64)
    write_ordered(words, 1, 5)
    read_ordered(words, 1)
    assert called == ["store", "load"]
