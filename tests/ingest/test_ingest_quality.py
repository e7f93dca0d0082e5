"""Every flag of the samples fires on its defect, with its numbers, and is silent on clean recordings.

These come from a simulator that shares nothing with the package: a crosshead whose speed changes within 50 to
300 ms (constant or smooth deceleration), an encoder with its counts, a Kelvin-Voigt tissue, and noise of the
load cell: white, correlated, or with mains hum.  Printed with the decimals of real exports.
"""

import re
from collections import Counter
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from ingest_files import put, read

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest import ReadOptions, find_inputs, quality, read_each
from tissueid.ingest.quality import below_cell_range, capacity_in, quality_flags
from tissueid.trial import Trial

RATES_HZ = (10, 20, 50, 100, 200, 500, 1000)
SPEEDS_MM_S = tuple(speed / 60.0 for speed in (10, 70, 100, 150, 250, 500))
MOST_SAMPLES = 20_000
FINE_S = 0.0005


@dataclass
class Recording:
    time_s: FloatArray
    displacement_mm: FloatArray
    force_N: FloatArray
    rate_Hz: float

    def channels(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.time_s, self.displacement_mm, self.force_N


def program(rng: np.random.Generator) -> tuple[list[tuple[float, float]], float]:
    """(speed, duration) of every move, and a sampling rate that keeps the file small."""
    rate, speed = float(rng.choice(RATES_HZ)), float(rng.choice(SPEEDS_MM_S))
    ramp, hold = rng.uniform(2.0, 8.0) / speed, rng.uniform(3.0, 30.0)
    moves = [(0.0, rng.uniform(0.0, 1.0)), (speed, ramp), (0.0, hold)]
    kind = rng.random()
    if kind < 0.3:
        moves += [(-speed, ramp), (0.0, 1.0)]
    elif kind < 0.5:
        moves = [(speed, ramp), (-speed, ramp)] * 3
    total = sum(duration for _, duration in moves)
    return moves, min(rate, 100.0) if rate * total > MOST_SAMPLES else rate


def path_of(moves: list[tuple[float, float]], time_s: FloatArray) -> FloatArray:
    """Displacement on straight lines with sharp corners."""
    knots = np.concatenate(([0.0], np.cumsum([duration for _, duration in moves])))
    reach = np.concatenate(([0.0], np.cumsum([speed * duration for speed, duration in moves])))
    return np.interp(time_s, knots, reach)


def crosshead(moves: list[tuple[float, float]], time_s: FloatArray, stop_s: float, kernel: str) -> FloatArray:
    """Displacement of a crosshead that takes ``stop_s`` for every change of speed."""
    fine = np.arange(0.0, time_s[-1] + 2.0 * stop_s, FINE_S)
    width = max(3, round(stop_s / FINE_S))
    weights = np.ones(width) if kernel == "constant" else np.hanning(width + 2)[1:-1]
    sharp = np.pad(path_of(moves, fine), width, mode="edge")
    smooth = np.convolve(sharp, weights / weights.sum(), mode="same")[width:-width]
    return np.interp(time_s, fine, smooth)


def tissue(rng: np.random.Generator, displacement_mm: FloatArray, step_s: float) -> FloatArray:
    """Force of a modified Kelvin-Voigt tissue met at a random travel."""
    depth = np.maximum(displacement_mm - rng.choice([0.0, 0.5, 1.0]), 0.0)
    tau, stiffness = rng.choice([0.02, 0.1, 1.0, 5.0]), rng.uniform(5.0, 80.0)
    decay = np.exp(-step_s / tau)
    stretch = np.zeros(depth.size)
    for i, rise in enumerate(np.diff(depth)):
        stretch[i + 1] = decay * stretch[i] + rise / step_s * tau * (1.0 - decay)
    return 20.0 * depth - 1.2 * depth**2 + 0.35 * depth**3 + stiffness * stretch


def load_cell(rng: np.random.Generator, time_s: FloatArray) -> FloatArray:
    """Noise of a force channel."""
    sigma = rng.choice([0.005, 0.02, 0.1, 0.5, 1.0])
    noise = rng.normal(0.0, sigma, time_s.size)
    kind = rng.choice(["white", "correlated", "hum"])
    if kind == "correlated":
        for i in range(1, noise.size):
            noise[i] += 0.7 * noise[i - 1]
    elif kind == "hum":
        noise += 2.0 * sigma * np.sin(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 6.0))
    return noise


