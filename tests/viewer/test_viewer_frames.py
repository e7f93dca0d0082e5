"""Frames, to the digits of their layout, to each client at its own pace; the hello: drawn is what is felt."""

import json
import struct
import time
from contextlib import ExitStack

import numpy as np
import pytest
from command_line import until
from live_server import append, frame_of, greeted, record, served
from session_heads import head_of

from tissueid.haptics.ring import RECORD, Ring
from tissueid.haptics.states import Lamp
from tissueid.rendering.guidance import funnel_touch
from tissueid.rendering.guidance_block import Bone, Funnel, Guidance, guidance_block
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.scene import load_scene
from tissueid.viewer import frames
from tissueid.viewer.hello import guided_objects, hello
from tissueid.viewer.protocols import Play


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


def test_every_field_arrives_with_the_digits_of_the_layout():
    records = some_records(50)
    samples = frames.samples_of(records)
    frame = frames.read_frame(frames.write_frame(samples, first=7, now_s=12.5, dropped=3, round_trip_us=9))
    assert (frame.first, frame.now_s, frame.dropped, frame.round_trip_us) == (7, 12.5, 3, 9)
    assert not frame.ended
    assert (frame.samples["time_s"] == records["time_s"]).all()
    assert (frame.samples["tick"] == records["tick"] % 2**32).all()
    for name in ("position_m", "force_N", "depth_mm", "tissue_force_N", "energy_J", "dt_s"):
        assert (frame.samples[name] == records[name].astype(np.float32)).all(), name
    for name in ("lamps", "state", "fault", "missed", "label", "buttons"):
        assert (frame.samples[name] == records[name]).all(), name


def test_a_page_can_read_a_sample_by_the_layout_alone():
    records = some_records(3)
    data = frames.write_frame(frames.samples_of(records), first=0, now_s=0.0)
    columns = {name: (read, offset) for name, read, offset in frames.layout()}
    read, offset = columns["depth_mm"]
    assert read == "getFloat32"
    value = struct.unpack_from("<f", data, frames.HEAD.itemsize + 2 * frames.SAMPLE.itemsize + offset)[0]
    assert value == np.float32(records["depth_mm"][2])
    # numbers lie where typed arrays and data views can take them
    assert all(8 * offset % int("".join(filter(str.isdigit, read))) == 0 for read, offset in columns.values())
    assert columns["force_N.2"][1] - columns["force_N.0"][1] == 2 * 4


def test_records_of_another_layout_keep_what_they_have():
    old = np.zeros(4, np.dtype([("time_s", "<f8"), ("depth_mm", "<f8")]))
    old["depth_mm"] = 2.5
    samples = frames.samples_of(old)
    assert (samples["depth_mm"] == 2.5).all()
    assert not samples["force_N"].any()


@pytest.mark.parametrize(
    ("cut", "version", "why"), [*((cut, 1, "frame") for cut in (0, 5, 31, 33, -1)), (None, 9, "version 1")]
)
def test_a_frame_that_is_not_whole_or_of_another_version_is_refused(cut, version, why):
    data = bytearray(frames.write_frame(frames.samples_of(some_records(2)), first=0, now_s=0.0))
    data[2] = version
    with pytest.raises(ValueError, match=why):
        frames.read_frame(bytes(data[:cut]))


def test_the_hello_says_what_is_drawn_and_which_lamp_is_which():
    words = json.loads(json.dumps(hello(head_of(), pointer=True), allow_nan=False))
    assert {one["kind"] for one in words["scene"]["objects"]} == {"workspace", "tool", "surface"}
    surface = next(one for one in words["scene"]["objects"] if one["kind"] == "surface")
    assert (surface["shape"], surface["motion_scale"]) == ("plane", 5.0)
    bits = {one["id"]: one["bits"] for one in words["lamps"]}
    assert bits["saturation"] & Lamp.CLIPPED
    assert bits["passivity"] == Lamp.PASSIVITY
    assert bits["outside"] == Lamp.OUTSIDE_DEPTH | Lamp.OUTSIDE_SPEED
    assert words["session"]["scale"]["force_scale"] == 0.0125
    assert words["session"]["pointer"] is True
    named = {name.partition(".")[0] for name, *_ in words["sample"]["columns"]}
    traces = [trace for strip in words["strips"] for trace in strip["traces"]]
    assert all(trace["field"] in named and trace.get("over", "time_s") in named for trace in traces)


