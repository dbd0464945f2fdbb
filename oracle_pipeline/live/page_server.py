"""Serves a page on a running watch (``page.html``) to browsers of this machine.

The page can change nothing: it receives server-sent events, each with the parts that have changed.
Requests pass the same guard as those to Dagster's UI.
"""

import asyncio
import base64
import hashlib
import json
import re
import socket
import threading
from collections.abc import AsyncIterator, Callable
from importlib.resources import files
from typing import Self

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.live.events import Event
from oracle_pipeline.live.page_state import PageState
from oracle_pipeline.web_guard import Guard

HOST = "127.0.0.1"
_EVERY_S = 0.2  # between two checks for changes
_ENDS_S = 3  # grace period of open connections when the watch ends
_ADVICE = "Open the address that oracle watch prints, on the machine where it runs."


class PortError(OracleError):
    """The page cannot be served at its port."""


class LivePage:
    """Serves the page at a port, 0 being any free one; a context manager.

    Raises
    ------
    PortError
        If the port is taken.
    """

    def __init__(self, port: int) -> None:
        self.state = PageState()
        self._socket = _listen(port)
        self.address = f"http://{HOST}:{self._socket.getsockname()[1]}"
        self._server = uvicorn.Server(
            uvicorn.Config(
                Guard(_application(self.state, lambda: self._server.should_exit), advice=_ADVICE),
                log_level="error",
                lifespan="off",
                timeout_graceful_shutdown=_ENDS_S,
            )
        )
        self._thread = threading.Thread(
            target=self._server.run, args=([self._socket],), name="page", daemon=True
        )

    def show(self, event: Event) -> None:
        """Show an event."""
        self.state.update(event)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self._server.should_exit = True
        self._thread.join()
        self._socket.close()


def _listen(port: int) -> socket.socket:
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise PortError(
            f"Nothing can listen at port {port} of {HOST}: {error.strerror}. Name another port, or "
            "0 for a free one."
        ) from error


def _page() -> tuple[str, str]:
    """Return the page, and its content security policy: its own script, its own events."""
    text = (files(__package__) / "page.html").read_text(encoding="utf-8")
    sources = {}
    for tag in ("script", "style"):
        found = re.search(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        assert found is not None, tag  # noqa: S101 -- the page is ours
        digest = hashlib.sha256(found[1].encode()).digest()
        sources[tag] = f"'sha256-{base64.b64encode(digest).decode()}'"
    policy = (
        f"default-src 'none'; script-src {sources['script']}; style-src {sources['style']}; "
        "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    return text, policy


def _application(state: PageState, is_over: Callable[[], bool]) -> Starlette:
    text, policy = _page()

    async def whole(_request: Request) -> Response:
        return HTMLResponse(
            text, headers={"Content-Security-Policy": policy, "Cache-Control": "no-store"}
        )

    async def events(request: Request) -> Response:
        return StreamingResponse(
            _changes(request, state, is_over),
            media_type="text/event-stream",
            headers={"Cache-Control": "no-store"},
        )

    return Starlette(routes=[Route("/", whole), Route("/events", events)])


async def _changes(
    request: Request, state: PageState, is_over: Callable[[], bool]
) -> AsyncIterator[str]:
    """Yield all parts, then those that change, until the page or the watch is gone."""
    change = 0
    yield "retry: 1000\n\n"
    while not is_over() and not await request.is_disconnected():
        change, parts = state.since(change)
        for name, part in parts.items():
            yield f"event: {name}\ndata: {json.dumps(part, allow_nan=False)}\n\n"
        await asyncio.sleep(_EVERY_S)
    if is_over():
        yield "event: over\ndata: {}\n\n"
