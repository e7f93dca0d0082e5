"""Recipe for the log of a rendered session: the tissue that a hand felt, with the scales undone.

The recording is made from the device's side alone (displacement = penetration / s_x, force = |F_device| /
s_F) and must agree with the tissue's side wherever no limit interfered, else it is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray, RecordArray
from tissueid.errors import BundleError, InputError
from tissueid.flags import Flag
from tissueid.haptics.states import Lamp, State
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.store.session_log import SessionLog, is_session_log, read_session_log
from tissueid.trial import RENDERED, Protocol

#: Lamps of ticks in which the whole force is taken up or away.
_RAMPED = Lamp.DEAD_MAN | Lamp.RAMPING
#: The same, and those of a device that did not answer, or late, whose force is lowered.
_LOWERED = _RAMPED | Lamp.SILENT | Lamp.LATENCY
_SHAPED = Lamp.CLIPPED | Lamp.SLEWED | Lamp.PASSIVITY | Lamp.STALLED | Lamp.RMS_LIMITED
#: Lamps of ticks in which the device's force is not the tissue's.
_INTERFERED = _LOWERED | _SHAPED | Lamp.RUPTURED
_LAMP_WORDS = {
    Lamp.CLIPPED: "clipped",
    Lamp.SLEWED: "slewed",
    Lamp.STALLED: "stalled",
    Lamp.RAMPING: "ramping",
    Lamp.PASSIVITY: "corrected by the passivity controller",
    Lamp.OUTSIDE_DEPTH: "deeper than identified",
    Lamp.OUTSIDE_SPEED: "faster than identified",
    Lamp.RUPTURED: "ruptured",
    Lamp.SILENT: "silent",
    Lamp.LATENCY: "late",
}
#: Disagreement of the two sides that is rounding: of the largest force, and of the depth [mm].
_FORCE_TOLERANCE = 1e-6
_DEPTH_TOLERANCE_MM = 1e-6
#: Ticks needed to judge a scale.
_FEWEST_TICKS = 20
_PLANE, _SPHERE = 0, 1
_M_TO_MM = 1000.0


def detect_session(file: InputFile) -> Detection:
    """The first bytes of a raw log, or an HDF5 file that says what it is."""
    said = "the file says that it is the log of a rendered session"
    return (1.0, said) if is_session_log(file.data) else NOT_MINE


def read_session(file: InputFile) -> Iterator[Table | InputError]:
    """One recording for every stretch in which one tissue was rendered."""
    place = Place(file.path)
    try:
        log = read_session_log(file.data, where=file.path)
    except BundleError as error:
        place.refuse("damaged_log", error.message.removeprefix(f"{file.path}: "))
    stretches = list(_stretches(log.records))
    if not stretches:
        place.refuse("no_rows", "the device was never engaged in this session: nothing was felt")
    for number, stretch in enumerate(stretches, 1):
        sheet = None if len(stretches) == 1 else str(number)
        try:
            yield _table(log, stretch, Place(file.path, sheet))
        except InputError as error:
            yield error


def _stretches(records: RecordArray) -> Iterator[RecordArray]:
    """Runs of engaged ticks with one tissue, without the ramps of force at their ends."""
    # the only state in which a force is felt
    engaged = records[records["state"] == State.ENGAGED]
    breaks = np.flatnonzero(np.diff(engaged["label"].astype(np.int64))) + 1
    for part in np.split(engaged, breaks):
        ramping = (part["lamps"] & _RAMPED) != 0
        # a ramp in air, before a force, is air all the same
        felt = np.flatnonzero(~ramping | (part["force_N"] == 0.0).all(axis=1) & (part["depth_mm"] < 0.0))
        if felt.size > 1:
            yield part[felt[0] : felt[-1] + 1]


def _table(log: SessionLog, records: RecordArray, place: Place) -> Table:
    scale = log.head["scale"]
    if scale is None:
        place.refuse(
            "no_columns", "the session rendered a force law of its own: there is no tissue to identify"
        )
    force = np.linalg.norm(records["force_N"], axis=1) / scale["force_scale"]
    # the length of a vector that was cut to the device's limit is that limit but for rounding
    limit = ((records["lamps"] & Lamp.CLIPPED) != 0) & np.isclose(force, force.max(), rtol=1e-12, atol=0.0)
    force[limit] = force.max()
    depth = _depth(log.head["surface"], records["position_m"], scale["motion_scale"])
    _agree(records, force, depth, place)
    tissue = next(entry for entry in log.head["tissues"] if entry["label"] == int(records["label"][0]))
    # a pause of the force in contact is no answer of the tissue
    felt = ((records["lamps"] & _LOWERED) == 0) | (records["depth_mm"] <= 0.0)
    if np.count_nonzero(felt) < 2:
        place.refuse("no_rows", "the device was silent or late all the time in contact: nothing was felt")
    return Table(
        time_s=(records["time_s"] - records["time_s"][0])[felt],
        displacement_mm=(records["depth_mm"] if depth is None else depth)[felt],
        force_N=force[felt],
        columns={"time": "time_s", "displacement": "position_m", "force": "force_N"},
        sheet=place.sheet,
        metadata=_metadata(log.head),
        specimen=tissue["name"],
        flags=(_rendered(records, tissue["name"]),),
        protocol=Protocol(kind=RENDERED, tip_radius_mm=tissue["tip_radius_mm"]),
    )


def _depth(surface: list[float], position: FloatArray, motion_scale: float) -> FloatArray | None:
    """Depth [mm of tissue] from the device's position, ``None`` behind the faces of a box."""
    point, normal, radius = np.array(surface[1:4]), np.array(surface[4:7]), surface[10]
    if surface[0] == _PLANE:
        distance = (position - point) @ normal
    elif surface[0] == _SPHERE:
        distance = np.linalg.norm(position - point, axis=1) - surface[7]
    else:
        return None
    return np.asarray((radius - distance) / motion_scale * _M_TO_MM)


