"""The JSON document inside a bundle (bundle.h5, data set `document`)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Document, NonNegative, Text
from tissueid.documents.flag import Flag
from tissueid.documents.identification import Estimate, Model, Provenance, Validity
from tissueid.documents.inspect import Units
from tissueid.documents.rupture import Law


class Bundle(Document, frozen=True):
    """The numbers of the model (theta, covariance, draws) are data sets beside it.

    Covariance and draws are the posterior's where one was sampled, and every draw is passive.
    """

    schema: Literal["tissueid/bundle/1"]
    specimen: Text
    model: Model
    theta_names: Annotated[tuple[Text, ...], Meta(min_length=1)]
    parameters: tuple[Estimate, ...]  # None of the yardstick
    validity: Validity
    sigma_N: NonNegative
    units: Units
    flags: tuple[Flag, ...]
    provenance: Provenance
    rupture: Law | None  # When the tissue breaks, as `tissueid rupture` found; null where nothing is claimed
