"""Pages of one document, populations too: their words, figures' numbers, and a browser that draws them."""

import html
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from cohort_outputs import cohort_fits, study_of
from fit_factory import identification
from rendered_tissues import PAPER_A
from report_pages import grave, payload_of, self_contained, wait_for_figures, wide
from rupture_cohorts import known_cohort, typical_threshold
from typed_call import typed_call

from tissueid.contrast.decision import Compared, contrast_document
from tissueid.design.document import design_document
from tissueid.design.machine import PRESETS
from tissueid.design.plan import against, planned
from tissueid.design.precision import Asked, given_protocol
from tissueid.design.tissues import given_recipe, of_recipe_tissue, parsed_want
from tissueid.documents import plain, typed
from tissueid.documents.identification import Identification
from tissueid.documents.selfcheck import Source
from tissueid.model.channels import ChannelModel
from tissueid.population.cohort import CohortOptions, cohort
from tissueid.population.document import as_document as population_document
from tissueid.population.document import members_of, population_bundle
from tissueid.population.sampler import SamplerOptions
from tissueid.report import contrast_page, design_page, reproduction_page, rupture_page, selfcheck_page
from tissueid.report.page import render_plain
from tissueid.report.parts import Figure, Section, Table
from tissueid.report.population_page import (
    MOST_DRAWN,
    held_out_sentence,
    population_payload,
    render_population,
)
from tissueid.reproduce.controller import table_3
from tissueid.reproduce.document import PAPER_WORDS, PLACES
from tissueid.reproduce.hip import guidance_forces, restitutions
from tissueid.reproduce.published import PIRES, SADEGHNEJAD, Ledger, Readings, rounded
from tissueid.reproduce.speeds import force_displacement, peak_against_speed
from tissueid.rupture.run import RuptureRun, as_document
from tissueid.rupture.study import rupture_study
from tissueid.selfcheck.protocol import of_recipe
from tissueid.selfcheck.records import Record
from tissueid.selfcheck.tissue import tissue_check
from tissueid.selfcheck.verdicts import check_document
from tissueid.store.curves import curves_of_fits
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.store.schema import first_problem
from tissueid.synth import recipe

contrast_verdict = typed_call(contrast_page.contrast_verdict)
render_contrast = typed_call(contrast_page.render_contrast)
render_design = typed_call(design_page.render_design)
render_reproduction = typed_call(reproduction_page.render_reproduction)
render_rupture = typed_call(rupture_page.render_rupture)
render_selfcheck = typed_call(selfcheck_page.render_selfcheck)


def tissue(name: str, scale: float) -> Compared:
    chance = np.random.default_rng(len(name))
    theta = PAPER_A.theta * np.array([scale, scale, scale, scale, 1.0])
    draws = theta * np.exp(0.01 * chance.standard_normal((150, 5)))
    model = PAPER_A.model
    assert isinstance(model, ChannelModel)
    return Compared(name, model, draws, (PAPER_A.speeds_mm_s[0], PAPER_A.speeds_mm_s[1]), total=False)


@cache
def contrast(*tissues: Compared) -> dict[str, Any]:
    found = tissues or (tissue("kidney", 1.0), tissue("liver", 1.5))
    return plain(contrast_document(found, clamp_N=5.0))


@cache
def design(machine_name: str = "paper-a") -> dict[str, Any]:
    machine, given = PRESETS[machine_name], given_recipe("paper-a-30")
    tissues = of_recipe_tissue(given)
    wants = tuple(parsed_want(text, tissues.model) for text in ("tau=2%", "eta=1%"))
    asked = Asked(wants=wants, max_depth_mm=8.0, max_force_N=machine.max_force_N)
    other = against(given.name, given_protocol(given), machine, tissues, asked)
    plan = planned(machine, tissues, asked, lambda _message, _done, _total: None)
    return plain(design_document(plan, machine, tissues, asked, given=other, specimens=17))


@cache
def reproduction() -> dict[str, Any]:
    readings, ledger = Readings(), Ledger(SADEGHNEJAD, "Table 2")
    items, figures = [ledger.item("table-2/tau", 0.0234, judge=rounded(3))], []
    for made in (force_displacement, peak_against_speed, guidance_forces):
        rows, figure = made(readings)
        items += rows
        figures.append(figure)
    items += [*restitutions(), *table_3(readings)]
    papers = [
        {"name": name, "words": PAPER_WORDS[name], "places": PLACES[name]} for name in (SADEGHNEJAD, PIRES)
    ]
    run = {"schema": "tissueid/reproduction/1", "tissueid": "0", "seed": 1, "seconds": 1.0, "papers": papers}
    found = {"readings": readings.as_json(), "items": plain(items), "figures": plain(figures)}
    return plain({**run, **found, "lost": ["everything"]})


