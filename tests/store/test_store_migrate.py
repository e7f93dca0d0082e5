"""Files of earlier versions are brought to this one, or stay as they are; released ones are read for ever."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from fit_factory import identification, specimen_fit, write_results

from tissueid.cli.main import main
from tissueid.errors import BundleError
from tissueid.store.bundle import bundle_from_fit, load_bundle, write_bundle
from tissueid.store.index import INDEX, INDEX_SCHEMA_VERSION, Index
from tissueid.store.migrate import migrate_bundle, migrate_folder
from tissueid.store.outputs import OutputSet
from tissueid.store.results import validate_outputs

RELEASED = Path(__file__).parent / "released"


def as_version_0(path: Path) -> None:
    """Turn a bundle into one of a version 0 that never was: other names, and a depth in metres."""
    with h5py.File(path, "r+") as file:
        document = json.loads(bytes(file["document"][()]))
        document["tissue"] = document.pop("specimen")
        document["validity"]["depth_m"] = document["validity"].pop("depth_mm") / 1000.0
        document["schema"] = "tissueid/bundle/0"
        del file["document"]
        text = json.dumps(document).encode()
        file.create_dataset("document", data=np.array(text, dtype=f"S{len(text)}"))
        file.move("theta", "parameters")
        file.attrs["schema_version"] = 0
        del file.attrs["content_sha256"]


def from_0_to_1(document: dict[str, Any], arrays: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    validity = dict(document["validity"])
    validity["depth_mm"] = validity.pop("depth_m") * 1000.0
    changed = {key: value for key, value in document.items() if key != "tissue"}
    changed |= {"specimen": document["tissue"], "validity": validity, "schema": "tissueid/bundle/1"}
    return changed, {("theta" if name == "parameters" else name): array for name, array in arrays.items()}


STEPS = {0: from_0_to_1}


def bundle(path: Path) -> Path:
    write_bundle(bundle_from_fit(specimen_fit(samples=40), provenance=identification([]).provenance), path)
    return path


def test_a_bundle_of_an_earlier_version_becomes_what_it_was_before(tmp_path):
    before = load_bundle(bundle(tmp_path / "b.h5"))
    as_version_0(tmp_path / "b.h5")
    with pytest.raises(BundleError, match=r"schema version 0.*tissueid migrate"):
        load_bundle(tmp_path / "b.h5")
    found = migrate_bundle(tmp_path / "b.h5", steps=STEPS)
    assert found.version == 0
    after = load_bundle(tmp_path / "b.h5")
    # a depth of 8 mm in metres and back is off by its last bit at most
    assert after.depth_mm == pytest.approx(before.depth_mm, rel=1e-15)
    assert after.specimen == before.specimen
    assert np.array_equal(after.theta, before.theta)
    assert np.array_equal(after.covariance, before.covariance)
    assert migrate_bundle(tmp_path / "b.h5", steps=STEPS) is None


def test_a_migration_that_fails_leaves_the_old_file(tmp_path):
    as_version_0(bundle(tmp_path / "b.h5"))
    content = (tmp_path / "b.h5").read_bytes()

    def forgets_theta(document: dict[str, Any], arrays: dict[str, Any]) -> Any:
        changed, _ = from_0_to_1(document, arrays)
        return changed, {}

    def not_passive(document: dict[str, Any], arrays: dict[str, Any]) -> Any:
        changed, new = from_0_to_1(document, arrays)
        return changed, new | {"theta": -new["theta"]}

    for step in (forgets_theta, not_passive):
        with pytest.raises(BundleError):
            migrate_bundle(tmp_path / "b.h5", steps={0: step})
        assert [path.name for path in tmp_path.iterdir()] == ["b.h5"]
        assert (tmp_path / "b.h5").read_bytes() == content
    with pytest.raises(BundleError, match="no way is known from schema version 0"):
        migrate_bundle(tmp_path / "b.h5")


def test_a_set_is_migrated_at_once_and_is_whole_afterwards(tmp_path):
    names = ("a", "b")
    with OutputSet(tmp_path) as run:
        write_results(run, identification([specimen_fit(name, trials=1, samples=40) for name in names]))
        for name in names:
            as_version_0(run.path(f"bundle-{name}.h5"))
        run.commit()
    found = migrate_folder(tmp_path, bundles=STEPS)
    assert [one.path.name for one in found] == ["bundle-a.h5", "bundle-b.h5"]
    validate_outputs(tmp_path)
    assert migrate_folder(tmp_path, bundles=STEPS) == []


def test_an_index_is_migrated_on_a_copy(tmp_path):
    with Index(tmp_path) as index:
        index.begin_run(1.0, {"pid": 1, "host": "here"}, 3)
    with sqlite3.connect(tmp_path / INDEX) as database:
        database.execute("ALTER TABLE runs RENAME COLUMN files TO inputs")
        database.execute("PRAGMA user_version=7")
    database.close()
    with pytest.raises(BundleError, match="schema version 7"):
        Index(tmp_path)
    with pytest.raises(BundleError, match="newer than this tissueid"):
        migrate_folder(tmp_path)
    with sqlite3.connect(tmp_path / INDEX) as database:
        database.execute("PRAGMA user_version=0")
    database.close()
    (one,) = migrate_folder(tmp_path, index={0: "ALTER TABLE runs RENAME COLUMN inputs TO files;"})
    assert (one.path.name, one.version) == (INDEX, 0)
    with sqlite3.connect(tmp_path / INDEX) as database:
        assert database.execute("SELECT files FROM runs").fetchone() == (3,)
        assert database.execute("PRAGMA user_version").fetchone() == (INDEX_SCHEMA_VERSION,)
    database.close()


@pytest.mark.parametrize("name", ["bundle-v1.h5"])
def test_a_bundle_of_every_released_version_is_read(name, tmp_path):
    (tmp_path / name).write_bytes((RELEASED / name).read_bytes())
    assert main(["migrate", str(tmp_path / name), "-q"]) == 0
    found = load_bundle(tmp_path / name)
    assert found.specimen == "kidney 3"
    # K = 6 N/mm and tau = 1.5 s, as it was made
    assert found.parameter("viscosity_N_s_per_mm").value == pytest.approx(9.0, rel=1e-12)
