"""Reaching a session that another machine serves: whether it is there, and lets one in."""

from __future__ import annotations

import urllib.error
import urllib.parse
import urllib.request

from tissueid.errors import UsageError, printable

TIMEOUT_S = 5.0


def reach(what: str, token: str | None) -> str:
    """Address of a page that answers.

    ``what``: ``HOST:PORT``, or the address as the other terminal shows it; ``token``: added where the address
    has none.  Raises UsageError: it is no address, nothing answers there, or the token is missing or wrong.
    """
    url = what if "//" in what else f"http://{what}/"
    parts = urllib.parse.urlsplit(url)
    if parts.scheme not in {"http", "https"} or parts.hostname is None:
        msg = f"{printable(what)!r} is neither a log nor HOST:PORT"
        raise UsageError(msg)
    if token is not None and "token=" not in parts.query:
        url = urllib.parse.urlunsplit(parts._replace(query=urllib.parse.urlencode({"token": token})))
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S):  # noqa: S310 -- the scheme was checked
            return url
    except urllib.error.HTTPError as error:
        words = error.read(300).decode("utf-8", "replace").strip().splitlines()
        why = printable(words[0]) if words else error.reason
        msg = f"{printable(what)}: {why}"
        raise UsageError(msg) from error
    except (urllib.error.URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", error)
        msg = (
            f"{printable(what)}: nothing answers ({reason}); start it there with "
            "`tissueid render ... --viewer --host ADDRESS`"
        )
        raise UsageError(msg) from error