@cache
def rupture(speeds: tuple[float, ...] = ()) -> dict[str, Any]:
    tested = {"speeds": speeds} if speeds else {"stop_mm": 6.0}
    failures = known_cohort("work", 0.05, [12], threshold=typical_threshold("work"), **tested)
    run = RuptureRun(rupture_study(failures, weight=1.5, asked="auto"), identification([]), ())
    return plain(as_document(run, {one.specimen: f"bundle-{one.specimen}.h5" for one in failures}))


NAMES = ("relaxation_time_s", "viscosity_N_s_per_mm", "force_N at 4 mm, 2.9 mm/s")


@cache
def selfcheck(*, narrow: bool = False) -> dict[str, Any]:
    """A check of 100 simulations whose ranks are uniform, or pile up at both ends."""
    rng = np.random.default_rng(12)
    protocol, centre = of_recipe(recipe("paper-a-hold-100Hz"))
    ranks = rng.integers(0, 400, (100, 3))
    if narrow:
        ranks[:, 0] = np.where(rng.random(100) < 0.5, 0, 399)
    records = [
        Record(
            index=i,
            truth=dict(zip(NAMES, z, strict=True)),
            mean=dict.fromkeys(NAMES, 0.0),
            sd=dict.fromkeys(NAMES, 1.0),
            rank={name: int(value) for name, value in zip(NAMES, rank, strict=True)},
            seconds=0.5,
            detail={"acceptance": 0.6},
        )
        for i, (z, rank) in enumerate(zip(rng.standard_normal((100, 3)), ranks, strict=True))
    ]
    source, check = Source("recipe", "paper-a-hold-100Hz", "paper-a"), tissue_check(protocol, centre)
    return plain(check_document(source, protocol, check, records, simulations=100, seed=7)[0])


def contrast_words(found: dict[str, Any]) -> Sequence[str]:
    limits = ("10.1068/p180681", "10.1007/BF00228884", "10.1007/BF00230304")
    said = ("kidney and liver differ.", "A hand could tell: force", *limits)
    return [*said, *(row["name"] for row in found["pairs"][0]["numbers"])]


def design_words(found: dict[str, Any]) -> Sequence[str]:
    best, other = found["protocols"][0], found["against"]["protocol"]
    moves = [
        f"{row['repeats']} × {row['words']}" for one in found["protocols"] for row in one["indentations"]
    ]
    taken = f"{best['logs']} logs in {best['seconds'] / 60:.1f} min of machine time"
    given = f"paper-a-30 takes {other['seconds'] / 60:.1f} min"
    said = ("<strong>Within reach.</strong>", "17 specimens", "The frame is taken as rigid")
    return [*moves, taken, given, *said]


def limits_words(found: dict[str, Any]) -> Sequence[str]:
    tau = found["protocols"][0]["precision"][0]["assured"]
    refused = "paper-a-30 can’t be run on this machine: it moves at 70 mm/min"
    said = ("<strong>None on this machine.</strong>", "What limits it", refused, "fit will flag it")
    limits = (one["words"] for one in found["verdict"]["limits"])
    return [*said, f"relaxation time to {100 * tau:.1f} %", *limits]


def reproduction_words(found: dict[str, Any]) -> Sequence[str]:
    kinds = {item["kind"] for item in found["items"]}
    marks = [f"{reproduction_page.KINDS[kind][1]}</i>{kind}</span>" for kind in kinds]
    return [*marks, "Not everything agrees", "Differing: Relaxation time."]


def rupture_words(found: dict[str, Any]) -> Sequence[str]:
    said = ("Criterion: work.", "The bundles rupture by total work.", "In the bundles")
    return [*said, f"{found['criteria'][0]['median']:.1f} N mm", *found["sentences"]]


def selfcheck_words(found: dict[str, Any]) -> Sequence[str]:
    covered = [f">{100 * row['fraction']:.1f}<" for one in found["parameters"] for row in one["coverage"]]
    return [
        *covered,
        "<strong>Calibrated.</strong>",
        "for this protocol, model and noise the intervals hold what they claim",
        "the program of paper-a-hold-100Hz at 100 Hz; 1 log, 3,191 samples",
        "sampler emcee, seed 7, 0.50 s each",
        "log-normal, median 0.021, sd of ln 0.4",
    ]


