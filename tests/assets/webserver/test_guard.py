"""The UI cannot be driven from elsewhere: real requests to a real web server, as sent on the wire.

Each of them starts a run on Dagster's bare web server, or would let a page do so.
"""

import json
import socket
from collections.abc import Iterator
from urllib.parse import quote

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from oracle_pipeline.web_guard import OriginError, parse_origins
from tests.ui import LAUNCH, WebServer, web_server

PROXY = "https://oracle.example.org"
JSON = "application/json"
BODY = json.dumps({"query": LAUNCH})
BY_GET = f"/graphql?query={quote(LAUNCH)}"
EVIL = "http://evil.example"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebServer]:
    with web_server(tmp_path_factory.mktemp("ui"), ORACLE_UI_ORIGINS=PROXY) as started:
        yield started


def send(
    server: WebServer, method: str, path: str, *headers: tuple[str, str], body: str = ""
) -> tuple[int, str]:
    """Send a raw request, and return status and full response."""
    given = dict.fromkeys(name.lower() for name, _ in headers)
    lines = [f"{method} {path} HTTP/1.1"]
    if "host" not in given:
        lines.append(f"Host: 127.0.0.1:{server.port}")
    lines += [f"{name}: {value}" for name, value in headers]
    lines += [f"Content-Length: {len(body.encode())}", "Connection: close", "", body]
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as wire:
        wire.sendall("\r\n".join(lines).encode())
        answer = b"".join(iter(lambda: wire.recv(65536), b"")).decode(errors="replace")
    return int(answer.split()[1]), answer


FORM = "application/x-www-form-urlencoded"
MULTIPART = "multipart/form-data; boundary=b"
REFUSED = {
    "a mutation by GET": ("GET", BY_GET, []),
    "by GET, a slash more": ("GET", BY_GET.replace("?", "/?"), []),
    "by GET, the path written otherwise": ("GET", BY_GET.replace("graphql", "%67raphql"), []),
    "by HEAD": ("HEAD", BY_GET, []),
    "by GET of an image": ("GET", BY_GET, [("Sec-Fetch-Site", "cross-site"),
                                           ("Sec-Fetch-Mode", "no-cors"),
                                           ("Sec-Fetch-Dest", "image")]),
    "as plain text": ("POST", "/graphql", [("Content-Type", "text/plain")]),
    "as plain text in the address": ("POST", BY_GET, [("Content-Type", "text/plain")]),
    "as text that mentions JSON": (
        "POST", "/graphql", [("Content-Type", "text/plain; application/json")]),
    "as two types": ("POST", "/graphql", [("Content-Type", "text/plain"), ("Content-Type", JSON)]),
    "without a type": ("POST", BY_GET, []),
    "as GraphQL": ("POST", "/graphql", [("Content-Type", "application/graphql")]),
    "as a form": ("POST", BY_GET, [("Content-Type", FORM)]),
    "as parts": ("POST", BY_GET, [("Content-Type", MULTIPART)]),
    "a foreign origin": ("POST", "/graphql", [("Content-Type", JSON), ("Origin", EVIL)]),
    "no origin, as of a sandbox": ("POST", "/graphql", [("Content-Type", JSON),
                                                        ("Origin", "null")]),
    "another port of this machine": ("POST", "/graphql", [("Content-Type", JSON),
                                                          ("Origin", "http://127.0.0.1:1")]),
    "the proxy's name without TLS": ("POST", "/graphql", [
        ("Content-Type", JSON), ("Origin", "http://oracle.example.org")]),
    "two origins": ("POST", "/graphql", [("Content-Type", JSON), ("Origin", PROXY),
                                         ("Origin", EVIL)]),
    "a rebound name": ("POST", "/graphql", [("Content-Type", JSON), ("Host", "evil.example:3000"),
                                            ("Origin", "http://evil.example:3000")]),
    "a name that begins like ours": ("POST", "/graphql", [
        ("Content-Type", JSON), ("Host", "127.0.0.1.evil.example")]),
    "a host behind an @": ("POST", "/graphql", [("Content-Type", JSON),
                                                ("Host", "127.0.0.1@evil.example")]),
    "an empty host": ("POST", "/graphql", [("Content-Type", JSON), ("Host", "")]),
    "the page of a rebound name": ("GET", "/", [("Host", "evil.example")]),
    "logs for a rebound name": ("GET", "/logs/a/b/c", [("Host", "evil.example")]),
    "JSON of another site, no origin": ("POST", "/graphql", [
        ("Content-Type", JSON), ("Sec-Fetch-Site", "cross-site")]),
    "in a frame of another site": ("GET", "/", [("Sec-Fetch-Site", "cross-site"),
                                                ("Sec-Fetch-Mode", "navigate"),
                                                ("Sec-Fetch-Dest", "iframe")]),
    "the question before it": ("OPTIONS", "/graphql", [("Origin", EVIL)]),
    "PUT": ("PUT", "/graphql", [("Content-Type", JSON)]),
    "a materialization as plain text": (
        "POST", "/report_asset_materialization/forged", [("Content-Type", "text/plain")]),
    "a check as a form": (
        "POST", "/report_asset_check/forged?check_name=a&passed=true", [("Content-Type", FORM)]),
}  # fmt: skip


