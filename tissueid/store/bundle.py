"""The bundle: one identified tissue in one HDF5 file, everything a renderer or a colleague needs.

Layout (schema version 1)::

    bundle.h5
    |  attributes: format = "tissueid/bundle", schema_version = 1, content_sha256
    |-- document     JSON text, schemas/bundle.schema.json
    |-- theta        (p,)    float64   parameters of the contact model, in the order of theta_names
    |-- covariance   (p, p)  float64   of the posterior where one was sampled, else of the optimum
    |-- draws        (n, p)  float64   only where a posterior was sampled; every row is passive
    `-- population_mean, population_sd  (m, p)  of a population: draws of mean and spread of ln quantities

The draws of a population's bundle are specimens drawn from it; its covariance is theirs.  Equal contents give
equal bytes: no time stamps, no version of the library that wrote it.  The content hash covers the document
and every number: a seal against accidents, not a signature.  A group ``specimen`` beside them is passed over.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray, evenly
from tissueid.documents import members, plain, typed
from tissueid.documents.folder import Bundle as Document
from tissueid.documents.identification import TipGeometry, Validity
from tissueid.errors import BundleError
from tissueid.flags import Flag
from tissueid.notebook import Shown
from tissueid.result import Estimate, ModelChoice, SpecimenFit
from tissueid.rupture_law import RuptureLaw
from tissueid.store.files import json_bytes
from tissueid.store.hdf5 import check_format, get_text, new_file, open_file, put_text
from tissueid.store.schema import check
from tissueid.trial import Axes

if TYPE_CHECKING:
    from tissueid.model.channels import ChannelModel


BUNDLE_FORMAT = "tissueid/bundle"
BUNDLE_SCHEMA_VERSION = 1
OPTIONAL = ("draws", "population_mean", "population_sd")
ARRAYS = ("theta", "covariance", *OPTIONAL)
#: Taken from a fit as they are.
_OF_FIT = ("specimen", "model", "theta_names", "theta", "speeds_mm_s", "tip_radius_mm", "tip", "flags")
UNITS = Axes().as_json()
_DOCUMENT = "document"
SPECIMEN_GROUP = "specimen"
#: Draws a bundle keeps: a 95 % bound from so many is good to 6 % of the posterior's sd.
MOST_DRAWS = 2_000
#: A covariance that went through a Cholesky factor and back is positive semi-definite to rounding only.
_COVARIANCE_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Bundle(Shown):
    """One identified tissue.

    Attributes
    ----------
    specimen : str
    model : ModelChoice
        Key and options of the contact model.
    theta_names : tuple of str
    theta : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    parameters : tuple of Estimate
        What was reported, in the words of identification.json.
    depth_mm : float
        The model is claimed on [0, depth_mm].
    speeds_mm_s : tuple of float
        Slowest and fastest loading speed it was fitted to [mm/s].
    tip_radius_mm : float or None
    tip : TipGeometry or None
        Shape of the tip, where it was stated.
    sigma_N : float
        Residual standard deviation [N].
    flags : tuple of Flag
    provenance : mapping
        Input hashes, versions, options, seed.
    draws : ndarray, shape (n, p), or None
        Posterior draws of theta; of a population, specimens drawn from it.
    population_mean, population_sd : ndarray, shape (m, p), or None
        Logarithms of the quantities of :mod:`tissueid.population.coordinates`.
    rupture : RuptureLaw or None
        When it breaks, as `tissueid rupture` found; ``None`` where nothing is claimed.
    units : mapping
    schema_version : int
    """

    specimen: str
    model: ModelChoice
    theta_names: tuple[str, ...]
    theta: FloatArray
    covariance: FloatArray
    parameters: tuple[Estimate, ...]
    depth_mm: float
    speeds_mm_s: tuple[float, float]
    tip_radius_mm: float | None
    sigma_N: float
    flags: tuple[Flag, ...]
    provenance: Mapping[str, Any]
    tip: TipGeometry | None = None
    draws: FloatArray | None = None
    population_mean: FloatArray | None = None
    population_sd: FloatArray | None = None
    rupture: RuptureLaw | None = None
    units: Mapping[str, str] = field(default_factory=lambda: dict(UNITS))
    schema_version: int = BUNDLE_SCHEMA_VERSION

    def __post_init__(self) -> None:
        for name in ARRAYS:
            values = getattr(self, name)
            if values is not None:
                array = np.array(values, dtype=np.float64, copy=True)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    @property
    def is_population(self) -> bool:
        """True where its draws are specimens of a population, and not what is known of one."""
        return self.population_mean is not None

    def contact_model(self) -> ChannelModel:
        """Build the contact model these parameters belong to, as it was fitted."""
        from tissueid.model.grammar import rebuilt

        return rebuilt(self.model, self.depth_mm)

    def require_renderable(self) -> None:
        """Check that a device could render this tissue.

        Raises BundleError: the recording was normalised: a device moves millimetres and pushes newtons.
        """
        if dict(self.units) != UNITS:
            units = ", ".join(f"{key} in {unit}" for key, unit in self.units.items())
            raise BundleError(
                f"{self.specimen}: the recordings were normalised ({units}), and a device renders mm and N; "
                "fit recordings of displacement and force to feel this tissue"
            )

    def parameter(self, name: str) -> Estimate:
        """Return the reported parameter of that name (``KeyError`` where there is none)."""
        return {estimate.name: estimate for estimate in self.parameters}[name]

    def as_json(self) -> dict[str, Any]:
        """Return the document of ``schemas/bundle.schema.json``."""
        return {
            "schema": f"{BUNDLE_FORMAT}/{self.schema_version}",
            "specimen": self.specimen,
            "model": self.model.as_json(),
            "theta_names": list(self.theta_names),
            "parameters": [estimate.as_json() for estimate in self.parameters],
            "validity": plain(Validity(**members(self, Validity))),
            "sigma_N": self.sigma_N,
            "units": dict(self.units),
            "flags": plain(self.flags),
            "provenance": dict(self.provenance),
            "rupture": None if self.rupture is None else self.rupture.as_json(),
        }


def array_problem(bundle: Bundle) -> str | None:
    """Fault of the sizes and numbers of a bundle's arrays, ``None`` where nothing is."""
    size = len(bundle.theta_names)
    known: Mapping[str, tuple[int, ...]] = {"theta": (size,), "covariance": (size, size)}
    for name in ARRAYS:
        array: FloatArray | None = getattr(bundle, name)
        if array is None:
            continue
        shape = known[name] if name in known else (len(array), size)
        if array.shape != shape:
            return f"{name} has shape {array.shape}, the {size} parameters need {shape}"
        if not np.isfinite(array).all():
            return f"{name} holds {int((~np.isfinite(array)).sum())} numbers that are not finite"
    covariance = bundle.covariance
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale[scale == 0] = 1.0
    # judged on the correlations, so that units (N/mm beside s) do not hide a wrong small entry
    correlation = covariance / np.outer(scale, scale)
    if np.abs(correlation - correlation.T).max(initial=0.0) > _COVARIANCE_ROUNDING:
        return "the covariance is not symmetric"
    smallest = float(np.linalg.eigvalsh(correlation).min(initial=0.0))
    if smallest < -_COVARIANCE_ROUNDING * max(size, 1):
        return f"the covariance is not positive semi-definite (eigenvalue {smallest:.3g} of the correlations)"
    return None


