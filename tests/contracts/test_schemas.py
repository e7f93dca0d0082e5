"""The schemas are valid, closed, and say what the code says."""

import copy
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from document_schemas import ROOTS, schema_of
from fit_factory import identification, specimen_fit
from jsonschema import Draft202012Validator
from msgspec import structs
from posterior_factory import sampled

from tissueid.documents import plain
from tissueid.documents.identification import Identification
from tissueid.errors import BundleError
from tissueid.flags import Flag
from tissueid.inspection import describe_segmented
from tissueid.result import Estimate, SpecimenFit
from tissueid.segment import segment
from tissueid.store import schema as schema_module
from tissueid.store.schema import check, first_problem, load_schema, schema_folder
from tissueid.trial import Source, Trial


def document_of(fit: SpecimenFit, *, refused: bool = False) -> dict[str, Any]:
    return plain(identification([fit], refused=refused).as_json())


def run_document() -> dict[str, Any]:
    return document_of(specimen_fit(), refused=True)


def sampled_document(*, identified: bool = True) -> dict[str, Any]:
    return document_of(sampled(specimen_fit(identified=identified)))


def objects_of(node: Any) -> list[dict[str, Any]]:
    found = []
    if isinstance(node, dict):
        if "properties" in node and node.get("type") == "object":
            found.append(node)
        for child in node.values():
            found += objects_of(child)
    elif isinstance(node, list):
        for child in node:
            found += objects_of(child)
    return found


@pytest.mark.parametrize("name", ROOTS)
def test_every_object_says_what_else_it_may_hold(name: str) -> None:
    open_on_purpose = {"optimisers"}
    schema = copy.deepcopy(dict(load_schema(name)))
    for definition in schema.get("$defs", {}).values():
        for key in open_on_purpose & set(definition.get("properties", {})):
            del definition["properties"][key]
    for node in objects_of(schema):
        assert "additionalProperties" in node, node.get("description", node)


def test_every_schema_file_is_known_by_name() -> None:
    files = {entry.name.removesuffix(".schema.json") for entry in schema_folder().iterdir()}
    assert files == set(ROOTS)


@pytest.mark.parametrize("name", ROOTS)
def test_every_schema_is_valid_and_written_from_the_types(name: str) -> None:
    Draft202012Validator.check_schema(load_schema(name))
    assert load_schema(name) == schema_of(name), "run scripts/write-docs"
    assert load_schema(name)["$id"] == f"{name}.schema.json"


def test_refusal_codes_are_those_of_ingest_and_those_a_fit_adds() -> None:
    refusals = pytest.importorskip("tissueid.ingest.refusals")
    known = set(load_schema("inspect")["$defs"]["error"]["properties"]["code"]["enum"])
    added = ("no_contact", "too_few_samples", "fit_failed", "mixed_axes", "frame_range")
    of_jobs = ("job_failed", "out_of_memory", "worker_killed", "other_versions")
    assert known == {*refusals.REFUSAL_CODES, *added, *of_jobs}


def test_identification_of_a_sampled_run_is_valid_and_says_what_was_asked_for() -> None:
    assert first_problem(run_document(), "identification") is None
    document = sampled_document()
    assert first_problem(document, "identification") is None
    specimen = document["specimens"][0]
    for estimate in specimen["parameters"]:
        assert estimate["ci95_total"][0] < estimate["ci95"][0] < estimate["mean"] < estimate["ci95"][1]
        assert {"sd", "ess_bulk", "ess_tail", "r_hat"} <= set(estimate)
    assert (specimen["sampler"]["name"], specimen["sampler"]["converged"]) == ("emcee", True)
    assert (specimen["noise"]["model"], specimen["noise"]["phi"]) == ("ar1", 0.6)
    assert specimen["misfit"]["raised"] is False


def test_what_is_not_identified_has_no_interval_of_its_own() -> None:
    document = sampled_document(identified=False)
    assert first_problem(document, "identification") is None
    (tau,) = [one for one in document["specimens"][0]["parameters"] if one["name"] == "relaxation_time_s"]
    assert [tau[key] for key in ("value", "mean", "sd", "ci95", "ci95_total", "r_hat")] == [None] * 6
    assert tau["detail"]["posterior"]["ci95"][0] < 1.5 < tau["detail"]["posterior"]["ci95"][1]
    assert Estimate.from_json(tau).as_json() == tau
    tau["ci95"] = [0.1, 9.0]
    problem = first_problem(document, "identification")
    assert problem.pointer.endswith("/ci95")