def narrow_words(_: dict[str, Any]) -> Sequence[str]:
    covers = "relaxation_time_s: the 95 % interval covers 0.0 % (band"
    return ["<strong>Not calibrated.</strong>", covers, "0.0 (outside)"]


Words = Callable[[dict[str, Any]], Sequence[str]]
SLOW = [pytest.mark.needs_jit, pytest.mark.system]
#: Name of the schema, the page, its document, and what it must say.
CASES = [
    pytest.param("contrast", render_contrast, contrast, contrast_words, id="contrast"),
    pytest.param("design", render_design, design, design_words, id="design", marks=SLOW),
    pytest.param(
        "design", render_design, partial(design, "slow-logger"), limits_words, id="limits", marks=SLOW
    ),
    pytest.param("reproduction", render_reproduction, reproduction, reproduction_words, id="reproduction"),
    pytest.param(
        "rupture", render_rupture, rupture, rupture_words, id="rupture", marks=pytest.mark.needs_jit
    ),
    pytest.param("selfcheck", render_selfcheck, selfcheck, selfcheck_words, id="selfcheck"),
    pytest.param("selfcheck", render_selfcheck, partial(selfcheck, narrow=True), narrow_words, id="narrow"),
]


@pytest.mark.parametrize(("schema", "render", "made", "words"), CASES)
def test_a_page_asks_the_network_for_nothing_and_says_its_numbers(schema, render, made, words):
    document = made()
    assert first_problem(document, schema) is None
    page = html.unescape(self_contained(partial(render, document)).partition("<script>")[0])
    assert [said for said in words(document) if said not in page] == []


def drawn_figures(tab: Any) -> list[list[dict[str, Any]]]:
    """Name and points of every trace of every figure, as plotly holds them, in the order of the payload."""
    tab.wait_for_function("[...document.querySelectorAll('[data-figure]')].every((box) => box.data)")
    boxes: list[Any] = tab.evaluate(
        """[...document.querySelectorAll('[data-figure]')].map((box) => [
            Number(box.dataset.place ?? box.dataset.figure),
            box.data.map((one) => ({name: one.name, x: Array.from(one.x), y: Array.from(one.y)}))])"""
    )
    return [traces for _, traces in sorted(boxes, key=lambda box: box[0])]


@pytest.mark.system
@pytest.mark.browser
@pytest.mark.parametrize(("schema", "render", "made", "words"), CASES[:2] + CASES[3:6])
@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (400, "dark")])
def test_a_browser_draws_the_numbers_of_the_payload(opened, schema, render, made, words, width, scheme):
    page = render(made())
    tab = opened(page, width=width, height=6000, color_scheme=scheme)
    figures = payload_of(page, "payload")
    for box in tab.locator("[data-figure]").all():
        box.scroll_into_view_if_needed()
    wait_for_figures(tab, len(figures))
    wanted = [
        [{"name": one.get("name"), "x": one["x"], "y": one["y"]} for one in figure["traces"]]
        for figure in figures
    ]
    assert drawn_figures(tab) == wanted
    titles = tab.evaluate("[...document.querySelectorAll('.xtitle')].map((one) => one.textContent)")
    assert Counter(titles) == Counter(figure["x"] for figure in figures)
    tab.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    assert wide(tab) <= width
    assert grave(tab) == []


def points(page: str, place: int) -> dict[str, tuple[list[float], list[float]]]:
    """Points of the named traces of a figure that a page carries."""
    return {
        one["name"]: (one["x"], one["y"])
        for one in payload_of(page, "payload")[place]["traces"]
        if one.get("name")
    }


def test_equal_tissues_are_not_called_equal():
    words = contrast_verdict(contrast(tissue("kidney", 1.0), tissue("kidnez", 1.0)))
    assert "not shown to differ" in words.title
    assert "no proof of being equal" in words.text
    assert "A hand would hardly tell" in words.text


def test_several_pairs_are_counted_against_chance():
    document = contrast(tissue("a", 1.0), tissue("bb", 1.0), tissue("<b>ccc</b>", 1.5))
    assert contrast_verdict(document).text.startswith(
        "2 of 3 pairs differ at the 2 % level; of tissues that are all one, 0.06 would"
    )
    page = render_contrast(document)
    assert [f'href="#pair-{pair}"' in page for pair in (1, 2, 3)] == [True] * 3
    # a name is text
    assert "<b>ccc" not in page
    alike = contrast(tissue("a", 1.0), tissue("bb", 1.0), tissue("c", 1.0))
    assert "None shown" in contrast_verdict(alike).title


