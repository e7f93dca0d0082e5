"""Compiled kernels that are older than a source they hold are compiled again."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tissueid.render.kernel_cache import forget_stale_kernels, kernel_modules
from tissueid.render.servo_loop import compiled_loop


def a_module(folder: Path, name: str, *, written: float, compiled: float | None) -> ModuleType:
    """A module with one kernel; its source and its compiled form are as old as said."""
    module = ModuleType(f"tissueid.render.{name}")
    source, cache = folder / f"{name}.py", folder / "__pycache__"
    source.write_text("", encoding="ascii")
    os.utime(source, (written, written))
    cache.mkdir(exist_ok=True)
    if compiled is not None:
        for suffix in ("nbi", "1.nbc"):
            file = cache / f"{name}.{suffix}"
            file.write_bytes(b"code")
            os.utime(file, (compiled, compiled))
    module.__file__ = str(source)
    module.kernel = SimpleNamespace(stats=SimpleNamespace(cache_path=str(cache)))  # type: ignore[attr-defined]
    return module


def left(folder: Path) -> set[str]:
    return {path.name for path in (folder / "__pycache__").iterdir()}


def test_an_edited_guard_takes_the_loop_that_holds_it_along(tmp_path: Path) -> None:
    loop = a_module(tmp_path, "loop", written=100.0, compiled=200.0)
    guard = a_module(tmp_path, "guard", written=300.0, compiled=None)
    assert forget_stale_kernels([loop, guard]) == 2
    assert left(tmp_path) == set()


def test_what_was_compiled_after_every_source_stays(tmp_path: Path) -> None:
    loop = a_module(tmp_path, "loop", written=100.0, compiled=200.0)
    guard = a_module(tmp_path, "guard", written=150.0, compiled=160.0)
    assert forget_stale_kernels([loop, guard]) == 0
    assert left(tmp_path) == {"loop.nbi", "loop.1.nbc", "guard.nbi", "guard.1.nbc"}


@pytest.mark.needs_jit
def test_guard_law_and_arm_are_among_the_modules_looked_at() -> None:
    assert compiled_loop is not None
    names = {module.__name__ for module in kernel_modules()}
    assert {
        "tissueid.compiled",
        "tissueid.haptics.arm",
        "tissueid.haptics.guard",
        "tissueid.model.kernels",
        "tissueid.render.environment",
    } <= names
