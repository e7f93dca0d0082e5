"""The words of an export in the languages of its program, as machines print them.

Written down apart from the reader's vocabulary, so that the two can be held against each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Words:
    """Names that one language gives the parts of an export."""

    names: tuple[str, str, str]  # columns of time, displacement and force
    #: Header keys, with their group before ``" : "``.
    label: str
    note: str
    rate: str
    depth: str
    hold: str
    results: str  # title of a table of results
    peak: str  # a result: the largest load
    statistics: tuple[str, str]  # row labels: mean and standard deviation


#: Language code -> words.
LANGUAGES: Mapping[str, Words] = MappingProxyType(
    {
        "en": Words(
            ("Time", "Extension", "Load"),
            "Text Inputs : Specimen label",
            "General : Sample note",
            "Test : Rate 1",
            "Test : Indentation depth",
            "Test : Hold time",
            "Results Table 1",
            "Maximum Load",
            ("Mean", "Standard deviation"),
        ),
        "de": Words(
            ("Zeit", "Traversenweg", "Last"),
            "Texteingaben : Probenbezeichnung",
            "Allgemein : Bemerkung",
            "Prüfung : Geschwindigkeit 1",
            "Prüfung : Eindringtiefe",
            "Prüfung : Haltezeit",
            "Ergebnistabelle 1",
            "Maximale Last",
            ("Mittelwert", "Standardabweichung"),
        ),
        "fr": Words(
            ("Temps", "Déplacement", "Charge"),
            "Saisies de texte : Libellé de l'éprouvette",
            "Général : Remarque",
            "Essai : Vitesse 1",
            "Essai : Profondeur d'indentation",
            "Essai : Temps de maintien",
            "Tableau de résultats 1",
            "Charge maximale",
            ("Moyenne", "Écart type"),
        ),
        "es": Words(
            ("Tiempo", "Extensión", "Carga"),
            "Entradas de texto : Etiqueta de probeta",
            "General : Nota de muestra",
            "Ensayo : Velocidad 1",
            "Ensayo : Profundidad de indentación",
            "Ensayo : Tiempo de retención",
            "Tabla de resultados 1",
            "Carga máxima",
            ("Media", "Desviación estándar"),
        ),
        "pt": Words(
            ("Tempo", "Extensão", "Carga"),
            "Entradas de texto : Rótulo do corpo de prova",
            "Geral : Nota da amostra",
            "Ensaio : Velocidade 1",
            "Ensaio : Profundidade de indentação",
            "Ensaio : Tempo de retenção",
            "Tabela de resultados 1",
            "Carga máxima",
            ("Média", "Desvio padrão"),
        ),
        "it": Words(
            ("Tempo", "Estensione", "Carico"),
            "Immissioni di testo : Etichetta provino",
            "Generale : Nota del campione",
            "Prova : Velocità 1",
            "Prova : Profondità di indentazione",
            "Prova : Tempo di mantenimento",
            "Tabella risultati 1",
            "Carico massimo",
            ("Media", "Deviazione standard"),
        ),
        "pl": Words(
            ("Godzina", "Przemieszczenie", "Obciążenie"),
            "Pola tekstowe : Etykieta próbki",
            "Ogólne : Uwaga",
            "Badanie : Prędkość 1",
            "Badanie : Głębokość wgłębienia",
            "Badanie : Czas przetrzymania",
            "Tabela wyników 1",
            "Maksymalne obciążenie",
            ("Średnia", "Odchylenie standardowe"),
        ),
        "zh": Words(
            ("时间", "位移", "载荷"),
            "文本输入 : 试样标签",
            "常规 : 样品备注",
            "测试 : 速率 1",
            "测试 : 压入深度",
            "测试 : 保持时间",
            "结果表 1",
            "最大载荷",
            ("平均值", "标准偏差"),
        ),
        "ja": Words(
            ("時間", "変位", "荷重"),
            "テキスト入力 : 試験片ラベル",
            "一般 : 備考",
            "試験 : 試験速度 1",
            "試験 : 押込み深さ",
            "試験 : 保持時間",
            "結果表 1",
            "最大荷重",
            ("平均", "標準偏差"),
        ),
    }
)
