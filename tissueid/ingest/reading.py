"""From a path to trials: the recipes, the choice between them, and the shell around them.

An entry point of another distribution names a :class:`~tissueid.ingest.recipe.Recipe`.  One that can't be
loaded, or breaks while it reads, is named in :func:`reader_faults` and never stops the others.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path, PurePosixPath

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import InputError, refuse
from tissueid.extras import faults_of
from tissueid.flags import Flag
from tissueid.ingest.archive import archive_recipe
from tissueid.ingest.blocks import MACH_1, MTS_793, SHIMADZU
from tissueid.ingest.delimited import BLUEHILL_CSV, CHIARO, COLUMNS_TEXT, TESTXPERT_TRA
from tissueid.ingest.discovery import find_inputs
from tissueid.ingest.header import protocol_of
from tissueid.ingest.held import read_anew
from tissueid.ingest.jpk import JPK_FORCE, JPK_TEXT
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.quality import capacity_in, quality_flags, zero_dt
from tissueid.ingest.recipe import Detection, InputFile, Match, Recipe, Table, open_input
from tissueid.ingest.refusals import Place
from tissueid.ingest.session import SESSION_LOG
from tissueid.ingest.vocabulary import CHANNELS, SYMBOL_RANK, Channel, plain_words, rank_of, split_name
from tissueid.ingest.workbook import TESTXPERT_WORKBOOK, WORKBOOK
from tissueid.signal_noise import between_ticks
from tissueid.trial import Axes, Source, Trial

_faults: dict[str, None] = {}


def reader_faults() -> tuple[str, ...]:
    """Faults of installed readers so far, one sentence each, naming the reader."""
    return tuple(_faults)


def report_fault(name: str, what: str) -> None:
    """Remember that a reader broke."""
    _faults[f"the installed reader {name!r} {what}"] = None


def forget_readers() -> None:
    """Look for installed readers again, after distributions were added or removed."""
    _installed_recipes.cache_clear()
    _faults.clear()


@cache
def _installed_recipes() -> dict[str, Recipe]:
    """The recipes of other distributions."""
    found: dict[str, Recipe] = {}

    def take(given: object) -> None:
        recipe = _checked(given, RECIPES.keys() | found.keys())
        found[recipe.key] = _guarded(recipe)

    for name, (place, fault) in faults_of("tissueid.readers", take).items():
        report_fault(f"{name} ({place})", fault)
    return found


def _checked(recipe: object, taken: set[str]) -> Recipe:
    if not isinstance(recipe, Recipe):
        raise TypeError(f"it is a {type(recipe).__name__}, not a tissueid.ingest.Recipe")
    if not recipe.key or recipe.key in taken:
        raise ValueError(f"its key {recipe.key!r} is taken; choose another")
    return recipe


def _table(item: object) -> Table | InputError:
    if not isinstance(item, Table | InputError):
        raise TypeError(f"it gave a {type(item).__name__}, not a Table")
    if isinstance(item, Table):
        missing = [channel for channel in CHANNELS if channel not in item.columns]
        if missing:
            raise ValueError(f"its table names no column of {' and '.join(missing)}")
        # a trial is made of it later; what that would refuse is the reader's fault
        Trial("", item.time_s, item.displacement_mm, item.force_N)
    return item


def _guarded(recipe: Recipe) -> Recipe:
    def read(file: InputFile) -> Iterator[Table | InputError]:
        try:
            for item in recipe.read(file):
                yield _table(item)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - a bug of theirs is a refusal of this file
            report_fault(recipe.key, f"broke on {file.path}: {type(error).__name__}: {str(error)[:200]}")
            yield Place(file.path).refusal(
                "reader_failed",
                f"the installed reader {recipe.key!r} broke on this file ({type(error).__name__}:"
                f" {str(error)[:160]}); choose another with --recipe, or tell its author",
            )

    return Recipe(recipe.key, recipe.description, recipe.detect, read)


def _recipes() -> dict[str, Recipe]:
    return {**RECIPES, **_installed_recipes()}


def known_recipe(key: str) -> Recipe:
    """The recipe of a name; UsageError with all of them where there is none."""
    recipes = _recipes()
    if key not in recipes:
        refuse(f"unknown recipe {key!r}, one of {', '.join(recipes)}")
    return recipes[key]


def match_recipe(file: InputFile) -> Match:
    """The surest recipe for a file, or the one the user asked for."""
    if file.options.recipe is not None:
        return Match(known_recipe(file.options.recipe), 1.0, "the user asked for it")
    matches = [Match(recipe, *_detect(recipe, file)) for recipe in _recipes().values()]
    best = max(matches, key=lambda match: match.confidence)
    if best.confidence == 0.0:
        # a table, a workbook and an archive each have a reader: what is left is no text, or has no table
        file.laid_out()
    return best


def _detect(recipe: Recipe, file: InputFile) -> Detection:
    """Detection of a file by a recipe; one that breaks, and is not ours, knows nothing of it."""
    if recipe.key in RECIPES:
        return recipe.detect(file)
    try:
        confidence, reason = recipe.detect(file)
        return min(max(float(confidence), 0.0), 1.0), str(reason)
    except Exception as error:  # noqa: BLE001 - somebody else's code must not stop the others
        what = f"could not look at {file.path}"
        report_fault(recipe.key, f"{what}: {type(error).__name__}: {str(error)[:200]}")
        return 0.0, "the reader broke"


#: Key -> recipe, in the order in which equals win.
RECIPES: Mapping[str, Recipe] = {
    recipe.key: recipe
    for recipe in (
        BLUEHILL_CSV,
        TESTXPERT_TRA,
        TESTXPERT_WORKBOOK,
        MACH_1,
        MTS_793,
        SHIMADZU,
        CHIARO,
        JPK_FORCE,
        JPK_TEXT,
        SESSION_LOG,
        WORKBOOK,
        COLUMNS_TEXT,
        archive_recipe(match_recipe),
    )
}

_MEANS = (
    r"(?:mean|averaged?|typical|median|representative)(?: (?:curve|specimen|sample|test|trace|values?))?"
    r"|mittelwert(?:e|s?kurve)?|mittelkurve|mittlere (?:kurve|probe)|durchschnitt(?:skurve|swerte?)?"
    r"|(?:typische|reprasentative) (?:kurve|probe)|typkurve"
    r"|(?:eprouvette|courbe|essai|valeurs?) (?:moyen(?:ne)?s?|type|typique|medianes?|representative?)|moyenne"
    r"|(?:curva|probeta|ensayo|provino|prova|corpo de prova) (?:medi[ao]|promedio|tipic[ao])"
    r"|promedio|(?:krzywa|probka) (?:srednia|typowa)|srednia|平均(?:曲线|值|试样)?|典型(?:曲线|试样)|代表曲线"
)
_SUMMARIES = (
    r"statistics|summary|results?|statistik|zusammenfassung|ergebnisse|statistiques?|synthese|resume"
    r"|resultats?|estadisticas?|resumen|resultados|statistic(?:a|he)|riepilogo|risultati|estatisticas?|resumo"
    r"|statystyk[ai]|podsumowanie|wyniki|统计|汇总|结果|統計|結果"
)
_SEARCHES = (
    r"(?:find(?:ing)?|search(?: for)?|seek(?:ing)?|detect(?:ing)?) (?:the )?contact"
    r"|contact (?:search|find(?:er|ing)?)"
    r"|kontakt ?suche|kontaktfindung|recherche (?:de |du )?contact|busqueda de(?:l)? contacto"
    r"|ricerca (?:del |di )?contatto|busca de contato|szukanie kontaktu|接触(?:查找|搜索|寻找)"
)
#: Words that are a mean among sheets, but may name a file of anything.
_AMONG_SHEETS = r"medi[ao]s?"
_KINDS = (
    ("mean", _MEANS, "a mean or typical curve"),
    ("summary", _SUMMARIES, "a summary"),
    ("search", _SEARCHES, "the machine's search for contact"),
)


def no_specimen(path: str, sheet: str | None) -> Flag | None:
    """``not_a_specimen``, where the name of a file, sheet, block, specimen or member says so."""
    names = [PurePosixPath(path.replace("\\", "/")).stem]
    parts = [] if sheet is None else sheet.split("::")
    names += [PurePosixPath(part).stem if "/" in part or "." in part else part for part in parts]
    for name in names:
        words = re.sub(r"^\d+ | \d+$", "", plain_words(name))
        for kind, pattern, what in _KINDS:
            sheets = kind == "mean" and parts and name is not names[0] and re.fullmatch(_AMONG_SHEETS, words)
            if sheets or re.fullmatch(pattern, words):
                message = f"{name!r} is {what}, no specimen, and is not fitted"
                return Flag("not_a_specimen", message, {"kind": kind})
    return None


#: Longest travel [mm] and largest force [N] of a materials testing machine, with room to spare.
TRAVEL_LIMIT_MM = 5_000.0
FORCE_LIMIT_N = 5e6
#: A travel without a unit may be in m where it is shorter than this and nothing soft is as stiff: the frame
#: of a machine has some 1000 N/mm.
SHORTEST_MM, STIFFEST_N_PER_MM = 0.1, 500.0
#: No clock shows so many seconds (stamps count from 1970, or 1904), and no recording lasts so long (3 years).
STAMP_LIMIT_S = 1e11
DURATION_LIMIT_S = 1e8
#: Days since 1900, or since year 0, as spreadsheets and MATLAB count them; and a step that is 2 s in days.
DAY_COUNTS, DAY_STEP = (2e4, 1e6), 2.0 / 86_400.0
_STAMP_UNITS = (("ms", 1e3), ("us", 1e6), ("ns", 1e9))


def match_of(path: str | Path, options: ReadOptions | None = None) -> Match:
    """Recipe that reads a file, with its certainty and reason."""
    return match_recipe(open_input(path, options or ReadOptions()))


def read_each(path: str | Path, options: ReadOptions | None = None) -> Iterator[Trial | InputError]:
    """Every trial of one file, or the refusal in its place; a bad sheet never stops the others."""
    try:
        for item in _read_each(path, options or ReadOptions()):
            if isinstance(item, InputError):
                # one that is kept must not keep the file alive, as the frames of its traceback would
                item.__traceback__ = item.__context__ = item.__cause__ = None
            yield item
    except MemoryError:
        message = "what the file holds is larger than the memory that is free; export fewer tests"
        yield Place(str(path)).refusal("unreadable_file", message)


def _read_each(path: str | Path, options: ReadOptions) -> Iterator[Trial | InputError]:
    try:
        file = open_input(path, options)
        match = match_recipe(file)
    except InputError as error:
        yield error
        return
    passed: list[str | None] = []
    found = False
    for table in match.recipe.tables(file):
        of_all = isinstance(table, InputError) and table.sheet is None
        if not of_all and not file.options.picks(table.sheet):
            passed.append(table.sheet)
            continue
        found = True
        yield table if isinstance(table, InputError) else _trial(file, match, table)
    if not found and passed:
        yield _unknown_sheet(file.path, file.options.sheet, passed)


def read_trials(path: str | Path, options: ReadOptions | None = None) -> list[Trial]:
    """All trials of a file, or of all recordings under a directory.

    Parameters
    ----------
    path : str or Path
    options : ReadOptions, optional

    Returns
    -------
    list of Trial

    Raises
    ------
    InputError
        The first refusal.
    UsageError
        There is no such path.

    Examples
    --------
    >>> trials = read_trials("lab_data/")  # doctest: +SKIP
    >>> trials[0].force_N.max()  # doctest: +SKIP
    """
    trials = []
    for file in find_inputs([path]):
        for trial in read_each(file, options):
            if isinstance(trial, InputError):
                raise trial
            trials.append(trial)
    return trials


def read_one(path: str | Path, sheet: str | None, options: ReadOptions | None = None) -> Trial:
    """One trial: of a text file (``sheet=None``), or one sheet of a workbook."""
    seen = []
    for trial in read_each(path, options):
        found = trial.sheet if isinstance(trial, InputError) else trial.source.sheet
        if found == sheet or (isinstance(trial, InputError) and found is None):
            if isinstance(trial, InputError):
                raise trial
            return trial
        seen.append(found)
    raise _unknown_sheet(str(path), sheet, seen)


def _unknown_sheet(path: str, sheet: str | None, seen: Sequence[str | None]) -> InputError:
    if set(seen) == {None}:
        trials = "the file has one trial and no sheets"
    else:
        trials = "the trials are " + ", ".join(repr(name) for name in seen)
    return InputError("unknown_sheet", f"there is no trial {sheet!r}; {trials}", path=path, sheet=sheet)


def _beyond_machines(table: Table, declared: Container[str]) -> Iterator[str]:
    """Travel or force that no test machine has: lost decimal marks, or a wrong unit."""
    reaches: tuple[tuple[Channel, float, float, str], ...] = (
        ("displacement", float(np.ptp(table.displacement_mm)), TRAVEL_LIMIT_MM, "mm"),
        ("force", float(np.abs(table.force_N).max()), FORCE_LIMIT_N, "N"),
    )
    for channel, reach, limit, unit in reaches:
        if channel not in declared and channel not in table.axes and reach > limit:
            yield (
                f"the {channel} in column {table.columns[channel]!r} reaches {reach:g} {unit}, more than any "
                f"test machine ({limit:g} {unit}): were decimal marks lost, or is the unit wrong? State it "
                f"with --units {channel}=UNIT, or export again"
            )


def _doubted(table: Table) -> tuple[Flag, ...]:
    """Flags of a table; a travel in mm by assumption, and so short that it may be in m, comes first."""
    travel, reach = float(np.ptp(table.displacement_mm)), float(np.ptp(table.force_N))
    if not 0.0 < travel < SHORTEST_MM or reach < STIFFEST_N_PER_MM * travel:
        return table.flags
    asked = f": {reach:.3g} N within {travel:.2g} mm, is it in m?"
    doubtful, others = [], []
    for flag in table.flags:
        if flag.code == "units_assumed" and flag.values["quantity"] == "displacement":
            doubtful.append(Flag("units_assumed", flag.message + asked, flag.values))
        else:
            others.append(flag)
    return (*doubtful, *others)


def _beyond_clocks(table: Table) -> Iterator[str]:
    """Times that are no seconds: a stamp in days, ms, us or ns under a name that does not say so."""
    first, last = float(table.time_s[0]), float(table.time_s[-1])
    # without a unit a part of a day as well
    assumed = {one.values["quantity"] for one in table.flags if one.code == "units_assumed"}
    counted = DAY_COUNTS[0] < first < DAY_COUNTS[1] or "time" in assumed
    days = counted and 0.0 < last - first < DAY_STEP * table.time_s.size
    if abs(first) < STAMP_LIMIT_S and last - first < DURATION_LIMIT_S and not days:
        return
    units = (
        unit for unit, per_s in _STAMP_UNITS if DURATION_LIMIT_S < abs(last) / per_s < STAMP_LIMIT_S / 10
    )
    unit = "day" if days else next(units, None) if abs(first) >= STAMP_LIMIT_S else None
    likely = f"is it a stamp in {unit}? State its unit" if unit else "is it in ms, us or ns? State it"
    yield (
        f"the time in column {table.columns['time']!r} runs from {first:.10g} to {last:.10g} s, which is no"
        f" recording: {likely} with --units time={unit or 'UNIT'}"
    )


def _stuck(table: Table) -> Iterator[str]:
    """Time that never changes, or displacement or force where other columns may be it."""
    channels: tuple[tuple[Channel, FloatArray], ...] = (
        ("time", table.time_s),
        ("displacement", table.displacement_mm),
        ("force", table.force_N),
    )
    choices = [flag.values for flag in table.flags if flag.code == "column_choice"]
    for channel, values in channels:
        # a letter is no better
        others = [
            one
            for choice in choices
            if choice["quantity"] == channel
            for one in choice["alternatives"]
            if rank_of(split_name(one)[0], channel, loose=True) != SYMBOL_RANK
        ]
        if (others or channel == "time") and not np.ptp(values) > 0.0:
            yield (
                f"column {table.columns[channel]!r} is {values[0]:g} in all {table.time_s.size} rows, as of a"
                " sensor that was not attached; take another, as with"
                f" --columns {channel}={others[0] if others else 'NAME'!r}"
            )


def _trial(file: InputFile, match: Match, table: Table) -> Trial | InputError:
    place = Place(file.path, table.sheet)
    for message in chain(_beyond_machines(table, file.options.axes), _beyond_clocks(table)):
        return place.refusal("implausible_range", message)
    for message in _stuck(table):
        return place.refusal("no_columns", message)
    taken = table.match or match
    source = Source(
        path=file.path,
        sheet=table.sheet,
        sha256=file.sha256,
        recipe=taken.recipe.key,
        recipe_reason=taken.reason if taken is match else f"{match.reason}; in it, {taken.reason}",
        recipe_confidence=taken.confidence,
        encoding=table.encoding,
        delimiter=table.delimiter,
        decimal=table.decimal,
        columns={str(channel): name for channel, name in table.columns.items()},
        metadata=table.metadata,
    )
    axes = replace(file.options, axes={**file.options.axes, **table.axes}).trial_axes
    time_s, tick_s = between_ticks(table.time_s)
    repeats = zero_dt(table.time_s, np.diff(table.time_s), tick_s) if tick_s > 0.0 else None
    (time_s, displacement_mm, force_N), held = read_anew(time_s, table.displacement_mm, table.force_N)
    said = (_normalised(axes), no_specimen(file.path, table.sheet), repeats, held)
    capacity_N = capacity_in(table.metadata, decimal=table.decimal)
    quality = quality_flags(time_s, displacement_mm, force_N, capacity_N=capacity_N)
    flags = (*_doubted(table), *(flag for flag in said if flag is not None), *quality)
    return Trial(
        specimen=_specimen(file, table),
        time_s=time_s,
        displacement_mm=displacement_mm,
        force_N=force_N,
        protocol=table.protocol or protocol_of(table.metadata, file.path, decimal=table.decimal),
        source=source,
        flags=flags,
        axes=axes,
    )


def _normalised(axes: Axes) -> Flag | None:
    if not axes.normalised:
        return None
    message = f"declared as normalised: for mm read {axes.length}, for N {axes.force}; can't be rendered"
    return Flag("normalised_axes", message, {"length": axes.length, "force": axes.force})


def _specimen(file: InputFile, table: Table) -> str:
    """The user's pattern, else the file's own word, else a name that nothing else has."""
    name = file.path if table.sheet is None else f"{file.path}::{table.sheet}"
    if file.options.specimen_by is not None:
        match = re.search(file.options.specimen_by, name)
        found = None if match is None else match[1] if match.re.groups else match[0]
        return found or name
    return table.specimen or name
