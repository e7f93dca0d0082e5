"""A rupture law in a bundle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from fit_factory import identification, specimen_fit

from tissueid.errors import BundleError
from tissueid.rupture_law import RuptureLaw
from tissueid.store.bundle import bundle_from_fit, load_bundle, write_bundle

PROVENANCE = identification([specimen_fit()]).provenance
LAW = RuptureLaw("weighted-force", 88.5, 1.5, 0.08, 0.15, 90.0, (80.0, 101.0), 0.2)


def test_a_bundle_keeps_its_law_of_rupture(tmp_path: Path) -> None:
    bundle = replace(bundle_from_fit(specimen_fit(), provenance=PROVENANCE), rupture=LAW)
    write_bundle(bundle, tmp_path / "bundle.h5")
    assert load_bundle(tmp_path / "bundle.h5").rupture == LAW


def test_a_law_comes_back_from_its_document() -> None:
    assert RuptureLaw.from_json(json.loads(json.dumps(LAW.as_json()))) == LAW
    assert LAW.unit == "N"


@pytest.mark.parametrize("wrong", [{"threshold": -1.0}, {"residual": 2.0}, {"criterion": "torque"}])
def test_a_law_that_makes_no_sense_never_reaches_a_file(wrong: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"threshold must be above 0|no criterion of rupture"):
        replace(LAW, **wrong)
    bundle = bundle_from_fit(specimen_fit(), provenance=PROVENANCE)
    with pytest.raises(BundleError, match="rupture"):
        write_bundle(replace(bundle, rupture=Forged({**LAW.as_json(), **wrong})), tmp_path / "bundle.h5")  # type: ignore[arg-type]


class Forged:
    """A law that says what it is told."""

    def __init__(self, document: dict[str, object]) -> None:
        self._document = document

    def as_json(self) -> dict[str, object]:
        return self._document
