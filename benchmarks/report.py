"""Size of a report, the time of writing it, and how soon it answers, at 5.7 million samples.

Thirty Bluehill CSVs of the published protocol at 10 kHz (5.7e6 rows in all) are fitted with every default.
The report is then written again by ``tissueid report`` in a process of its own, imports and the reading of
the folder included: more than it costs beyond the fit.  A browser opens it, and from the end of loading it
is timed until a click on a heading has sorted the table of trials, and until a drag in the first figure has
zoomed it.

    python benchmarks/report.py [--rate 10000] [--repeats 3] [--fit-option --sampler=none ...] [--json]

Bars: 7 MB, 5 s, 3 s.  Times are medians of the repeats; all of them are printed with ``--json``.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from harness import command_line, run

RECIPE = "paper-a-30-k1"
CHROMIUM = Path("/usr/bin/chromium")
BARS = {"bytes": 7_000_000, "write_s": 5.0, "first_sort_s": 3.0, "first_zoom_s": 3.0}
#: Long enough for a slow machine; a page that never answers fails.
PATIENCE_MS = 60_000

SORTED = """table => {
    const heading = document.querySelector(`${table} thead th:nth-child(2)`);
    return heading.hasAttribute("aria-sort");
}"""
PAINTED = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
ZOOMED = """() => {
    const box = document.querySelector(".first [data-figure]");
    return Boolean(box.layout) && box.layout.xaxis.autorange === false;
}"""


def opened(engine: Any, page: Path) -> tuple[Any, float, float]:
    """A tab with the loaded page, when it was loaded, and how long that took."""
    tab = engine.new_context(viewport={"width": 1400, "height": 900}).new_page()
    start = time.perf_counter()
    tab.goto(page.as_uri(), wait_until="load", timeout=PATIENCE_MS)
    loaded = time.perf_counter()
    return tab, loaded, loaded - start


def answers(page: Path) -> dict[str, float]:
    """Seconds of loading, and from its end to the first sort and to the first zoom, each in a fresh tab."""
    from playwright.sync_api import sync_playwright

    found = {}
    with sync_playwright() as playwright:
        engine = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        tab, loaded, found["load_s"] = opened(engine, page)
        table = "#specimen-1-trial-table"
        tab.evaluate(
            "table => document.querySelector(`${table} thead th:nth-child(2) button`).click()", table
        )
        tab.wait_for_function(SORTED, arg=table, timeout=PATIENCE_MS)
        tab.evaluate(PAINTED)
        found["first_sort_s"] = time.perf_counter() - loaded
        tab.close()
        tab, loaded, _ = opened(engine, page)
        tab.wait_for_function(
            "() => Boolean(document.querySelector('.first [data-figure]').data)", timeout=PATIENCE_MS
        )
        area = tab.locator(".first [data-figure] .nsewdrag").first.bounding_box()
        x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
        tab.mouse.move(x - 80, y - 60)
        tab.mouse.down()
        tab.mouse.move(x, y, steps=3)
        tab.mouse.move(x + 80, y + 60, steps=3)
        tab.mouse.up()
        tab.wait_for_function(ZOOMED, timeout=PATIENCE_MS)
        tab.evaluate(PAINTED)
        found["first_zoom_s"] = time.perf_counter() - loaded
        engine.close()
    return found


def measured(out: Path, repeats: int) -> dict[str, list[float]]:
    """Times of every repeat: writing the report, and its answers in a browser."""
    times: dict[str, list[float]] = {}
    for _ in range(repeats):
        wall, processor, _ = run("-m", "tissueid", "report", str(out), "-q")
        times.setdefault("write_s", []).append(wall)
        times.setdefault("write_processor_s", []).append(processor)
        for name, value in (answers(out / "report.html") if CHROMIUM.exists() else {}).items():
            times.setdefault(name, []).append(value)
    return times


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--rate", type=float, default=10_000.0, help="samples a second")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--fit-option", action="append", default=[], help="one more for `tissueid fit`")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder) / "logs", Path(folder) / "out"
        run("-m", "tissueid", "synth", RECIPE, "-o", str(data), "--rate", f"{options.rate:g}", "-q")
        fit = ("fit", str(data), "-o", str(out), "--specimen-by", "logs", "-q", *options.fit_option)
        fit_s, _, _ = run("-m", "tissueid", *fit)
        document = json.loads((out / "identification.json").read_bytes())
        samples = sum(one["n_samples"] for one in document["provenance"]["inputs"])
        times = measured(out, options.repeats)
        size = (out / "report.html").stat().st_size
    found: dict[str, float] = {"bytes": size}
    found |= {name: statistics.median(values) for name, values in times.items()}
    verdicts = {name: found[name] <= bar for name, bar in BARS.items() if name in found}
    if options.json:
        print(
            json.dumps(
                {
                    "recipe": RECIPE, "rate_Hz": options.rate, "samples": samples, "logs": len(
                        document["provenance"]["inputs"]
                    ), "fit_options": options.fit_option, "fit_s": fit_s, **found, "repeats": times,
                    "bars": BARS, "within": verdicts,
                },
                indent=1,
            )
        )  # fmt: skip
        return
    print(f"{samples:,} samples in {len(document['provenance']['inputs'])} logs; fit {fit_s:.1f} s")
    for name, value in found.items():
        bar = BARS.get(name)
        shown = f"{value:,}" if name == "bytes" else f"{value:.2f}"
        print(f"{name:14} {shown:>12}" + ("" if bar is None else f"   bar {bar:,}"))
    if not CHROMIUM.exists():
        print(f"no browser at {CHROMIUM}: sort and zoom were not timed")


if __name__ == "__main__":
    main()
