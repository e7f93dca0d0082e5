"""What the terminal says of a fit: intervals, sampler, alarms, warnings and quoted numbers, in few lines."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from command_line import QUICK, read_json, run, write_log
from fit_factory import identification, specimen_fit, write_results
from posterior_factory import sampled
from typed_call import typed_call

from tissueid.cli.fit_command import _print_specimens
from tissueid.documents import plain
from tissueid.flags import FLAGS, MOST_WORDS, Flag, harm_rank
from tissueid.report import specimen_lines
from tissueid.report.specimen_lines import MOST_WARNINGS, WIDTH
from tissueid.store.outputs import OutputSet
from tissueid.trial import Axes

#: Functions that write lines, of documents in plain values.
said = SimpleNamespace(
    **{
        name: typed_call(one)
        for name, one in vars(specimen_lines).items()
        if name.endswith(("_lines", "_codes"))
    }
)


def test_a_parameter_stands_with_both_intervals_to_one_place():
    fit = sampled(specimen_fit())
    known = fit.parameter("viscosity_N_s_per_mm").uncertainty
    assert known is not None
    assert known.ci95_total is not None
    low, high = known.ci95
    wide_low, wide_high = known.ci95_total
    (first,) = [line for line in said.parameter_lines(fit.as_json()) if line.startswith("eta")]
    expected = f"9.00 N s/mm [{low:.2f}, {high:.2f}] [{wide_low:.2f}, {wide_high:.2f}]"
    # sd 0.27: two digits of it end at the second decimal
    assert " ".join(first.replace("95 %", "").replace("total", "").split()) == f"eta {expected}"


def test_sampler_and_noise_are_one_line_each_and_without_them_the_standard_error_stands():
    lines = said.parameter_lines(specimen_fit().as_json())
    assert lines[0] == "tau    1.500 ± 0.030 s"
    assert "eta    9.00 ± 0.11 N s/mm" in lines
    assert said.sampling_lines(specimen_fit().as_json()) == []
    assert said.alarm_lines(specimen_fit().as_json()) == []
    assert said.sampling_lines(sampled(specimen_fit()).as_json()) == [
        "emcee  4,000 draws, R-hat at most 1.001, 34 % accepted, converged",
        "noise  ar1, 0.3 N, correlation 0.6 over 0.01 s",
    ]


def test_no_interval_stands_where_nothing_is_identified_or_the_model_is_contradicted():
    lines = said.parameter_lines(sampled(specimen_fit(identified=False)).as_json())
    assert [line for line in lines if "tau" in line] == ["tau    not identified"]
    fit = sampled(specimen_fit(), misfit=True)
    assert not re.search("95 %|total|±", "\n".join(said.parameter_lines(fit.as_json())))
    (line,) = said.alarm_lines(fit.as_json())
    assert line.endswith("the force just after the peak lies 2.1 N above the model")
    assert line.startswith("no interval is given")
    # a flag that says the same is not said again
    flagged = replace(fit, flags=(*fit.flags, Flag("misfit", "the residuals show a slow mode")))
    assert said.alarm_lines(flagged.as_json()) == []


def test_a_sampler_that_stopped_early_is_told_with_its_reason():
    fit = sampled(specimen_fit(), converged=False)
    (line,) = said.alarm_lines(fit.as_json())
    assert line.endswith("intervals are rough: R-hat of ln_tau_1 is 1.08 after 20,000 steps")
    assert "not converged" in said.sampling_lines(fit.as_json())[0]


def test_normalised_results_are_said_in_their_units():
    fit = replace(sampled(specimen_fit(), total=False), axes=Axes("1", "MPa"))
    lines = said.parameter_lines(fit.as_json())
    assert any(line.startswith("eta    9.00 MPa s") for line in lines)
    assert not any("total" in line or "mm" in line for line in lines)
    assert said.sampling_lines(fit.as_json())[1].startswith("noise  ar1, 0.3 MPa")


def test_small_numbers_have_a_power_of_ten_that_a_terminal_can_print():
    fit = sampled(specimen_fit())
    known = fit.parameters[0].uncertainty
    assert known is not None
    narrow = replace(known, sd=5e-7, ci95=(2.4e-5, 2.6e-5), ci95_total=None)
    small = replace(fit.parameters[0], value=2.5e-5, uncertainty=narrow)
    (line,) = said.parameter_lines(replace(fit, parameters=(small,)).as_json())
    assert line == "a1     2.500×10⁻⁵ N/mm  95 % [2.400×10⁻⁵, 2.600×10⁻⁵]"


def test_a_report_made_again_has_bands_and_draws_from_the_folder_alone(tmp_path):
    with OutputSet(tmp_path / "out") as outputs:
        write_results(outputs, identification([sampled(specimen_fit(trials=2, samples=60))]))
        outputs.commit()
    run("report", tmp_path / "out", "-o", tmp_path / "again.html", code=0)
    html = (tmp_path / "again.html").read_text(encoding="utf-8")
    payload = json.loads(html.split('id="curves">')[1].split("</script>")[0])
    assert all("low" in trial and "high" in trial for trial in payload["specimens"][0])
    assert payload["posteriors"][0]["draws"]["count"] == 1_000
    assert "How sure" in html


_print_specimens = typed_call(_print_specimens)

#: Lines of a specimen without -v.
MOST_LINES = 12
CODES = ("corner_slow", "preload", "clipped_force", "gap", "units_assumed", "misfit", "spike", "no_hold")


def document(name: str = "cow", codes: tuple[str, ...] = CODES, **options: Any) -> dict[str, Any]:
    fit = replace(sampled(specimen_fit()), flags=(), specimen=name, **options)
    found: dict[str, Any] = fit.as_json()
    flags = plain([Flag(code, f"{code} was seen at 3 s") for code in codes])
    found["trials"] = [{**found["trials"][0], "flags": flags, "sheet": name}]
    return found


def test_the_five_of_most_harm_stand_first_and_the_rest_is_counted():
    lines = said.warning_lines(document())
    assert len(lines) == MOST_WARNINGS
    words = [line.split()[0] for _, line in lines]
    expected = sorted(set(CODES) - {"no_hold"}, key=harm_rank)
    assert words == expected[:MOST_WARNINGS]
    assert words[0] == "clipped_force"
    assert lines[0][0] == "serious"
    assert lines[-1][1].endswith("(2 more: -v)")
    for (_, line), code in zip(lines, words, strict=True):
        assert FLAGS[code].remedy in line
        assert len(line.replace("(2 more: -v)", "").split()) <= MOST_WORDS
    every = said.warning_lines(document(), verbose=1)
    told = " ".join(line for _, line in every)
    assert all(f"{code} was seen" in told for code in CODES)


def test_what_most_of_a_batch_shares_is_counted_once():
    names = [f"FF{k}" for k in range(124)]
    batch = [document(name, ("preload",)) for name in names[:-1]] + [document(names[-1], ("gap",))]
    shared = said.shared_codes(batch)
    assert shared == ("preload",)
    (line,) = said.shared_lines(batch, shared)
    assert line == "123 of 124 sheets start preloaded. Start in air, or state --contact."
    assert said.warning_lines(batch[0], shared=shared) == []
    (own,) = said.warning_lines(batch[-1], shared=shared)
    assert own[1].startswith("gap was seen")
    # two of a kind are no batch
    assert said.shared_codes(batch[:2]) == ()


def test_a_specimen_takes_few_lines_and_the_block_comes_first(capsys):
    _print_specimens([document()], verbose=0)
    blank, head, *lines = capsys.readouterr().out.splitlines()
    assert not blank
    assert "NRMSD" in head
    block = [line.split()[0] for line in lines if not line.startswith("   ")][:4]
    assert block == ["relaxation", "viscosity", "static", "dynamic"]
    assert len([head, *lines[:-1]]) <= MOST_LINES
    assert lines[-1].startswith("In brackets: 95 % intervals")
    _print_specimens([document()], verbose=1)
    assert "95 % [" in capsys.readouterr().out


def test_the_block_names_what_is_not_identified_and_wraps_what_is_long():
    lines = said.block_lines(sampled(specimen_fit(identified=False)).as_json())
    assert any(line.endswith("tau not identified") for line in lines)
    fits = (sampled(specimen_fit()), sampled(specimen_fit(identified=False)))
    every = [
        line
        for fit in fits
        for line in (*said.parameter_lines(fit.as_json()), *said.sampling_lines(fit.as_json()))
    ]
    assert all(len(line) <= WIDTH for line in (*lines, *every))
    contradicted = said.block_lines(sampled(specimen_fit(), misfit=True).as_json())
    assert not any("[" in line or "±" in line for line in contradicted)


def row(name: str, mean: float | None, **more: Any) -> dict[str, Any]:
    kept = {"unit": "N", "program": 1, "hold": 1, "time_s": None, "ramp_time_s": [2.0, 2.0], "count": 3}
    return {"name": name, "mean": mean, "sd": 0.5, "reason": None} | kept | more


ROWS = (
    row("peak", 10.0),
    row("force", 8.0, time_s=1.0),
    row("force", 6.0, time_s=10.0),
    row("peak", 4.0, program=2, hold=0),
    row("peak", 2.0, program=3, hold=0),
)


def test_a_specimen_among_many_has_one_line_of_its_first_program():
    assert said.brief_measured_lines(ROWS) == [
        "measured    peak 10.00 ± 0.50 N, F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N, 2 more programs"
    ]
    assert said.brief_measured_lines(()) == []
    assert said.brief_measured_lines([row("peak", None)]) == []


def test_a_specimen_alone_shows_two_programs_and_counts_the_others():
    lines = said.measured_lines(ROWS)
    assert lines[0].startswith(
        "measured program 1, no model, ± sd of 3 logs, ramp of 2 s: peak 10.00 ± 0.50 N"
    )
    assert lines[1] == "  F(1 s) 8.00 ± 0.50 N, F(10 s) 6.00 ± 0.50 N"
    assert lines[2].startswith("measured program 2, no model")
    assert lines[3] == "1 more programs and holds stand in the report"


def test_numbers_that_are_asked_for_are_in_the_document_and_in_few_lines(tmp_path):
    log = write_log(tmp_path / "log.csv", stride=1)
    out = tmp_path / "out"
    asked = "--tip sphere:4 --thickness 30 --poisson 0.45 --frequencies 1,500 --unloading"
    ended = run("fit", log, "-o", out, *QUICK, *asked.split(), code={0, 4})
    lines = [line for line in ended.stdout.splitlines() if line.startswith(("  measured", "  modulus"))]
    assert [line.split()[0] for line in lines] == ["modulus", "measured,"]
    specimen = read_json(out / "identification.json")["specimens"][0]
    asked = {
        entry["at"]["frequency_Hz"]: entry
        for entry in specimen["quoted"]["model"]
        if entry["name"] == "tan_delta"
    }
    assert set(asked) == {1.0, 500.0}
    assert asked[500.0]["value"] is None
    assert "outside" in asked[500.0]["reason"]
    assert specimen["quoted"]["assumptions"]["poisson"] == 0.45
    # the contact is where the load channel's lag puts it: a sample more or less
    assert specimen["unloading"]["samples_in_air"] <= 1
