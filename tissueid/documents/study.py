"""Study manifest of tissueid: study.toml, as JSON, units in the names of the keys."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from tissueid.documents.base import (
    Count,
    Document,
    Fraction,
    JsonSchema,
    NonNegative,
    Positive,
    PositiveCount,
    Text,
)
from tissueid.documents.inspect import Refusal


class NormalPrior(Document, frozen=True):
    """Normal prior of one coefficient, cut to the passive set [N/mm]."""

    mean: float  # Mean [N/mm]
    sd: Positive  # Standard deviation [N/mm], above 0


class LogNormalPrior(Document, frozen=True):
    """Log-normal prior of one branch's relaxation time."""

    median: Positive  # Median [s]
    sd_ln: Positive  # Standard deviation of the natural logarithm: 0.5 means within a factor of 2.7 with 95 %


class Phi(Document, frozen=True):
    """Bounds of a uniform correlation of the noise over one reference step, the commonest sampling step."""

    low: Fraction  # From 0
    high: Fraction  # To 1, above low


class GainSd(Document, frozen=True):
    """Half-normal prior of how much the gain (its logarithm) varies from log to log."""

    scale: Positive  # Standard deviation of the normal that is cut in half, a fraction: 0.3 allows 30 %


class Priors(Document, frozen=True, forbid_unknown_fields=False):
    """Knowledge before the data; of laws beside the Kelvin-Voigt one, by their parameters' names."""

    RULES: ClassVar[JsonSchema] = {
        "additionalProperties": {
            "anyOf": [{"$ref": "#/$defs/normal_prior"}, {"$ref": "#/$defs/log_normal_prior"}]
        }
    }

    #: Normal prior of one coefficient, cut to the passive set [N/mm]
    static_1_N_per_mm: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^2]
    static_2_N_per_mm2: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^3]
    static_3_N_per_mm3: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm]
    stiffness_0_N_per_mm: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^2]
    stiffness_1_N_per_mm2: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^3]
    stiffness_2_N_per_mm3: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm]
    stiffness_0_N_per_mm_b2: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^2]
    stiffness_1_N_per_mm2_b2: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^3]
    stiffness_2_N_per_mm3_b2: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm]
    stiffness_0_N_per_mm_b3: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^2]
    stiffness_1_N_per_mm2_b3: NormalPrior | None = None
    #: Normal prior of one coefficient, cut to the passive set [N/mm^3]
    stiffness_2_N_per_mm3_b3: NormalPrior | None = None
    #: One table a branch, by ascending time
    relaxation_time_s: Annotated[tuple[LogNormalPrior, ...], Meta(min_length=1, max_length=3)] | None = None
    sigma_N: LogNormalPrior | None = None  # Log-normal prior of the noise's standard deviation
    #: Correlation of the noise over one reference step (the commonest sampling step) is uniform between these
    phi: Phi | None = None
    #: Half-normal prior of how much the gain (its logarithm) varies from log to log
    gain_sd: GainSd | None = None


class TissueFacts(Document, frozen=True):
    """Facts about the tissue, its donor and its state."""

    species: Text | None = None  # Species, and breed or strain
    tissue: Text | None = None  # Tissue or organ
    donor: Text | None = None  # Animal or donor; specimens of one donor are not independent
    sex: Text | None = None  # Sex of the donor
    age_years: NonNegative | None = None  # Age of the donor [years]
    age_group: Text | None = None  # Age in words, where no number is known
    side: Text | None = None  # Left or right
    thickness_mm: Positive | None = None  # Thickness of the tissue under the tip [mm]
    thickness_mm_sd: NonNegative | None = None  # Standard deviation of the thickness [mm]
    storage: Text | None = None  # Storage of the specimen until the test
    freeze_thaw_cycles: Count | None = None  # Number of times it was frozen and thawed
    hydration: Text | None = None  # Means of keeping it moist in the test
    temperature_C: float | None = None  # Temperature of the tissue in the test [degrees Celsius]
    time_post_mortem_h: NonNegative | None = None  # Hours from death or excision to the test [h]
    support: Text | None = None  # Support under the specimen, and its fixture
    site: Text | None = None  # Place on the body or organ