def model_problem(bundle: Bundle) -> str | None:
    """Why the contact model of a bundle can't be rendered, ``None`` where it can."""
    try:
        model = bundle.contact_model()
    except (KeyError, ValueError) as error:
        return f"the contact model can't be built ({error})"
    if tuple(model.parameter_names) != bundle.theta_names:
        return (
            f"theta is {bundle.theta_names}, the model {bundle.model.key} has {tuple(model.parameter_names)}"
        )
    if not model.is_passive(bundle.theta):
        return "theta is not passive: it would put out more energy than was put in"
    if bundle.draws is not None:
        active = np.flatnonzero(~model.passive(bundle.draws))
        if active.size:
            return f"draw {active[0]} is not passive: it would put out more energy than was put in"
    return None


def bundle_from_fit(fit: SpecimenFit, *, provenance: Mapping[str, Any]) -> Bundle:
    """Make the bundle of one specimen's fit; its covariance and draws are the posterior's where there is one.

    ``provenance``: of the run; inputs that this specimen did not use are left out.
    """
    own = {(trial.path, trial.sheet) for trial in fit.trials}
    inputs = [
        dict(entry)
        for entry in provenance.get("inputs", ())
        if (entry.get("path"), entry.get("sheet")) in own and entry.get("specimen") == fit.specimen
    ]
    posterior = fit.posterior
    return Bundle(
        **{name: getattr(fit, name) for name in _OF_FIT},
        covariance=fit.covariance if posterior is None else posterior.covariance,
        parameters=tuple(replace(one, unit=fit.axes.unit(one.unit)) for one in fit.parameters),
        depth_mm=float(fit.depth_mm),
        sigma_N=float(fit.sigma_N),
        provenance={**provenance, "inputs": inputs},
        draws=None if posterior is None else posterior.draws[evenly(len(posterior.draws), MOST_DRAWS)],
        units=fit.axes.as_json(),
    )


def write_bundle(bundle: Bundle, path: Path | str) -> None:
    """Write a bundle, whole or not at all, after the checks that :func:`load_bundle` makes.

    Raises BundleError: if the bundle could not be loaded again.
    """
    with new_file(Path(path)) as file:
        put_bundle(file, bundle, where=str(path))


