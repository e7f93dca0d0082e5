"""One page of this machine that is talked back to: ``/`` is the page, ``/decide`` hears a decision on it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from tissueid.errors import TissueidError
from tissueid.viewer.security import LOOPBACK, Access, RefusalLog, new_token
from tissueid.viewer.server import Guarded, config
from tissueid.viewer.serving import ViewerOptions, listening_socket

#: A decision is a number and a sentence.
LARGEST_DECISION = 8_192
MOST_CONNECTIONS = 16
#: The page carries its own scripts; it loads nothing, and talks to nobody else.
PAGE_POLICY = (
    b"default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; "
    b"img-src data: blob:; font-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    b"frame-ancestors 'none'"
)
REFUSED, TOO_LONG = 422, 413


class DecidedPage(Protocol):
    """Page that is served; every method may raise a :class:`tissueid.errors.TissueidError`."""

    def page(self) -> str:
        """The page as it stands."""

    def decide(self, words: Mapping[str, Any]) -> str:
        """Take a decision, and say what was done."""


def page_app(shown: DecidedPage, access: Access) -> ASGIApp:
    """The application."""

    async def page(_request: Request) -> Response:
        try:
            return HTMLResponse(await run_in_threadpool(shown.page))
        except TissueidError as error:
            return PlainTextResponse(
                f"{error}\nCorrect it, then load this page again.\n", status_code=REFUSED
            )

    async def decide(request: Request) -> Response:
        words = await _words(request)
        if isinstance(words, Response):
            return words
        try:
            return JSONResponse({"said": await run_in_threadpool(shown.decide, words)})
        except TissueidError as error:
            return JSONResponse({"said": str(error)}, status_code=REFUSED)

    routes = [Route("/", page, methods=["GET"]), Route("/decide", decide, methods=["POST"])]
    return Guarded(Starlette(routes=routes), access, RefusalLog(), policy=PAGE_POLICY)


async def _words(request: Request) -> dict[str, Any] | Response:
    """The decision in a request, or the answer to one that holds none."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_DECISION:
            return JSONResponse({"said": "too long: shorten the reason"}, status_code=TOO_LONG)
    try:
        words = json.loads(body)
    except ValueError:
        words = None
    if not isinstance(words, dict):
        return JSONResponse({"said": "this is no decision"}, status_code=REFUSED)
    return words


class PageServer(AbstractContextManager["PageServer"]):
    """The server, in this process, which listens from its making on; UsageError: the port is taken."""

    def __init__(self, shown: DecidedPage, port: int | None = None) -> None:
        self._listening = listening_socket(ViewerOptions(LOOPBACK, port))
        self.access = Access(LOOPBACK, self._listening.getsockname()[1], new_token())
        self.server = uvicorn.Server(
            config(
                page_app(shown, self.access), ws="none", lifespan="off", limit_concurrency=MOST_CONNECTIONS
            )
        )

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{LOOPBACK}:{self.access.port}/?token={self.access.token}"

    def run(self) -> None:
        """Serve until Ctrl-C, or until ``server.should_exit``."""
        asyncio.run(self.server.serve(sockets=[self._listening]))

    def close(self) -> None:
        """Give the port back; harmless when called twice."""
        self._listening.close()

    def __exit__(self, *_: object) -> None:
        self.close()
