"""Scene of tissueid: what is felt and where, as scene.toml; units in the names of the keys."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from tissueid.documents.base import Document, JsonSchema, NonNegative, Positive, Text


class Tissue(Document, frozen=True):
    """Tissue that is felt."""

    RULES: ClassVar[JsonSchema] = {"oneOf": [{"required": ["bundle"]}, {"required": ["preset"]}]}

    bundle: Text | None = None  # Path, from the scene's own folder
    preset: Text | None = None
    surface: str | None = None  # As --surface
    force_scale: Positive | None = None
    motion_scale: Positive | None = None
    tip_radius_mm: Positive | None = None


Vector = tuple[float, float, float]


class Plan(Document, frozen=True):
    """The planned axis, in the device's frame from the middle of its workspace."""

    entry_mm: Vector
    axis: Vector  # Out of the bone; its length does not matter


class Funnel(Document, frozen=True):
    """Funnel around a planned path."""

    RULES: ClassVar[JsonSchema] = {
        "not": {
            "required": ["contact_law"],
            "anyOf": [
                {"required": [key]} for key in ("stiffness_N_per_m_n", "exponent", "restitution", "law")
            ],
        }
    }

    kind: Literal["hyperboloid", "cone"] | None = None
    radius_mm: Positive | None = None
    offset_mm: NonNegative | None = None
    slope: Positive | None = None
    stiffness_N_per_m_n: Positive | None = None
    exponent: Annotated[float, Meta(ge=0.5, le=4)] | None = None
    restitution: Annotated[float, Meta(ge=0.05, le=1)] | None = None
    law: Literal["flores", "exact"] | None = None
    slowest_mm_per_s: Positive | None = None
    #: Bundle of a power * impact fit whose k, n and e are felt; path from the scene's own folder
    contact_law: Text | None = None


class Pull(Document, frozen=True):
    """Pull toward a planned path."""

    far_N_per_m: NonNegative | None = None
    near_N_per_m: NonNegative | None = None
    reach_mm: Positive | None = None
    tau_s: NonNegative | None = None
    filter_s: NonNegative | None = None
    conservative: bool | None = None  # False for the printed variant, without the axial force


class Bone(Document, frozen=True):
    """Bone around a planned path."""

    radius_mm: NonNegative | None = None  # 0 for none
    stiffness_N_per_m: Positive | None = None
    hole_radius_mm: NonNegative | None = None
    resistance_N_s_per_m: Positive | None = None
    drill_depth_mm: NonNegative | None = None


class Weight(Document, frozen=True):
    """Force that carries the tool."""

    force_N: Vector
    slope_N_per_m: tuple[Vector, Vector, Vector] | None = None


class Guidance(Document, frozen=True):
    """Guidance along a planned path."""

    funnel: Funnel | None = None
    pull: Pull | None = None
    bone: Bone | None = None
    weight: Weight | None = None  # Force that carries the tool


class Scene(Document, frozen=True):
    """Scene: what is felt, and where."""

    RULES: ClassVar[JsonSchema] = {
        "oneOf": [
            {"required": ["tissue"], "not": {"anyOf": [{"required": ["guidance"]}, {"required": ["plan"]}]}},
            {"required": ["guidance", "plan"]},
        ]
    }

    schema: Literal["tissueid/scene/1"]
    name: Annotated[str, Meta(min_length=1, max_length=200)]
    about: str | None = None  # Origin of the numbers
    assumed: tuple[str, ...] | None = None  # Keys whose numbers no source states
    device: str | None = None  # As --device
    tissue: Tissue | None = None
    plan: Plan | None = None
    guidance: Guidance | None = None
