"""Scenes as files: what is felt, where, and on which device (``scene.toml``, schemas/scene.schema.json)."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from tissueid.errors import printable, refuse
from tissueid.haptics.hand import MM
from tissueid.model.channels import DampedModel
from tissueid.rendering.guidance_block import Bone, Funnel, Guidance, Pull
from tissueid.rendering.tissue_block import WORKSPACE_CENTRE_M
from tissueid.store.bundle import load_bundle
from tissueid.store.schema import first_problem

#: The one shape of a static law that a wall takes.
EXPONENT = "static_exponent"
#: Keys of a scene that are lengths or speeds in millimetres -> fields in metres.
_IN_MM = "_mm"
_PER_S = "_mm_per_s"


@dataclass(frozen=True, slots=True)
class Scene:
    """Contents of a file."""

    name: str
    assumed: tuple[str, ...]  # keys whose numbers no source states
    device: str | None
    #: Of :class:`tissueid.rendering.options.RenderOptions`: bundle, preset, surface, scales, tip.
    tissue: Mapping[str, Any]
    guidance: Guidance | None

    def lines(self) -> list[str]:
        """Lines printed before force is enabled."""
        text = [f"scene      {self.name}"]
        if self.assumed:
            text.append(f"assumed    {', '.join(self.assumed)}")
        return text


_SCENES = resources.files("tissueid.rendering") / "scenes"


def scene_names() -> tuple[str, ...]:
    """Scenes that come along."""
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in _SCENES.iterdir()))


def load_scene(given: str, *, plan: Path | None = None) -> Scene:
    """A scene by name or path; or UsageError.

    ``plan``: file of a patient's ``axis`` and ``entry_mm``, in the place of the scene's own.
    """
    file = _SCENES / f"{given}.toml" if given in scene_names() else Path(given)
    if not file.is_file():
        known = ", ".join(scene_names())
        refuse(f"--scene {printable(given)!r} is no file, and scenes that come along are {known}")
    document, folder = _document(file, given), Path(given).parent
    if plan is not None:
        if "guidance" not in document:
            refuse(f"--plan is an axis to be guided along, and scene {printable(given)!r} has no guidance")
        document["plan"] = _document(plan, str(plan))
    problem = first_problem(document, "scene")
    if problem is not None:
        refuse(f"scene {printable(given)!r}, {problem}")
    tissue = document.get("tissue", {})
    if "bundle" in tissue:
        tissue["bundle"] = folder / tissue["bundle"]
    return Scene(
        name=document["name"],
        assumed=tuple(document.get("assumed", ())),
        device=document.get("device"),
        tissue=tissue,
        guidance=_guidance(document, given, folder),
    )


def _document(file: Traversable, name: str) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        refuse(f"{printable(name)} is no TOML: {error}")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        refuse(f"{printable(str(file))}: can't be read ({reason}); name a TOML file, see docs/guidance.md")


def _law(path: Path) -> dict[str, Any]:
    """Stiffness [N/m^n], exponent, restitution and law of the bundle of a damped power of depth."""
    bundle = load_bundle(path)
    model = bundle.contact_model()
    if not isinstance(model, DampedModel) or [one.spec.name for one in model.static.shapes] != [EXPONENT]:
        refuse(f"{printable(str(path))} is of {bundle.model.name!r}; a wall takes a 'power * impact' fit")
    unknown = [one.symbol for one in bundle.parameters if one.value is None]
    if unknown:
        refuse(f"{printable(str(path))}: {', '.join(unknown)} not identified; there is no law to be felt")
    stiffness, exponent, restitution = bundle.theta.tolist()
    return {
        "stiffness_N_per_m_n": stiffness * MM**-exponent,
        "exponent": exponent,
        "restitution": restitution,
        "law": model.damping.variant,
    }


def _guidance(document: Mapping[str, Any], given: str, folder: Path) -> Guidance | None:
    if "guidance" not in document:
        return None
    table, plan = document["guidance"], document["plan"]
    weight = {"force_N": [0.0] * 3, "slope_N_per_m": [[0.0] * 3] * 3} | table.get("weight", {})
    rows = weight["slope_N_per_m"]
    x, y, z = (centre + MM * off for centre, off in zip(WORKSPACE_CENTRE_M, plan["entry_mm"], strict=True))
    funnel = _in_metres(table.get("funnel", {}))
    try:
        if "contact_law" in funnel:
            funnel |= _law(folder / funnel.pop("contact_law"))
        return Guidance(
            entry_m=(x, y, z),
            axis=tuple(plan["axis"]),
            funnel=Funnel(**funnel),
            pull=Pull(**_in_metres(table.get("pull", {}))),
            bone=Bone(**_in_metres(table.get("bone", {}))),
            weight_N=tuple(weight["force_N"]),
            weight_slope_N_per_m=(tuple(rows[0]), tuple(rows[1]), tuple(rows[2])),
        )
    except ValueError as error:
        refuse(f"scene {printable(given)!r}: {error}")


def _in_metres(table: Mapping[str, Any]) -> dict[str, Any]:
    out = {}
    for key, value in table.items():
        if key.endswith(_PER_S):
            out[key.removesuffix(_PER_S) + "_m_s"] = MM * value
        elif key.endswith(_IN_MM):
            out[key.removesuffix(_IN_MM) + "_m"] = MM * value
        else:
            out[key] = value
    return out
