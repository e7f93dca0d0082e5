"""Words and numbers of the report."""

from __future__ import annotations

from typing import Any

from fit_factory import specimen_fit
from posterior_factory import sampled
from report_pages import specimen_of
from typed_call import typed_call

from tissueid.documents.inspect import Units
from tissueid.flags import FLAGS
from tissueid.report.wording import (
    LEVELS,
    event_words,
    overview_sentence,
    parameter_words,
    remarks,
    tissue_sentence,
    took,
    unit_words,
    verdict,
)

remarks = typed_call(remarks)
overview_sentence = typed_call(overview_sentence)
tissue_sentence = typed_call(tissue_sentence)
verdict = typed_call(verdict)


def document(**options: Any) -> dict[str, Any]:
    return specimen_of(specimen_fit(**options))


def test_the_sentence_names_stiffness_relaxation_viscosity_tip_and_validity():
    # secant at 6 mm: 4 + 0.8 * 6 + 0.05 * 36 = 10.6 N/mm
    assert tissue_sentence(document()) == (
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
    unknown = tissue_sentence(document(identified=False))
    assert "its relaxation time is not identified" in unknown
    assert "1.5" not in unknown


def test_the_verdict_falls_with_what_is_missing():
    clean = document() | {"flags": [], "relaxation": []}
    clean["trials"] = [one | {"flags": []} for one in clean["trials"]]
    assert verdict(clean).level == "ok"
    assert verdict(document()).level == "caution"
    assert "5 of 6 parameters are identified" in verdict(document(identified=False)).text
    lost = document()
    lost["parameters"][-1] |= {"identified": False, "value": None}
    assert verdict(lost).level == "serious"
    stopped = clean | {"flags": [{"code": "not_converged", "message": "m"}]}
    assert verdict(stopped).level == "serious"


def test_a_flag_of_many_trials_is_one_remark_that_names_them_and_the_gravest_comes_first():
    found = remarks(document(trials=3, identified=False))
    (same_time,) = [remark for remark in found if remark.code == "zero_dt"]
    assert same_time.where == ("run_1.csv", "run_2.csv", "run_3.csv")
    levels = [LEVELS.index(remark.level) for remark in found]
    assert levels == sorted(levels, reverse=True)


def test_several_specimens_are_summed_up_by_median_and_range():
    entries = [document(specimen="a"), document(specimen="b"), document(specimen="c", identified=False)]
    entries[0]["parameters"][-1]["value"] = 12.0
    sentence = overview_sentence(entries)
    assert "viscosity 9.00 N·s/mm (9.00 to 12.0)" in sentence
    assert "relaxation time 1.50 s (1.50 to 1.50, identified in 2)" in sentence


def test_branches_units_and_stops_are_put_in_words():
    assert parameter_words("relaxation_time_s_b2") == "Relaxation time, branch 2"
    assert [unit_words(unit) for unit in ("N s/mm", "N/mm^2")] == ["N·s/mm", "N/mm²"]
    # a stop within a sampling interval is not called instant
    assert [took(seconds) for seconds in (0.0, 0.02)] == ["too short to see", "took 0.020 s"]


def test_title_and_sentence_of_a_remark_do_not_repeat_each_other():
    assert all(1 <= len(title.split()) <= 4 for title, *_ in FLAGS.values())
    for remark in remarks(document(identified=False)):
        title = set(remark.title.lower().split())
        assert remark.message.lower() != remark.title.lower()
        # a long title would say the sentence over again
        assert len(title & set(remark.message.lower().split())) <= len(title) // 2 + 1


def test_sentences_of_one_flag_are_joined_once_each():
    entry = document()
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