@pytest.mark.parametrize("request_", REFUSED.values(), ids=REFUSED)
def test_requests_of_foreign_pages_are_rejected(
    server: WebServer, request_: tuple[str, str, list[tuple[str, str]]]
) -> None:
    method, path, headers = request_
    before = server.runs()
    status, answer = send(server, method, path, *headers, body=BODY if method == "POST" else "")
    assert status in {400, 403, 405, 415}, answer
    assert "access-control-allow" not in answer.lower()
    assert server.runs() == before
    assert server.instance.get_asset_keys() == []


ANSWERED = {
    "our own page": [("Origin", "http://127.0.0.1:{port}"), ("Sec-Fetch-Site", "same-origin")],
    "a program": [],
    "the proxy, which keeps the host": [("Host", "oracle.example.org"), ("Origin", PROXY)],
    "the proxy, which writes its own": [("Origin", PROXY), ("Sec-Fetch-Site", "same-origin")],
    "a tunnel": [("Host", "localhost:8080"), ("Origin", "http://localhost:8080")],
    "the other loopback": [("Host", "[::1]:3000"), ("Origin", "http://[::1]:3000")],
    "a type with a charset": [("Content-Type", "application/json; charset=utf-8")],
}


@pytest.mark.parametrize("headers", ANSWERED.values(), ids=ANSWERED)
def test_our_own_page_a_proxy_and_programs_start_runs(
    server: WebServer, headers: list[tuple[str, str]]
) -> None:
    before = server.runs()
    filled = [(name, value.format(port=server.port)) for name, value in headers]
    if not any(name == "Content-Type" for name, _ in filled):
        filled.append(("Content-Type", JSON))
    status, answer = send(server, "POST", "/graphql", *filled, body=BODY)
    assert status == 200, answer
    assert "LaunchRunSuccess" in answer
    assert server.runs() == before + 1


def test_a_link_in_a_mail_opens_the_page_and_no_frame_shows_it(server: WebServer) -> None:
    link = [("Sec-Fetch-Site", "cross-site"), ("Sec-Fetch-Mode", "navigate"),
            ("Sec-Fetch-Dest", "document")]  # fmt: skip
    status, answer = send(server, "GET", "/runs", *link)
    assert status == 200
    assert "frame-ancestors 'self'" in answer
    assert "x-frame-options: sameorigin" in answer.lower()


def test_a_rejection_states_the_remedy(server: WebServer) -> None:
    _, answer = send(server, "GET", "/", ("Host", "oracle.lan"))
    assert "'oracle.lan'" in answer
    assert "ORACLE_UI_ORIGINS" in answer


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({"Origin": EVIL}, False),
        ({"Origin": "null"}, False),
        ({"Origin": "http://127.0.0.1:1"}, False),
        ({"Origin": PROXY}, True),
        ({}, True),
    ],
    ids=str,
)
def test_a_websocket_is_opened_to_our_own_pages_only(
    server: WebServer, headers: dict[str, str], allowed: bool
) -> None:
    address = f"ws://127.0.0.1:{server.port}/graphql"
    protocol = [Subprotocol("graphql-ws")]
    if not allowed:
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, additional_headers=headers, subprotocols=protocol)
        return
    with connect(address, additional_headers=headers, subprotocols=protocol) as wire:
        wire.send(json.dumps({"type": "connection_init"}))
        assert json.loads(wire.recv()) == {"type": "connection_ack"}


def test_a_websocket_with_a_rebound_name_is_rejected(server: WebServer) -> None:
    wire = socket.create_connection(("127.0.0.1", server.port))
    with pytest.raises(InvalidStatus, match="403"):
        connect("ws://evil.example:3000/graphql", sock=wire)


def test_the_allow_list_holds_origins_as_browsers_show_them() -> None:
    text = "https://Oracle.example.org:443/, http://10.0.0.5:3000 https://[::1]:8443"
    assert parse_origins(text) == [
        "https://oracle.example.org", "http://10.0.0.5:3000", "https://[::1]:8443"
    ]  # fmt: skip
    assert parse_origins("") == []


@pytest.mark.parametrize(
    "wrong", ["oracle.example.org", "*", "https://*.org", "https://a/b", "ftp://a", "https://u@a"]
)
def test_the_error_for_an_invalid_origin_has_advice(wrong: str) -> None:
    with pytest.raises(OriginError, match="such as https://"):
        parse_origins(wrong)
