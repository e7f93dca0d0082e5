"""The feed: every client at its own pace, the newest first, nobody waits."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack

import numpy as np
import pytest
from live_server import frame_of, greeted, record, served, until

from tissueid.haptics.ring import RECORD, Ring
from tissueid.viewer.feed import KEPT, MOST_SAMPLES, MOST_UNANSWERED, Client, LiveFeed, Playback
from tissueid.viewer.frames import Frame, read_frame, samples_of
from tissueid.viewer.protocols import Play


@pytest.fixture
def feed(ring: Ring) -> LiveFeed:
    return LiveFeed(ring)


def fill(ring: Ring, count: int, first: int = 0) -> None:
    for number in range(first, first + count):
        ring.append(record(number))


def shown(one: Client) -> Frame:
    """The frame that is to be sent now."""
    return read_frame(one.next_frame())


def test_a_client_gets_every_sample_in_order(ring, feed):
    one = Client(feed, "one")
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
    hung, awake = Client(feed, "hung"), Client(feed, "awake")
    received = sent = 0
    while (data := hung.next_frame()) is not None or sent < MOST_UNANSWERED:
        sent += 1
        fill(ring, 10, 10 * (sent - 1))
        feed.pump()
        if data is not None:
            received += read_frame(data).samples.size
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
    assert total > KEPT
    assert frame.samples["tick"].tolist() == list(range(total - MOST_SAMPLES, total))
    assert frame.dropped == total - MOST_SAMPLES - received
    assert awake.dropped == 0


def test_what_the_ring_lost_is_counted_and_does_not_shift_numbers():
    ring = Ring.create(capacity=64)
    feed = LiveFeed(ring)
    one = Client(feed, "one")
    fill(ring, 200)
    feed.pump()
    assert feed.published == 200
    shown(one)
    # only what the ring still held is known; its number is its tick
    assert feed.between(199, 200)["tick"].tolist() == [199]
    assert feed.between(140, 200)["tick"].tolist() == list(range(140, 200))


def test_an_answer_that_cannot_be_is_refused(ring):
    one = Client(LiveFeed(ring), "one")
    assert not one.answer(1)
    fill(ring, 5)
    one.source.pump()
    assert one.next_frame() is not None
    assert one.answer(1)
    assert not one.answer(0)
    assert not one.answer(2)


def test_the_end_is_said_once(ring, feed):
    one = Client(feed, "one")
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
        for _ in range(MOST_UNANSWERED):
            frame_of(hung)
        with pytest.raises(TimeoutError):
            hung.recv(0.2)
        hung.send(json.dumps({"v": 1, "answer": MOST_UNANSWERED}))
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
        return samples_of(records)

    def test_samples_come_when_they_came(self):
        now = [0.0]
        play = Playback(self.samples(), lambda: now[0])
        assert play.published == 1
        now[0] = 0.2505
        assert play.published == 251
        assert not play.ended
        now[0] = 5.0
        assert (play.published, play.ended) == (1000, True)

    def test_it_stands_still_goes_on_and_goes_back(self):
        now = [0.1]
        play = Playback(self.samples(), lambda: now[0])
        play.play(Play(0.5, paused=True))
        now[0] = 9.0
        assert play.now_s() == pytest.approx(50.5)
        play.play(Play(None, paused=False))
        now[0] = 9.2005
        assert play.published == 701
        one = Client(play, "one")
        assert one.next_frame() is not None
        play.play(Play(0.0, paused=True))
        one.rewind()
        assert shown(one).samples["tick"].tolist() == [0]
