"""Normalised recordings: the same mathematics, units that follow, and no rendering."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typed_call import typed_call

from tissueid.errors import BundleError, InputError, UsageError
from tissueid.ingest import ReadOptions, read_trials
from tissueid.pipeline import identify
from tissueid.report import render_report
from tissueid.store.bundle import bundle_from_fit, load_bundle, write_bundle
from tissueid.store.files import plain_json
from tissueid.store.schema import check
from tissueid.trial import Axes, Trial

render_report = typed_call(render_report)

STRAIN_STRESS = Axes("1", "MPa")


def ramp_hold(axes: Axes, *, name: str = "fibre") -> Trial:
    """Ramp to 0.2 in 2 s, hold 10 s: F = 3 x + K s with K = 5, tau = 0.5 s, in closed form, with noise."""
    time = np.arange(0.0, 12.0, 0.01)
    speed, tau = 0.1, 0.5
    x = np.minimum(speed * time, 0.2)
    loading = -speed * tau * np.expm1(-np.minimum(time, 2.0) / tau)
    force = 3.0 * x + 5.0 * loading * np.exp(-np.maximum(time - 2.0, 0.0) / tau)
    force = force + np.random.default_rng(5).normal(0.0, 2e-3, time.size)
    return Trial(name, time, x, force, axes=axes)


def test_units_of_a_normalised_specimen_follow_to_json_report_and_bundle(tmp_path: Path) -> None:
    other = identify([ramp_hold(Axes("1", "N"))])
    found = identify([ramp_hold(STRAIN_STRESS)])
    document = plain_json(found.as_json())
    check(document, "identification", where="test")
    specimen = document["specimens"][0]
    assert specimen["units"] == {"length": "1", "force": "MPa", "time": "s"}
    units = {entry["name"]: entry["unit"] for entry in specimen["parameters"]}
    assert units["static_1_N_per_mm"] == units["static_3_N_per_mm3"] == "MPa"
    assert units["viscosity_N_s_per_mm"] == "MPa s"
    assert units["relaxation_time_s"] == "s"
    # the numbers are those of the same samples in another unit
    assert np.array_equal(found.specimens[0].theta, other.specimens[0].theta)
    assert found.specimens[0].parameter("viscosity_N_s_per_mm").value == pytest.approx(2.5, rel=0.02)
    page = render_report(document, [])
    block = page.split(">Contact model")[1].split("</table>")[0]
    assert "MPa" in block
    assert "N/mm" not in block
    assert " mm" not in block
    path = tmp_path / "bundle.h5"
    write_bundle(bundle_from_fit(found.specimens[0], provenance=document["provenance"]), path)
    bundle = load_bundle(path)
    assert dict(bundle.units) == {"length": "1", "force": "MPa", "time": "s"}
    with pytest.raises(BundleError, match="normalised"):
        bundle.require_renderable()


def test_a_specimen_in_millimetres_and_newtons_may_be_rendered(tmp_path: Path) -> None:
    found = identify([ramp_hold(Axes())])
    path = tmp_path / "bundle.h5"
    write_bundle(
        bundle_from_fit(found.specimens[0], provenance=plain_json(found.as_json())["provenance"]), path
    )
    bundle = load_bundle(path)
    bundle.require_renderable()
    assert dict(bundle.units) == {"length": "mm", "force": "N", "time": "s"}


def test_recordings_of_other_axes_are_not_pooled() -> None:
    found = identify([ramp_hold(STRAIN_STRESS), replace(ramp_hold(Axes()))])
    assert [one.code for one in found.refused] == ["mixed_axes"]
    assert len(found.specimens[0].trials) == 1
    assert found.exit.code == 7


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("N", "MPa"),
        ("N/mm", "MPa"),
        ("N/mm^3", "MPa"),
        ("N s/mm", "MPa s"),
        ("mm", "1"),
        ("mm/s", "1/s"),
        ("s", "s"),
        ("mJ", "MPa"),
    ],
)
def test_units_in_strain_and_stress(text: str, expected: str) -> None:
    assert STRAIN_STRESS.unit(text) == expected
    assert Axes().unit(text) == text


def test_stress_is_found_by_its_name_and_converted(tmp_path: Path) -> None:
    path = tmp_path / "stress.csv"
    rows = "".join(f"{t / 10},{t / 2},{t * 3},{t}\n" for t in range(30))
    path.write_text("Time (s),Strain (%),Stress (kPa),Load (N)\n" + rows, encoding="utf-8")
    options = ReadOptions(axes={"displacement": "strain", "force": "stress"})
    (trial,) = read_trials(path, options)
    assert trial.axes == STRAIN_STRESS
    assert dict(trial.source.columns) == {
        "time": "Time (s)",
        "displacement": "Strain (%)",
        "force": "Stress (kPa)",
    }
    assert trial.displacement_mm[-1] == pytest.approx(0.145)
    assert trial.force_N[-1] == pytest.approx(0.087)
    assert "normalised_axes" in {flag.code for flag in trial.flags}


def test_stress_that_was_not_declared_is_refused_with_the_way_out(tmp_path: Path) -> None:
    path = tmp_path / "stress.csv"
    rows = "".join(f"{t / 10},{t / 2},{t * 3}\n" for t in range(30))
    path.write_text("Time (s),Extension (mm),Load (kPa)\n" + rows, encoding="utf-8")
    with pytest.raises(InputError, match="--axes force=stress"):
        read_trials(path)


def test_an_axis_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UsageError, match="force can't be 'strain'"):
        ReadOptions(axes={"force": "strain"})


def test_specimens_in_different_units_are_not_compared_in_one_column() -> None:
    found = identify([ramp_hold(STRAIN_STRESS), ramp_hold(Axes(), name="meat")])
    page = render_report(plain_json(found.as_json()), [])
    overview = page.split('<table class="overview">')[1].split("</table>")[0]
    assert "[N/mm]" not in overview
    assert "MPa·s" in overview
    assert "N·s/mm" in overview
    assert "in different units" in page
