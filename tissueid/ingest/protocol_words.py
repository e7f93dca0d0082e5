"""Header keys that state the protocol, in the languages of the test programs.

Each pattern matches the last part of a key in plain words (lower case, without accents, unit and group):
``"Prüfung : Geschwindigkeit 1"`` is ``geschwindigkeit 1``.
"""

from __future__ import annotations

import re
from functools import cache

from tissueid.ingest.vocabulary import plain_words

_NUMBER = r"(?: 1)?"
RATE = re.compile(
    r"(?:test |crosshead |ramp |loading |indentation |piezo |displacement |machine )?(?:rate|speed|velocity)"
    rf"{_NUMBER}|v1|test ?geschwindigkeit{_NUMBER}|rate{_NUMBER}"
    rf"|(?:pruf|eindring|verfahr|traversen)?geschwindigkeit{_NUMBER}"
    rf"|vitesse(?: d essai| de (?:la )?traverse| d indentation)?{_NUMBER}|taux{_NUMBER}"
    rf"|velocidad(?: de(?:l)? (?:ensayo|la cruceta|indentacion))?{_NUMBER}|tasa{_NUMBER}"
    rf"|velocidade(?: d[eo] (?:ensaio|teste|indentacao))?{_NUMBER}|taxa{_NUMBER}"
    rf"|velocita(?: di prova| della traversa| di indentazione)?{_NUMBER}"
    rf"|predkosc(?: (?:badania|testu|trawersy))?{_NUMBER}"
    rf"|(?:试验|测试|加载|压入)?(?:速度|速率){_NUMBER}|試験速度{_NUMBER}"
)
DEPTH = re.compile(
    r"(?:indentation|penetration|target|maximum|max) (?:depth|displacement|indentation|extension)|depth"
    r"|ramp amplitude|eindring(?:tiefe|weg)|zieltiefe"
    r"|profondeur(?: d indentation| maximale| de penetration)?|enfoncement(?: maximal)?"
    r"|profundidad(?: de (?:indentacion|penetracion)| maxima)?"
    r"|profundidade(?: de (?:indentacao|penetracao)| maxima)?"
    r"|profondita(?: di (?:indentazione|penetrazione)| massima)?"
    r"|glebokosc(?: (?:wglebienia|indentacji|zaglebienia))?|压入深度|压痕深度|最大深度|押込み深さ"
)
HOLD = re.compile(
    rf"(?:hold|dwell|relaxation|wait)(?:ing)?(?: time| duration)?{_NUMBER}|fixed relaxation time"
    rf"|(?:halte|relaxations|verweil)(?:zeit|dauer){_NUMBER}"
    rf"|(?:temps|duree) (?:de )?(?:maintien|relaxation|pause){_NUMBER}"
    rf"|(?:tiempo|duracion) de (?:retencion|mantenimiento|espera|relajacion){_NUMBER}"
    rf"|(?:tempo|duracao) de (?:retencao|espera|manutencao|relaxamento|relaxacao){_NUMBER}"
    rf"|(?:tempo|durata) di (?:mantenimento|attesa|rilassamento|tenuta){_NUMBER}"
    rf"|czas (?:przetrzymania|utrzymania|relaksacji|wytrzymania){_NUMBER}"
    rf"|(?:保持|保载|松弛)时间{_NUMBER}|保持時間{_NUMBER}"
)
LOAD_LIMIT = re.compile(
    r"(?:maximum |max |upper )?(?:load|force) (?:limit|threshold|trigger)|trigger (?:load|force)"
    r"|kraft(?:grenze|grenzwert|schwelle)|limite (?:de|di) (?:force|charge|carga|fuerza|forca|forza|carico)"
    r"|granica (?:sily|obciazenia)|(?:载荷|力)(?:上限|限值)|荷重上限"
)
TIP_RADIUS = re.compile(
    r"(?:tip|tool|indenter|probe|sphere) radius|(?:spitzen|kugel|indenter|eindringkorper)radius"
    r"|rayon (?:de (?:la )?(?:pointe|bille)|de l indenteur)|radio (?:de la (?:punta|bola)|del indentador)"
    r"|raio (?:da ponta|do indentador)|raggio (?:della punta|dell indentatore|del penetratore)"
    r"|promien (?:koncowki|wglebnika)|压头半径|探头半径"
)
TIP_DIAMETER = re.compile(
    r"(?:tip|tool|indenter|probe|sphere) diameter|(?:spitzen|kugel|indenter|stempel)durchmesser"
    r"|diametre (?:de (?:la )?(?:pointe|bille)|de l indenteur|du poincon)"
    r"|diametro (?:de la (?:punta|bola)|del indentador|da ponta|do indentador|della punta|del penetratore)"
    r"|srednica (?:koncowki|wglebnika)|压头直径|探头直径"
)
_ALL = (RATE, DEPTH, HOLD, LOAD_LIMIT, TIP_RADIUS, TIP_DIAMETER)
_UNIT_AT_END = re.compile(r" (?:(?:m|\u03bc|u|n)?m(?: (?:s|sec|min))?|s|sec|n)$")


@cache
def last_part(key: str) -> str:
    """A key without group, unit and final colon: ``"Test : Rate 1 (mm/min)"`` gives ``"rate 1"``."""
    return _UNIT_AT_END.sub("", plain_words(key.rsplit(" : ", 1)[-1]))


def is_protocol_key(key: str) -> bool:
    """True where a header key states rate, depth, hold, load limit or tip."""
    words = last_part(key)
    return any(pattern.fullmatch(words) for pattern in _ALL)