def test_the_tool_is_drawn_as_the_tip_that_was_stated():
    head = head_of()
    head["tissues"][0]["tip"] = {"shape": "cone", "half_angle_deg": 30.0}
    drawn = [
        next(one for one in hello(each)["scene"]["objects"] if one["kind"] == "tool")
        for each in (head_of(), head)
    ]
    assert [(one["shape"], one["half_angle_deg"]) for one in drawn] == [("sphere", None), ("cone", 30.0)]


def test_a_blind_session_tells_no_tissue_and_no_band():
    words = hello(head_of(blind=True))
    assert words["session"]["title"] == "blind comparison"
    assert words["band"] is None


@pytest.mark.parametrize("kind", ["hyperboloid", "cone"])
def test_the_drawn_funnel_is_the_one_that_is_felt(kind):
    funnel = Funnel(kind=kind)
    plan = Guidance((0.01, 0.0, 0.12), (0.0, 0.6, 0.8), funnel=funnel)
    axis, drawn, bone = guided_objects(guidance_block(plan).tolist())
    json.dumps([axis, drawn, bone])
    assert [one["kind"] for one in (axis, drawn, bone)] == ["axis", "funnel", "bone"]
    np.testing.assert_allclose(drawn["entry_m"], plan.entry_m)
    np.testing.assert_allclose(drawn["axis"], [0.0, 0.6, 0.8])
    for r, z in drawn["profile_m"]:
        assert abs(funnel_touch(funnel.numbers(), 0, r, z, np.zeros(2), 0)) < 1e-9
    assert axis["from_m"] == -plan.bone.drill_depth_m
    assert bone["radius_m"] == plan.bone.radius_m


def test_where_there_is_no_bone_none_is_drawn():
    plan = Guidance((0.0, 0.0, 0.13), bone=Bone(radius_m=0.0))
    assert [one["kind"] for one in guided_objects(guidance_block(plan))] == ["axis", "funnel"]


def test_a_guided_session_has_its_scenes_title_a_wire_and_no_lamp_of_a_tissue():
    scene = load_scene("hip-resurfacing")
    head = plan_session(RenderOptions(device="sim", seconds=1.0, scene=scene)).head
    words = hello(head, pointer=True)
    assert words["session"]["title"] == scene.name
    assert "bone" in words["words"]["hint"]
    assert "zoom" in hello(head)["words"]["hint"]
    assert words["words"]["scale"] == "forces and motion are the device's own"
    assert not {"rupture", "outside"} & {lamp["id"] for lamp in words["lamps"]}
    (tool,) = [one for one in words["scene"]["objects"] if one["kind"] == "tool"]
    assert tool["shape"] == "wire"
    np.testing.assert_allclose(tool["axis"], scene.guidance.unit_axis())


def test_a_tissue_of_a_scene_has_its_title_and_all_lamps():
    scene = load_scene("orbital-floor")
    asked = RenderOptions(device="sim", seconds=1.0, scene=scene, **{"surface": "plane", **scene.tissue})
    words = hello(plan_session(asked).head)
    assert words["session"]["title"] == scene.name
    assert {"rupture", "outside"} <= {lamp["id"] for lamp in words["lamps"]}


@pytest.fixture
def feed(ring: Ring) -> frames.LiveFeed:
    return frames.LiveFeed(ring)


def fill(ring: Ring, count: int, first: int = 0) -> None:
    for number in range(first, first + count):
        append(ring, record(number))


def shown(one: frames.Client) -> frames.Frame:
    """The frame that is to be sent now."""
    return frames.read_frame(one.next_frame())


def test_a_client_gets_every_sample_in_order(ring, feed):
    one = frames.Client(feed)
    seen: list[int] = []
    for turn in range(20):
        fill(ring, 13, 13 * turn)
        feed.pump()
        frame = shown(one)
        assert frame.first == len(seen)
        seen += frame.samples["tick"].tolist()
        assert one.answer(turn + 1)
    assert seen == list(range(260))
    assert one.dropped == 0
    assert one.next_frame() is None