def measured(seed: int) -> Recording:
    """A clean recording: real motion, encoder, tissue, noise, print."""
    rng = np.random.default_rng(seed)
    moves, rate = program(rng)
    time = np.arange(int(sum(duration for _, duration in moves) * rate)) / rate
    x = crosshead(moves, time, rng.uniform(0.05, 0.3), str(rng.choice(["constant", "smooth"])))
    force = tissue(rng, x, 1.0 / rate) + load_cell(rng, time)
    x = x + rng.choice([0.0, 2e-5, 1e-4, 5e-4]) * rng.normal(size=x.size)
    counts = rng.choice([0.0, 6e-5, 1e-3])
    x = np.rint(x / counts) * counts if counts else x
    if rng.random() < 0.3:
        time = np.maximum.accumulate(time + rng.normal(0.0, 2e-5, time.size).clip(-1e-4, 1e-4))
    return Recording(time.round(5), x.round(int(rng.choice([3, 4, 5, 6]))), force.round(3), rate)


def commanded(seed: int) -> Recording:
    """The same test with the displacement that the machine was told."""
    rng = np.random.default_rng(seed)
    moves, rate = program(rng)
    time = np.arange(int(sum(duration for _, duration in moves) * rate)) / rate
    told = path_of(moves, time)
    force = tissue(rng, crosshead(moves, time, 0.1, "smooth"), 1.0 / rate) + load_cell(rng, time)
    return Recording(time.round(5), told.round(int(rng.choice([4, 5, 6]))), force.round(3), rate)


def ramp_hold(seed: int = 7, *, rate_Hz: float = 100.0, decimals: int = 5) -> Recording:
    """One clean ramp of 4 mm at 2 mm/s and a hold of 10 s, 0.1 N of white noise."""
    rng = np.random.default_rng(seed)
    moves = [(0.0, 0.5), (2.0, 2.0), (0.0, 10.0)]
    time = np.arange(int(12.5 * rate_Hz)) / rate_Hz
    x = crosshead(moves, time, 0.15, "smooth") + 2e-5 * rng.normal(size=time.size)
    depth = np.maximum(x - 0.5, 0.0)
    force = 15.0 * depth + 2.0 * depth**2 + rng.normal(0.0, 0.1, time.size)
    return Recording(time, x.round(decimals), force.round(4), rate_Hz)


#: Flags that say something of the samples, not of columns or units.
OF_SAMPLES = set(re.findall(r'Flag\(\s*"(\w+)"', Path(quality.__file__).read_text(encoding="utf-8")))


def flags_of(recording: Recording) -> dict[str, Flag]:
    return {flag.code: flag for flag in quality_flags(*recording.channels())}


def pushed(time: np.ndarray, seed: int, *, speed: float = 1.0) -> Recording:
    """Into 4 mm of a tissue of 10 N/mm, with noise of 0.1 N and 0.1 um."""
    rng = np.random.default_rng(seed)
    x = np.minimum(speed * time, 4.0) + rng.normal(0.0, 1e-4, time.size)
    return Recording(time, x, 10.0 * x + rng.normal(0.0, 0.1, time.size), 0.0)


def only(recording: Recording, code: str) -> Flag:
    """The flag of that code; no other may be there."""
    found = flags_of(recording)
    assert list(found) == [code]
    return found[code]


