"""Words of the report: sentences, quoted numbers and loops, the measured block and its workbook."""

import base64
import io
import re
from dataclasses import replace
from typing import Any

import openpyxl
import pytest
from fit_factory import specimen_fit
from msgspec import structs
from posterior_factory import sampled
from report_pages import document_of, render_report, specimen_of
from typed_call import typed_call

from tissueid.documents.inspect import Units
from tissueid.documents.measured import (
    Base,
    Measured,
    MeasuredForce,
    MeasuredHold,
    MeasuredPeak,
    MeasuredPush,
    MeasuredTau,
)
from tissueid.documents.quantities import (
    Assumptions,
    AtDepth,
    Conditions,
    Cycle,
    Measure,
    Quantity,
    Quoted,
    Spectrum,
)
from tissueid.measured import spread
from tissueid.measured.geometry import Geometry
from tissueid.model.moduli import Indenter
from tissueid.report.measured_words import MOST_COLUMNS, measured_view
from tissueid.report.quoted_words import MOST_ROWS, cycle_table, quoted_tables
from tissueid.report.wording import (
    LEVELS,
    event_words,
    overview_sentence,
    remarks,
    tissue_sentence,
    verdict,
)
from tissueid.report.workbook import report_workbook
from tissueid.result import SpecimenFit
from tissueid.store.curves import curves_of_fits
from tissueid.store.schema import first_problem

remarks = typed_call(remarks)
overview_sentence = typed_call(overview_sentence)
tissue_sentence = typed_call(tissue_sentence)
verdict = typed_call(verdict)


def specimen_document(**options: Any) -> dict[str, Any]:
    return specimen_of(specimen_fit(**options))


def test_the_sentence_names_stiffness_relaxation_viscosity_tip_and_validity():
    # secant at 6 mm: 4 + 0.8 * 6 + 0.05 * 36 = 10.6 N/mm
    assert tissue_sentence(specimen_document()) == (
        "Its static stiffness is 4.000 ± 0.050 N/mm at contact (10.6 N/mm on average over 6.00 mm), "
        "it relaxes in 1.500 ± 0.030 s and its viscosity is 9.00 ± 0.11 N·s/mm; found with a tool tip of "
        "radius 3.00 mm, valid to 6.00 mm deep and for loading at 0.500 to 4.00 mm/s (30.0 to 240 mm/min)."
    )


def test_a_sampled_tissue_is_told_with_its_total_intervals_and_a_misfit_takes_them_off():
    fit = sampled(specimen_fit())
    (eta,) = [one for one in fit.parameters if one.name.startswith("viscosity")]
    low, high = eta.uncertainty.ci95_total
    sentence = tissue_sentence(specimen_of(fit))
    assert (
        f"its viscosity is 9.00 N·s/mm [{low:.2f} to {high:.2f}] (brackets: 95 % total intervals)" in sentence
    )
    assert "±" not in sentence
    statistical = tissue_sentence(specimen_of(sampled(specimen_fit(), total=False)))
    assert "(brackets: 95 % statistical intervals)" in statistical
    doubted = tissue_sentence(specimen_of(sampled(specimen_fit(), misfit=True)))
    assert "95 %" not in doubted
    assert "±" not in doubted
    unknown = tissue_sentence(specimen_document(identified=False))
    assert "its relaxation time is not identified" in unknown
    assert "1.5" not in unknown


def test_the_verdict_falls_with_what_is_missing():
    clean = specimen_document() | {"flags": [], "relaxation": []}
    clean["trials"] = [one | {"flags": []} for one in clean["trials"]]
    assert verdict(clean).level == "ok"
    assert verdict(specimen_document()).level == "caution"
    assert "5 of 6 parameters are identified" in verdict(specimen_document(identified=False)).text
    lost = specimen_document()
    lost["parameters"][-1] |= {"identified": False, "value": None}
    assert verdict(lost).level == "serious"
    assumed = clean | {"flags": [{"code": "split_assumed", "message": "m"}]}
    assert verdict(assumed).text.endswith("every parameter is identified, if K is constant.")
    stopped = clean | {"flags": [{"code": "not_converged", "message": "m"}]}
    assert verdict(stopped).level == "serious"


def test_a_flag_of_many_trials_is_one_remark_that_names_them_and_the_gravest_comes_first():
    found = remarks(specimen_document(trials=3, identified=False))
    (same_time,) = [remark for remark in found if remark.code == "zero_dt"]
    assert same_time.where == ("run_1.csv", "run_2.csv", "run_3.csv")
    levels = [LEVELS.index(remark.level) for remark in found]
    assert levels == sorted(levels, reverse=True)


