"""Recordings that are no specimens, by the names that test programs give them.

testXpert writes mean and typical curves as sheets beside the tests (``Eprouvette moyenne``, ``Mittelwert``),
other programs summaries and statistics; a Mach-1 file begins with the machine's own search for contact.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from tissueid.flags import Flag
from tissueid.ingest.vocabulary import plain_words

_MEANS = (
    r"(?:mean|averaged?|typical|median|representative)(?: (?:curve|specimen|sample|test|trace|values?))?"
    r"|mittelwert(?:e|s?kurve)?|mittelkurve|mittlere (?:kurve|probe)|durchschnitt(?:skurve|swerte?)?"
    r"|(?:typische|reprasentative) (?:kurve|probe)|typkurve"
    r"|(?:eprouvette|courbe|essai|valeurs?) (?:moyen(?:ne)?s?|type|typique|medianes?|representative?)|moyenne"
    r"|(?:curva|probeta|ensayo|provino|prova|corpo de prova) (?:medi[ao]|promedio|tipic[ao])"
    r"|promedio|(?:krzywa|probka) (?:srednia|typowa)|srednia"
    r"|平均(?:曲线|值|试样)?|典型(?:曲线|试样)|代表曲线"
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
_KINDS = (("mean", _MEANS), ("summary", _SUMMARIES), ("search", _SEARCHES))
_WHAT = {
    "mean": "a mean or typical curve",
    "summary": "a summary",
    "search": "the machine's search for contact",
}


def no_specimen(path: str, sheet: str | None) -> Flag | None:
    """``not_a_specimen``, where the name of a file, sheet, block or specimen says so.

    ``path``: file; ``sheet``: sheet, block, specimen or member of an archive; parts behind ``::``.
    """
    names = [PurePosixPath(path.replace("\\", "/")).stem]
    parts = [] if sheet is None else sheet.split("::")
    names += [PurePosixPath(part).stem if "/" in part or "." in part else part for part in parts]
    for name in names:
        words = re.sub(r"^\d+ | \d+$", "", plain_words(name))
        for kind, pattern in _KINDS:
            sheets = kind == "mean" and parts and name is not names[0] and re.fullmatch(_AMONG_SHEETS, words)
            if sheets or re.fullmatch(pattern, words):
                return Flag(
                    "not_a_specimen",
                    f"{name!r} is {_WHAT[kind]}, no specimen, and is not fitted",
                    {"kind": kind},
                )
    return None
