"""The file that keeps a chain while it is sampled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tissueid.posterior import checkpoint
from tissueid.inference.checkpoint import Checkpoint, SavedWalk, discard


def _walk(steps: int = 30) -> SavedWalk:
    rng = np.random.default_rng(31)
    random = np.random.RandomState(31)
    random.standard_normal(7)
    return SavedWalk(
        points=rng.standard_normal((steps, 32, 3)),
        log_density=rng.standard_normal((steps, 32)),
        centre=rng.standard_normal(3),
        root=np.eye(3),
        random_state=tuple(random.get_state()),
    )


def test_a_walk_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path, walk = tmp_path / "chains" / "liver.npz", _walk()
    Checkpoint(path, "key").save(walk)
    found = Checkpoint(path, "key").load()
    assert found is not None
    for name in ("points", "log_density", "centre", "root"):
        assert np.array_equal(getattr(found, name), getattr(walk, name))
    after, before = np.random.RandomState(1), np.random.RandomState(31)
    after.set_state(found.random_state)
    before.standard_normal(7)
    # an odd number of normals was drawn, so that the second of a pair is part of the state
    assert np.array_equal(after.standard_normal(5), before.standard_normal(5))


def test_a_walk_of_another_run_is_not_used_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "liver.npz"
    Checkpoint(path, "first data").save(_walk(10))
    other = Checkpoint(path, "other data")
    assert other.load() is None
    assert other.remark is None
    other.save(_walk(20))
    assert Checkpoint(path, "first data").load() is None
    found = Checkpoint(path, "other data").load()
    assert found is not None
    assert len(found.points) == 20


@pytest.mark.parametrize(
    "damage", ["cut", "empty", "noise", "flipped", "other arrays", "no zip member", "shapes"]
)
def test_a_damaged_file_is_left_aside_with_a_remark(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "liver.npz"
    Checkpoint(path, "key").save(_walk())
    content = path.read_bytes()
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "noise":
        path.write_bytes(np.random.default_rng(32).bytes(5000))
    elif damage == "flipped":
        middle = len(content) // 2
        path.write_bytes(content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :])
    elif damage == "other arrays":
        np.savez(path, points=np.zeros(3))
    elif damage == "no zip member":
        np.save(path.with_suffix(".npy"), np.zeros(3))
        path.with_suffix(".npy").replace(path)
    else:
        walk = _walk()
        Checkpoint(path, "key").save(SavedWalk(walk.points, walk.log_density[:5], *_rest(walk)))
    found = Checkpoint(path, "key")
    assert found.load() is None
    assert found.remark is not None
    assert "liver.npz" in found.remark
    assert "from its start" in found.remark


def _rest(walk: SavedWalk) -> tuple[np.ndarray, np.ndarray, tuple[object, ...]]:
    return walk.centre, walk.root, walk.random_state


def test_objects_in_a_file_are_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "liver.npz"
    np.savez(path, identity=np.array([{"any": "object"}], dtype=object))
    found = Checkpoint(path, "key")
    assert found.load() is None
    assert found.remark is not None


def test_a_folder_that_cannot_be_written_does_not_stop_the_chain(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file where the folder should be")
    kept = Checkpoint(tmp_path / "taken" / "liver.npz", "key")
    kept.save(_walk())
    assert kept.remark is not None
    assert "can't be kept" in kept.remark
    assert not kept.written


def test_without_a_path_nothing_is_due_and_nothing_written(tmp_path: Path) -> None:
    kept = Checkpoint(None, "key", interval_s=0.0)
    kept.save(_walk())
    assert not kept.due
    assert kept.load() is None
    assert list(tmp_path.iterdir()) == []


def test_a_write_is_due_once_an_interval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: clock[0])
    kept = Checkpoint(tmp_path / "liver.npz", "key", interval_s=1.0)
    assert not kept.due
    clock[0] = 101.0
    assert kept.due
    kept.save(_walk())
    assert not kept.due
    clock[0] = 102.0
    assert kept.due


def test_slow_writes_are_further_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]

    def slow(path: Path, content: bytes) -> None:
        clock[0] += 0.4

    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(checkpoint, "write_file", slow)
    kept = Checkpoint(tmp_path / "liver.npz", "key", interval_s=1.0)
    kept.save(_walk())
    # 0.4 s are 5 % of 8 s
    clock[0] = 8.3
    assert not kept.due
    clock[0] = 8.5
    assert kept.due


def test_a_discarded_file_takes_its_empty_folder_along(tmp_path: Path) -> None:
    folder = tmp_path / ".sampling"
    first, second = folder / "liver.npz", folder / "spleen.npz"
    for path in (first, second):
        Checkpoint(path, "key").save(_walk(2))
    (folder / ".tmp-liver.npz").write_bytes(b"left by a kill")
    discard(first)
    assert sorted(path.name for path in folder.iterdir()) == ["spleen.npz"]
    discard(second)
    assert not folder.exists()
    discard(second)
    assert list(tmp_path.iterdir()) == []