# 0 of 4000: the rate of false alarms is below 0.1 % (95 %: 3 / 4000)
@pytest.mark.parametrize(
    "seeds", [range(150), pytest.param(range(10_000, 14_000), marks=pytest.mark.slow)], ids=len
)
def test_clean_recordings_raise_no_flag(seeds: range) -> None:
    alarms = Counter(flag.code for seed in seeds for flag in quality_flags(*measured(seed).channels()))
    assert alarms == Counter()


#: Real recordings with event rows at segment changes; none has anything else.
WITH_EVENTS = ("Specimen_RawData_6.csv", *(f"AvgpCa4.4_{seconds}s.csv" for seconds in (0.1, 1, 10, 100)))


def test_real_recordings_raise_no_false_flag(shared_data) -> None:
    read = 0
    for path in find_inputs([shared_data]):
        muscle = ReadOptions(columns={"displacement": "L", "force": "F"})
        for trial in read_each(path, muscle if "muscle" in path.parts[-2] else None):
            if isinstance(trial, Trial):
                read += 1
                codes = {flag.code for flag in trial.flags} & OF_SAMPLES
                assert codes == ({"event_rows"} if path.name in WITH_EVENTS else set()), trial.name
    assert read >= 40


def test_a_gap_in_the_ramp_tells_how_far_the_force_went_unseen() -> None:
    clean = ramp_hold()
    keep = (clean.time_s < 1.0) | (clean.time_s > 2.2)
    cut = Recording(*(channel[keep] for channel in clean.channels()), 100.0)
    values = only(cut, "gap").values
    assert values["count"] == 1
    before, after = (clean.force_N[clean.time_s < 1.0][-1], clean.force_N[clean.time_s > 2.2][0])
    assert values["force_change_N"] == after - before
    # the last sample kept is at 0.99 s and the next at 2.21 s
    assert values["longest_s"] == pytest.approx(1.22, abs=1e-9)
    assert values["at_s"] == 0.99


def test_gaps_are_told_though_intervals_run_from_1_ms_to_26_s() -> None:
    parts = [np.arange(0.0, 20.0, 0.1)]
    for pause in (19.0, 26.0, 22.0):
        parts.append(parts[-1][-1] + pause + np.arange(0.0, 30.0, 0.5))
    time = np.concatenate(parts)
    found = flags_of(pushed(np.sort(np.append(time, time[199] + 0.001)), 1, speed=0.2))
    assert (found["gap"].values["count"], found["gap"].values["longest_s"]) == (3, pytest.approx(26.0))
    assert found["event_rows"].values["least_interval_s"] == pytest.approx(0.001)
    slow = np.concatenate([np.arange(0.0, 2.0, 0.001), 2.0 + np.arange(60.0), 81.0 + np.arange(40.0)])
    gap = flags_of(pushed(slow, 3, speed=2.0))["gap"].values
    assert (gap["longest_s"], gap["usual_interval_s"]) == pytest.approx((20.0, 1.0))


def test_repeated_times_and_event_rows_are_counted() -> None:
    clean = ramp_hold()
    double = np.repeat(np.arange(clean.time_s.size), np.where(np.arange(clean.time_s.size) == 300, 2, 1))
    repeated = Recording(*(channel[double] for channel in clean.channels()), 100.0)
    assert only(repeated, "zero_dt").values == {"count": 1, "first_s": 3.0}
    at = clean.time_s[250] + 0.001
    extra = [np.insert(channel, 251, channel[250]) for channel in clean.channels()]
    extra[0][251] = at
    extra[2][251] += 0.05
    assert only(Recording(*extra, 100.0), "event_rows").values["first_s"] == at


@pytest.mark.parametrize("limit_N", [2.0, 20.0, 40.0])
def test_a_clipped_force_tells_its_limit(limit_N: float) -> None:
    clean = ramp_hold()
    flag = only(replace(clean, force_N=np.minimum(clean.force_N, limit_N)), "clipped_force")
    assert flag.values["force_N"] == limit_N
    assert flag.values["samples_in_all"] >= int((clean.force_N > limit_N).sum())


