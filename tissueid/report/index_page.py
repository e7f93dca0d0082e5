"""The report of a large cohort: a table of all specimens that sorts and filters, and distributions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import misfit_raised, verdict

#: Parameters of the table.
_SHOWN = ("static_1_N_per_mm", "relaxation_time_s", "viscosity_N_s_per_mm")
#: Refused inputs that are listed; identification.json has them all.
_LISTED = 500


def index_row(specimen: Mapping[str, Any], page: str) -> dict[str, Any]:
    """A specimen of identification.json as a row of the table.

    ``page``: address of its own page, from the table's.
    """
    values = {one["name"]: one for one in specimen["parameters"]}
    found = verdict(specimen)
    sure = not misfit_raised(specimen)
    return {
        "name": specimen["specimen"],
        "page": page,
        "level": found.level,
        "verdict": found.title,
        "values": [values[name]["value"] if name in values else None for name in _SHOWN],
        "errors": [values[name]["stderr"] if sure and name in values else None for name in _SHOWN],
        "nrmsd": 100.0 * specimen["nrmsd"]["range"],
        "trials": len(specimen["trials"]),
        "depth": specimen["validity"]["depth_mm"],
    }


def render_index(
    rows: Sequence[Mapping[str, Any]],
    refused: Sequence[str],
    *,
    created: str | None = None,
) -> str:
    """Write the report of a large cohort as one self-contained HTML page with links to those of specimens.

    ``rows``: from :func:`index_row`; ``refused``: what was left out, and why; ``created``: time stamp to
    print.  Returns HTML, UTF-8.
    """
    tally = Counter((row["level"], row["verdict"]) for row in rows)
    return (
        page_environment()
        .get_template("index.html.j2")
        .render(
            title=f"Contact mechanics of {len(rows):,} specimens",
            count=len(rows),
            counts=[(level, title, count) for (level, title), count in tally.most_common()],
            refused=refused[:_LISTED],
            more=max(len(refused) - _LISTED, 0),
            payload={"rows": rows},
            created=created,
            style=asset("page.css"),
            script=asset("index.js"),
            plotly=plotly_script(),
        )
    )