def _agree(records: RecordArray, force: FloatArray, depth: FloatArray | None, place: Place) -> None:
    """Refuse a log whose device side and tissue side do not belong to one scale."""
    free = (records["lamps"] & _INTERFERED) == 0
    wanted = records["tissue_force_N"]
    largest = float(max(np.abs(wanted).max(), force.max()))
    if np.count_nonzero(free & (wanted > 0.0)) >= _FEWEST_TICKS:
        off = float(np.abs(force - wanted)[free].max())
        if off > _FORCE_TOLERANCE * largest:
            _wrong_scale("force", "N", off, place)
    if depth is not None:
        off = float(np.abs(depth - records["depth_mm"]).max())
        if off > max(_DEPTH_TOLERANCE_MM, _FORCE_TOLERANCE * float(np.ptp(depth))):
            _wrong_scale("motion", "mm", off, place)


def _wrong_scale(which: str, unit: str, off: float, place: Place) -> None:
    place.refuse(
        "wrong_scale",
        f"the {which} scale that the log states does not lead from the device's side to the tissue's: they "
        f"differ by up to {off:.3g} {unit}; the scale was changed after the session, record it again",
    )


def _metadata(head: Mapping[str, Any]) -> dict[str, str]:
    scale, device = head["scale"], head["device"]
    return {
        "device": str(device["name"]),
        "force scale": f"{scale['force_scale']:.6g}",
        "motion scale": f"{scale['motion_scale']:.6g}",
        "started": str(head["started"]),
    }


def _rendered(records: RecordArray, name: str) -> Flag:
    shares = {word: float(np.mean((records["lamps"] & bit) != 0)) for bit, word in _LAMP_WORDS.items()}
    return Flag(
        "rendered",
        f"this is the force law of {name!r} as rendered, no measurement of tissue",
        {"specimen": name, **{f"{word.split()[0]}_share": share for word, share in shares.items()}},
    )


SESSION_LOG = Recipe(
    "session-log",
    "log of `tissueid render` (HDF5, or .part of a killed session)",
    detect_session,
    read_session,
)
