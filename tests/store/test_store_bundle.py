"""A bundle comes back as it was written, or is refused with the reason."""

import json
import re
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from fit_factory import STATIC, STIFFNESS, TAU_S, identification, specimen_fit, write_results
from posterior_factory import sampled

from tissueid.cli.main import main
from tissueid.documents.identification import TipGeometry
from tissueid.errors import BundleError
from tissueid.model.base import ContactPath
from tissueid.rupture_law import RuptureLaw
from tissueid.store.bundle import MOST_DRAWS, Bundle, bundle_from_fit, load_bundle, write_bundle
from tissueid.store.index import INDEX, INDEX_SCHEMA_VERSION, Index
from tissueid.store.migrate import migrate_bundle, migrate_folder
from tissueid.store.outputs import OutputSet
from tissueid.store.results import validate_outputs

PROVENANCE = identification([specimen_fit()]).provenance
LAW = RuptureLaw("weighted-force", 88.5, 1.5, 0.08, 0.15, 90.0, (80.0, 101.0), 0.2)


def a_bundle(draws: int = 0) -> Bundle:
    fit = specimen_fit()
    spread = np.random.default_rng(3).normal(0.0, 1e-3, (draws, fit.theta.size))
    bundle = bundle_from_fit(fit, provenance=PROVENANCE)
    return replace(bundle, draws=fit.theta + spread) if draws else bundle


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "bundle.h5"
    write_bundle(a_bundle(draws=5), path)
    return path


def test_everything_comes_back_exactly(written, tmp_path):
    expected, actual = a_bundle(draws=5), load_bundle(written)
    assert actual.as_json() == json.loads(json.dumps(expected.as_json()))
    for name in ("theta", "covariance", "draws"):
        assert np.array_equal(getattr(actual, name), getattr(expected, name)), name
    assert actual.parameter("relaxation_time_s").value == TAU_S
    assert not actual.theta.flags.writeable
    # a tip and a law of rupture where they are stated
    assert "tip" not in expected.as_json()["validity"]
    cone = TipGeometry("cone", 30.0)
    more = bundle_from_fit(replace(specimen_fit(), tip=cone), provenance=PROVENANCE)
    write_bundle(replace(more, rupture=LAW), tmp_path / "b.h5")
    back = load_bundle(tmp_path / "b.h5")
    assert (back.tip, back.draws, back.rupture, LAW.unit) == (cone, None, LAW, "N")


def test_a_fit_gives_covariance_intervals_thinned_draws_and_its_own_inputs(tmp_path):
    fit = sampled(specimen_fit())
    write_bundle(bundle_from_fit(fit, provenance=PROVENANCE), tmp_path / "b.h5")
    bundle = load_bundle(tmp_path / "b.h5")
    assert np.array_equal(bundle.covariance, fit.posterior.covariance)
    assert bundle.draws.shape == (MOST_DRAWS, fit.theta.size)
    every = {tuple(row) for row in fit.posterior.draws}
    assert all(tuple(row) in every for row in bundle.draws)
    # evenly over the chain: first and last draw are kept
    assert np.array_equal(bundle.draws[[0, -1]], fit.posterior.draws[[0, -1]])
    assert bundle.parameter("viscosity_N_s_per_mm").uncertainty == fit.parameters[-1].uncertainty
    fits = [specimen_fit("a"), specimen_fit("b")]
    bundle = bundle_from_fit(fits[1], provenance=identification(fits).provenance)
    assert {entry["specimen"] for entry in bundle.provenance["inputs"]} == {"b"}
    assert len(bundle.provenance["inputs"]) == 3


def test_the_model_in_the_bundle_gives_the_closed_form_force(written):
    bundle = load_bundle(written)
    speed, time = 2.0, np.linspace(0.0, 3.0, 301)
    depth = speed * time
    expected = STATIC[0] * depth + STATIC[1] * depth**2 + STATIC[2] * depth**3
    expected = expected - STIFFNESS * speed * TAU_S * np.expm1(-time / TAU_S)
    actual = bundle.contact_model().force(bundle.theta, ContactPath(time, depth))
    # the recursion is exact on a constant-speed ramp: rounding only
    assert actual == pytest.approx(expected, rel=1e-12, abs=1e-12)


def edit_number(file: Any) -> None:
    file["theta"][0] = 4.1


def edit_document(file: Any) -> None:
    text = bytes(file["document"][()]).replace(b'"tip_radius_mm": 3.0', b'"tip_radius_mm": 9.0')
    file["document"][()] = np.array(text, dtype=file["document"].dtype)


