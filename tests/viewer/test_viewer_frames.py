"""Frames: what a servo recorded arrives as it was, to the digits that the layout states."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from session_heads import head_of

from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import Lamp
from tissueid.viewer.frames import HEAD, SAMPLE, layout, read_frame, samples_of, write_frame
from tissueid.viewer.hello import hello


def some_records(count: int, seed: int = 1) -> np.ndarray:
    """Records of random bytes that are numbers."""
    chance = np.random.default_rng(seed)
    records = np.zeros(count, RECORD)
    records["tick"] = np.arange(count) + 2**32 - 2
    records["time_s"] = 1e5 + 1e-3 * np.arange(count)
    for name in ("position_m", "force_N"):
        records[name] = chance.normal(size=(count, 3))
    for name in ("depth_mm", "tissue_force_N", "energy_J", "dt_s", "speed_mm_per_s", "surface_mm"):
        records[name] = chance.normal(size=count)
    records["lamps"] = chance.integers(0, 2**12, count)
    records["state"], records["fault"], records["missed"] = 5, 3, 65_535
    return records


def test_every_field_arrives_with_the_digits_of_the_layout() -> None:
    records = some_records(50)
    frame = read_frame(write_frame(samples_of(records), first=7, now_s=12.5, dropped=3, round_trip_us=9))
    assert (frame.first, frame.now_s, frame.dropped, frame.round_trip_us) == (7, 12.5, 3, 9)
    assert not frame.ended
    assert (frame.samples["time_s"] == records["time_s"]).all()
    assert (frame.samples["tick"] == records["tick"] % 2**32).all()
    for name in ("position_m", "force_N", "depth_mm", "tissue_force_N", "energy_J", "dt_s"):
        assert (frame.samples[name] == records[name].astype(np.float32)).all(), name
    for name in ("lamps", "state", "fault", "missed", "label", "buttons"):
        assert (frame.samples[name] == records[name]).all(), name


def test_a_page_can_read_a_sample_by_the_layout_alone() -> None:
    records = some_records(3)
    data = write_frame(samples_of(records), first=0, now_s=0.0)
    fields = {name: (kind, offset) for name, kind, _, offset in layout()}
    kind, offset = fields["depth_mm"]
    assert kind == "<f4"
    value = struct.unpack_from("<f", data, HEAD.itemsize + 2 * SAMPLE.itemsize + offset)[0]
    assert value == np.float32(records["depth_mm"][2])
    # numbers lie where typed arrays and data views can take them
    assert all(offset % int(kind[2:]) == 0 for kind, offset in fields.values())


def test_records_of_another_layout_keep_what_they_have() -> None:
    old = np.zeros(4, np.dtype([("time_s", "<f8"), ("depth_mm", "<f8")]))
    old["depth_mm"] = 2.5
    samples = samples_of(old)
    assert (samples["depth_mm"] == 2.5).all()
    assert not samples["force_N"].any()


@pytest.mark.parametrize("cut", [0, 5, 31, 33, -1])
def test_a_frame_that_is_not_whole_is_refused(cut: int) -> None:
    data = write_frame(samples_of(some_records(2)), first=0, now_s=0.0)
    with pytest.raises(ValueError, match="frame"):
        read_frame(data[:cut])


def test_a_frame_of_another_version_is_refused() -> None:
    data = bytearray(write_frame(samples_of(some_records(2)), first=0, now_s=0.0))
    data[2] = 9
    with pytest.raises(ValueError, match="version 1"):
        read_frame(bytes(data))


def test_the_hello_says_what_is_drawn_and_which_lamp_is_which() -> None:
    words = json.loads(json.dumps(hello(head_of(), pointer=True), allow_nan=False))
    assert {one["kind"] for one in words["scene"]["objects"]} == {"workspace", "tool", "surface"}
    surface = next(one for one in words["scene"]["objects"] if one["kind"] == "surface")
    assert surface["shape"] == "plane"
    assert surface["motion_scale"] == 5.0
    bits = {one["id"]: one["bits"] for one in words["lamps"]}
    assert bits["saturation"] & Lamp.CLIPPED
    assert bits["passivity"] == Lamp.PASSIVITY
    assert bits["outside"] == Lamp.OUTSIDE_DEPTH | Lamp.OUTSIDE_SPEED
    assert words["session"]["scale"]["force_scale"] == 0.0125
    assert words["session"]["pointer"] is True
    named = {name for name, *_ in words["sample"]["fields"]}
    traces = [trace for strip in words["strips"] for trace in strip["traces"]]
    assert all(trace["field"] in named and trace.get("over", "time_s") in named for trace in traces)


def test_the_tool_is_drawn_as_the_tip_that_was_stated() -> None:
    head = head_of()
    head["tissues"][0]["tip"] = {"shape": "cone", "half_angle_deg": 30.0}
    drawn = [
        next(one for one in hello(each)["scene"]["objects"] if one["kind"] == "tool")
        for each in (head_of(), head)
    ]
    assert [(one["shape"], one["half_angle_deg"]) for one in drawn] == [("sphere", None), ("cone", 30.0)]


def test_a_blind_session_tells_no_tissue_and_no_band() -> None:
    words = hello(head_of(blind=True))
    assert words["session"]["title"] == "blind comparison"
    assert words["band"] is None
