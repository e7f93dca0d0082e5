from __future__ import annotations

from pathlib import Path

import pytest

from tissueid.errors import InputError
from tissueid.ingest.manifest import read_study
from tissueid.priors import PopulationPriors, SpreadPrior

HEAD = 'schema = "tissueid/study/1"\n'


def test_priors_of_the_population_are_read_and_the_rest_keeps_its_default(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        HEAD + "[population]\nmean_sd = 8\n[population.between]\nmedian = 0.15\nsd_ln = 0.3\n"
        "[population.tails]\nshape = 3\nrate = 0.2\n",
        encoding="utf-8",
    )

    found = read_study(tmp_path).population

    assert found == PopulationPriors(mean_sd=8, between=SpreadPrior(0.15, 0.3), tail_shape=3, tail_rate=0.2)


def test_a_study_that_is_silent_states_none(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(HEAD, encoding="utf-8")

    assert read_study(tmp_path).population is None


def test_a_spread_without_its_width_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        HEAD + "[population]\n[population.between]\nmedian = 0.15\n", encoding="utf-8"
    )

    with pytest.raises(InputError, match="sd_ln is missing") as refused:
        read_study(tmp_path)

    assert refused.value.line == 3
