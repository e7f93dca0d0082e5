"""Files written and read in one line each, and logs whose digits on paper are known."""

import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import openpyxl

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each
from tissueid.synth import SyntheticLog
from tissueid.synth.machines import GRAM_FORCE_N
from tissueid.trial import Trial

#: Time, travel and force of thirty samples, as cells of a table.
ROWS = "".join(f"{k / 10:.1f},{k * 0.05:.3f},{1 + k * 0.25:.3f}\n" for k in range(30))
SPEED_MM_S, DEPTH_MM, HOLD_S = 0.5, 8.25, 60.0


def put(path: Path, content: str | bytes, encoding: str = "utf-8") -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def written(path: Path, head: str, rows: str = ROWS) -> Path:
    return put(path, f"{head}\n{rows}")


def zipped(parts: Mapping[str, bytes | str]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return out.getvalue()


def workbook(path: Path, sheets: dict[str, Iterable[Sequence[object]]]) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def read(path: Path, options: ReadOptions | None = None) -> Trial:
    """The one trial of a file."""
    (item,) = read_each(path, options)
    assert isinstance(item, Trial), item
    return item


def refusal(path: Path, options: ReadOptions | None = None) -> InputError:
    """The one refusal of a file."""
    (item,) = read_each(path, options)
    assert isinstance(item, InputError)
    return item


def codes(trial: Trial) -> list[str]:
    return [flag.code for flag in trial.flags]


def log_of(count: int, *, name: str = "hold-1", start_s: float = 990.0) -> SyntheticLog:
    """Past a thousand seconds and newtons, compression negative, offsets, a peak inside."""
    i = np.arange(count)
    grain = 3.7e-9 * (i % 7)  # seen where more than five decimals are printed
    force = 4.319 - 31.25 * np.minimum(i, 2 * count // 3) + 3.125 * np.maximum(i - 2 * count // 3, 0)
    return SyntheticLog(
        name, "22L.3", start_s + 0.25 * i, -2.04726 - 0.01 * i + grain, force + grain, force,
        {"speed_mm_s": SPEED_MM_S, "depth_mm": DEPTH_MM, "hold_s": HOLD_S},
    )  # fmt: skip


#: What turns newtons into what is printed, decimals beyond five, and back to newtons.
PRINTED = {"mach-1": (1 / GRAM_FORCE_N, 0, GRAM_FORCE_N), "mts-793-de": (1e-3, 3, 1e3)}


def expected(name: str, log: SyntheticLog) -> list[list[float]]:
    """Time, displacement and force as the digits on paper say."""
    time = [float(f"{v:.5f}") for v in log.time_s.tolist()]
    if name.startswith("chiaro"):
        small = (log.displacement_mm, log.force_N)
        return [time, *([float(f"{1e6 * v:.6f}") * 1e-6 for v in one.tolist()] for one in small)]
    factor, more, back = PRINTED.get(name, (1.0, 0, 1.0))
    travel = [float(f"{v:.5f}") for v in log.displacement_mm.tolist()]
    if factor == GRAM_FORCE_N**-1:
        return [time, travel, [float(f"{v / GRAM_FORCE_N:.5f}") * back for v in log.force_N.tolist()]]
    return [time, travel, [float(f"{v * factor:.{5 + more}f}") * back for v in log.force_N.tolist()]]


def assert_equal(trial: Trial, name: str, log: SyntheticLog) -> None:
    """Count, first, last, peak and all between: bit for bit but for one rounding of a unit's factor."""
    channels = (trial.time_s, trial.displacement_mm, trial.force_N)
    assert trial.time_s.size == log.time_s.size
    for recorded, wanted in zip(channels, expected(name, log), strict=True):
        # parse, factor of the unit, product: one rounding each, twice
        inexact = name in PRINTED or name.startswith("chiaro")
        np.testing.assert_allclose(recorded, wanted, rtol=6e-16 if inexact else 0.0, atol=0.0)