def test_a_diagnostic_without_a_value_is_null_and_comes_back_as_nan() -> None:
    fit = sampled(specimen_fit())
    known = fit.parameters[0].uncertainty
    odd = replace(fit.parameters[0], uncertainty=replace(known, r_hat=float("nan"), ess_tail=float("nan")))
    document = plain(odd.as_json())
    assert (document["r_hat"], document["ess_tail"]) == (None, None)
    back = Estimate.from_json(document).uncertainty
    assert np.isnan(back.r_hat)
    assert back.ci95 == known.ci95


def test_what_could_not_be_worked_out_is_null_and_loses_nothing_else() -> None:
    fit = sampled(specimen_fit())
    first, *others = fit.posterior.budget
    budget = (structs.replace(first, sd=float("nan")), *others)
    known = fit.parameters[0].uncertainty
    odd = replace(fit.parameters[0], uncertainty=replace(known, ci95_total=(1.0, float("inf"))))
    document = document_of(
        replace(fit, parameters=(odd, *fit.parameters[1:]), posterior=replace(fit.posterior, budget=budget))
    )
    assert first_problem(document, "identification") is None
    assert document["specimens"][0]["budget"][0]["sd"] is None
    assert document["specimens"][0]["parameters"][0]["ci95_total"] is None
    assert document["specimens"][0]["parameters"][0]["ci95"] == list(known.ci95)


@pytest.mark.parametrize(
    ("pointer", "value"),
    [
        ("/specimens/0/parameters/0/name", "stiffness"),
        ("/specimens/0/parameters/0/stderr", -1.0),
        ("/specimens/0/model/static_pooling", "none"),
        ("/specimens/0/trials/0/residual_acf1", 1.5),
        ("/specimens/0/relaxation/0/window_s", [1.0]),
        ("/specimens/0/flags/0/code", "made_up"),
        ("/specimens/0/flags/0/message", None),
        ("/specimens/0/flags/0/deep", {"a": 1}),
        ("/specimens/0/sigma_N", float("nan")),
        ("/refused/0/error/code", "made_up"),
        ("/refused/0/error/line", 0),
        ("/provenance/inputs/0/sha256", "xyz"),
        ("/exit/code", 8),
        ("/schema", "tissueid/identification/2"),
        ("/specimens/0/surprise", 1),
        ("/specimens/0/parameters/0/identified", False),
        ("/specimens/0/parameters/0/value", None),
    ],
)
def test_a_wrong_value_is_refused_with_its_pointer(pointer: str, value: Any) -> None:
    document = run_document()
    *parents, last = [int(part) if part.isdigit() else part for part in pointer.split("/")[1:]]
    node: Any = document
    for part in parents:
        node = node[part]
    node[last] = value
    # a member that is unknown, and what members say together, is their owner's fault
    together = last in {"surprise", "identified", "value"} or parents[-2:] == ["flags", 0]
    with pytest.raises(BundleError, match=f"/{'/'.join(map(str, parents))}:" if together else pointer):
        check(document, Identification, where="identification.json")
    assert first_problem(document, "identification") is not None, "the schema says less than the types"


def test_a_flag_carries_numbers_beside_its_message() -> None:
    assert first_problem(plain(Flag("gap", "a gap of 2 s", {"gap_s": 2.0, "rows": [3, 4]})), "flag") is None
    assert first_problem({"code": "gap", "message": "m", "deep": {"a": 1}}, "flag") is not None


def inspected() -> dict[str, Any]:
    time = np.linspace(0.0, 4.0, 400)
    trial = Trial("a", time, time, time, source=Source(path="a.csv"))
    return plain(describe_segmented(trial, segment(trial)))


def test_inspect_lists_trials_and_refusals_and_nothing_between() -> None:
    refused = run_document()["refused"][0]
    assert first_problem([inspected(), refused], "inspect") is None
    for key in inspected():
        cut = inspected()
        del cut[key]
        assert first_problem([cut], "inspect") is not None, key
    assert first_problem([inspected() | {"compression_sign": 0}], "inspect") is not None


def test_schemas_are_found_in_an_installed_package_first(tmp_path, monkeypatch) -> None:
    packaged = tmp_path / "schemas"
    packaged.mkdir()
    (packaged / "flag.schema.json").write_text(json.dumps({"title": "packaged"}), encoding="utf-8")
    monkeypatch.setattr(schema_module.resources, "files", lambda _package: tmp_path)
    assert schema_folder() == packaged