def test_a_force_clipped_only_while_it_is_held_is_seen() -> None:
    clean = ramp_hold()
    still = np.where(clean.time_s >= 2.8, clean.displacement_mm[-1], clean.displacement_mm)
    limit = float(np.quantile(clean.force_N[clean.time_s > 3.0], 0.001))
    held = replace(clean, displacement_mm=still, force_N=np.minimum(clean.force_N, round(limit, 4)))
    assert "clipped_force" in flags_of(held)


def test_either_limit_of_the_load_cell_counts() -> None:
    # adhesion pulls harder than the clipped push: the smaller extreme is the limit
    clean = ramp_hold()
    force = np.minimum(clean.force_N, 30.0) - 45.0 * (clean.time_s > 11.0)
    pulled = np.where(clean.time_s > 11.0, force - 20.0 * np.exp(-((clean.time_s - 11.5) ** 2) / 0.05), force)
    noise = np.random.default_rng(12).normal(0.0, 0.05, force.size) * (clean.time_s > 11.0)
    assert flags_of(replace(clean, force_N=pulled + noise))["clipped_force"].values["force_N"] == 30.0


def sampled_twice(ramp_Hz: float, hold_Hz: float) -> Recording:
    ramp = np.arange(int(4.0 * ramp_Hz)) / ramp_Hz
    hold = ramp[-1] + 1.0 / ramp_Hz + np.arange(int(60.0 * hold_Hz)) / hold_Hz
    return pushed(np.concatenate([ramp, hold]), 2)


def resting() -> Recording:
    """A coarsely printed force that rests at its peak."""
    time = np.arange(3000) * 0.01
    force = np.round(30.0 * np.tanh(time / 8.0) + np.random.default_rng(5).normal(0.0, 0.003, 3000), 2)
    x = np.minimum(time * 0.2, 5.0) + np.random.default_rng(6).normal(0.0, 1e-4, 3000)
    return Recording(time, x, force, 100.0)


def computed(power: float) -> Recording:
    """A force without noise that stands in its hold."""
    time = np.arange(3000) * 0.01
    x = np.minimum(time * 0.2, 4.0)
    return Recording(time, x, 3.0 * x**power, 100.0)


def equal_steps() -> Recording:
    """80 equal steps of a computed ramp, and a hold: equal steps are its speed, not its resolution."""
    x = np.concatenate([np.arange(80) * 0.05, np.full(400, 4.0)])
    force = 10.0 * x + np.random.default_rng(8).normal(0.0, 0.1, x.size)
    return Recording(np.arange(480) * 0.1, x, force, 10.0)


def ringing() -> Recording:
    """The sharp peak of a stop, and what swings behind it."""
    time = np.arange(0.0, 12.0, 0.04)
    x, decay = np.minimum(time, 4.0), np.exp(-np.maximum(time - 4.0, 0.0) / 0.05)
    ring = np.where(time > 4.0, 0.5 * decay * np.cos(2 * np.pi * (time - 4.0) / 0.08), 0.0)
    noise = np.random.default_rng(9).normal(0.0, 0.005, time.size)
    return Recording(time, x, 0.25 * x + decay * 0.6 * (x > 0) + ring + noise, 25.0)


def dropped() -> Recording:
    clean = ramp_hold()
    return replace(clean, force_N=clean.force_N - 20.0 * (clean.time_s > 1.9))


BURSTS = (np.arange(200)[:, None] + np.arange(8) * 0.001).ravel()


@pytest.mark.parametrize(
    ("recording", "code"),
    [
        *((sampled_twice(*rates), None) for rates in ((1000.0, 1.0), (100.0, 2.0), (1.0, 100.0))),
        (pushed(BURSTS, 4, speed=0.05), "gap"),
        (resting(), "clipped_force"),
        (computed(1.0), "clipped_force"),
        (computed(2.0), "clipped_force"),
        (equal_steps(), "below_resolution"),
        (ringing(), "spike"),
        (dropped(), "spike"),
    ],
    ids=[
        "a slower hold", "a little slower hold", "a faster hold", "bursts with pauses", "a peak that rests",
        "computed", "computed, squared", "equal steps", "ringing", "a drop that stays",
    ],
)  # fmt: skip
def test_what_only_looks_like_a_defect_raises_none(recording: Recording, code: str | None) -> None:
    found = flags_of(recording)
    assert code not in found if code else found == {}