def narrow_theta(file: Any) -> None:
    values = file["theta"][()].astype("f4")
    del file["theta"]
    file["theta"] = values


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (edit_number, "changed since it was written"),
        (edit_document, "changed since it was written"),
        (lambda file: file.attrs.modify("schema_version", 99), "schema version 99"),
        (lambda file: file.attrs.modify("format", "other"), "not 'tissueid/bundle'"),
        (lambda file: file.pop("covariance"), "missing"),
        (lambda file: file.attrs.pop("content_sha256"), "no content hash"),
        (lambda file: file.create_dataset("extra", data=1.0), "unknown"),
        (narrow_theta, "float32"),
    ],
)
def test_a_hand_edited_file_is_refused(written, edit, reason):
    with h5py.File(written, "r+") as file:
        edit(file)
    with pytest.raises(BundleError, match=reason) as caught:
        load_bundle(written)
    assert str(written) in caught.value.message


def spoiled(name: str, changes: dict[Any, float]) -> Callable[[Bundle], Bundle]:
    """A bundle with some numbers of an array changed."""

    def spoil(bundle: Bundle) -> Bundle:
        array = getattr(bundle, name).copy()
        for place, value in changes.items():
            array[place] = value
        return replace(bundle, **{name: array})

    return spoil


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (spoiled("theta", {3: -1.0}), "theta is not passive"),
        (spoiled("draws", {(2, 4): -0.5}), "draw 2 is not passive"),
        (spoiled("covariance", {(0, 1): 1e-4}), "not symmetric"),
        (spoiled("covariance", {(0, 1): 0.1, (1, 0): 0.1}), "not positive semi-definite"),
        (spoiled("theta", {-1: np.nan}), "not finite"),
        (lambda b: replace(b, theta=b.theta[:-1]), "has shape"),
        (lambda b: replace(b, sigma_N=float("inf")), "/sigma_N"),
        (lambda b: replace(b, theta_names=(*b.theta_names[:-1], "tau")), "theta is"),
        (lambda b: replace(b, model=replace(b.model, key="springs")), "springs"),
    ],
)
def test_what_could_not_be_rendered_safely_is_never_written(tmp_path, spoil, reason):
    with pytest.raises(BundleError, match=reason):
        write_bundle(spoil(a_bundle(draws=5)), tmp_path / "b.h5")
    assert list(tmp_path.iterdir()) == []


def test_every_truncation_is_refused(written, tmp_path):
    content = written.read_bytes()
    cut = tmp_path / "cut.h5"
    for size in np.linspace(0, len(content) - 1, 60).astype(int):
        cut.write_bytes(content[:size])
        with pytest.raises(BundleError, match=re.escape(str(cut))):
            load_bundle(cut)


def test_a_flipped_byte_is_refused_or_harmless(written, tmp_path):
    content = written.read_bytes()
    expected = load_bundle(written)
    rng = np.random.default_rng(7)
    flipped = tmp_path / "flipped.h5"
    refused = 0
    for position in rng.integers(0, len(content), 300):
        changed = bytearray(content)
        changed[position] ^= int(rng.integers(1, 256))
        flipped.write_bytes(bytes(changed))
        try:
            actual = load_bundle(flipped)
        except BundleError:
            refused += 1
        else:
            assert actual.as_json() == expected.as_json()
            assert np.array_equal(actual.theta, expected.theta)
            assert np.array_equal(actual.covariance, expected.covariance)
    # most of the file is the document and the numbers, which the hash covers
    assert refused > 150


def test_another_kind_of_file_and_none_are_refused(tmp_path):
    path = tmp_path / "bundle.h5"
    for content in (b"", b"Time,Load\n0,1\n", b"\x89HDF\r\n\x1a\n" + b"\0" * 64):
        path.write_bytes(content)
        with pytest.raises(BundleError, match="cannot be read as a bundle"):
            load_bundle(path)
    for none in (tmp_path / "none.h5", tmp_path):
        with pytest.raises(BundleError, match="no such file"):
            load_bundle(none)


@pytest.mark.parametrize("wrong", [{"threshold": -1.0}, {"residual": 2.0}, {"criterion": "torque"}])
def test_a_law_that_makes_no_sense_never_reaches_a_file(wrong, tmp_path):
    with pytest.raises(ValueError, match=r"threshold must be above 0|no criterion of rupture"):
        replace(LAW, **wrong)
    forged = SimpleNamespace(as_json=lambda: {**LAW.as_json(), **wrong})
    with pytest.raises(BundleError, match="rupture"):
        write_bundle(replace(a_bundle(), rupture=forged), tmp_path / "bundle.h5")


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
