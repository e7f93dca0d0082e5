"""Mean curves, summaries and searches for contact: shown, said to be no specimens, left out of a fit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tissueid.collection import TrialCache, collect
from tissueid.ingest import read_trials
from tissueid.ingest.reading import no_specimen
from tissueid.segment import SegmentOptions


@pytest.mark.parametrize(
    ("sheet", "kind"),
    [
        ("Eprouvette moyenne", "mean"), ("Courbe type", "mean"), ("Mittelwert", "mean"),
        ("Mittelwertkurve", "mean"),
        ("Mean", "mean"), ("Typical", "mean"), ("Average curve", "mean"), ("Probeta media", "mean"),
        ("Curva tipica", "mean"), ("Provino medio", "mean"), ("Media", "mean"), ("平均曲线", "mean"),
        ("Statistik", "summary"), ("Statistiques", "summary"), ("Estadísticas", "summary"),
        ("Riepilogo", "summary"),
        ("Results 1", "summary"), ("1: Find Contact", "search"), ("archive/a.txt::2: Find Contact", "search"),
    ],
)  # fmt: skip
def test_names_of_no_specimens_in_the_exporters_language(sheet: str, kind: str) -> None:
    flag = no_specimen("lab/meat.xlsx", sheet)
    assert flag.values["kind"] == kind


@pytest.mark.parametrize(
    "sheet", ["230403-FF1A", "2: Stress Relaxation", "Mean cow 3", "Typ A", "Probe 1", "Resultant", None]
)
def test_other_names_are_specimens(sheet: str | None) -> None:
    assert no_specimen("lab/meat.xlsx", sheet) is None


def test_files_are_named_so_too_but_not_by_words_of_anything() -> None:
    assert no_specimen("lab/Mean.csv", None) is not None
    assert no_specimen("lab/media.csv", None) is None


def test_a_mean_sheet_is_read_and_left_out_of_the_fit_unless_listed(shared_data: Path) -> None:
    book = shared_data / "zwick-meat-gpl3" / "230407_C_Indentation_relaxation_500N_force.xlsx"
    if not book.exists():
        pytest.skip(f"no {book}")
    trials = [
        trial for trial in read_trials(book) if trial.source.sheet in {"Eprouvette moyenne", "230407_FF1A"}
    ]
    mean = next(trial for trial in trials if trial.source.sheet == "Eprouvette moyenne")
    assert "not_a_specimen" in [flag.code for flag in mean.flags]
    found = collect(trials, SegmentOptions(), TrialCache(None), lambda *_: None)
    assert [one.sheet for one in found.excluded] == ["Eprouvette moyenne"]
    assert found.excluded[0].no_specimen
    assert sum(len(logs) for logs in found.groups.values()) == 1
