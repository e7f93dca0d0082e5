"""Files made to break a reader: bombs, junk, endless lines; and a child with limits that reads them."""

import io
import json
import os
import random
import struct
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ingest_files import zipped

REPOSITORY = Path(__file__).resolve().parents[2]
HEAD = b"Time,Extension,Load\n(s),(mm),(N)\n"
MEBI = 1 << 20

_TYPES = "http://schemas.openxmlformats.org/package/2006/content-types"
_RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"


@dataclass(frozen=True)
class Verdict:
    """The fate of one file in the child: codes of its items, seconds, and memory so far."""

    codes: tuple[str, ...]
    messages: tuple[str, ...]
    seconds: float
    peak_bytes: int


_CHILD = """
import json, pathlib, re, resource, sys, time
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
from tissueid.errors import InputError
from tissueid.ingest import read_each

def peak_bytes():
    # ru_maxrss begins with what the parent had when it made this process; VmHWM is of this program alone
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\\s*(\\d+) kB", status.read_text())[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

for path in sys.argv[2:]:
    start = time.perf_counter()
    items = list(read_each(path))
    codes = [item.code if isinstance(item, InputError) else "read" for item in items]
    said = [str(item) if isinstance(item, InputError) else "" for item in items]
    peak = peak_bytes()
    print(json.dumps([path, codes, said, time.perf_counter() - start, peak]), flush=True)
"""


def read_in_child(paths: Iterable[Path], *, memory_bytes: int, timeout_s: float) -> dict[str, Verdict]:
    """Read each path in one process that may have so much address space, and so much time for all."""
    names = [str(path) for path in paths]
    command = [sys.executable, "-c", _CHILD, str(memory_bytes), *names]
    own = {"PYTHONPATH": str(REPOSITORY), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=timeout_s, check=False, env=os.environ | own
    )
    verdicts = {}
    for line in ended.stdout.splitlines():
        path, codes, said, seconds, peak = json.loads(line)
        verdicts[path] = Verdict(tuple(codes), tuple(said), seconds, peak)
    left = [name for name in names if name not in verdicts]
    assert ended.returncode == 0, f"ended with {ended.returncode} at {left[:1]}: {ended.stderr[-2000:]}"
    return {Path(path).name: verdict for path, verdict in verdicts.items()}


def xlsx(cells: str, *, before: str = "", more: dict[str, bytes] | None = None) -> bytes:
    """The least workbook: one sheet with these rows."""
    sheet = (
        f'<?xml version="1.0"?>{before}<worksheet xmlns="{_MAIN}"><sheetData>{cells}</sheetData></worksheet>'
    )
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    parts = {
        "[Content_Types].xml": f'<?xml version="1.0"?><Types xmlns="{_TYPES}"><Default Extension="rels"'
        ' ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Override'
        f' PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/><Override'
        f' PartName="/xl/worksheets/sheet1.xml" ContentType="{kind}.worksheet+xml"/></Types>',
        "_rels/.rels": f'<?xml version="1.0"?><Relationships xmlns="{_RELATIONS}"><Relationship Id="rId1"'
        f' Type="{_OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<?xml version="1.0"?><workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>'
        '<sheet name="A" sheetId="1" r:id="rId1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<?xml version="1.0"?><Relationships xmlns="{_RELATIONS}">'
        f'<Relationship Id="rId1" Type="{_OFFICE}/worksheet" Target="worksheets/sheet1.xml"/>'
        "</Relationships>",
        "xl/worksheets/sheet1.xml": sheet,
    }
    return zipped(parts | (more or {}))


def row(number: int, *values: float) -> str:
    cells = "".join(f'<c r="{chr(65 + k)}{number}"><v>{value}</v></c>' for k, value in enumerate(values))
    return f'<row r="{number}">{cells}</row>'


def table_cells(rows: int = 30) -> str:
    names = "".join(
        f'<c r="{letter}1" t="str"><v>{name}</v></c>'
        for letter, name in zip("ABC", ("Time (s)", "Extension (mm)", "Load (N)"), strict=True)
    )
    body = "".join(row(i + 2, 0.1 * i, 0.5 * i, 2.0 * i + 0.25) for i in range(rows))
    return f'<row r="1">{names}</row>{body}'


def binary_sheet(*records: tuple[int, bytes]) -> bytes:
    """A sheet of binary records with types below 128."""
    return b"".join(bytes([kind, len(content)]) + content for kind, content in records)


