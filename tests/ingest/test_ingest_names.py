"""Names and units as laboratories print them: glued, above or under names, letters, strain, comments.

Mean curves, summaries and searches for contact are told by their names and left out of a fit; units that are
known without pint are what pint makes of them.  A row of units that is not understood is asked about: taken
for a remark, it would leave pounds as newtons.
"""

import contextlib
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path

import pint
import pytest
from ingest_files import ROWS, codes, put, read, refusal, workbook, written

from tissueid.ingest import ReadOptions, read_each, read_trials
from tissueid.ingest.reading import no_specimen
from tissueid.ingest.vocabulary import split_name
from tissueid.units import INTERNAL_UNITS, KNOWN_UNITS, KNOWN_WORDS, REPEATS, factor_to, quantity_of


@pytest.mark.parametrize(
    ("head", "factors"),
    [
        ("Time,Displacement,Force\nTimer,LVDT,Load cell\nsec,um,mN", (1e-3, 1e-3)),
        ("Operator,lab\nUnits: s, um, mN\nTime,Position,Load", (1e-3, 1e-3)),
        ("Operator,lab\nUnits,(s),(um),(mN)\nTime,Position,Load", (1e-3, 1e-3)),
        *(
            (f"Time {is_} s\nDisplacement {is_} um\nForce {is_} mN\n\n{names}", (1e-3, 1e-3))
            for is_ in ("unit:", "unit,", "units =")
            for names in ("Time,Displacement,Force", "Elapsed Time,Position,Load")
        ),
        ("Time_s,Extension_mm,Load_N", (1, 1)),
        ("Time-s,Extension-um,Load-mN", (1e-3, 1e-3)),
        ("time_s,height_measured_m,force_N", (1e3, 1)),
        ("Time s,Extension mm,Load kN", (1, 1e3)),
        ("Time.s,Extension.mm,Load.kN", (1, 1e3)),
        ("Time..s.,Extension..um.,Load..mN.", (1e-3, 1e-3)),
        ("Time <s>,Extension <um>,Load <mN>", (1e-3, 1e-3)),
        ("Time {s},Extension {mm},Load {kgf}", (1, 9.80665)),
        ("t_s,z_mm,weight_g", (1, 9.80665e-3)),
        ("経過時間(s),ストローク(mm),荷重(kN)", (1, 1e3)),
        ("Temps (s),Course_Traverse (mm),Effort (N)", (1, 1)),
        ("Temps (s),Déplacement de la traverse (mm),Force (N)", (1, 1)),
        ("Temps (s),Position traverse (mm),Charge (N)", (1, 1)),
        ("Čas (s),Posunutí (mm),Síla (N)", (1, 1)),
        ("Tijd (s),Verplaatsing (mm),Kracht (N)", (1, 1)),
        ("Tid (s),Förskjutning (mm),Kraft (N)", (1, 1)),
        ("Tid (s),Forskydning (mm),Belastning (N)", (1, 1)),
        ("Zaman (s),Uzama (mm),Kuvvet (N)", (1, 1)),
        ("시간(초),변위(mm),하중(N)", (1, 1)),
        ("Время (с),Перемещение (мм),Нагрузка (Н)", (1, 1)),
        ("Time_S,Displacement_mm,Force_N", (1, 1)),
        ("Time (s),Deformation (mm),Loadcell (N)", (1, 1)),
        ("time_s,pos_z_mm,fz_N", (1, 1)),
        ("time_s,pos_z_mm,force_normal_N", (1, 1)),
        ("time_s,pos_z_mm,normal_force_N", (1, 1)),
        ("Time (s),伸び (mm),荷重 (N)", (1, 1)),
        ("Čas (s),Posun (mm),Síla (N)", (1, 1)),
        ("Zaman (sn),Uzama (mm),Kuvvet (N)", (1, 1)),
        ("t [s],s [mm],F [N]", (1, 1)),
        ("t [s],h [nm],P [mN]", (1e-6, 1e-3)),
        ("Time [s],ΔL [mm],F [N]", (1, 1)),
        ("t1 (s),x1 (mm),F1 (N)", (1, 1)),
        ("Time [s],CH2: Stroke [mm],CH1: Load [N]", (1, 1)),
        ("Time (s),Displacement [um] (LVDT),Force [mN] (cell 2)", (1e-3, 1e-3)),
        ("Time_s_,LVDT_um_,Load_kN_", (1e-3, 1e3)),
        ("t in s,s in um,F in kN", (1e-3, 1e3)),
        ("t in [s],s in [um],F [in kN]", (1e-3, 1e3)),
        ("Zeit in Sekunden,Stempelweg in Millimeter,Axialkraft in Newton", (1, 1)),
        ("t_s [s],x_mm [mm],F_N [kN]", (1, 1e3)),
        ("time [s],delta [um],P [kN]", (1e-3, 1e3)),
        ("Time|s,Disp|um,Force|kN", (1e-3, 1e3)),
        ("Time (s)*,Ext. (mm)*,Load (kN)**", (1, 1e3)),
        ("s,um,kN", (1e-3, 1e3)),
        ("(s),(um),(kN)", (1e-3, 1e3)),
        ("Tempo (secondi),Penetrazione (millimetri),Forza (newton)", (1, 1)),
        ("Tiempo (segundos),Indentación (milímetros),Fuerza (newtons)", (1, 1)),
        ("时间(秒),深度(微米),法向力(千克力)", (1e-3, 9.80665)),
        ("時刻(s),押込み量(ミリ),荷重値(ニュートン)", (1, 1)),
        ("Время (с),Деформация (мкм),Нагрузка (кгс)", (1e-3, 9.80665)),
        ("Время с,Глубина мм,Усилие кН", (1, 1e3)),
        ("Час (с),Переміщення (мм),Зусилля (мН)", (1, 1e-3)),
        ("Χρόνος (s),Μετατόπιση (mm),Δύναμη (N)", (1, 1)),
        ("Aika (s),Siirtymä (mm),Voima (N)", (1, 1)),
        ("Idő (s),Elmozdulás (mm),Erő (N)", (1, 1)),
        ("Tid (s),Vandring (mm),Kraft (N)", (1, 1)),
        ("Čas (s),Dráha (mm),Síla (N)", (1, 1)),
        ("Messzeit Kanal 1 [s],Wegaufnehmer WA20 [mm],Kraft U10M [N]", (1, 1)),
        ("Zeit [s],Wegsensor 2 Stempel [um],Kraftsensor 1 [mN]", (1e-3, 1e-3)),
        ("Temps (s),Course vérin 1 (mm),Effort capteur (kN)", (1, 1e3)),
    ],
)
def test_names_with_glued_units_of_french_crossheads_eight_more_languages_and_loggers_are_read(
    tmp_path: Path, head: str, factors: tuple[float, float]
) -> None:
    trial = read(written(tmp_path / "a.csv", head))
    assert trial.flags == ()
    # parse, factor, product: a rounding each
    found = (trial.displacement_mm[2], trial.force_N[2])
    assert found == pytest.approx((0.1 * factors[0], 1.5 * factors[1]), rel=1e-15)