def test_eighteen_levels_are_quantised() -> None:
    clean = ramp_hold(rate_Hz=500.0)
    smooth = 15.0 * np.maximum(clean.displacement_mm - 0.5, 0.0)
    flag = flags_of(replace(clean, force_N=np.round(smooth / 2.8) * 2.8))["quantised_force"]
    assert flag.values["levels"] == np.unique(np.round(smooth / 2.8)).size
    assert flag.values["step_N"] == pytest.approx(2.8)


@pytest.mark.parametrize(("step_mm", "said"), [(0.1, True), (0.05, True), (0.02, False)])
def test_few_steps_of_the_encoder_are_told(step_mm: float, said: bool) -> None:
    clean = ramp_hold()
    coarse = np.rint(clean.displacement_mm / step_mm) * step_mm
    found = flags_of(replace(clean, displacement_mm=coarse))
    assert ("below_resolution" in found) is said
    if said:
        # 4 mm of travel
        assert found["below_resolution"].values["displacement_steps"] == pytest.approx(4.0 / step_mm, abs=1)
        assert found["below_resolution"].values["step_displacement_mm"] == pytest.approx(step_mm)


def test_few_steps_of_the_load_cell_are_told_though_noise_dithers_them() -> None:
    clean = ramp_hold()
    flag = only(replace(clean, force_N=np.rint(clean.force_N / 2.0) * 2.0), "below_resolution")
    assert flag.values["step_force_N"] == 2.0
    assert flag.values["force_steps"] == pytest.approx(np.ptp(clean.force_N) / 2.0, abs=1)


#: The last one in a short recording, most of it corners.
SPIKES = (*product((0.1, 1.5, 8.0), (-15.0, 4.0, 300.0), (100.0,)), (9.0, -20.0, 10.0))


@pytest.mark.parametrize(("place_s", "off_N", "rate_Hz"), SPIKES)
def test_one_wild_force_is_a_spike_and_is_placed(place_s: float, off_N: float, rate_Hz: float) -> None:
    clean = ramp_hold(rate_Hz=rate_Hz)
    at = int(place_s * rate_Hz)
    force = clean.force_N.copy()
    force[at] += off_N
    values = flags_of(replace(clean, force_N=force))["spike"].values
    assert (values["force_count"], values["force_largest_s"]) == (1, clean.time_s[at])
    # seen from its neighbours: their noise of 0.1 N, a few times over
    assert values["force_off_N"] == pytest.approx(off_N, abs=1.0)


def test_spikes_put_into_real_recordings_are_found(shared_data) -> None:
    found = total = 0
    rng = np.random.default_rng(1)
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    for trial in read_each(path):
        for at in rng.integers(5, trial.time_s.size - 5, 4).tolist():
            force = trial.force_N.copy()
            force[at] += 0.3 * np.ptp(force) * rng.choice([-1.0, 1.0])
            flags = quality_flags(trial.time_s, trial.displacement_mm, force)
            placed = [flag.values.get("force_largest_s") for flag in flags if flag.code == "spike"]
            found += placed == [trial.time_s[at]]
            total += 1
    # near the start and the stop of the machine none is told: some 2 s of the 14 s of a recording
    assert found >= 0.7 * total


def test_spikes_of_displacement_and_force_are_counted_apart() -> None:
    clean = ramp_hold()
    force, x = clean.force_N.copy(), clean.displacement_mm.copy()
    force[[100, 700, 900]] += 20.0
    x[800] -= 1.0
    values = only(replace(clean, force_N=force, displacement_mm=x), "spike").values
    assert (values["force_count"], values["displacement_count"]) == (3, 1)
    assert values["displacement_off_mm"] == pytest.approx(-1.0, abs=1e-3)