def hostile_workbooks() -> dict[str, bytes]:
    laughs = "".join(f'<!ENTITY {chr(98 + i)} "{(f"&{chr(97 + i)};") * 10}">' for i in range(9))
    entity = '<row r="1"><c r="A1" t="str"><v>&j;</v></c></row>'
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
    sound = xlsx(table_cells())
    lying = bytearray(xlsx(f'<row r="1"><c r="A1" t="str"><v>{"x" * (8 * MEBI)}</v></c></row>'))
    at = lying.rfind(b"PK\x01\x02", 0, lying.rfind(b"xl/worksheets/sheet1.xml"))
    lying[at + 24 : at + 28] = struct.pack("<I", 1000)
    flipped = bytearray(sound)
    flipped[len(sound) // 2] ^= 0x55
    return {
        "laughs.xlsx": xlsx(entity, before=f'<!DOCTYPE l [<!ENTITY a "ha">{laughs}]>'),
        "outside.xlsx": xlsx(entity, before='<!DOCTYPE l [<!ENTITY j SYSTEM "file:///etc/hostname">]>'),
        "far.xlsx": xlsx(table_cells() + far),
        "far-row.xlsx": xlsx(table_cells() + '<row r="4000000000"><c r="A4000000000"><v>1</v></c></row>'),
        "far-column.xlsx": xlsx('<row r="1"><c r="ZZZZZZ1"><v>1</v></c></row>' + row(99999, 1.0)),
        "long-number.xlsx": xlsx('<row r="1"><c r="A99999999999999"><v>1</v></c></row>'),
        "deep.xlsx": xlsx("<a>" * 100_000 + "</a>" * 100_000),
        "open-rows.xlsx": xlsx("<row" * 500_000),
        "ratio.xlsx": xlsx("", more={"xl/media/a.bin": bytes(64 * MEBI)}),
        "lying.xlsx": bytes(lying),
        "half.xlsx": sound[: len(sound) // 2],
        "no-directory.xlsx": sound[:-60],
        "flipped.xlsx": bytes(flipped),
        "magic-only.xls": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + random.Random(5).randbytes(5000),
        "far.xlsb": zipped(
            {
                "xl/workbook.bin": b"",
                "xl/worksheets/sheet1.bin": binary_sheet(
                    (0, struct.pack("<I", 1048575)), (5, struct.pack("<Id", 16383, 1.0))
                ),
            }
        ),
        "sound.xlsx": sound,
    }


def hostile_archives() -> dict[str, bytes]:
    """Zip archives that are no workbooks."""
    recording = HEAD + b"".join(b"%.1f,%.2f,%.2f\n" % (0.1 * i, 0.1 * i, 0.2 * i) for i in range(50))
    sound = zipped({"a.csv": recording})
    inner = sound
    for _ in range(20):
        inner = zipped({"inner.csv": inner})
    overlapping = io.BytesIO()
    with zipfile.ZipFile(overlapping, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.csv", bytes(15 * MEBI))
        # ten thousand entries of one and the same content: kilobytes for 150 GB
        archive.filelist += archive.filelist * 9_999
    flipped = bytearray(sound)
    flipped[60] ^= 0x10
    return {
        "bomb.zip": zipped({"a.csv": bytes(200 * MEBI)}),
        "nested.zip": inner,
        "overlapping.zip": overlapping.getvalue(),
        "many.zip": zipped({f"{i}.csv": b"" for i in range(10_001)}),
        "cut.zip": sound[:-30],
        "flipped.zip": bytes(flipped),
        "outside.zip": zipped({"../../outside.csv": recording, "/etc/outside.csv": recording}),
        "sound.zip": sound,
    }


def hostile_texts() -> dict[str, bytes]:
    rng = random.Random(7)
    rows = b"".join(b"%.2f,%.3f,%.3f\n" % (0.1 * i, 0.05 * i, 0.5 * i) for i in range(400))
    late = HEAD + rows
    return {
        "junk.csv": rng.randbytes(300_000),
        "junk-after-head.csv": late + rng.randbytes(100_000),
        "nul-inside.csv": late[:3000] + bytes(64) + late[3000:],
        "nul-tail.csv": late + bytes(4096),
        "junk-late.csv": HEAD + b"0.01,1.5,2.25\n" * 9000 + rng.randbytes(100_000),
        "wide-key.csv": b"Specimen " + b"a" * 60_000 + b",x\n" + late,
        "half-row.csv": late + b"40.00,20.0",
        "wide.csv": b"Time,Extension,Load," + b"x," * 20_000 + b"\n" + (b"1.5," * 15_000 + b"2.5\n") * 40,
        "wide-name.csv": b"Time" + b" " * 30_000 + b"x,Extension (" + b"(" * 20_000 + b",Load\n" + rows,
        "quotes.csv": HEAD + b'"' * 50_000 + b"\n" + rows,
        "commas.csv": HEAD + b"," * 50_000 + b"\n" + rows,
        "nested.json.csv": b"[" * 60_000 + b"]" * 60_000,
        "many-marks.csv": HEAD + b"1" + b".1" * 30_000 + b",2,3\n" + rows,
        "many-digits.csv": HEAD + b"0." + b"1" * 60_000 + b",2,3\n" + rows,
        "big-exponent.csv": HEAD + b"1e" + b"9" * 60_000 + b",2,3\n" + rows,
        "headers-only.csv": b"Key : a,b\n" * 300_000,
        "blank-lines.csv": HEAD + b"\n" * (4 * MEBI) + rows,
        "bom-soup.csv": b"\xef\xbb\xbf\xff\xfe\xfe\xff\0\0" + late,
    }


def endless(path: Path, size: int, *, start: bytes = b"", piece: bytes = b"1234567890") -> Path:
    """A file of one line of a size, written in pieces."""
    block = piece * (MEBI // len(piece))
    with path.open("wb") as stream:
        stream.write(start)
        while stream.tell() < size:
            stream.write(block)
    return path