class Study(TissueFacts, frozen=True):
    """The study; what is said of the tissue here holds for every specimen that does not say otherwise."""

    title: Text | None = None  # Title of the study
    description: Text | None = None  # Summary of the work, in a paragraph
    authors: Annotated[tuple[Text, ...], Meta(min_length=1)] | None = None  # Names, in order
    laboratory: Text | None = None  # Place of the tests
    operator: Text | None = None  # Who ran the machine
    machine: Text | None = None  # Test machine: maker, model, serial number
    date: Text | None = None  # Day or days of the tests
    ethics: Text | None = None  # Number of the ethics approval, or why none is needed
    licence: Text | None = None  # Licence of the data: an SPDX name such as CC-BY-4.0, or an address
    doi: Text | None = None  # DOI of the data or of the publication
    only_listed: bool | None = None  # Read the files named under [[trial]] and no others
    notes: Text | None = None  # Anything else


class Tip(Document, frozen=True):
    """Tool tip."""

    shape: Literal["sphere", "flat", "cone", "other"] | None = None  # Shape of the tool tip
    radius_mm: Positive | None = None  # Radius of a sphere or of a flat punch [mm]
    #: Half of the opening angle of a cone [degrees]
    half_angle_deg: Annotated[float, Meta(gt=0, lt=90)] | None = None
    material: Text | None = None  # Material of the tip


class Tails(Document, frozen=True):
    """Gamma prior of the degrees of freedom of a t distribution, cut to 1 and above."""

    shape: Positive  # Shape
    rate: Positive  # Rate


class Population(Document, frozen=True):
    """Priors of the population that specimens are drawn from; what is missing keeps its default."""

    #: Standard deviation of the normal prior of the mean of each ln quantity around 0
    mean_sd: Positive | None = None
    #: Standard deviation of the normal prior of the effect of a group or covariate on ln quantities
    effect_sd: Positive | None = None
    #: Log-normal prior of the standard deviation of ln quantities between specimens
    between: LogNormalPrior | None = None
    level: LogNormalPrior | None = None  # The same between donors, sites or operators
    #: Shape of the LKJ distribution of the correlations; 1 is uniform
    correlation_shape: Positive | None = None
    #: Gamma prior of the degrees of freedom of a t distribution, cut to 1 and above
    tails: Tails | None = None


class Calibration(Document, frozen=True):
    """Force and displacement channels, machine frame."""

    RULES: ClassVar[JsonSchema] = {
        "allOf": [{"not": {"required": ["frame", "frame_stiffness_N_per_mm"]}}],
        "dependentRequired": {
            "frame_stiffness_N_per_mm_sd": ["frame_stiffness_N_per_mm"],
            "force_filter_s_sd": ["force_filter_s"],
            "skew_s_sd": ["skew_s"],
        },
    }

    load_cell_capacity_N: Positive | None = None  # Capacity of the load cell [N]
    #: Class of the force measuring system by ISO 7500-1: 0.5, 1, 2 or 3
    load_cell_class: Positive | None = None
    verified_from_N: Positive | None = None  # Lower limit of the verified force range [N]
    #: Class of the displacement measuring system by ISO 9513: 0.2, 0.5, 1 or 2
    displacement_class: Positive | None = None
    displacement_resolution_mm: Positive | None = None  # Smallest step of the logged displacement [mm]
    sampling_Hz: Positive | None = None  # Sampling rate [Hz]
    force_filter_s: NonNegative | None = None  # Time constant of the force channel's low-pass [s]; 0 for none
    force_filter_s_sd: NonNegative | None = None  # Its standard deviation [s]
    skew_s: float | None = None  # Delay of the logged force behind the displacement [s]
    skew_s_sd: NonNegative | None = None  # Its standard deviation [s]
    frame: Text | None = None  # File written by `tissueid calibrate-frame`, relative to this one
    #: Stiffness of machine, load cell and fixture in series with the specimen [N/mm]
    frame_stiffness_N_per_mm: Positive | None = None
    frame_stiffness_N_per_mm_sd: NonNegative | None = None  # Its standard deviation [N/mm]


class Model(Document, frozen=True):
    """Contact model of every specimen, where the command names none, or candidates: the best is taken."""

    #: As tissueid fit --model takes it: kelvin-voigt, auto, or STATIC * [STIFFNESS *] RELAXATION
    name: str | None = None
    candidates: Annotated[tuple[str, ...], Meta(min_length=1)] | None = None  # Names to choose among


class Specimen(TissueFacts, frozen=True, kw_only=True):
    """Specimen."""

    name: Text  # Name
    notes: Text | None = None  # Anything else