@pytest.mark.parametrize(
    ("codec", "head"),
    [
        ("cp1251", "Время;Перемещение;Нагрузка\nс;мм;Н"),
        ("cp949", "시간(s);변위(mm);하중(N)"),
        ("cp1250", "Čas (s);Posunutí (mm);Síla (N)"),
        ("cp1254", "Zaman (s);Yer değiştirme (mm);Kuvvet (N)"),
        ("big5", "時間(秒);位移(mm);荷重(N)"),
    ],
)
def test_their_code_pages_are_told_by_their_words(tmp_path: Path, codec: str, head: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes((head + "\n" + ROWS.replace(",", ";").replace(".", ",")).encode(codec))
    trial = read(path)
    assert trial.flags == ()
    assert (trial.displacement_mm[2], trial.force_N[2]) == (0.1, 1.5)


def test_an_indenters_export_of_micrometres_and_micronewtons_is_read(tmp_path: Path) -> None:
    head = "Fn contact : 25 µN\n\nMeasured values\nTime (s)\tPd (µm)\tFn (µN)\tFnRef (µN)\tSegmentID\n"
    rows = "".join(f"{k / 10:.1f}\t{50.5 * k:.2f}\t{1e3 + 250.25 * k:.4f}\t5.35\t1\n" for k in range(30))
    path = tmp_path / "a.TXT"
    path.write_text(head + "\n" + rows, encoding="cp1252")
    trial = read(path)
    assert trial.source.columns == {"time": "Time (s)", "displacement": "Pd (µm)", "force": "Fn (µN)"}
    assert trial.displacement_mm[2] == pytest.approx(0.101)
    assert trial.force_N[2] == pytest.approx(1.5005e-3)


@pytest.mark.parametrize(
    "head",
    [
        "ElapsedTime,AxialDisplacement,AxialForce",
        "testTime,crossheadPosition,loadCell",
        "TimeStamp,PositionZ,ForceZ",
        "Time,z_pos,fz",
    ],
)
def test_names_that_run_words_together_are_those_words(tmp_path: Path, head: str) -> None:
    assert set(codes(read(written(tmp_path / "a.csv", head)))) == {"units_assumed"}


def test_a_length_of_any_name_is_named_beside_the_deflection_that_was_taken(tmp_path: Path) -> None:
    """A cantilever bends by less than its base travels."""
    rows = "".join(f"{0.1 * k:.1f},{5 * k},{0.25 * k:.2f},{0.5 * k:.1f}\n" for k in range(40))
    trial = read(put(tmp_path / "a.csv", f"Time (s),Base (um),Deflection (um),Force (uN)\n{rows}"))
    (flag,) = trial.flags
    assert (flag.code, flag.values["alternatives"]) == ("column_choice", ["Base (um)"])


@pytest.mark.parametrize("head", ["t,x,F", "t,delta,P", "t,h,P"])
def test_letters_are_taken_where_only_one_can_be_meant_and_said(tmp_path: Path, head: str) -> None:
    trial = read(written(tmp_path / "a.csv", head))
    assert codes(trial) == ["units_assumed"] * 3
    assert "--axes displacement=strain" in trial.flags[1].message
    assert "--axes force=stress" in trial.flags[2].message


#: Five columns: a head takes as many of them as it has names.
FIVE = [(k / 10, k * 0.05, 1 + k * 0.25, 2 + k * 0.125, k * 0.5) for k in range(30)]


def five(head: str) -> str:
    """The head with a row of numbers under each name."""
    return f"{head}\n" + "".join(
        ",".join(f"{v:.3f}" for v in row[: head.count(",") + 1]) + "\n" for row in FIVE
    )


def timed(times: Iterable[object], travel: float = 0.05) -> str:
    return "".join(f"{t},{k * travel:g},{1 + k * 0.25:.3f}\n" for k, t in enumerate(times))


@pytest.mark.parametrize("head", ["Laikas (s),Poslinkis (um),Jėga (N)", "Laikas,Poslinkis,Jėga\ns,um,N"])
def test_names_of_no_known_language_are_told_by_their_units_where_each_channel_has_one(tmp_path, head):
    trial, known = (
        read(written(tmp_path / name, one)) for name, one in (("a.csv", head), ("b.csv", "s,um,N"))
    )
    assert trial.displacement_mm.tolist() == known.displacement_mm.tolist()
    assert [flag.code for flag in trial.flags] == ["column_choice"] * 3
    assert all("by its unit alone" in flag.message for flag in trial.flags)


@pytest.mark.parametrize(
    "head",
    [
        "Time (s),Wavelength (nm),Force (N)",
        "Time (s),Deformation,Force (N)",
        "Time (s),Compression,Force (N)",
        "Time (s),Pd,Force (N)",
        "t,x,F,u",
        "T,x,F",  # a capital T is a temperature
        "t,x,P",  # of a gas, but beside a depth
        "t,h,P,T",
        "s,m,N",
        "h,mm,N",
        "Time (s),x_mm [um],F [N]",
        "Time (s),Extension (mm),Stress",
        "Time (s),Strain rate (%/s),Force (N)",
        "Time (s),Force X (N),Force Y (N),Displacement (mm)",
        "Time (s),Travel (mm),Friction force (N)",
        "Time (s),Travel (mm),Lateral force (N)",
        "Time (s),Shear displacement (mm),Force (N)",
        "Time (s),Travel_SP (mm),Force (N)",
        "Time (s),Travel reference (mm),Force (N)",
        "Time (s),Travel (mm),F1 (N),F2 (N)",
        "Time (s),Width (mm),Force (N)",
        "Laikas (s),Storis (mm),Poslinkis (mm),Jėga (N)",
    ],
)
def test_what_may_be_something_else_is_not_taken_for_want_of_another(tmp_path: Path, head: str) -> None:
    error = refusal(put(tmp_path / "a.csv", five(head)))
    assert error.code == "no_columns"
    assert "--columns" in error.message


@pytest.mark.parametrize(
    ("head", "first", "step", "unit", "stated"),
    [
        ("%time,position_mm,force_N", "1552000000000", "100", "ms", "ms"),
        ("%time,position_mm,force_N", "1552000000000000000", "100000000", "ns", "ns"),
        ("%time,position_mm,force_N", "0", "100000000", "UNIT", "ns"),
        ("Time,position_mm,force_N", "45021.4244", "0.0000011574074", "day", "day"),
        ("Time,position_mm,force_N", "738000.4244", "0.0000011574074", "day", "day"),
        ("Time,position_mm,force_N", "0", "0.0000011574074", "day", "day"),
    ],
)
def test_a_stamp_that_is_no_seconds_is_asked_about(tmp_path, head, first, step, unit, stated) -> None:
    rows = "".join(
        f"{Decimal(first) + k * Decimal(step)},{k * 0.05:.3f},{1 + k * 0.25:.3f}\n" for k in range(30)
    )
    path = written(tmp_path / "a.csv", head, rows)
    error = refusal(path)
    assert error.code == "implausible_range"
    assert f"--units time={unit}" in error.message
    trial = read(path, ReadOptions(units={"time": stated}))
    assert trial.time_s[29] - trial.time_s[0] == pytest.approx(2.9, abs=1e-3)


@pytest.mark.parametrize(
    ("head", "step", "travel", "said"),
    [
        ("Time (s),Depth (nm),Load (uN)", Decimal("0.1"), 1500, []),
        ("Time (s),Depth (um),Load (mN)", Decimal("0.1"), 1500, ["no_decimals"]),
        ("Time,Depth (mm),Load (N)", 100, 0.05, ["units_assumed", "no_decimals"]),
    ],
)
def test_whole_numbers_may_have_lost_a_mark_where_they_are_coarse(tmp_path, head, step, travel, said) -> None:
    trial = read(written(tmp_path / "a.csv", head, timed((k * step for k in range(30)), travel)))
    assert codes(trial) == said
    assert len(said) < 2 or "--units time=ms" in trial.flags[1].message
    path, units = tmp_path / "a.csv", {"displacement": "um"}
    assert "no_decimals" not in codes(read(path, ReadOptions(units=units))) or "(um)" not in head


def test_a_time_that_stands_still_is_refused(tmp_path: Path) -> None:
    error = refusal(written(tmp_path / "a.csv", "Time_s,Extension_mm,Load_N", timed(["3.0"] * 30)))
    assert error.code == "no_columns"
    assert "--columns time=" in error.message


@pytest.mark.parametrize(
    ("head", "axes", "factor"),
    [
        ("Time-s,Strain-%,Stress-kPa", ("1", "MPa"), (1e-2, 1e-3)),
        ("Time (s),Stretch,Force (N)", ("1", "N"), (1, 1)),
        ("Time (s),Extension (mm),Stress (MPa)", ("mm", "MPa"), (1, 1)),
        ("Time (s),Stretch (mm/mm),Stress (Pa)", ("1", "MPa"), (1, 1e-6)),
    ],
)
def test_strain_and_stress_are_taken_as_such_where_nothing_else_is_there_and_said(
    tmp_path: Path, head: str, axes: tuple[str, str], factor: tuple[float, float]
) -> None:
    trial = read(written(tmp_path / "a.csv", head))
    assert (trial.axes.length, trial.axes.force) == axes
    assert "normalised_axes" in codes(trial)
    assert trial.displacement_mm[2] == pytest.approx(0.1 * factor[0])
    assert trial.force_N[2] == pytest.approx(1.5 * factor[1])


SHIFTED = "".join(f"{k},{k / 10:.1f},{k * 0.5:.2f},{1 + k * 0.25:.3f}\n" for k in range(30))


@pytest.mark.parametrize("name", ["Comment", "Bemerkung", "Commentaires", "Observaciones", "Note"])
def test_numbers_under_comments_are_asked_about(tmp_path: Path, name: str) -> None:
    path = written(tmp_path / "a.csv", f"Time,Extension,Load,{name}", SHIFTED)
    error = refusal(path)
    assert (error.code, error.line, error.column) == ("ragged_rows", 2, 4)
    assert "--columns time=#1" in error.message
    answered = {"time": "#2", "displacement": "#3", "force": "#4"}
    trial = read(path, ReadOptions(columns=answered))
    assert trial.time_s[2] == pytest.approx(0.2)


def test_a_column_of_numbers_without_a_name_is_asked_about_where_the_head_has_comments(tmp_path) -> None:
    rows = "".join(f"{line},\n" for line in SHIFTED.splitlines())
    halves = "".join(f"{0.5 * k},{line.partition(',')[2]}\n" for k, line in enumerate(rows.splitlines()))
    error = refusal(written(tmp_path / "a.csv", ",Time,Extension,Load,Comment", halves))
    assert (error.code, error.column) == ("ragged_rows", 1)
    # the row numbers that other programs write have no name either
    read(written(tmp_path / "b.csv", ",Time,Extension,Load", SHIFTED))
    read(written(tmp_path / "b.csv", ",Time,Extension,Load,Comment", rows))
    # and comments may be comments
    said = "".join(f"{line},{'slow' if k == 3 else ''}\n" for k, line in enumerate(ROWS.splitlines()))
    read(written(tmp_path / "c.csv", "Time,Extension,Load,Comment", said))
    # of which a row without one may leave out the cell, but for none of numbers
    lone = ROWS.replace("\n", ",slow start\n", 1)
    trial = read(written(tmp_path / "d.csv", "Time,Extension,Load,Comment", lone))
    assert trial.time_s.size == len(ROWS.splitlines())
    for remark, name in (("3.5", "Comment"), ("slow", "Mode")):
        path = written(tmp_path / "e.csv", f"Time,Extension,Load,{name}", lone.replace("slow start", remark))
        assert refusal(path).code == "ragged_rows"


def test_specimens_side_by_side_without_time_are_refused_one_by_one(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(
        f'"{k / 7:.4f}","{k / 50:.4f}","{k / 10:.2f}","{k / 6:.4f}","{k / 40:.4f}"\n' for k in range(30)
    )
    head = '"A","","B","",""\n"Force","Course","Temps","Force","Course"\n"N","mm","sec","N","mm"\n'
    path.write_text(head + rows)
    first, second = read_each(path)
    assert (first.code, first.sheet) == ("no_columns", "A")
    assert "state the rate, as in --columns time=100Hz" in first.message
    assert second.force_N[7] == pytest.approx(7 / 6, abs=1e-4)


def test_a_mach1_force_negative_in_compression_keeps_its_sign_and_the_search_is_no_specimen(tmp_path) -> None:
    def block(name: str, head: str, first: float) -> str:
        rows = "".join(
            f"{k * 0.1:.5f}\t{first + min(k, 50) * 0.01:.5f}\t0.00000\t{-20.0 * max(min(k, 50) - 10, 0) / 40 * (1 if k < 50 else 0.6 + 0.4 * 0.98 ** (k - 50)):.6f}\n"  # noqa: E501
            for k in range(300)
        )
        names = "Time, s\tPosition (z), mm\tPosition (x), mm\tFz, gf\n"
        return f"<{name}>\n{head}<DATA>\n{names}{rows}<END DATA>\n"

    relax = "Stage Axis:\tPosition (z)\nRamp amplitude, mm:\t0.5000\nRamp velocity, mm/s:\t0.1000\n"
    text = "<Mach-1 File>\n<INFO>\nTime:\t10:21:07\n<END INFO>\n"
    text += block("Find Contact", "Stage velocity, mm/s:\t0.1\n", 0.0)
    text += block("Stress Relaxation", relax + "Fixed relaxation time, s:\t25.000\n", 5.0)
    search, test = read_trials(put(tmp_path / "a.txt", text))
    assert "not_a_specimen" in codes(search)
    assert "not_a_specimen" not in codes(test)
    assert (test.protocol.speed_mm_s, test.protocol.depth_mm, test.protocol.hold_s) == (0.1, 0.5, 25.0)
    assert test.force_N.min() == pytest.approx(-20.0 * 0.00980665, rel=1e-6)


@pytest.mark.parametrize(
    ("line", "limit_N"),
    [
        ('Test : Load limit,"0.05000",kN', 50.0),
        ('Control : Force limit,"50.00000",N', 50.0),
        ('Test : Kraftgrenze,"50.00000",N', 50.0),
        ('Results : Maximum load,"50.00000",N', None),
        ('Test : Load limit,"50.00000",mm', None),
    ],
)
def test_a_stated_load_limit_is_read(tmp_path: Path, line: str, limit_N: float | None) -> None:
    trial = read(written(tmp_path / "limit.csv", f"{line}\n\nTime,Extension,Load\n(s),(mm),(N)"))
    assert trial.protocol.load_limit_N == (None if limit_N is None else pytest.approx(limit_N))


@pytest.mark.parametrize(
    ("sheet", "kind"),
    [
        ("Eprouvette moyenne", "mean"), ("Courbe type", "mean"), ("Mittelwert", "mean"),
        ("Mittelwertkurve", "mean"),
        ("Mean", "mean"), ("Typical", "mean"), ("Average curve", "mean"), ("Probeta media", "mean"),
        ("Curva tipica", "mean"), ("Provino medio", "mean"), ("Media", "mean"), ("平均曲线", "mean"),
        ("Statistik", "summary"), ("Statistiques", "summary"), ("Estadísticas", "summary"),
        ("Riepilogo", "summary"),
        ("Results 1", "summary"), ("1: Find Contact", "search"), ("archive/a.txt::2: Find Contact", "search"),
        ("230403-FF1A", None), ("2: Stress Relaxation", None), ("Mean cow 3", None), ("Typ A", None),
        ("Probe 1", None), ("Resultant", None), (None, None),
    ],
)  # fmt: skip
def test_names_of_no_specimens_in_the_exporters_language(sheet: str | None, kind: str | None) -> None:
    flag = no_specimen("lab/meat.xlsx", sheet)
    assert (None if flag is None else flag.values["kind"]) == kind
    # files are named so too, but not by words of anything
    assert no_specimen("lab/Mean.csv", sheet) is not None
    assert no_specimen("lab/media.csv", None) is None


REGISTRY = pint.UnitRegistry()


@pytest.mark.parametrize("unit", sorted(KNOWN_UNITS))
def test_known_factors_are_those_of_pint(unit):
    quantity, factor = KNOWN_UNITS[unit]
    assert factor == REGISTRY.Quantity(1, unit).to(INTERNAL_UNITS[quantity]).magnitude
    assert factor_to(f"({unit})", quantity) == factor
    assert quantity_of(unit) == quantity


def test_a_known_unit_of_something_else_is_refused():
    with pytest.raises(ValueError, match="does not measure force"):
        factor_to("mm/min", "force")


@pytest.mark.parametrize("word", sorted(KNOWN_WORDS))
def test_words_over_columns_are_no_units_of_pint(word):
    with pytest.raises(pint.UndefinedUnitError):
        REGISTRY.parse_units(word)
    assert quantity_of(word) is None


@pytest.mark.parametrize("letter", sorted(REPEATS))
def test_letters_that_number_repeats_are_no_units(letter):
    assert quantity_of(letter) is None
    assert split_name(f"Load-{letter}") == (f"Load-{letter}", None)


@pytest.mark.parametrize(
    ("name", "base", "unit"),
    [
        ("force_n", "force", "N"), ("force_mn", "force", "mn"), ("loadcell_V", "loadcell", "V"),
        ("position_steps", "position", "steps"), ("Force (10^-3 N)", "Force", "10^-3 N"),
        ("Time (10\u207b\u00b3 s)", "Time", "10\u207b\u00b3 s"), ("Travel (0.01 mm)", "Travel", "0.01 mm"),
        ("Load (500 N)", "Load (500 N)", None), ("force_raw", "force_raw", None), ("disp_v", "disp_v", None),
        ("Time:s", "Time", "s"), ("Force:mN", "Force", "mN"), ("hh:mm:ss", "hh:mm:ss", None),
        ("timeMs", "time", "ms"), ("dispMM", "disp", "mm"), ("elapsedTimeS", "elapsedTime", "s"),
        ("forceN", "force", "N"), ("loadKn", "load", "kN"), ("forceMN", "forceMN", None),
        ("forceZ", "forceZ", None), ("displacementN", "displacementN", None),
    ],
)  # fmt: skip
def test_a_unit_behind_a_name_is_seen_though_it_is_none_of_a_channel(name, base, unit):
    assert split_name(name) == (base, unit)


@pytest.mark.parametrize(
    ("head", "likely"),
    [("time_s,position_mm,force_mn", "mN"), ("Time (s),x (mm),Force (10^-3 N)", "UNIT")],
)
def test_a_unit_that_cannot_be_read_is_never_taken_for_newton(head, likely, tmp_path):
    rows = "".join(f"{0.01 * k:.2f},{0.01 * k:.3f},{0.1 * k:.2f}\n" for k in range(60))
    error = refusal(put(tmp_path / "a.csv", f"{head}\n{rows}"))
    assert error.code == "unknown_unit"
    assert error.message.endswith(f"--units force={likely}")


@pytest.mark.parametrize(
    ("head", "displacement", "force"),
    [
        ("Time (s),x,Force (N),Extension (mm)", "Extension (mm)", "Force (N)"),
        ("Time (s),Extension (mm),Force (N),Strain (%)", "Extension (mm)", "Force (N)"),
        ("Time (s),Position Z (mm),Force X (N),Force Z (N)", "Position Z (mm)", "Force Z (N)"),
        ("Time (s),Load Y (N),Load (Z) (N),Displacement (mm)", "Displacement (mm)", "Load (Z) (N)"),
        ("Time (s),X displacement (mm),Z displacement (mm),Force (N)", "Z displacement (mm)", "Force (N)"),
        ("Time (s),Displacement X (mm),Force (N),Comment", "Displacement X (mm)", "Force (N)"),
        ("Time (s),Set position (mm),Actual position (mm),Force (N)", "Actual position (mm)", "Force (N)"),
        (
            "Time (s),Demand position (mm),Measured position (mm),Load (N)",
            "Measured position (mm)",
            "Load (N)",
        ),
        (
            "Elapsed (s),Commanded travel (mm),Travel feedback (mm),Load (N)",
            "Travel feedback (mm)",
            "Load (N)",
        ),
        ("Time (s),Distance (mm),Soll Kraft (N),Kraft gefiltert (N)", "Distance (mm)", "Kraft gefiltert (N)"),
        ("Time (s),Travel_SP (mm),Travel_PV (mm),Load (N)", "Travel_PV (mm)", "Load (N)"),
        ("Time (s),Sollweg (mm),Istweg (mm),Kraft (N)", "Istweg (mm)", "Kraft (N)"),
        ("Time (s),Travel ref (mm),Travel fbk (mm),Load (N)", "Travel fbk (mm)", "Load (N)"),
        ("Time (s),Travel (mm),Force limit (N),Measured force (N)", "Travel (mm)", "Measured force (N)"),
        (
            "Time (s),Shear displacement (mm),Normal displacement (mm),Load (N)",
            "Normal displacement (mm)",
            "Load (N)",
        ),
        ("time,position_z,force_x,force_z", "position_z", "force_z"),
        ("Time (s),Deflection (um),Height Sensor (um),Force (nN)", "Height Sensor (um)", "Force (nN)"),
        ("Time (s),Disp 1 (mm),Disp 2 (mm),Force (N)", "Disp 1 (mm)", "Force (N)"),
        ("Time (s),LVDT 2 (mm),LVDT 1 (mm),Force1 (N)", "LVDT 1 (mm)", "Force1 (N)"),
    ],
)
def test_neither_a_sideways_axis_nor_what_was_asked_for_is_taken_for_what_was_measured(
    tmp_path: Path, head: str, displacement: str, force: str
) -> None:
    text = five(head) if not head.endswith("Comment") else f"{head}\n" + ROWS.replace("\n", ",\n")
    trial = read(put(tmp_path / "a.csv", text))
    assert (trial.source.columns["displacement"], trial.source.columns["force"]) == (displacement, force)


@pytest.mark.parametrize("value", ["0.0000", "-1.2500"])
def test_a_sensor_that_was_not_attached_is_not_taken_for_the_travel(tmp_path: Path, value: str) -> None:
    rows = ROWS.replace("\n", f",{value}\n")
    path = written(tmp_path / "a.csv", "Time (s),Position (mm),Force (N),Extension (mm)", rows)
    error = refusal(path)
    assert error.code == "no_columns"
    assert "--columns displacement='Position (mm)'" in error.message
    answered = read(path, ReadOptions(columns={"displacement": "Position (mm)"}))
    assert answered.displacement_mm[2] == 0.1


GROUPS = "Force (g),Distance (mm),Time (sec)"


@pytest.mark.parametrize(
    ("above", "head", "sheets"),
    [
        ("liver 1,,,liver 2,,", f"{GROUPS},{GROUPS}", ["liver 1", "liver 2"]),
        ("liver 1,liver 1,liver 1,liver 2,liver 2,liver 2", f"{GROUPS},{GROUPS}", ["liver 1", "liver 2"]),
        ("", f"{GROUPS},{GROUPS}", ["1", "2"]),
        ("", f"{GROUPS},Force (g).1,Distance (mm).1,Time (sec).1", ["1", "2"]),
        ("", "Force 1 (g),Distance 1 (mm),Time 1 (s),Force 2 (g),Distance 2 (mm),Time 2 (s)", ["1", "2"]),
        ("", "F1 (g),x1 (mm),t1 (s),F2 (g),x2 (mm),t2 (s)", ["1", "2"]),
        (
            "",
            "L1 Force (g),L1 Distance (mm),L1 Time (s),L2 Force (g),L2 Distance (mm),L2 Time (s)",
            ["1", "2"],
        ),
    ],
)
def test_specimens_side_by_side_whose_time_stands_last_are_all_read(tmp_path, above, head, sheets) -> None:
    rows = "".join(
        f"{k * 10:.1f},{k * 0.05:.3f},{k / 10:.1f},"
        + (f"{k * 20:.1f},{k * 0.1:.3f},{k / 5:.1f}\n" if k < 20 else ",,\n")
        for k in range(30)
    )
    path = put(tmp_path / "a.csv", f"{above}\n{head}\n{rows}")
    first, second = read_trials(path)
    assert [first.source.sheet, second.source.sheet] == sheets
    assert (first.time_s.size, second.time_s.size) == (30, 20)
    assert (first.force_N[2], second.force_N[2]) == pytest.approx((20 * 9.80665e-3, 40 * 9.80665e-3))
    lines = [line.split(",") for line in [head, *rows.splitlines()]]
    cells = [[None if c == "" else c if k == 0 else float(c) for c in line] for k, line in enumerate(lines)]
    both = read_trials(workbook(tmp_path / "a.xlsx", {"S": cells}))
    assert [trial.time_s.size for trial in both] == [30, 20]


@pytest.mark.parametrize(
    "head",
    [
        "Time (s),Load (N),Extension (mm),Time (s),Load (N),Position (mm)",
        "Time (s),Load 1 (N),Load 2 (N),Extension (mm),Position (mm),Strain (%)",
    ],
)
def test_other_sensors_of_one_specimen_are_no_second_specimen(tmp_path: Path, head: str) -> None:
    rows = "".join(
        f"{k / 10:.1f},{1 + k * 0.25:.3f},{k * 0.05:.3f},{k / 10:.1f},{k * 0.25:.3f},{k * 0.06:.3f}\n"
        for k in range(30)
    )
    assert read(written(tmp_path / "a.csv", head, rows)).source.sheet is None


@pytest.mark.parametrize("stamps", ["Date/Time,Elapsed Time (s)", "Time,t [s]"])
def test_a_time_with_a_unit_is_taken_before_a_stamp_of_whole_seconds(tmp_path: Path, stamps: str) -> None:
    rows = timed(f"3/4/2019 2:53:{10 + k // 10:02d} PM,{k / 10:.1f}" for k in range(30))
    trial = read(written(tmp_path / "a.csv", f"{stamps},Displacement (mm),Load (N)", rows))
    assert trial.time_s[29] == 2.9
    assert codes(trial) == ["column_choice"]


POUND_N = 4.4482216152605


@pytest.mark.parametrize(
    ("units", "factors"),
    [
        (("SEC", "MM", "KGF"), (1, 1, 9.80665)),
        (("Seconds", "Millimeters", "Newtons"), (1, 1, 1)),
        (("Minutes", "Inches", "pounds"), (60, 25.4, POUND_N)),
        (("msec", "microns", "gF"), (1e-3, 1e-3, 9.80665e-3)),
        (("mSec", "micrometer", "gram-force"), (1e-3, 1e-3, 9.80665e-3)),
        (("s", "mil", "ozf"), (1, 0.0254, POUND_N / 16)),
        (("SECS", "IN", "LBF"), (1, 25.4, POUND_N)),
        (("Sec.", "Inch", "Lbf"), (1, 25.4, POUND_N)),
        (("sec", "mm", "kp"), (1, 1, 9.80665)),
        (("s", "mm", "Kg"), (1, 1, 9.80665)),
        (("sec", "mm", "g"), (1, 1, 9.80665e-3)),
        (("sec", "mm", "gr"), (1, 1, 9.80665e-3)),
    ],
)
@pytest.mark.parametrize("where", ["names", "row", "above", "wide"])
def test_units_are_read_however_they_are_spelled(tmp_path, units, factors, where) -> None:
    names = ("Time", "Extension", "Load")
    over, under = ",".join(names), ",".join(units)
    head = {
        "names": ",".join(f"{name} ({unit})" for name, unit in zip(names, units, strict=True)),
        "row": f"{over}\n{under}",
        "above": f"{under}\n{over}",
        "wide": ",".join(f"{name}（{unit}）" for name, unit in zip(names, units, strict=True)),
    }[where]
    trial = read(put(tmp_path / "a.csv", f"{head}\n{ROWS}"))
    assert trial.flags == ()
    found = (trial.time_s[2], trial.displacement_mm[2], trial.force_N[2])
    # parse, factor, product: a rounding each
    assert found == pytest.approx((0.2 * factors[0], 0.1 * factors[1], 1.5 * factors[2]), rel=1e-15)


def test_names_that_go_on_in_another_line_are_read_and_lines_keep_their_numbers(tmp_path: Path) -> None:
    head = '"Time\n(ms)","Extension\r\nof the piston\n(um)","Load\n(mN)"'
    path = put(tmp_path / "a.csv", f"{head}\n{ROWS}")
    trial = read(path)
    assert trial.flags == ()
    assert (trial.time_s[2], trial.force_N[2]) == pytest.approx((2e-4, 1.5e-3))
    spoilt = put(tmp_path / "b.csv", f"{head}\n{ROWS.replace('1.500', '1.5.0')}")
    assert spoilt.read_text(encoding="utf-8").splitlines()[refusal(spoilt).line - 1].endswith("1.5.0")


@pytest.mark.parametrize("unit", ["G", "MN", "Mn", "NM", "МН", "Гс", "С"])
def test_capitals_that_may_mean_another_unit_are_not_guessed(unit: str) -> None:
    with contextlib.suppress(ValueError):
        assert factor_to(unit, "force") not in {9.80665e-3, 1e-3}
    assert quantity_of(unit) != "time"  # a Cyrillic С may be a temperature


@pytest.mark.parametrize("row", ["sek.,mm,Pond", "Sekunde,Milimeter,Newt"])
def test_words_under_the_names_that_are_no_known_units_are_asked_about(tmp_path: Path, row: str) -> None:
    path = put(tmp_path / "a.csv", f"Time,Extension,Load\n{row}\n{ROWS}")
    error = refusal(path)
    assert error.code == "unknown_unit"
    assert "--units" in error.message
    stated = ReadOptions(units={"time": "s", "displacement": "mm", "force": "lbf"})
    assert read(path, stated).force_N[2] == pytest.approx(1.5 * POUND_N)


@pytest.mark.parametrize("remark", ["Start of the test,,", "begin,,", '"","Timed",""', "n/a,n/a,n/a"])
def test_a_remark_under_the_names_is_no_row_of_units(tmp_path: Path, remark: str) -> None:
    trial = read(put(tmp_path / "a.csv", f"Time (s),Extension (mm),Load (N)\n{remark}\n{ROWS}"))
    assert codes(trial) == ["rows_skipped"]


@pytest.mark.parametrize("key", ["Y_Unit_Label", "UnitName=", "Units", "Einheiten:", "单位"])
def test_units_in_a_line_of_the_header_are_those_of_the_columns_below(tmp_path: Path, key: str) -> None:
    head = f"Operator\tlab\n{key}\tmN\tum\nSamples\t30\t30\n\nX_Value\tForce\tPosition"
    rows = "".join(f"{k / 10:.1f}\t{1 + k * 0.25:.3f}\t{k * 0.05:.3f}\n" for k in range(30))
    trial = read(put(tmp_path / "a.lvm", f"{head}\n{rows}"))
    assert codes(trial) == ["units_assumed"]  # of the time alone
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.1e-3, 1.5e-3))


def test_units_of_another_table_are_not_those_of_the_columns(tmp_path: Path) -> None:
    above = read(put(tmp_path / "b.csv", f"Units,N,um\n\nTime,Extension,Load\n{ROWS}"))
    assert above.force_N[2] == 1.5
    assert codes(above) == ["units_assumed"] * 3


def test_missing_numbers_under_the_names_are_no_units(tmp_path: Path) -> None:
    head = "Time (s),Extension (mm),Load (N)\n"
    error = refusal(put(tmp_path / "a.csv", f"{head}0.0000,NaN,NaN\n{ROWS}"))
    assert (error.code, error.line) == ("not_finite", 2)
