"""A guard for the web server: pages of other origins cannot use it.

Dagster's web server has no login, and accepts GraphQL by GET and as plain text. A browser sends
both for any page that its user visits, and DNS rebinding makes such a page appear to be ours. So a
request must have a known host, must come from our own page or from no page, and may change state
only as a JSON POST, which browsers send to another origin only after a CORS preflight.

References: Fetch Standard (CORS-safelisted requests, ``Sec-Fetch-*``), RFC 6454 (origins).
"""

import logging
import re
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

VARIABLE = "ORACLE_UI_ORIGINS"
BEHIND_A_PROXY = (
    f"Behind a proxy, set {VARIABLE} to the public address of the UI (docs/how-to/security.md)."
)
_LOOPBACK = {"127.0.0.1", "localhost", "[::1]"}
_HOST = re.compile(r"([a-z0-9._-]+|\[[0-9a-f:.]+\])(?::[0-9]{1,5})?")
_POLICY_VIOLATION = 1008  # RFC 6455
_log = logging.getLogger("dagster.ui")


class OriginError(ValueError):
    """An entry of the allow list is not an origin."""


def parse_origins(text: str) -> list[str]:
    """Return the origins in an allow list; an origin is the part of an address before the path.

    Parameters
    ----------
    text
        Origins separated by commas or spaces, such as ``https://oracle.example.org:8443``.

    Raises
    ------
    OriginError
        An entry is not an origin.
    """
    return [_normal(entry) for entry in re.split(r"[\s,]+", text) if entry]


def _normal(origin: str) -> str:
    parts = urlsplit(origin.lower())
    bare = f"{parts.scheme}://{parts.netloc}"
    if parts.scheme not in {"http", "https"} or not _HOST.fullmatch(parts.netloc) \
            or origin.lower().rstrip("/") != bare:  # fmt: skip
        raise OriginError(
            f"{origin!r} in {VARIABLE} is not an origin. Write scheme, name and port as the "
            "browser shows them, such as https://oracle.example.org or http://10.0.0.5:3000."
        )
    default = {"http": ":80", "https": ":443"}[parts.scheme]
    return bare.removesuffix(default)


class Guard:
    """Forwards requests of our own pages and of programs, and rejects all others.

    Parameters
    ----------
    app
        The web server's application.
    origins
        Allowed origins, besides loopback addresses: see `parse_origins`.
    advice
        Advice in the response to rejected requests.
    """

    def __init__(
        self, app: ASGIApp, origins: Collection[str] = (), advice: str = BEHIND_A_PROXY
    ) -> None:
        self._app = app
        self._advice = advice
        self._origins = frozenset(origins)
        self._hosts = frozenset(urlsplit(origin).netloc for origin in origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or reject it with the reason."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        refusal = self._refusal(scope, Headers(scope=scope))
        if refusal is None:
            return await self._app(scope, receive, _not_in_foreign_frames(send))
        status, reason = refusal
        _log.warning("Refused %r: %s", scope["path"], reason)
        if scope["type"] == "websocket":
            closing = {"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": "refused"}
            return await send(closing)
        return await PlainTextResponse(reason + "\n", status)(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Return status and reason if a request is to be rejected, else None."""
        for name in ("host", "origin", "content-type"):
            if len(headers.getlist(name)) > 1:
                return 400, f"There is more than one header {name!r}."
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if not (is_loopback(host) or host in self._hosts):
            return 403, f"The host {host!r} does not belong to this server. {self._advice}"
        if origin is not None and not self._is_ours(origin.lower(), host):
            return 403, f"The origin {origin!r} does not belong to this server. {self._advice}"
        if scope["type"] == "websocket":
            return None
        method = scope["method"]
        if origin is None and _is_sent_by_another_site(method, headers):
            return 403, f"A page of another site or an extension sent this. {self._advice}"
        if method in {"GET", "HEAD"}:
            asks_graphql = scope["path"].rstrip("/").endswith("/graphql")
            if asks_graphql and "text/html" not in headers.get("accept", ""):
                return 405, "GraphQL is accepted only as a POST of JSON."
            return None
        if method != "POST":
            return 405, f"The method {method} is not allowed."
        media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
        if media_type != "application/json":
            return 415, "A POST is accepted only as application/json."
        return None

    def _is_ours(self, origin: str, host: str) -> bool:
        return origin in self._origins or (is_loopback(host) and origin == f"http://{host}")


def is_loopback(host: str) -> bool:
    """Return whether a host header is a loopback address, at any port (as through a tunnel)."""
    return bool(_HOST.fullmatch(host)) and re.sub(r":[0-9]+$", "", host) in _LOOPBACK


def _is_sent_by_another_site(method: str, headers: Headers) -> bool:
    """Return whether a page of another site, or an extension, sent the request, but for a link.

    The requests of an extension come from no site, as an address that a user types does.
    """
    if headers.get("sec-fetch-site", "same-origin") == "same-origin":
        return False
    follows = headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest")
    return not (method == "GET" and follows == ("navigate", "document"))


def _not_in_foreign_frames(send: Send) -> Send:
    """Forbid pages of other origins to embed ours in a frame, against clickjacking."""

    async def framed(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.append("Content-Security-Policy", "frame-ancestors 'self'")
            headers["X-Frame-Options"] = "SAMEORIGIN"
        await send(message)

    return framed
