"""Sums come back bit for bit, add up, and are refused where they were touched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tissueid.errors import BundleError
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.lag_sums import LagSums, lag_sums
from tissueid.likelihood.sums import LogData
from tissueid.store.sums import StoredLog, StoredSums, read_sums, with_logs_of, write_sums

PARTS = ("start", "later", "earlier", "difference", "ratio", "links")


def made(seed: int, *, rates: int = 1, n: int = 400) -> tuple[LagSums, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    steps = np.repeat([0.01, 0.05, 0.2][:rates], -(-n // rates))[: n - 1]
    time = np.concatenate([[0.0], np.cumsum(steps)])
    depth = np.minimum(time, 2.0)
    data = LogData(
        time, depth, 9.0 * depth + rng.normal(size=n), np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64)
    )
    basis = kernel_basis(step_s=0.01, length_s=30.0)
    center = rng.normal(size=4 + basis.tau_s.size)
    sums = lag_sums(data, basis, degree=0, reference_step_s=0.01, center=center)
    return sums, center, basis.tau_s


def stored(specimen: str, *, seeds: tuple[int, ...], rates: int = 1) -> StoredSums:
    logs = []
    tau = np.empty(0)
    for seed in seeds:
        sums, center, tau = made(seed, rates=rates)
        parts = {name: getattr(sums, name) for name in PARTS}
        logs.append(
            StoredLog(
                path=f"lab/{specimen} {seed}.csv",
                sheet="Blatt µ" if seed % 2 else None,
                sha256=f"{seed:064x}",
                chains=sums.chains,
                center=center,
                **parts,
            )
        )
    return StoredSums(
        specimen=specimen,
        tau_s=tau,
        degree=0,
        scale_mm=2.0,
        reference_step_s=0.01,
        moving_average=0.3,
        filter_phi=0.9,
        step_s=0.01,
        duration_s=30.0,
        log_range=(-3.0, 2.0) if rates > 1 else None,
        logs=tuple(logs),
    )


def test_sums_come_back_bit_for_bit(tmp_path: Path) -> None:
    expected = [stored("a", seeds=(1, 2, 3)), stored("Ärmel", seeds=(4, 5), rates=3)]
    write_sums(expected, tmp_path / "sums.h5")
    actual = list(read_sums(tmp_path / "sums.h5"))
    assert [one.specimen for one in actual] == ["a", "Ärmel"]
    for before, after in zip(expected, actual, strict=True):
        for name in (
            "degree",
            "scale_mm",
            "reference_step_s",
            "moving_average",
            "filter_phi",
            "step_s",
            "duration_s",
        ):
            assert getattr(after, name) == getattr(before, name), name
        assert after.log_range == before.log_range
        assert np.array_equal(after.tau_s, before.tau_s)
        for log, other in zip(before.logs, after.logs, strict=True):
            assert (other.path, other.sheet, other.sha256) == (log.path, log.sheet, log.sha256)
            assert other.chains == log.chains
            for name in (*PARTS, "center"):
                assert np.array_equal(getattr(other, name), getattr(log, name)), name
                assert getattr(other, name).dtype == getattr(log, name).dtype, name


def test_a_log_without_links_comes_back(tmp_path: Path) -> None:
    whole = stored("a", seeds=(1,))
    none = np.zeros((0, whole.columns, whole.columns))
    bare = replace(
        whole.logs[0],
        later=none,
        earlier=none,
        difference=none,
        ratio=np.zeros(0),
        links=np.zeros(0, dtype=np.int64),
    )
    write_sums([replace(whole, logs=(bare,))], tmp_path / "sums.h5")
    (actual,) = read_sums(tmp_path / "sums.h5")
    assert actual.logs[0].later.shape == (0, whole.columns, whole.columns)
    assert np.array_equal(actual.logs[0].start, bare.start)


def test_no_specimens_come_back_as_none(tmp_path: Path) -> None:
    write_sums([], tmp_path / "sums.h5")
    assert list(read_sums(tmp_path / "sums.h5")) == []


def test_stored_sums_are_the_same_likelihood(tmp_path: Path) -> None:
    sums, center, tau = made(7, rates=3)
    write_sums([stored("a", seeds=(7,), rates=3)], tmp_path / "sums.h5")
    ((log,),) = (one.logs for one in read_sums(tmp_path / "sums.h5"))
    again = LagSums(
        chains=log.chains, degree=0, reference_step_s=0.01, **{name: getattr(log, name) for name in PARTS}
    )
    gram, log_det = sums.whitened(0.93)
    assert np.array_equal(again.whitened(0.93)[0], gram)
    assert again.whitened(0.93)[1] == log_det
    assert np.array_equal(log.center, center)
    assert tau.size + 5 == gram.shape[0]


def test_equal_sums_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("one.h5", "two.h5"):
        write_sums((stored("a", seeds=(1, 2)) for _ in range(2)), tmp_path / name)
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


def test_upper_triangles_take_half_the_room(tmp_path: Path) -> None:
    one = stored("a", seeds=(1, 2, 3))
    write_sums([one], tmp_path / "sums.h5")
    full = sum(getattr(log, name).nbytes for log in one.logs for name in PARTS[:4])
    assert (tmp_path / "sums.h5").stat().st_size <= 0.55 * full + 20_000


def test_logs_of_one_basis_add_up() -> None:
    both = with_logs_of(stored("a", seeds=(1, 2)), stored("a", seeds=(3,)))
    assert [log.sha256[-1] for log in both.logs] == ["1", "2", "3"]


def test_logs_of_other_columns_do_not_add_up() -> None:
    one = stored("a", seeds=(1,))
    other = stored("a", seeds=(2,))
    with pytest.raises(ValueError, match=r"reference_step_s is 0.01 and 0.02"):
        with_logs_of(one, replace(other, reference_step_s=0.02))
    with pytest.raises(ValueError, match="other nodes"):
        with_logs_of(one, replace(other, tau_s=other.tau_s * 1.1))
    with pytest.raises(ValueError, match=r"a 1\.csv would count twice"):
        with_logs_of(one, stored("a", seeds=(1,)))


@pytest.mark.parametrize("where", ["cut", "not hdf5", "number", "name", "version", "kind", "missing"])
def test_a_damaged_file_is_refused_with_the_way_out(tmp_path: Path, where: str) -> None:
    path = tmp_path / "sums.h5"
    write_sums([stored("a", seeds=(1, 2))], path)
    if where == "cut":
        path.write_bytes(path.read_bytes()[:-300])
    elif where == "not hdf5":
        path.write_bytes(b"time;force\n0;1\n")
    else:
        with h5py.File(path, "r+") as file:
            if where == "number":
                file["0/gram"][1, 5] += 1e-9
            elif where == "name":
                text = bytes(file["index"][()]).replace(b'"specimen": "a"', b'"specimen": "b"')
                file["index"][()] = np.array(text, dtype=file["index"].dtype)
            elif where == "version":
                file.attrs["schema_version"] = 99
            elif where == "kind":
                file.attrs["format"] = "tissueid/curves/1"
            else:
                del file["0/links"]
    with pytest.raises(BundleError, match=r"cannot be read as sums.*run `tissueid fit` again"):
        list(read_sums(path))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match="no such file"):
        list(read_sums(tmp_path / "sums.h5"))


def test_a_failure_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "sums.h5"
    write_sums([stored("a", seeds=(1,))], path)
    before = path.read_bytes()

    def broken():
        yield stored("a", seeds=(2,))
        msg = "the disk is full"
        raise OSError(msg)

    with pytest.raises(OSError, match="disk is full"):
        write_sums(broken(), path)
    assert path.read_bytes() == before
