"""Recipe for Shimadzu text: three head rows, several specimens side by side, ragged ends.

::

    "1_1","","","1_2","",""
    "Time","Force","Stroke","Time","Force","Stroke"
    "sec","N","mm","sec","N","mm"
    "0","0.01","0","0","0.02","0"
    "0.01","0.02","0.001","","",""

One trial a specimen; its sheet is the name above its columns.  A specimen ends where its cells are empty,
and must stay ended.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tissueid.errors import InputError
from tissueid.ingest.block import Head, SpecimenColumns, block_layout, block_text, shifted, specimen_columns
from tissueid.ingest.columns import split_name
from tissueid.ingest.delimited import read_table
from tissueid.ingest.header import header_entries
from tissueid.ingest.layout import Layout, split_line
from tissueid.ingest.recipe import Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import plain_words

_STROKE = frozenset({"stroke", "ストローク", "hub"})


def _specimens(file: InputFile) -> list[SpecimenColumns]:
    layout = file.layout
    if layout is None:
        return []
    above = layout.header[-1] if layout.header else ()
    return specimen_columns(above, layout.names, layout.units, file.options)


def detect_shimadzu(file: InputFile) -> Detection:
    """Specimens named above columns that repeat, or above one stroke."""
    layout = file.layout
    if layout is None:
        return 0.0, "no table of numbers"
    specimens = _specimens(file)
    if not specimens:
        return 0.0, "no specimen names above the columns"
    if len(specimens) > 1:
        names = ", ".join(repr(s.name) for s in specimens[:3])
        return 0.98, f"the specimens {names} stand side by side above the same columns"
    if any(plain_words(split_name(name)[0]) in _STROKE for name in layout.names):
        return 0.94, f"the specimen {specimens[0].name!r} stands above Time, Force and Stroke"
    return 0.0, "one specimen, and no stroke"


def read_shimadzu(file: InputFile) -> Iterator[Table | InputError]:
    """Every specimen."""
    text, layout, place = file.text, file.layout, Place(file.path)
    if text is None or layout is None:
        yield file.fault or place.refusal("not_an_export", "this is no text")
        return
    specimens = _specimens(file)
    named = bool(specimens) and specimens[0].is_named
    metadata = header_entries(layout.header[:-1] if named else layout.header)
    names = [specimen.name for specimen in specimens]
    for count, specimen in enumerate(specimens, 1):
        sheet = specimen.name if names.count(specimen.name) == 1 else f"{count}: {specimen.name}"
        own = Place(file.path, sheet)
        try:
            alone = _alone(text, layout, specimen, own)
            laid = block_layout(
                alone,
                Head(
                    layout.names[specimen.start : specimen.stop],
                    layout.units[specimen.start : specimen.stop],
                    layout.names_line or layout.first_line,
                    layout.first_line,
                ),
                delimiter=layout.delimiter,
                options=file.options,
                place=own,
                decimal=layout.decimal,
            )
            yield read_table(alone, laid, file.options, own, metadata=metadata)
        except InputError as error:
            yield shifted(error, specimen.start)


def _alone(text: Text, layout: Layout, specimen: SpecimenColumns, place: Place) -> Text:
    """The lines of the file with the cells of one specimen, blank where it has ended."""
    lines: list[str] = []
    ended = 0
    for number, raw in enumerate(text.data[layout.offset :].splitlines(), layout.first_line):
        row = split_line(text.decode(raw), layout.delimiter)
        cells = row[specimen.start : specimen.stop]
        if not any(cell.strip() for cell in cells):
            ended = ended or (number if any(cell.strip() for cell in row) else 0)
            lines.append("")
            continue
        if ended:
            place.refuse(
                "empty_cell",
                f"the cells of the specimen are empty in line {ended}, filled below; fill or remove the row",
                line=ended,
                column=1,
            )
        lines.append(_joined(cells, layout.delimiter))
    # without a last line end the last row may be cut, as in the file
    rows = "\n".join(lines) + ("\n" if text.data.endswith(b"\n") else "")
    return block_text(text, rows.encode(text.codec, "replace"), layout.first_line)


def _joined(cells: Sequence[str], delimiter: str) -> str:
    return delimiter.join(
        '"' + cell.replace('"', '""') + '"' if delimiter in cell or '"' in cell else cell for cell in cells
    )


SHIMADZU = Recipe(
    "shimadzu", "Shimadzu Trapezium text, specimens side by side", detect_shimadzu, read_shimadzu
)
