"""Draws for arviz: the groups, the files, and the way out where arviz is missing."""

from __future__ import annotations

import importlib.util
import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from fit_factory import THETA_NAMES, identification, specimen_fit
from posterior_factory import posterior, sampled

from tissueid.errors import UsageError
from tissueid.exchange import netcdf_bytes
from tissueid.result import SpecimenFit
from tissueid.store.outputs import OutputSet
from tissueid.store.results import write_results

NO_ARVIZ = importlib.util.find_spec("arviz") is None
needs_arviz = pytest.mark.skipif(NO_ARVIZ, reason="arviz is not installed: pip install 'tissueid[arviz]'")


def _written(folder: Path, *fits: SpecimenFit) -> Path:
    with OutputSet(folder) as outputs:
        write_results(outputs, identification(fits))
        outputs.commit()
    return folder


def _arviz() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz


class _Recorded:
    """A data set, or a tree of them, that keeps what it was made from."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    @classmethod
    def from_dict(cls, groups: dict[str, Any]) -> _Recorded:
        return cls("tree", groups)


def _install(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    arviz, xarray = types.ModuleType("arviz"), types.ModuleType("xarray")
    arviz.__dict__.update(__version__=version, InferenceData=_Recorded)
    xarray.__dict__.update(Dataset=_Recorded, DataTree=_Recorded)
    monkeypatch.setitem(sys.modules, "arviz", arviz)
    monkeypatch.setitem(sys.modules, "xarray", xarray)


@pytest.mark.parametrize("version", ["0.18.0", "1.2.0"])
def test_quarters_of_the_draws_are_chains_and_so_are_walkers(
    monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    _install(monkeypatch, version)
    given = posterior(draws=53)
    made = given.to_arviz()
    groups = made.kwargs if version.startswith("0") else made.args[1]
    assert (made.args == ()) == version.startswith("0")
    theta, chain = groups["posterior"].args[0], groups["unconstrained_posterior"].args[0]
    assert list(theta) == [*THETA_NAMES, *(f"{name}_total" for name in THETA_NAMES)]
    for k, name in enumerate(THETA_NAMES):
        assert theta[name][0] == ("chain", "draw")
        assert np.array_equal(theta[name][1], np.stack(np.split(given.draws[:52, k], 4)))
        assert np.array_equal(theta[f"{name}_total"][1], given.draws_total[:52, k].reshape(4, 13))
    assert list(chain) == list(given.chain_names)
    for k, name in enumerate(given.chain_names):
        assert np.array_equal(chain[name][1], given.chain[:, :, k])
    assert "sample_stats" not in groups
    coordinates = groups["unconstrained_posterior"].kwargs["coords"]
    assert (coordinates["chain"].size, coordinates["draw"].size) == given.chain.shape[:2]


def test_the_log_density_of_a_walked_chain_goes_along(monkeypatch: pytest.MonkeyPatch) -> None:
    _install(monkeypatch, "0.18.0")
    given = posterior(draws=50)
    given = replace(given, log_density=given.chain.sum(axis=2))
    stats = given.to_arviz().kwargs["sample_stats"].args[0]
    assert np.array_equal(stats["lp"][1], given.log_density)


def test_without_total_draws_there_are_no_total_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    _install(monkeypatch, "0.18.0")
    made = posterior(draws=50, total=False).to_arviz()
    assert list(made.kwargs["posterior"].args[0]) == list(THETA_NAMES)


def test_without_arviz_the_way_out_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "arviz", None)
    out = _written(tmp_path / "out", sampled(specimen_fit("kidney 3", samples=60)))
    ended = run("export", out, "--format", "netcdf", "-o", tmp_path / "chains.nc")
    assert ended.code == 2
    assert "pip install 'tissueid[arviz]'" in ended.stderr
    assert not (tmp_path / "chains.nc").exists()


def test_a_library_for_netcdf_that_is_missing_is_named(tmp_path: Path) -> None:
    class Unwritable:
        def to_netcdf(self, path: str) -> None:
            msg = "No module named 'h5netcdf'"
            raise ImportError(msg)

    with pytest.raises(UsageError, match="pip install h5netcdf"):
        netcdf_bytes(Unwritable())


def test_netcdf_is_not_printed(tmp_path: Path) -> None:
    out = _written(tmp_path / "out", sampled(specimen_fit("kidney 3", samples=60)))
    ended = run("export", out, "--format", "netcdf")
    assert ended.code == 2
    assert "name a file with -o" in ended.stderr


def test_a_fit_without_a_posterior_has_no_draws(tmp_path: Path) -> None:
    out = _written(tmp_path / "out", specimen_fit("kidney 3", samples=60))
    ended = run("export", out, "--format", "netcdf", "-o", tmp_path / "chains.nc")
    assert ended.code == 2
    assert "no posterior was sampled" in ended.stderr


@needs_arviz
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_arviz_reads_the_draws_of_each_specimen(tmp_path: Path) -> None:
    arviz = _arviz()
    fits = [sampled(specimen_fit(name, samples=60)) for name in ("kidney 3", "liver/left")]
    out = _written(tmp_path / "out", *fits)
    ended = run("export", out, "--format", "netcdf", "-o", tmp_path / "chains.nc")
    assert ended.code == 0, ended.stderr
    assert sorted(path.name for path in tmp_path.glob("*.nc")) == [
        "chains-kidney_3.nc",
        "chains-liver_left.nc",
    ]
    for fit, name in zip(fits, ("chains-kidney_3.nc", "chains-liver_left.nc"), strict=True):
        found = arviz.from_netcdf(str(tmp_path / name))
        assert found["posterior"].attrs["specimen"] == fit.specimen
        stored = fit.posterior
        assert stored is not None
        first = stored.theta_names[0]
        assert np.array_equal(np.asarray(found["posterior"][first]).ravel(), stored.draws[:, 0])
        walkers = np.asarray(found["unconstrained_posterior"][stored.chain_names[1]])
        assert np.array_equal(walkers, stored.chain[:, :, 1])


@needs_arviz
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_one_specimen_has_the_file_that_was_named(tmp_path: Path) -> None:
    arviz = _arviz()
    out = _written(tmp_path / "out", sampled(specimen_fit("kidney 3", samples=60)))
    ended = run("export", out, "--format", "netcdf", "-o", tmp_path / "mine.nc")
    assert ended.code == 0, ended.stderr
    summary = arviz.summary(arviz.from_netcdf(str(tmp_path / "mine.nc"))["unconstrained_posterior"])
    assert summary.loc["ln_tau_1", "r_hat"] < 1.01