def test_several_specimens_are_summed_up_by_median_and_range():
    entries = [
        specimen_document(specimen="a"),
        specimen_document(specimen="b"),
        specimen_document(specimen="c", identified=False),
    ]
    entries[0]["parameters"][-1]["value"] = 12.0
    sentence = overview_sentence(entries)
    assert "viscosity 9.00 N·s/mm (9.00 to 12.0)" in sentence
    assert "relaxation time 1.50 s (1.50 to 1.50, identified in 2)" in sentence


def test_sentences_of_one_flag_are_joined_once_each():
    entry = specimen_document()
    entry["flags"] = [
        {"code": "not_identified", "message": message}
        for message in ("a is open.", "b is open", "a is open.")
    ]
    entry["trials"] = [one | {"flags": []} for one in entry["trials"]]
    (remark,) = remarks(entry | {"relaxation": []})
    assert remark.message == "a is open; b is open"


MM_N = Units(length="mm", force="N", time="s")


def test_an_event_is_told_in_words_and_units():
    broken = {"force_before_N": 66.2, "drop_N": 12.5, "drop_fraction": 0.19, "work_N_mm": 64.16}
    said = "force before 66.20 N, falls by 12.50 N, work from contact 64.16 N mm"
    assert event_words(broken, MM_N) == said
    assert event_words({"turns": 3, "force_N": 2.0}, MM_N) == "turns 3, force 2.000 N"
    normalised = Units(length="1", force="MPa", time="s")
    assert event_words({"drop_N": 2.0, "depth_mm": 0.5}, normalised) == "falls by 2.000 MPa, depth 0.5"


cycle_table = typed_call(cycle_table)
quoted_tables = typed_call(quoted_tables)


def loop(number: int = 1, **changes: Any) -> Cycle:
    one = Cycle(
        path="lab/loops.csv", sheet=None, number=number, kind="cycle", start_s=0.0, peak_s=2.0, end_s=4.0,
        floor_mm=0.0, peak_depth_mm=4.0, peak_force_N=Measure(52.7391, 0.0132),
        loading_work_mJ=Measure(281.3, 0.2), dissipated_mJ=Measure(118.57, 0.31),
        hysteresis=Measure(0.42158, 0.0011), secant_N_per_mm=Measure(13.18, 0.01),
        tangent_N_per_mm=Measure(15.1, 0.4), residual_depth_mm=Measure(),
        viscosity_N_s_per_mm=Measure(37.27, 0.09), viscosity_model_N_s_per_mm=Measure(),
        peak_force_change=Measure(), dissipated_change=Measure(),
        at_depths=(AtDepth(2.0, Measure(11.0, 0.1), Measure(12.0, 0.2)),),
    )  # fmt: skip
    return structs.replace(one, **changes)


def numbers() -> Quoted:
    step = Conditions(path="step", depth_mm=4.0)
    ramp = Conditions(path="ramp", depth_mm=4.0, speed_mm_s=2.0)
    swing = Conditions(frequency_Hz=1.0, depth_mm=2.0)
    deep = Conditions(depth_mm=4.0)
    late = "later than the 12 s that were seen"
    model = [
        Quantity("fraction_relaxed", "1", structs.replace(step, time_s=1.0), 0.2387, 0.0042, None),
        Quantity("fraction_relaxed", "1", structs.replace(step, time_s=100.0), None, None, late),
        Quantity("peak_to_plateau", "1", step, 1.8, 0.01, None),
        Quantity("fraction_relaxed", "1", structs.replace(ramp, time_s=1.0), 0.1746, 0.0026, None),
        Quantity("fraction_relaxed", "1", structs.replace(ramp, time_s=100.0), None, None, late),
        Quantity("peak_to_plateau", "1", ramp, 1.4, 0.01, None),
        Quantity("storage_stiffness", "N/mm", swing, 19.85, 0.16, None),
        Quantity("loss_stiffness", "N/mm", swing, 3.716, 0.033, None),
        Quantity("tan_delta", "1", swing, 0.18722, 0.0023, None),
        Quantity("dissipated_energy", "mJ", structs.replace(swing, amplitude_mm=0.4), 1.867, 0.017, None),
    ]
    for name in ("equilibrium", "instantaneous"):
        model.append(Quantity(f"{name}_secant", "N/mm", deep, 20.8, 0.1, None))
        model.append(Quantity(f"{name}_tangent", "N/mm", deep, 27.2, 0.1, None))
    at = Conditions(formula="hertz", doi="10.1515/crll.1882.92.156", depth_mm=4.0)
    return Quoted(
        window_s=12.0,
        resolution_s=0.02,
        noise="white",
        model=tuple(model),
        moduli=(
            Quantity("modulus_equilibrium", "kPa", at, 33.78, 0.18, None),
            Quantity("modulus_instantaneous", "kPa", at, None, None, "the data do not determine it"),
        ),
        spectra=(
            Spectrum("lab/hold.csv", None, 1.0, 13.0, 5.0, (0.2, 0.5, 3.0), (3.0, 1.0, 4.0), 0.01, 0.02),
        ),
        assumptions=Geometry(Indenter("sphere", 3.0)).stated(),
    )  # fmt: skip


