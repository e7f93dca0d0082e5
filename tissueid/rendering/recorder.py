"""Records of a session: every tick of the ring to a file that a killed process leaves whole, and a summary.

A failure to write, a full disk included, stops the recording and nothing else; what was recorded is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, RecordArray
from tissueid.errors import refuse
from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import FAULT_WORDS, Fault, Lamp, State
from tissueid.rendering.servo import DEGRADED_SHARE
from tissueid.store.session_log import convert_session_log, raw_head

#: Added to the log's name while the session runs.
PART_SUFFIX = ".part"


class Recorder:
    """Writes ``<log>.part``, which becomes ``<log>`` (HDF5) at the end; UsageError where it may not."""

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        self.path = path
        self.part = path.parent / (path.name + PART_SUFFIX)
        #: Records written.
        self.written = 0
        #: Why the recording ended before the session; None while it runs.
        self.stopped: str | None = None
        if path.exists():
            refuse(f"{path}: exists already; recordings are not overwritten, choose another name")
        try:
            # no buffer: what was written survives this process
            self._stream = self.part.open("xb", buffering=0)
        except FileExistsError:
            refuse(
                f"{self.part}: left by a session that was killed; read it with `tissueid inspect "
                f"{self.part}`, then move it away"
            )
        except OSError as error:
            refuse(f"{self.part}: can't be written ({error.strerror}); choose another place")
        if not self._write(raw_head(head, RECORD)):
            self._close()
            self.part.unlink(missing_ok=True)
            refuse(f"{self.stopped}; choose another place for the log")

    def append(self, records: NDArray[Any]) -> None:
        """Append records; after a failure to write nothing more is tried."""
        if self.stopped is None and records.size and self._write(np.ascontiguousarray(records).tobytes()):
            self.written += records.size

    def finish(self, summary: Mapping[str, Any]) -> Path:
        """Close the log and turn it into HDF5; where there was no room for it the part stays."""
        self._close()
        try:
            convert_session_log(self.part, self.path, {**summary, "recording_stopped": self.stopped})
        except OSError as error:
            self.stopped = self.stopped or f"the log could not be finished: {error.strerror or error}"
            return self.part
        self.part.unlink(missing_ok=True)
        return self.path

    def _write(self, data: bytes) -> bool:
        view = memoryview(data)
        try:
            while view:
                view = view[self._stream.write(view) :]
        except OSError as error:
            self.stopped = f"{self.part}: {error.strerror or error}"
            return False
        return True

    def _close(self) -> None:
        try:
            self._stream.close()
        except OSError as error:
            self.stopped = self.stopped or f"{self.part}: {error.strerror or error}"


#: A tick off by more than this share of the period is off.
OFF_SHARE = 0.10
S_TO_US = 1e6


def period_statistics(error_s: FloatArray) -> dict[str, float]:
    """Median, p99, p99.9 and largest of absolute period errors [us]; zeros where there are none."""
    found = np.quantile(error_s, [0.5, 0.99, 0.999, 1.0]) * S_TO_US if error_s.size else np.zeros(4)
    return dict(zip(("median", "p99", "p99_9", "max"), found.tolist(), strict=True))


class SessionSummary:
    """Counts over all records of a session."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._errors: list[NDArray[np.float32]] = []
        self._lit = {lamp: 0 for lamp in Lamp if lamp}
        #: Records counted.
        self.ticks = 0
        self._touched = self._lost = self._switches = self._missed = 0
        self._first_s = self._last_s = 0.0
        self._label: int | None = None
        self._peak_N = self._peak_tissue_N = self._energy_J = 0.0
        self._deepest_mm = -np.inf
        #: State and fault of the newest record.
        self.state = State.CLOSED
        self.fault = Fault.NONE

    @property
    def seconds(self) -> float:
        """Time from the first record to the newest [s]."""
        return self._last_s - self._first_s

    def add(self, records: RecordArray, lost: int = 0) -> None:
        """Count new records, and those that were overwritten before they could be read."""
        self._lost += lost
        if not records.size:
            return
        if not self.ticks:
            self._first_s = float(records["time_s"][0])
        self.ticks += records.size
        self._last_s = float(records["time_s"][-1])
        self._errors.append(np.abs(records["dt_s"] - self._period_s).astype(np.float32))
        for lamp in self._lit:
            self._lit[lamp] += int(np.count_nonzero(records["lamps"] & int(lamp)))
        engaged = records[records["state"] == State.ENGAGED]
        self._touched += int(np.count_nonzero(engaged["depth_mm"] > 0.0))
        self._peak_N = max(self._peak_N, float(np.linalg.norm(records["force_N"], axis=1).max()))
        self._peak_tissue_N = max(self._peak_tissue_N, float(records["tissue_force_N"].max()))
        self._deepest_mm = max(self._deepest_mm, float(records["depth_mm"].max()))
        self._energy_J = float(records["energy_J"][-1])
        self._missed = int(records["missed"][-1])
        labels = records["label"]
        before = int(labels[0]) if self._label is None else self._label
        self._switches += int(np.count_nonzero(np.diff(np.concatenate([[before], labels.astype(np.int64)]))))
        self._label = int(labels[-1])
        self.state, self.fault = State(int(records["state"][-1])), Fault(int(records["fault"][-1]))

    def as_json(self, *, scheduling: str, virtual_time: bool) -> dict[str, Any]:
        """The summary of ``schemas/session.schema.json``, ``recording_stopped`` left open."""
        errors = np.concatenate(self._errors).astype(np.float64) if self._errors else np.zeros(0)
        off = float(np.mean(errors > OFF_SHARE * self._period_s)) if errors.size else 0.0
        ticks = max(self.ticks, 1)
        return {
            "ticks": self.ticks,
            "seconds": self.seconds,
            "skipped_ticks": self._missed,
            "lost_records": self._lost,
            "period_us": period_statistics(np.zeros(0) if virtual_time else errors),
            "timing_degraded": bool(not virtual_time and off > DEGRADED_SHARE),
            "scheduling": scheduling,
            "shares": {str(lamp.name).lower(): count / ticks for lamp, count in self._lit.items()},
            "contact_share": self._touched / ticks,
            "peak_device_force_N": self._peak_N,
            "peak_tissue_force_N": self._peak_tissue_N,
            "deepest_mm": float(self._deepest_mm) if np.isfinite(self._deepest_mm) else 0.0,
            "energy_J": self._energy_J,
            "switches": self._switches,
            "end_state": self.state.name.lower(),
            "fault": FAULT_WORDS[self.fault],
            "recording_stopped": None,
        }
