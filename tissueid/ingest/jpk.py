"""Recipe for JPK force curves: ``.jpk-force`` of one curve, ``.jpk-force-map`` and the like of many.

A zip archive of Java property files and arrays of big-endian numbers::

    shared-data/header.properties
    segments/0/segment-header.properties
    segments/0/channels/vDeflection.dat

A map has ``index/0/segments`` for each curve.  ``channel.C.lcd-info.*=3`` stands for all that is said of
``lcd-info.3`` in the shared header.  A number is scaled by the encoder, then from slot to slot (volts,
distance, force).  The layout is as public readers describe it (afmformats, gwyddion).
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.delimited import read_delimited
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Recipe, Table, packed_kind
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES
from tissueid.ingest.unpacking import BROKEN_ARCHIVE, UNPACKED_BYTES
from tissueid.trial import Protocol

_TYPES = {
    "signedshort": ">i2", "unsignedshort": ">u2", "signedinteger": ">i4", "unsignedinteger": ">u4",
    "signedlong": ">i8", "float": ">f4", "double": ">f8",
}  # fmt: skip
#: Measured heights before that of the piezo's voltage, each with the slots that are in metres.
_HEIGHTS = ("measuredHeight", "capacitiveSensorHeight", "strainGaugeHeight", "height", "head-height")
_HEIGHT_SLOTS = ("nominal", "absolute", "calibrated")
_DEFLECTION = "vDeflection"
_SEGMENT = re.compile(r"((?:index/(\d+)/)?segments/(\d+)/)segment-header\.properties")
_M_TO_MM = 1000.0
#: Bending below this share of the travel is not worth a remark.
_BENDING_SAID = 0.005

Properties = Mapping[str, str]


def detect_jpk(file: InputFile) -> Detection:
    """A zip archive with the header and segments of force curves."""
    if packed_kind(file.data) == "force curves":
        return 1.0, "a zip archive with header.properties and segments of force curves"
    return NOT_MINE


def _properties(data: bytes) -> dict[str, str]:
    entries = {}
    for line in data.decode("latin-1").splitlines():
        key, mark, value = line.partition("=")
        if mark and not line.startswith(("#", "!")):
            entries[key.strip()] = value.strip().replace("\\:", ":")
    return entries


@dataclass(frozen=True, slots=True)
class _Segment:
    """One move or pause: its header with the shared one put in, and where its channels are."""

    folder: str
    said: Properties

    def number(self, key: str, place: Place) -> float:
        try:
            return float(self.said[key])
        except (KeyError, ValueError):
            _lacking(place, self.folder, key)

    def found(self, *keys: str) -> str:
        """The first of the keys that is there; the last, to be refused by name, where none is."""
        return next((key for key in keys if key in self.said), keys[-1])


def _lacking(place: Place, folder: str, what: str) -> NoReturn:
    message = f"{folder or 'the archive'} holds no {what}: give the file as the microscope saved it"
    place.refuse("unreadable_archive", message)


def read_jpk(file: InputFile) -> Iterator[Table | InputError]:
    """Every curve of the archive."""
    place = Place(file.path)
    try:
        with zipfile.ZipFile(io.BytesIO(file.data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > UNPACKED_BYTES:
                place.refuse(
                    "unreadable_archive",
                    f"the curves unpack to more than {UNPACKED_BYTES / 2**20:.0f} MiB; export fewer a file",
                )
            curves: dict[str, list[str]] = {}
            for name in archive.namelist():
                match = _SEGMENT.fullmatch(name)
                if match is not None:
                    curves.setdefault(match[2] or "", []).append(match[1])
            for curve in sorted(curves, key=lambda index: int(index or 0)):
                folders = sorted(curves[curve], key=lambda folder: int(folder.rstrip("/").rpartition("/")[2]))
                try:
                    yield _curve(archive, folders, Place(file.path, curve or None))
                except InputError as error:
                    yield error
    except BROKEN_ARCHIVE as error:
        place.refuse("unreadable_archive", f"the archive is damaged ({str(error)[:120]}); copy it again")


def _segments(archive: zipfile.ZipFile, folders: list[str]) -> list[_Segment]:
    names = set(archive.namelist())
    shared_file = "shared-data/header.properties"
    shared = _properties(archive.read(shared_file)) if shared_file in names else {}
    segments = []
    for folder in folders:
        said = _properties(archive.read(folder + "segment-header.properties"))
        for key, number in list(said.items()):
            if key.endswith(".*"):
                head, _, kind = key[:-2].rpartition(".")
                start = f"{kind}.{number}."
                said |= {
                    f"{head}.{name[len(start) :]}": value
                    for name, value in shared.items()
                    if name.startswith(start)
                }
        segments.append(_Segment(folder, said))
    return segments


def _curve(archive: zipfile.ZipFile, folders: list[str], place: Place) -> Table:
    segments = _segments(archive, folders)
    names = set(archive.namelist())
    height = next(
        (one for one in _HEIGHTS if all(f"{s.folder}channels/{one}.dat" in names for s in segments)), None
    )
    if height is None:
        place.refuse("no_columns", f"no height is in every segment: one of {', '.join(_HEIGHTS)} is needed")
    start, parts = 0.0, []
    for segment in segments:
        travel = _channel(archive, segment, height, _HEIGHT_SLOTS, place)
        force = _channel(archive, segment, _DEFLECTION, ("force",), place)
        if force.size != travel.size or travel.size == 0:
            _lacking(place, segment.folder, "pair of height and deflection of one length")
        duration = segment.number(
            segment.found(
                "force-segment-header.duration", "force-segment-header.settings.segment-settings.duration"
            ),
            place,
        )
        parts.append((start + duration * np.arange(travel.size) / travel.size, travel, force))
        start += duration
    time_s, travel, force = (np.concatenate(part) for part in zip(*parts, strict=True))
    stiffness = segments[0].said.get(
        f"channel.{_DEFLECTION}.conversion-set.conversion.force.scaling.multiplier"
    )
    if time_s.size < 2 or (np.diff(time_s) < 0.0).any() or not np.isfinite(travel + force).all():
        place.refuse(
            "not_finite", "the curve's numbers are not finite, or its time falls; copy the file again"
        )
    return Table(
        time_s=time_s,
        displacement_mm=travel * _M_TO_MM,
        force_N=force,
        columns={"time": "duration", "displacement": height, "force": f"{_DEFLECTION} (force)"},
        sheet=place.sheet,
        metadata={} if stiffness is None else {"Spring constant (N/m)": stiffness},
        flags=_bending(travel, force, stiffness),
        protocol=Protocol(kind="afm"),
    )


def _channel(
    archive: zipfile.ZipFile, segment: _Segment, name: str, slots: tuple[str, ...], place: Place
) -> FloatArray:
    """One channel of one segment in its calibrated unit, m or N."""
    head = f"channel.{name}"
    kind = segment.said.get(
        segment.found(
            f"{head}.data.encoder.type", f"{head}.encoder.type", f"{head}.data.type", f"{head}.type"
        ),
        "",
    )
    kind = kind.removesuffix("-limited").removesuffix("-data").removeprefix("memory-")
    try:
        raw = archive.read(f"{segment.folder}channels/{name}.dat")
        values = np.frombuffer(raw, dtype=_TYPES[kind]).astype(np.float64)
    except KeyError:
        _lacking(place, segment.folder, f"channel {name} in a known type ({kind})")
    encoders = [f"{head}.data.encoder.scaling", f"{head}.encoder.scaling"]
    encoder = next((one for one in encoders if f"{one}.multiplier" in segment.said), None)
    if encoder is not None:
        values = segment.number(f"{encoder}.multiplier", place) * values
        values += segment.number(f"{encoder}.offset", place)
    conversions = f"{head}.conversion-set.conversion"
    slot = next((one for one in slots if f"{conversions}.{one}.scaling.multiplier" in segment.said), None)
    if slot is None:
        _lacking(place, segment.folder, f"calibration of {name} in {' or '.join(slots)}: calibrate it first")
    base = segment.said.get(f"{head}.conversion-set.conversions.base", "volts")
    steps: list[str] = []
    while slot != base and slot not in steps:
        steps.append(slot)
        slot = segment.said.get(f"{conversions}.{slot}.base-calibration-slot", base)
    for one in reversed(steps):
        scaling = f"{conversions}.{one}.scaling"
        values = segment.number(f"{scaling}.multiplier", place) * values
        values += segment.number(f"{scaling}.offset", place)
    return values


def _bending(travel: FloatArray, force: FloatArray, stiffness: str | None) -> tuple[Flag, ...]:
    """The travel is that of the cantilever's root: the tip lags by its bending."""
    try:
        newton_per_m = float(stiffness or "nan")
    except ValueError:
        return ()
    bent = float(np.ptp(force)) / newton_per_m if newton_per_m > 0.0 else 0.0
    if not bent > _BENDING_SAID * float(np.ptp(travel)):
        return ()
    per_mm = newton_per_m / _M_TO_MM
    message = (
        f"the cantilever of {per_mm:.3g} N/mm bends by {1e3 * _M_TO_MM * bent:.3g} um of"
        f" {1e3 * _M_TO_MM * float(np.ptp(travel)):.3g} um of travel"
    )
    values = {"stiffness_N_per_mm": per_mm, "bending_mm": bent * _M_TO_MM}
    return (Flag("cantilever_bending", message, values),)


