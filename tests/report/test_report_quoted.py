"""The report's tables of quoted numbers and loops say what the document says, and why one is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fit_factory import specimen_fit
from msgspec import structs
from report_pages import document_of, render_report
from typed_call import typed_call

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
from tissueid.measured.geometry import Geometry
from tissueid.model.moduli import Indenter
from tissueid.report.quoted_words import MOST_ROWS, cycle_table, quoted_tables
from tissueid.store.curves import curves_of_fits
from tissueid.store.schema import first_problem

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