def test_a_commanded_displacement_is_suspected() -> None:
    fast = [recording for recording in map(commanded, range(60)) if recording.rate_Hz >= 50.0]
    assert sum("commanded_displacement" in flags_of(one) for one in fast) >= 0.85 * len(fast)


@pytest.mark.parametrize("repeat", [-1, 1])
def test_a_commanded_displacement_tells_its_corners(repeat: int) -> None:
    time = np.arange(1500) * 0.01
    x = repeat * np.interp(time, [0.0, 0.503, 2.423, 15.0], [0.0, 0.0, 8.0, 8.0]).round(5)
    force = 10.0 * x + np.random.default_rng(10).normal(0.0, 0.5, time.size)
    values = only(Recording(time, x, force.round(3), 100.0), "commanded_displacement").values
    assert values["corners"] == 2
    # 250 mm/min
    assert values["speed_change_mm_s"] == pytest.approx(8.0 / 1.92, rel=1e-3)
    assert values["last_digit_mm"] == 1e-5
    # a computed force without noise is no measurement to doubt
    assert "commanded_displacement" not in flags_of(Recording(time, x, 10.0 * x, 100.0))


@pytest.mark.parametrize("stop_s", [0.05, 0.1, 0.3])
@pytest.mark.parametrize("kernel", ["constant", "smooth"])
@pytest.mark.parametrize("rate_Hz", [40.0, 50.0, 100.0, 1000.0])
def test_a_noiseless_encoder_with_a_real_stop_is_not_suspected(stop_s, kernel, rate_Hz) -> None:
    time = np.arange(int(10.0 * rate_Hz)) / rate_Hz
    for shift in np.linspace(0.0, 1.0 / rate_Hz, 5):
        for decimals in (3, 4, 5):
            x = crosshead([(0.0, 0.5 + shift), (2.0, 2.0), (0.0, 8.0)], time, stop_s, kernel).round(decimals)
            force = 10.0 * x + np.random.default_rng(11).normal(0.0, 0.1, time.size)
            assert "commanded_displacement" not in flags_of(Recording(time, x, force, rate_Hz))


@pytest.mark.parametrize(
    ("key", "value", "capacity_N"),
    [
        ("System : Load cell capacity", "2 kN", 2000.0), ("Load Cell", "500 N", 500.0),
        ("Kraftaufnehmer Nennkraft", "2,5 kN", 2500.0), ("Capteur de force", "100 N", 100.0),
        ("Load cell", "S/N 1234", None), ("Test : Rate 1", "10 mm/min", None),
    ],
)  # fmt: skip
def test_the_capacity_of_the_cell_is_read_from_the_header(key, value, capacity_N) -> None:
    assert capacity_in({key: value}, decimal="," if "," in value else ".") == capacity_N


def test_a_small_force_on_a_large_cell_is_told() -> None:
    force = ramp_hold().force_N
    largest = float(np.abs(force - force[0]).max())
    flag = below_cell_range(force, 10_000.0)
    assert flag.values == {"largest_N": largest, "verified_from_N": 100.0, "capacity_N": 10_000.0}
    assert below_cell_range(force, 2_000.0) is None
    assert below_cell_range(force, None) is None
    assert below_cell_range(force, 10_000.0, verified_from_N=10.0) is None
    assert below_cell_range(force, None, verified_from_N=2.0 * largest) is not None


def test_the_flag_comes_out_of_a_file_whose_header_names_the_cell(tmp_path) -> None:
    clean = ramp_hold()
    rows = [f"{t:.2f},{x:.5f},{f:.4f}" for t, x, f in zip(*clean.channels(), strict=True)]
    head = ['System : Load cell capacity,"30.00000",kN', "", "Time,Extension,Load", "(sec),(mm),(N)"]
    trial = read(put(tmp_path / "large-cell.csv", "\n".join([*head, *rows, ""])))
    assert [flag.code for flag in trial.flags] == ["below_cell_range"]
    assert trial.flags[0].values["capacity_N"] == 30_000.0


