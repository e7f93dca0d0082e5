"""One browser for the tests of pages, and tabs that must be silent."""

from pathlib import Path
from typing import Any

import pytest

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def browser():
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}: install chromium to run this test")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as engine:
        off = [f"--disable-{part}" for part in ("background-networking", "component-update", "sync")]
        quiet = ["--no-sandbox", "--no-first-run", *off]
        running = engine.chromium.launch(executable_path=str(CHROMIUM), args=quiet)
        yield running
        running.close()


@pytest.fixture
def opened(browser, tmp_path):
    """Function that shows a page in a tab; none has an error, a warning or a request beyond itself to say."""
    said: list[str] = []
    path = tmp_path / "page.html"
    own = (path.as_uri(), "data:", "blob:")

    def show(html: str, *, width: int = 1400, height: int = 900, **context: Any) -> Any:
        path.write_text(html, encoding="utf-8")
        tab = browser.new_context(viewport={"width": width, "height": height}, **context).new_page()
        tab.on("console", lambda one: said.append(one.text) if one.type in {"error", "warning"} else None)
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("request", lambda one: None if one.url.startswith(own) else said.append(one.url))
        tab.goto(path.as_uri())
        return tab

    yield show
    assert said == []