def test_curves_and_ratios_of_tissues_are_those_of_the_document():
    document = contrast()
    page = render_contrast(document)
    loading, hold, (ratio,) = (figure["traces"] for figure in payload_of(page, "payload"))
    rows = [(one["name"], curve) for one in document["curves"] for curve in one["loading"]]
    assert len(loading) == 3 * len(rows)
    for place, (name, curve) in enumerate(rows):
        for trace, kind in zip(loading[3 * place :], ("low", "high", "median"), strict=False):
            assert trace["name"].startswith(name)
            assert (trace["x"], trace["y"]) == (curve["depth_mm"], curve[kind])
    for trace, one in zip(hold[2::3], document["curves"], strict=True):
        assert (trace["x"], trace["y"]) == (one["hold"]["time_s"][1:], one["hold"]["median"][1:])
    ratios = {row["name"]: row["ratio"][1] for row in document["pairs"][0]["numbers"]}
    assert dict(zip(ratio["y"], ratio["x"], strict=True)) == ratios


@pytest.mark.system
@pytest.mark.needs_jit
@pytest.mark.parametrize("want", [0, 1])
def test_precision_against_time_holds_the_points_of_the_tables(want):
    document = design()
    page = render_design(document)
    found, layout = points(page, want), payload_of(page, "payload")[want]["layout"]
    assert [layout[axis]["type"] for axis in ("xaxis", "yaxis")] == ["log", "log"]
    assert "What limits it" not in page
    rows = {
        "least time": sorted(document["front"], key=lambda one: one["seconds"]),
        "protocols": document["protocols"],
        "paper-a-30": [document["against"]["protocol"]],
    }
    for name, protocols in rows.items():
        assert found[name] == (
            [one["seconds"] / 60.0 for one in protocols],
            [100.0 * one["precision"][want]["assured"] for one in protocols],
        )
    assert found["wanted"][1] == [100.0 * document["asked"]["wants"][want]["share"]] * 2


def test_rows_say_their_kind_and_figures_are_those_of_the_papers():
    document = reproduction()
    page = render_reproduction(document)
    for item in document["items"]:
        row = page.partition(f'data-item="{item["item"]}"')[2].partition("</tr>")[0]
        assert f"</i>{item['kind']}</span>" in row
        assert ("not printed" in row) is (item["published"] is None)
    for place, figure in enumerate(document["figures"]):
        found = points(page, place)
        assert found == {one["name"]: (one["x"], one["y"]) for one in figure["traces"]}
    right = {**document, "items": document["items"][1:]}
    assert "Not everything agrees" not in render_reproduction(right)


@pytest.mark.needs_jit
def test_ruptures_are_counted_drawn_and_written_into_bundles_or_not():
    document = rupture()
    censored = sum(not one["ruptured"] for one in document["tests"])
    assert sum(row["censored"] for row in document["speeds"]) == censored > 0
    assert f"{censored} of 18 tests ended without a rupture" in " ".join(document["sentences"])
    force, _, reached = (figure["traces"] for figure in payload_of(render_rupture(document), "payload"))
    assert len(force) == len({one["specimen"] for one in document["tests"] if one["ruptured"]}) + 1
    assert len([one for one in reached if one["visible"] is True]) == 2
    without = render_rupture(document | {"laws": [], "taken": "none", "asked": "none"})
    assert "No rupture is written into the bundles." in without
    assert "In the bundles" not in without
    single = rupture((600.0,))
    assert "one speed" in single["decision"]["reason"]
    assert "Undecided." in render_rupture(single)


def test_ranks_are_drawn_in_their_bins():
    figures = payload_of(render_selfcheck(selfcheck()), "payload")
    assert len(figures) == 2 * len(NAMES)
    histograms = [one["histogram"] for one in selfcheck()["parameters"]]
    assert [figure["traces"][0]["y"] for figure in figures[1::2]] == histograms
    assert render_selfcheck(selfcheck(narrow=True)).count("not calibrated") == 1


LINE = {"x": [0, 1], "y": [1, 2], "mode": "lines", "line": {"ink": "data", "width": 3}}
DOTS = {"x": [0, 1], "y": [2, 1], "mode": "markers", "marker": {"ink": "model"}}


