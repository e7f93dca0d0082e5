"""Deflection of machine, load cell and fixture under compressive force, from a rigid block."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Document, NonNegative, Positive, PositiveCount


class Source(Document, frozen=True):
    """Recording a calibration was made from."""

    path: str
    sheet: str | None
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class Frame(Document, frozen=True):
    """Deflection of machine, load cell and fixture against force."""

    schema: Literal["tissueid/frame/1"]
    tissueid: str  # Version that wrote this
    force_N: Annotated[tuple[NonNegative, ...], Meta(min_length=2)]  # Knots of force, growing from 0 [N]
    #: du/dF at the knots, linear between them [mm/N]
    compliance_mm_per_N: Annotated[tuple[NonNegative, ...], Meta(min_length=2)]
    covariance: tuple[tuple[float, ...], ...]  # Of the compliances, noise and repeatability together [mm2/N2]
    deflection_mm: tuple[NonNegative, ...]  # u(F) at the knots, for reading [mm]
    sd_mm: tuple[NonNegative, ...]  # Standard deviation of u(F) at the knots [mm]
    range_N: tuple[NonNegative, NonNegative]  # Forces the recordings cover [N]
    stiffness_N_per_mm: Positive  # Tangent stiffness at the largest force [N/mm]
    noise_sd_mm: NonNegative  # Standard deviation of the residual displacement [mm]
    #: Standard deviation between loadings at the largest force [mm]; null for one loading, where 5 % is
    #: assumed
    repeatability_sd_mm: NonNegative | None
    loadings: PositiveCount  # Loadings that were used
    sources: Annotated[tuple[Source, ...], Meta(min_length=1)]