def put_bundle(file: Any, bundle: Bundle, *, where: str) -> None:
    """Write a bundle into the root of an open HDF5 file, after the checks that :func:`load_bundle` makes."""
    document = plain(bundle.as_json())
    check(document, Document, where=where)
    _check_contents(bundle, where=where)
    arrays = {name: getattr(bundle, name) for name in ARRAYS if getattr(bundle, name) is not None}
    text = json_bytes(document)
    file.attrs["format"] = BUNDLE_FORMAT
    file.attrs["schema_version"] = np.int64(bundle.schema_version)
    file.attrs["content_sha256"] = _content_hash(text, arrays)
    put_text(file, _DOCUMENT, text)
    for name, array in arrays.items():
        file.create_dataset(name, data=array, dtype="<f8", track_times=False)


def load_bundle(path: Path | str) -> Bundle:
    """Read a bundle whose parameters, and every draw of them, make a passive model.

    Raises BundleError: it could not have been written by :func:`write_bundle`; with file, fault and way out.
    """
    path = Path(path)
    damaged = "it is damaged, incomplete or another kind of file: copy it again or run `tissueid fit` again"
    with open_file(path, "a bundle", damaged, "bundles into its output folder") as file:
        check_format(file, BUNDLE_FORMAT)
        version, seal = file.attrs.get("schema_version"), file.attrs.get("content_sha256")
        if version != BUNDLE_SCHEMA_VERSION:
            newer = isinstance(version, np.integer | int) and version > BUNDLE_SCHEMA_VERSION
            way = "install a newer tissueid" if newer else f"run `tissueid migrate {path}`"
            reads = f"this tissueid reads version {BUNDLE_SCHEMA_VERSION}"
            raise BundleError(f"{path}: schema version {version}, {reads}; {way}, or fit again")
        if seal is None:
            none = "carries no content hash, so it was not written by tissueid"
            raise BundleError(f"{path}: {none}; run `tissueid fit` again")
        text, arrays = _read(file)
    if seal != _content_hash(text, arrays):
        msg = f"{path}: changed since it was written (the content hash differs); run `tissueid fit` again"
        raise BundleError(msg)
    try:
        document = json.loads(text)
    except ValueError as error:
        raise BundleError(f"{path}: its document is not JSON ({error}); run `tissueid fit` again") from error
    check(document, Document, where=str(path))
    bundle = bundle_of_document(document, arrays)
    _check_contents(bundle, where=str(path))
    return bundle


def _content_hash(text: bytes, arrays: Mapping[str, FloatArray]) -> str:
    digest = hashlib.sha256(f"{BUNDLE_FORMAT}/{BUNDLE_SCHEMA_VERSION}".encode())
    digest.update(len(text).to_bytes(8, "little") + text)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name], dtype="<f8")
        digest.update(f"{name}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def _read(file: Any) -> tuple[bytes, dict[str, FloatArray]]:
    names = set(file) - {SPECIMEN_GROUP}
    missing = {_DOCUMENT, *ARRAYS} - set(OPTIONAL) - names
    unknown = names - {_DOCUMENT, *ARRAYS}
    if missing or unknown:
        raise ValueError(f"data sets missing: {sorted(missing)}, unknown: {sorted(unknown)}")
    text = get_text(file, _DOCUMENT)
    arrays = {}
    for name in names - {_DOCUMENT}:
        dataset = file[name]
        if dataset.dtype != np.dtype("<f8"):
            raise ValueError(f"data set {name} holds {dataset.dtype}, not 64-bit floats")
        arrays[name] = np.asarray(dataset[()])
    return text, arrays


def bundle_of_document(document: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Bundle:
    """The bundle that a document of this schema version and its arrays describe, not yet checked."""
    found = typed(document, Document)
    return Bundle(
        specimen=found.specimen,
        model=ModelChoice.of(found.model),
        theta_names=found.theta_names,
        parameters=tuple(Estimate.from_json(estimate) for estimate in document["parameters"]),
        **members(found.validity, Validity),
        sigma_N=found.sigma_N,
        flags=found.flags,
        provenance=document["provenance"],
        units=document["units"],
        rupture=None if found.rupture is None else typed(document["rupture"], RuptureLaw),
        **dict[str, Any](arrays),
    )


def _check_contents(bundle: Bundle, *, where: str) -> None:
    from tissueid.model.grammar import MISSING_LAW

    problem = array_problem(bundle) or model_problem(bundle)
    if problem is not None:
        again = "" if MISSING_LAW in problem else ", run `tissueid fit` again"
        raise BundleError(f"{where}: {problem}; such a bundle can't be rendered safely{again}")