def document(**changes: Any) -> tuple[dict[str, Any], Any]:
    fit = replace(specimen_fit(), **changes)
    made = document_of(fit)
    assert first_problem(made, "identification") is None
    return made, curves_of_fits([fit])


def test_document_with_every_quoted_number_is_valid_and_its_page_has_them():
    made, curves = document(quoted=numbers(), cycles=(loop(), loop(2)))
    page = render_report(made, curves)
    for text in (
        "Numbers to quote", "23.87 ± 0.42", "later than the 12 s", "33.78 ± 0.18",
        "the data do not determine it", "0.1872 ± 0.0023", "Load-unload loops", "118.57 ± 0.31",
        "42.16 ± 0.11",
        "a sphere of radius 3.00 mm", "this tip on this support",
    ):  # fmt: skip
        assert text in page, text
    assert "no modulus is given" not in page


def test_without_a_tip_the_stiffness_is_called_structural_and_without_numbers_there_is_no_section():
    made, curves = document(quoted=structs.replace(numbers(), moduli=(), assumptions=Assumptions()))
    assert "no modulus is given" in render_report(made, curves)
    page = render_report(*document())
    assert "Numbers to quote" not in page
    assert "Load-unload loops" not in page


def test_spectrum_is_told_by_decades():
    tables = {table.title: table for table in quoted_tables(numbers())}
    spectrum = tables["Relaxation spectrum"]
    assert spectrum.heads == ("Hold of", "0.1 to 1 s", "1 to 10 s", "Plateau [N]")
    assert spectrum.rows == (("hold.csv", "50", "50", "5.00"),)


def test_many_loops_are_cut_to_the_first_and_last():
    table = cycle_table([loop(k) for k in range(1, 31)])
    assert len(table.rows) == MOST_ROWS
    assert table.left_out == 30 - MOST_ROWS
    assert table.rows[0][0].endswith("cycle 1")
    assert table.rows[-1][0].endswith("cycle 30")


def test_unloading_is_told_beside_the_loops_and_loops_of_what_could_not_be_fitted_are_shown():
    unloading = {
        "rounds": 3, "converged": False, "change_sd": 0.4, "samples_in_contact": 600, "samples_in_air": 150,
        "samples_pulled": 0, "rms_in_contact_N": 0.2, "rms_in_air_N": 0.21, "surface_unique": True,
    }  # fmt: skip
    made, curves = document(cycles=(loop(),), unloading=unloading)
    made["unfitted_cycles"] = made["specimens"][0]["cycles"]
    assert first_problem(made, "identification") is None
    page = render_report(made, curves)
    assert "not settled after 3 rounds" in page
    assert "150 in air with 0.210 N left there" in page
    assert "Loops of recordings that were not fitted" in page


measured_view = typed_call(measured_view)
report_workbook = typed_call(report_workbook)


def log(peak_N: float, *, depth_mm: float = 6.0, speed_mm_s: float = 4.0, holds: int = 1) -> Measured:
    """A log whose force falls to 80 % of the peak at 1 s and to half of it at 10 s."""
    ramp_s = depth_mm / speed_mm_s
    push = MeasuredPush(
        0.0, ramp_s, ramp_s, speed_mm_s, depth_mm, depth_mm, 0.1, MeasuredPeak(ramp_s, peak_N, peak_N), None
    )
    forces = tuple(
        MeasuredForce(
            t, share * peak_N, 0.01, share * peak_N, share * peak_N, share / 0.5, share, False, None
        )
        for t, share, force in ((1.0, 0.8, 0.8 * peak_N), (10.0, 0.5, 0.5 * peak_N))
    )
    tau = MeasuredTau((ramp_s, ramp_s + 12.0), 2.0, (), 0.01, None)
    hold = MeasuredHold(ramp_s, ramp_s + 12.0, "position", push, forces, 0.5 * peak_N, 0.0, tau, False)
    return Measured(Base(0.0, "air"), push, (hold,) * holds, ())