def sections() -> str:
    figure = Figure("Two <lines>", "x [mm]", "y [N]", [LINE, DOTS], {"yaxis": {"rangemode": "tozero"}})
    table = Table(("a", "b"), [("1", "<2>")])
    return render_plain("A <title>", [Section("One", "Words.", [table], [figure])])


def test_a_page_of_sections_is_escaped_and_carries_no_script_without_figures():
    page = sections()
    assert "A &lt;title&gt;" in page
    assert "<td>&lt;2&gt;</td>" in page
    (figure,) = payload_of(page, "figures")
    assert (figure["x"], figure["traces"]) == ("x [mm]", [LINE, DOTS])
    assert "<script" not in render_plain("Empty", [Section("One", "Words.")])


@pytest.mark.system
@pytest.mark.browser
def test_a_browser_draws_sections_in_the_pages_colours(opened):
    tab = opened(sections())
    assert len(drawn_figures(tab)[0]) == 2
    colours = tab.evaluate("document.querySelector('[data-figure]').data.map((one) => one.line?.color)")
    ink = tab.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--data').trim()")
    assert colours[0] == ink


members_of = typed_call(members_of)
held_out_sentence = typed_call(held_out_sentence)
render_population = typed_call(render_population)
population_payload = typed_call(population_payload)


@pytest.fixture(scope="module")
def found():
    fits = cohort_fits(6)
    document = plain(identification(fits).as_json()) | {"study": study_of(fits)}
    options = CohortOptions(group_by="sex", sampler=SamplerOptions(draws=1000, blocks=1))
    results = [
        (entry, curves_of_fits([one]), posteriors_of_fits([one])[0])
        for entry, one in zip(typed(document, Identification).specimens, fits, strict=True)
    ]
    fit = cohort(members_of(document, results), options)
    document = population_document(fit, options, source="0" * 64)
    bundle = population_bundle(fit, document.provenance)
    assert bundle is not None
    return plain(document), bundle


def test_the_page_asks_the_network_for_nothing_and_says_its_numbers(found):
    document, bundle = found
    page = self_contained(partial(render_population, document, bundle))
    said = ("Population of 6 specimens", "Intraclass correlation", "sex: m against f", "4.23 to 10.95 %")
    for words in (*said, document["population"]["quantities"][2]["words"]):
        assert words in page


def test_paper_a_is_compared_with_and_not_claimed():
    spread = {"median": 0.05, "low68": 0.02, "high68": 0.13}
    wide = {"median": 0.4, "low68": 0.2, "high68": 0.5}
    held: dict[str, Any] = {
        "folds": 3, "paper_a_percent": [4.23, 10.95], "nrmsd_range": spread, "nrmsd_mean": wide, "trials": [],
    }  # fmt: skip

    assert "is consistent with that, which proves nothing" in held_out_sentence(held)
    assert "lies outside that" in held_out_sentence(held | {"nrmsd_range": wide})


def test_bands_of_force_hold_the_typical_tissue(found):
    bands = population_payload(*found)["bands"]
    low, high = bands["quantiles"][0], bands["quantiles"][4]
    assert all(a <= b <= c for a, b, c in zip(low[1:], bands["typical"][1:], high[1:], strict=True))


def test_a_large_cohort_draws_its_outliers_and_an_even_choice(found):
    document, _ = found
    row = document["population"]["specimens"][0]
    many = [
        row | {"specimen": f"s{k}", "outlier": "relaxation_time_s" if k == 777 else None} for k in range(900)
    ]
    large = document | {"population": document["population"] | {"specimens": many}}

    shown = population_payload(large, None)["specimens"]

    assert len(shown) == MOST_DRAWN
    assert [one["name"] for one in shown if one["outlier"]] == ["s777"]


@pytest.mark.browser
def test_figures_draw_themselves_without_an_error(opened, found):
    page = opened(render_population(*found), width=1200, height=6000)
    wait_for_figures(page, 5)
    page.select_option("#quantity", "4")
    page.wait_for_timeout(300)
    axis = page.evaluate("document.querySelector('[data-figure=shrinkage]').layout.yaxis.title.text")
    points = page.evaluate(
        "document.querySelector('[data-figure=shrinkage]').querySelectorAll('.scatterlayer .point').length"
    )
    assert axis == "relaxation time [s]"
    # six specimens, alone and with the population
    assert points == 12