def test_a_client_that_hung_goes_on_with_the_newest_and_knows_what_it_missed(ring, feed):
    hung, awake = frames.Client(feed), frames.Client(feed)
    received = sent = 0
    while (data := hung.next_frame()) is not None or sent < frames.MOST_UNANSWERED:
        sent += 1
        fill(ring, 10, 10 * (sent - 1))
        feed.pump()
        if data is not None:
            received += frames.read_frame(data).samples.size
    # more than it is kept for passes while it draws nothing
    for turn in range(5):
        fill(ring, 1000, 10 * sent + 1000 * turn)
        feed.pump()
        assert hung.next_frame() is None
        shown(awake)
        assert awake.answer(awake.sent)
    total = feed.published
    assert hung.answer(hung.sent)
    frame = shown(hung)
    # what is kept goes round meanwhile
    assert total > frames.KEPT
    assert frame.samples["tick"].tolist() == list(range(total - frames.MOST_SAMPLES, total))
    assert frame.dropped == total - frames.MOST_SAMPLES - received
    assert awake.dropped == 0


def test_what_the_ring_lost_is_counted_and_does_not_shift_numbers():
    ring = Ring.create(capacity=64)
    feed = frames.LiveFeed(ring)
    one = frames.Client(feed)
    fill(ring, 200)
    feed.pump()
    assert feed.published == 200
    shown(one)
    # only what the ring still held is known; its number is its tick
    assert feed.between(199, 200)["tick"].tolist() == [199]
    assert feed.between(140, 200)["tick"].tolist() == list(range(140, 200))


def test_an_answer_that_cannot_be_is_refused(ring):
    one = frames.Client(frames.LiveFeed(ring))
    assert not one.answer(1)
    fill(ring, 5)
    one.source.pump()
    assert one.next_frame() is not None
    assert one.answer(1)
    assert not one.answer(0)
    assert not one.answer(2)


def test_the_end_is_said_once(ring, feed):
    one = frames.Client(feed)
    fill(ring, 3)
    feed.end()
    frame = shown(one)
    assert (frame.samples.size, frame.ended) == (3, True)
    assert one.next_frame() is None


def test_five_clients_one_of_them_hung_and_the_others_miss_nothing():
    with served() as live, greeted(live.ws) as hung, ExitStack() as others:
        opened = [others.enter_context(greeted(live.ws)) for _ in range(4)]
        seen: list[list[int]] = [[] for _ in opened]
        written = 0
        begun = time.monotonic()
        while time.monotonic() - begun < 1.5:
            live.write(50, written)
            written += 50
            for ticks, one in zip(seen, opened, strict=True):
                frame = frame_of(one)
                ticks += frame.samples["tick"].tolist()
                assert frame.dropped == 0
                live_answer(one)
        for ticks, one in zip(seen, opened, strict=True):
            while ticks[-1] < written - 1:
                ticks += frame_of(one).samples["tick"].tolist()
                live_answer(one)
            assert ticks == list(range(written))
        others.close()
        until(lambda: len(live.stage.clients) == 1)
        # the hung one got what it may have unanswered and no more
        for _ in range(frames.MOST_UNANSWERED):
            frame_of(hung)
        with pytest.raises(TimeoutError):
            hung.recv(0.2)
        hung.send(json.dumps({"v": 1, "answer": frames.MOST_UNANSWERED}))
        live.write(1, written)
        while frame_of(hung).samples["tick"][-1] != written:
            pass


def live_answer(one: object) -> None:
    """Answer all frames that were received on a connection."""
    one.answered = getattr(one, "answered", 0) + 1
    one.send(json.dumps({"v": 1, "answer": one.answered}))


class TestPlayback:
    def samples(self) -> np.ndarray:
        records = np.zeros(1000, RECORD)
        records["tick"], records["time_s"] = np.arange(1000), 50.0 + 1e-3 * np.arange(1000)
        return frames.samples_of(records)

    def test_samples_come_when_they_came(self):
        now = [0.0]
        play = frames.Playback(self.samples(), lambda: now[0])
        assert play.published == 1
        now[0] = 0.2505
        assert play.published == 251
        assert not play.ended
        now[0] = 5.0
        assert (play.published, play.ended) == (1000, True)

    def test_it_stands_still_goes_on_and_goes_back(self):
        now = [0.1]
        play = frames.Playback(self.samples(), lambda: now[0])
        play.play(Play(0.5, paused=True))
        now[0] = 9.0
        assert play.now_s() == pytest.approx(50.5)
        play.play(Play(None, paused=False))
        now[0] = 9.2005
        assert play.published == 701
        one = frames.Client(play)
        assert one.next_frame() is not None
        play.play(Play(0.0, paused=True))
        one.rewind()
        assert shown(one).samples["tick"].tolist() == [0]