def measured_fit(*logs: Measured, speeds: tuple[float, ...] = ()) -> SpecimenFit:
    fit = specimen_fit(trials=len(logs), samples=60)
    trials = tuple(
        replace(trial, measured=one, speed_mm_s=speeds[i] if speeds else 4.0)
        for i, (trial, one) in enumerate(zip(fit.trials, logs, strict=True))
    )
    return replace(fit, trials=trials, measured=spread(logs))


def view_of(fit: SpecimenFit) -> Any:
    return measured_view(specimen_of(fit))


def cells(fit: SpecimenFit) -> dict[str, list[str]]:
    return {row["name"]: [text for text, _ in row["cells"]] for row in view_of(fit)["rows"]}


def test_logs_of_one_programme_have_a_mean_and_their_standard_deviation():
    fit = measured_fit(log(9.0), log(10.0), log(11.0))
    found = cells(fit)
    assert found["Peak force"] == ["10.0 ± 1.0"]
    assert found["F(1 s)"] == ["8.00 ± 0.80"]
    assert found["F(10 s)"] == ["5.00 ± 0.50"]
    assert found["F(1 s)/F(10 s)"] == ["1.600"]
    assert found["One τ of the hold"] == ["2.000"]
    # a share of the peak is the ramp's as much as the tissue's
    assert not [name for name in found if "F_peak" in name]
    view = view_of(fit)
    assert view["head"] == ["Value, ramp 1.50 s"]
    assert view["said"].startswith("F(t): t after the stop. Mean ± SD between logs.")


def test_one_log_says_that_its_spread_is_unknown_and_several_holds_have_a_column_each():
    fit = measured_fit(log(9.0))
    assert cells(fit)["F(1 s)"] == ["7.200"]
    assert "the spread between sites is unknown" in view_of(fit)["said"]
    view = view_of(measured_fit(log(9.0, holds=2)))
    assert view["head"] == ["Hold 1, ramp 1.50 s", "Hold 2, ramp 1.50 s"]


def test_programmes_are_not_pooled_and_those_beyond_the_first_are_counted():
    logs = (log(9.0), log(11.0), log(30.0, speed_mm_s=20.0), log(2.0, speed_mm_s=0.1))
    fit = measured_fit(*logs, speeds=(4.0, 4.0, 20.0, 0.1))
    view = view_of(fit)
    assert len(view["head"]) == MOST_COLUMNS
    assert "1 more stand in the workbook" in view["said"]
    pooled = [cell for name, row in cells(fit).items() if name == "Peak force" for cell in row]
    assert set(pooled) <= {"10.0 ± 1.4", "30.00", "2.000"}
    assert len(pooled) == MOST_COLUMNS


def test_a_folder_of_an_older_version_has_no_such_block():
    document = document_of(specimen_fit(samples=60))
    for specimen in document["specimens"]:
        del specimen["measured"]
        for trial in specimen["trials"]:
            del trial["measured"]
    assert measured_view(document["specimens"][0]) is None
    html = render_report(document, [])
    assert "Measured, no model" not in html


def test_the_block_and_the_workbook_have_the_same_numbers():
    fit = measured_fit(log(9.0), log(11.0))
    document = document_of(fit)
    html = render_report(document, curves_of_fits([fit]))
    block = html.split('<div class="measured">')[1].split("</div>")[0]
    assert "8.0 ± 1.1" in block
    raw = re.search(r'spreadsheetml\.sheet;base64,([^"]+)"', html)
    assert base64.b64decode(raw[1]) == report_workbook(document)
    book = openpyxl.load_workbook(io.BytesIO(report_workbook(document)))
    assert book.sheetnames == ["Parameters", "Measured", "Measured logs", "Logs", "Quoted"]
    head, *rows = book["Measured"].values
    force = next(row for row in rows if row[head.index("quantity")] == "F(1 s)")
    assert force[head.index("mean")] == pytest.approx(8.0)
    assert force[head.index("SD between logs")] == pytest.approx(0.8 * 2**0.5)
    assert force[head.index("shortest ramp [s]")] == 1.5
    head, *rows = book["Measured logs"].values
    assert [row[head.index("F(10 s) [N]")] for row in rows] == [4.5, 5.5]
    assert [row[head.index("F(1 s)/F_peak, depends on the ramp")] for row in rows] == [0.8, 0.8]
    # a column in which nothing stands is left out
    assert "donor" not in next(book["Logs"].values)