class Protocol(Document, frozen=True):
    """Test protocol."""

    name: Text  # Name that [[trial]] refers to
    kind: Text | None = None  # Kind of test, such as ramp, ramp-hold or cyclic
    speed_mm_s: Positive | None = None  # Loading speed [mm/s]
    depth_mm: Positive | None = None  # Depth the machine was told to go to [mm]
    hold_s: NonNegative | None = None  # Length of the hold [s]
    cycles: Count | None = None  # Loading cycles before or in the test
    preload_N: NonNegative | None = None  # Force at which the test was started [N]
    notes: Text | None = None  # Anything else


class Trial(Document, frozen=True):
    """Recording."""

    file: Text  # Path or glob, relative to the folder of this file
    sheet: Text | None = None  # Sheet of a workbook or block of a file; all of them where it is missing
    #: Specimen, by its name under [[specimen]]; trials of one specimen are fitted together
    specimen: Text | None = None
    site: Text | None = None  # Place on the specimen that was tested
    protocol: Text | None = None  # Protocol, by its name under [[protocol]]
    run: PositiveCount | None = None  # Place of the trial in the order of testing, from 1
    rest_s: NonNegative | None = None  # Rest since the trial before on this specimen [s]
    notes: Text | None = None  # Anything else


class OfChannels(Document, frozen=True):
    """Word for each channel."""

    time: Text | None = None
    displacement: Text | None = None
    force: Text | None = None


class Override(Document, frozen=True):
    """Decisions of one recording, and the reason."""

    RULES: ClassVar[JsonSchema] = {"dependentRequired": {"contact_sd_mm": ["contact_mm"]}}

    file: Text  # Path or glob, relative to the folder of this file
    because: Text  # Why; printed wherever the decision shows
    sheet: Text | None = None  # Sheet of a workbook or block of a file; all of them where it is missing
    contact_mm: float | None = None  # Displacement at contact as recorded [mm]
    contact_sd_mm: NonNegative | None = None  # Its standard deviation [mm]
    #: Direction of the recorded displacement that is compression
    compression: Literal["positive", "negative"] | None = None
    force: Literal["positive", "negative"] | None = None  # Sign of the recorded force under compression
    minimum_hold_s: NonNegative | None = None  # Shortest standstill after a ramp that counts as a hold [s]
    start_s: float | None = None  # First time that counts, as recorded [s]
    hold_from_s: float | None = None  # Begin of the hold nearest to it, as recorded [s]
    end_s: float | None = None  # Last time that counts, as recorded [s]
    rupture: bool | None = None  # false: no force drop of this recording is a rupture
    columns: OfChannels | None = None  # Column of each quantity, by name or "#2"
    units: OfChannels | None = None  # Units in place of the file's
    axes: OfChannels | None = None  # Content of a channel that is not mm or N, such as strain or stress


class Exclude(Document, frozen=True):
    """Recording to leave out, and the reason."""

    file: Text  # Path or glob, relative to the folder of this file
    because: Text  # Why; printed beside the numbers with and without the trial
    sheet: Text | None = None  # Sheet of a workbook or block of a file; all of them where it is missing


class StudyFile(Document, frozen=True):
    """Study manifest."""

    schema: Literal["tissueid/study/1"]
    study: Study | None = None
    calibration: Calibration | None = None
    priors: Priors | None = None
    model: Model | None = None
    population: Population | None = None
    tip: Tip | None = None
    specimen: tuple[Specimen, ...] | None = None  # Specimens
    protocol: tuple[Protocol, ...] | None = None  # Programs of the machine
    trial: tuple[Trial, ...] | None = None  # Recordings and what the files do not say
    override: tuple[Override, ...] | None = None  # Decisions of the user in place of the data's
    exclude: tuple[Exclude, ...] | None = None  # Recordings that are not fitted


class Missing(Document, frozen=True):
    """Keys that are missing."""

    table: Literal["study", "calibration", "tip", "specimen", "trial"]
    keys: Annotated[tuple[str, ...], Meta(min_length=1)]  # Any one of them will do
    weight: Literal[1, 2, 3]  # 3: essential; 2: a reviewer asks for it; 1: it helps
    why: str
    where: tuple[str, ...]  # Specimens or trials without it; empty where none has it


class StudyCheck(Document, frozen=True):
    """Completeness of a study file."""

    schema: Literal["tissueid/study-check/1"]
    path: str  # study.toml as it was named
    grade: Literal["A", "B", "C", "D", "E", "F"]
    share: Fraction  # Share of the weights that is stated
    missing: tuple[Missing, ...]  # Facts that are not stated, the weightiest first
    unmatched: tuple[Refusal, ...]
