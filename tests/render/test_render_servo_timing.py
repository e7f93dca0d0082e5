"""Period statistics, deadlines and scheduling: closed forms, never the clock of a loaded machine."""

import os
import resource
import time

import numpy as np
import pytest

from tissueid.haptics.sim import SimulatedDevice
from tissueid.rendering import servo_loop, servo_schedule
from tissueid.rendering.selftest import Figure, run_selftest
from tissueid.rendering.servo import period_statistics
from tissueid.rendering.servo_tick import MISSED, servo_here

PERIOD_NS = 1_000_000


def histogram(errors_us: list[float]) -> np.ndarray:
    counts = np.zeros(servo_loop.BINS + 1, np.int64)
    for error in errors_us:
        servo_loop._count(counts, round(1e3 * error))
    return counts


class TestStatistics:
    def test_quantiles_are_those_of_the_errors_to_a_microsecond(self):
        errors = np.random.default_rng(1).gamma(2.0, 20.0, 5000)
        found = period_statistics(histogram(list(errors)), 0, PERIOD_NS, "SCHED_FIFO 80")
        exact = np.quantile(errors, [0.5, 0.99, 0.999], method="inverted_cdf")
        assert [found.median_us, found.p99_us, found.p999_us] == pytest.approx(np.floor(exact), abs=1.0)
        assert found.max_us == pytest.approx(errors.max(), abs=1e-3)
        assert found.ticks == 5000

    def test_an_error_beyond_the_last_bin_is_counted_and_the_largest_kept(self):
        found = period_statistics(histogram([5.0, 5.0, 93_000.0]), 0, PERIOD_NS, "")
        assert found.max_us == 93_000.0
        assert found.late_share == pytest.approx(1 / 3)

    @pytest.mark.parametrize(
        ("late", "missed", "degraded"), [(9, 0, False), (10, 0, False), (11, 0, True), (5, 6, True)]
    )
    def test_more_than_one_late_tick_in_a_hundred_is_degraded_timing(self, late, missed, degraded):
        errors = [101.5] * late + [99.5] * (1000 - late - missed)
        found = period_statistics(histogram(errors), missed, PERIOD_NS, "")
        assert found.late_share == pytest.approx((late + missed) / 1000)
        assert found.degraded is degraded
        assert found.label == ("timing degraded" if degraded else "timing good")

    def test_a_session_without_a_tick_has_no_error(self):
        found = period_statistics(histogram([]), 0, PERIOD_NS, "")
        assert (found.median_us, found.max_us, found.late_share, found.degraded) == (0.0, 0.0, 0.0, False)


class TestClock:
    def test_sleeping_ends_no_earlier_than_the_deadline(self):
        room = np.zeros(servo_loop.CLOCK_SIZE, np.int64)
        # the clock that no clock jump reaches
        before = time.monotonic_ns()
        assert before <= servo_loop.monotonic_ns(room) <= time.monotonic_ns()
        deadline = servo_loop.monotonic_ns(room) + 3_000_000
        servo_loop.sleep_until(deadline, room)
        assert servo_loop.monotonic_ns(room) >= deadline
        # a deadline that is past does not wait
        servo_loop.sleep_until(0, room)

    def test_a_pipe_is_readable_with_bytes_and_at_its_end(self):
        room = np.zeros(servo_loop.CLOCK_SIZE, np.int64)
        reading, writing = os.pipe()
        assert not servo_loop.readable(reading, room)
        os.write(writing, b"x")
        assert servo_loop.readable(reading, room)
        os.read(reading, 1)
        assert not servo_loop.readable(reading, room)
        os.close(writing)
        assert servo_loop.readable(reading, room)
        os.close(reading)
        assert not servo_loop.readable(-1, room)


@pytest.mark.needs_jit
class TestDeadlines:
    @pytest.mark.parametrize("loop", [servo_loop.compiled_loop, servo_loop.realtime_loop])
    def test_deadlines_that_passed_are_skipped_and_counted(self, loop):
        counts, watch = np.zeros(servo_loop.BINS + 1, np.int64), servo_loop.new_watch()
        # a microsecond a tick is more than any machine can keep
        period_ns, ticks = 1_000, 300
        with servo_here(SimulatedDevice(real_time=True)) as (io, servo, _ring, _block):
            begun = time.monotonic_ns()
            assert loop(io, servo, watch, counts, period_ns, ticks) == servo_loop.ENDED_TICKS
            most = (time.monotonic_ns() - begun) // period_ns
            records = servo.records[:ticks].copy()
        elapsed = records["time_s"][-1] - records["time_s"][0]
        least = int(elapsed * 1e9 / period_ns)
        assert counts[:-1].sum() == ticks
        assert servo.counters[MISSED] > 0
        # no burst: ticks and skipped deadlines together make up the time
        assert least - 2 <= ticks + int(servo.counters[MISSED]) <= most + 2
        # the measured step is what passed
        assert np.diff(records["time_s"]) == pytest.approx(records["dt_s"][1:], abs=1e-9)


class TestSchedule:
    @pytest.fixture
    def refused(self, monkeypatch):
        """A user without any right, whatever the test runs as."""

        def refuse(*_: object) -> None:
            raise PermissionError

        monkeypatch.setattr(os, "sched_setscheduler", refuse)
        monkeypatch.setattr(os, "sched_setaffinity", refuse)
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setattr(resource, "getrlimit", lambda _: (65_536, 65_536))
        monkeypatch.setattr(resource, "setrlimit", refuse)
        monkeypatch.setenv("USER", "ada")
        monkeypatch.setattr(servo_schedule.gc, "disable", lambda: None)

    def test_what_is_refused_is_said_with_what_to_type(self, refused):
        got = servo_schedule.make_punctual(locked=servo_schedule.settled())
        assert got.name == "SCHED_OTHER"
        assert not got.locked
        assert "'ada - memlock unlimited' to /etc/security/limits.d/tissueid.conf" in got.remedies[0]
        assert "'ada - rtprio 80' to /etc/security/limits.d/tissueid.conf" in got.remedies[1]
        assert "sudo setcap cap_sys_nice,cap_ipc_lock+ep" in got.remedies[1]
        assert len(got.remedies) == 2

    def test_what_is_granted_needs_no_remedy(self, refused, monkeypatch):
        asked = []
        monkeypatch.setattr(os, "sched_setscheduler", lambda *words: asked.append(words[1]))
        monkeypatch.setattr(servo_schedule, "_lock", lambda _libc: True)
        got = servo_schedule.make_punctual(locked=servo_schedule.settled(collect=True))
        assert asked == [os.SCHED_FIFO]
        assert (got.name, got.remedies) == ("SCHED_FIFO 80", ())


class TestSelfTest:
    def test_a_figure_holds_up_to_its_bar(self):
        assert [Figure("x", value, 5.0, "us").holds for value in (4.9, 5.0, 5.1)] == [True, True, False]

    @pytest.mark.needs_jit
    def test_the_selftest_measures_every_figure(self):
        told = []
        found = run_selftest(0.3, told.append)
        # other programs may take the processor: the number of ticks is a loose bound
        assert 30 <= found.statistics.ticks <= 1000
        assert found.start_s > 0.0
        assert told[-1] <= 1.0
        assert [(figure.name, figure.bar) for figure in found.figures] == [
            ("period error, 99 %", 100.0),
            ("period error, 99.9 %", 1000.0),
            ("force step", 100.0),
            ("tick, 99 %", 5.0),
        ]
        times = found.times
        assert 0.0 < times.force_step_ns * 1e-3 < times.tick_median_us <= times.tick_p99_us