@pytest.mark.parametrize(
    ("leap_N", "stands", "told"), [(0.3, True, True), (0.3, False, False), (0.01, True, False)]
)
def test_a_load_cell_that_is_zeroed_in_mid_log_is_told(leap_N, stands, told):
    time = np.arange(0.0, 40.0, 0.02)
    # 10 s at rest in air, a ramp, and a hold that relaxes
    travel = np.interp(time, [0.0, 10.0, 14.0, 40.0], [0.0, 0.0, 4.0, 4.0])
    force = np.maximum(travel - 1.0, 0.0) * (1.0 + 0.5 * np.exp(-np.maximum(time - 14.0, 0.0)))
    force += 0.003 * np.random.default_rng(2).standard_normal(time.size)
    force -= leap_N * (time > (5.0 if stands else 11.5))
    found = [flag for flag in quality_flags(time, travel, force) if flag.code == "jump"]
    assert bool(found) is told
    if told:
        assert found[0].values["leap_N"] == pytest.approx(-leap_N, abs=0.02)
        assert "zeroed?" in found[0].message


@pytest.mark.parametrize(
    ("leap_N", "at_s", "told"), [(-1.1, 5.0, True), (0.4, 5.0, True), (-0.4, 9.0, False)]
)
def test_a_load_cell_that_is_zeroed_on_its_way_through_air_is_told(leap_N, at_s, told):
    """The tool moves at 1 mm/s from the first sample on; what leaps in the tissue may be of it."""
    time = np.arange(0.0, 30.0, 0.01)
    travel = np.minimum(time, 12.0)
    force = 3.0 * np.maximum(travel - 8.0, 0.0) * (1.0 + 0.5 * np.exp(-np.maximum(time - 12.0, 0.0)))
    force += 0.01 * np.random.default_rng(2).standard_normal(time.size) + leap_N * (time > at_s)
    found = [flag for flag in quality_flags(time, travel, force) if flag.code == "jump"]
    assert bool(found) is told
    if told:
        assert found[0].values["leap_N"] == pytest.approx(leap_N, abs=0.05)
        assert found[0].message.endswith("while the tool moves in air: zeroed?")


def test_a_probe_that_is_drawn_onto_its_sample_was_not_zeroed():
    """The tip snaps by 0.3 N where it meets the sample, and force rises from there at 2 N/mm and 1 mm/s."""
    time = np.arange(0.0, 10.0, 0.02)
    travel = np.minimum(time, 8.0)
    force = np.where(travel > 5.0, 2.0 * (travel - 5.0) - 0.3, 0.0)
    force += 0.003 * np.random.default_rng(2).standard_normal(time.size)
    assert not [flag for flag in quality_flags(time, travel, force) if flag.code == "jump"]


@pytest.mark.parametrize("in_contact", [True, False])
def test_travel_that_is_zeroed_under_a_force_is_told_and_a_fast_way_back_in_air_is_not(in_contact):
    time = np.arange(0.0, 40.0, 0.02)
    # 2 mm held for 10 s, then 2 mm more; in air the same leap is a fast way back
    travel = np.interp(time, [0.0, 4.0, 14.0, 18.0, 40.0], [0.0, 3.0, 3.0, 5.0, 5.0])
    force = np.maximum(travel - 1.0, 0.0) * 0.8 if in_contact else np.zeros(time.size)
    force += 0.003 * np.random.default_rng(2).standard_normal(time.size)
    found = quality_flags(time, travel - 3.0 * (time > 10.0), force + (time > 18.0) * (not in_contact))
    told = [flag for flag in found if flag.code == "jump"]
    assert bool(told) is in_contact
    if told:
        assert told[0].values["leap_mm"] == pytest.approx(3.0, abs=0.02)
        assert told[0].message.endswith("zeroed?")
