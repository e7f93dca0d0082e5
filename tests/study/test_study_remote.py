"""Data at a URL are fitted as data on this machine are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from study_folder import QUICK, fit, recording

fsspec = pytest.importorskip("fsspec")

TIMES = {"a": 1.0, "b": 1.3}


def found_in(document: dict[str, Any]) -> dict[str, Any]:
    """What was found of each specimen, but for where its recordings lie."""
    return {
        one["specimen"].rsplit("/", 1)[-1]: (one["parameters"], one["nrmsd"], one["n_samples"])
        for one in document["specimens"]
    }


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_study_at_a_url_is_that_of_a_folder(tmp_path: Path, workers: str) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    system = fsspec.filesystem("memory")
    for name, times in TIMES.items():
        text = recording(times=times)
        (folder / f"{name}.csv").write_text(text, encoding="ascii")
        system.pipe_file(f"/remote/{name}.csv", text.encode())
    # a file system in memory is that of this process
    where = "memory://remote" if workers == "1" else f"file://{folder}"
    _, local = fit(folder, *QUICK, out=tmp_path / "local")
    _, remote = fit(where, *QUICK, "--workers", workers, out=tmp_path / "remote")
    system.rm("/remote", recursive=True)
    assert len(local["specimens"]) == 2
    assert found_in(remote) == found_in(local)
