"""What the terminal says of uncertainty: intervals, sampler, alarms, each in one short line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import run
from fit_factory import identification, specimen_fit
from posterior_factory import sampled
from typed_call import typed_call

from tissueid.flags import Flag
from tissueid.report.specimen_lines import alarm_lines, parameter_lines, sampling_lines
from tissueid.result import SpecimenFit
from tissueid.store.outputs import OutputSet
from tissueid.store.results import write_results
from tissueid.trial import Axes

alarm_lines = typed_call(alarm_lines)
parameter_lines = typed_call(parameter_lines)
sampling_lines = typed_call(sampling_lines)

WIDTH = 100


def test_a_parameter_stands_with_both_intervals_to_one_place() -> None:
    fit = sampled(specimen_fit())
    known = fit.parameter("viscosity_N_s_per_mm").uncertainty
    assert known is not None
    assert known.ci95_total is not None
    low, high = known.ci95
    wide_low, wide_high = known.ci95_total
    (first,) = [line for line in parameter_lines(fit.as_json()) if line.startswith("eta")]
    expected = f"9.00 N s/mm [{low:.2f}, {high:.2f}] [{wide_low:.2f}, {wide_high:.2f}]"
    # sd 0.27: two digits of it end at the second decimal
    assert " ".join(first.replace("95 %", "").replace("total", "").split()) == f"eta {expected}"


def test_without_a_posterior_the_standard_error_stands_as_before() -> None:
    lines = parameter_lines(specimen_fit().as_json())
    assert lines[0] == "tau    1.500 ± 0.030 s"
    assert "eta    9.00 ± 0.11 N s/mm" in lines
    assert sampling_lines(specimen_fit().as_json()) == []
    assert alarm_lines(specimen_fit().as_json()) == []


def test_no_interval_stands_where_nothing_is_identified_or_the_model_is_contradicted() -> None:
    (tau,) = [
        line for line in parameter_lines(sampled(specimen_fit(identified=False)).as_json()) if "tau" in line
    ]
    assert tau == "tau    not identified"
    fit = sampled(specimen_fit(), misfit=True)
    assert not any(
        "95 %" in line or "total" in line or "±" in line for line in parameter_lines(fit.as_json())
    )
    (line,) = alarm_lines(fit.as_json())
    assert line.endswith("the force just after the peak lies 2.1 N above the model")
    assert line.startswith("no interval is given")
    # a flag that says the same is not said again
    flagged = replace(fit, flags=(*fit.flags, Flag("misfit", "the residuals show a slow mode")))
    assert alarm_lines(flagged.as_json()) == []


def test_a_sampler_that_stopped_early_is_told_with_its_reason() -> None:
    fit = sampled(specimen_fit(), converged=False)
    (line,) = alarm_lines(fit.as_json())
    assert line.endswith("intervals are rough: R-hat of ln_tau_1 is 1.08 after 20,000 steps")
    assert "not converged" in sampling_lines(fit.as_json())[0]


def test_sampler_and_noise_are_one_line_each() -> None:
    assert sampling_lines(sampled(specimen_fit()).as_json()) == [
        "emcee  4,000 draws, R-hat at most 1.001, 34 % accepted, converged",
        "noise  ar1, 0.3 N, correlation 0.6 over 0.01 s",
    ]


def test_normalised_results_are_said_in_their_units() -> None:
    fit = replace(sampled(specimen_fit(), total=False), axes=Axes("1", "MPa"))
    lines = parameter_lines(fit.as_json())
    assert any(line.startswith("eta    9.00 MPa s") for line in lines)
    assert not any("total" in line or "mm" in line for line in lines)
    assert sampling_lines(fit.as_json())[1].startswith("noise  ar1, 0.3 MPa")


@pytest.mark.parametrize(
    "fit",
    [
        sampled(specimen_fit()),
        sampled(specimen_fit(identified=False)),
        sampled(specimen_fit(), misfit=True),
    ],
)
def test_lines_of_numbers_fit_a_terminal_of_a_hundred_columns(fit: SpecimenFit) -> None:
    for line in (*parameter_lines(fit.as_json()), *sampling_lines(fit.as_json())):
        assert len(f"  {line}") <= WIDTH


def test_small_numbers_have_a_power_of_ten_that_a_terminal_can_print() -> None:
    fit = sampled(specimen_fit())
    known = fit.parameters[0].uncertainty
    assert known is not None
    narrow = replace(known, sd=5e-7, ci95=(2.4e-5, 2.6e-5), ci95_total=None)
    small = replace(fit.parameters[0], value=2.5e-5, uncertainty=narrow)
    (line,) = parameter_lines(replace(fit, parameters=(small,)).as_json())
    assert line == "a1     2.500×10⁻⁵ N/mm  95 % [2.400×10⁻⁵, 2.600×10⁻⁵]"


def test_a_report_made_again_has_bands_and_draws_from_the_folder_alone(tmp_path: Path) -> None:
    fits = [sampled(specimen_fit(trials=2, samples=60))]
    with OutputSet(tmp_path / "out") as outputs:
        write_results(outputs, identification(fits))
        outputs.commit()
    assert run("report", tmp_path / "out", "-o", tmp_path / "again.html").code == 0
    html = (tmp_path / "again.html").read_text(encoding="utf-8")
    payload = json.loads(html.split('id="curves">')[1].split("</script>")[0])
    assert all("low" in trial and "high" in trial for trial in payload["specimens"][0])
    assert payload["posteriors"][0]["draws"]["count"] == 1_000
    assert "How sure" in html