JPK_FORCE = Recipe("jpk-force", "JPK force curves, one trial a curve", detect_jpk, read_jpk)

# The same as text: "# columns: vDeflection height seriesTime" and "# units: N m s" above rows parted by
# spaces, a head a segment.
_SAID = re.compile(rb"^# ?(columns|units|springConstant): (.*?)\r?$", re.MULTILINE)
_TIMES = ("seriesTime", "segmentTime", "time")
_TIP = ("verticalTipPosition", "tipSampleSeparation")


def _said(file: InputFile) -> dict[str, list[str]]:
    """Words of the first head behind each key."""
    text = file.text
    found = [] if text is None else _SAID.findall(text.data[:HEAD_BYTES])
    return {key.decode(): text.decode(words).split() for key, words in reversed(found)} if text else {}


def detect_jpk_text(file: InputFile) -> Detection:
    """Columns named in a remark, the deflection of a cantilever among them."""
    if file.layout is not None and _DEFLECTION in _said(file).get("columns", ()):
        return 0.97, f"a remark names the columns, {_DEFLECTION} among them"
    return NOT_MINE


def read_jpk_text(file: InputFile) -> Iterator[Table | InputError]:
    """The one curve of the file: the tip where it is given, else the height, whose cantilever bends."""
    said, (_, layout) = _said(file), file.laid_out()
    names, units = (tuple(said.get(key, ())) for key in ("columns", "units"))
    if len(names) != layout.n_columns or len(units) not in (0, len(names)):
        message = f"'# columns:' names {len(names)}, the rows have {layout.n_columns}; export it again"
        Place(file.path).refuse("ragged_rows", message, line=layout.first_line)
    heights = [name for name in names if name.lower().endswith("height")]
    wanted = {
        "time": next((name for name in _TIMES if name in names), _TIMES[0]),
        "displacement": next((name for name in (*_TIP, *heights) if name in names), _TIP[0]),
        "force": _DEFLECTION,
    }
    options = replace(file.options, columns=wanted | dict(file.options.columns))
    named = replace(layout, names=names, units=units or ("",) * len(names), units_in_row=bool(units))
    for item in read_delimited(replace(file, layout=named, options=options)):
        if isinstance(item, InputError):
            yield item
            continue
        bent = item.columns["displacement"].startswith(tuple(heights))
        stiffness = next(iter(said.get("springConstant", ())), None) if bent else None
        bending = _bending(item.displacement_mm / _M_TO_MM, item.force_N, stiffness)
        yield replace(item, flags=(*item.flags, *bending), protocol=Protocol(kind="afm"))


JPK_TEXT = Recipe("jpk-text", "JPK force curves as text", detect_jpk_text, read_jpk_text)
