"""Real recordings, read here by the plainest means: what a person sees in them must be found."""

import csv

import numpy as np
import pytest
from told import codes, events, kinds

from tissueid.segment import segment
from tissueid.trial import Trial

calamine = pytest.importorskip("python_calamine")


def numbers(path, skip: int) -> np.ndarray:
    with path.open(encoding="latin-1", newline="") as file:
        rows = list(csv.reader(file))[skip:]
    return np.array([[float(cell) for cell in row[:3]] for row in rows if row])


def test_every_meat_sheet_has_a_ramp_and_a_hold(shared_data):
    path = next((shared_data / "zwick-meat-gpl3").glob("230403*.xlsx"))
    book = calamine.CalamineWorkbook.from_path(str(path))
    seen = 0
    for name in book.sheet_names:
        rows = book.get_sheet_by_name(name).to_python()[3:]
        if len(rows) < 50 or not all(isinstance(cell, float) for cell in rows[0][:3]):
            continue
        time_s, force, depth = np.array([row[:3] for row in rows], dtype=float).T
        found = segment(Trial(name, time_s, depth, force))
        seen += 1
        tests = [kind for kind in kinds(found) if kind != "approach"]
        assert tests == ["ramp", "hold"], name
        hold = found.of_kind("hold")[0]
        # the machine dwells 10 s after the force limit
        assert 9.5 <= hold.end_s - hold.start_s <= 11.0, name
        assert 0.5 <= found.of_kind("ramp")[0].speed_mm_s <= 2.5, name
        assert (found.compression_sign, found.force_sign) == (1, 1)
        assert found.contact is not None
    assert seen == 29


def test_cyclic_bluehill_file_is_cyclic_without_a_hold_and_not_preconditioned(shared_data):
    data = numbers(shared_data / "instron-bluehill-cyclic-cc0" / "Specimen_RawData_6.csv", 5)
    found = segment(Trial("cyclic", *data.T))
    assert (found.compression_sign, found.force_sign) == (-1, -1)
    assert kinds(found) == ["cycle"] * 3
    assert {"cyclic", "no_hold", "preload", "not_preconditioned"} <= codes(found)
    # -4.3 N of preload at some 5-8 N/mm: contact 0.5-0.9 mm before the start at -2.047 mm
    assert abs(found.contact.displacement_mm + 1.35) < 2.5 * found.contact.sd_mm
    assert found.contact.sd_mm < 1.0
    # 10 mm/min as its header says
    assert [phase.speed_mm_s for phase in found.phases] == pytest.approx([10.0 / 60.0] * 3, rel=0.01)
    assert [data[phase.peak, 0] for phase in found.phases] == pytest.approx([60.0, 180.0, 300.0], abs=0.2)


@pytest.mark.parametrize("state", ["Relaxed", "pCa4.4"])
@pytest.mark.parametrize("ramp_s", ["0.1", "1", "10", "100"])
def test_muscle_stretch_is_a_ramp_of_its_named_time_and_a_hold(shared_data, state, ramp_s):
    data = numbers(shared_data / "muscle-ramp-hold-mit" / f"Avg{state}_{ramp_s}s.csv", 1)
    found = segment(Trial("muscle", *data.T))
    assert kinds(found)[-2:] == ["ramp", "hold"]
    ends = found.of_kind("ramp")[0].end_s - data[0, 0]
    assert ends == pytest.approx(float(ramp_s), rel=0.12)


def test_oocyte_dwell_is_found_between_approach_and_retract(shared_data):
    data = numbers(shared_data / "oocyte-afm-mit" / "cell1-0008_full.csv", 1)
    found = segment(Trial("cell", data[:, 0], 1e3 * data[:, 2], data[:, 1]))
    assert kinds(found)[-3:] == ["ramp", "hold", "retract"]
    hold = found.of_kind("hold")[0]
    # 30 s of dwell as named by its source
    assert hold.end_s - hold.start_s == pytest.approx(30.0, abs=0.2)


def test_an_invar_bar_pulled_to_failure_ruptures_after_its_peak(shared_data):
    lines = (shared_data / "zwick-tra-mit" / "Invar_LT_05_01.TRA").read_text("latin-1").splitlines()
    rows = [row for row in csv.reader(lines) if len(row) > 3]
    names = next(row for row in rows if "Standard force" in row)
    columns = [names.index(name) for name in ("Time", "Standard travel", "Standard force")]
    table = rows[rows.index(names) + 2 :]
    data = np.array([[float(row[k]) for k in columns] for row in table])
    found = segment(Trial("invar", *data.T))
    (event,) = events(found, "rupture")
    # necking from the peak of 7.4 kN at 0.9 mm on; hardly anything is carried at the end
    assert 0.9 < event.values["depth_mm"] < 1.3
    assert event.values["drop_fraction"] > 0.9
