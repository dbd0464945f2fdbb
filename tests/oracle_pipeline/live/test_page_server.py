"""The page is served to this machine only, and to its own page only."""

import http.client
import json
import re
import socket
from collections.abc import Iterator

import pytest

from oracle_pipeline.live.page_server import LivePage, PortError
from tests.oracle_pipeline.live.happenings import events, verdict


@pytest.fixture(scope="module")
def served() -> Iterator[LivePage]:
    with LivePage(0) as page:
        for event in events():
            page.show(event)
        yield page


def ask(page: LivePage, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(page.address.removeprefix("http://"), timeout=10)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def parts(answer: http.client.HTTPResponse, count: int) -> dict[str, object]:
    """Read a number of server-sent events."""
    found: dict[str, object] = {}
    name = ""
    while len(found) < count:
        line = answer.readline().decode().rstrip("\n")
        if line.startswith("event: "):
            name = line.removeprefix("event: ")
        elif line.startswith("data: "):
            found[name] = json.loads(line.removeprefix("data: "))
    return found


def test_the_page_requests_no_other_file(served: LivePage) -> None:
    answer = ask(served)
    text = answer.read().decode()
    assert answer.status == 200
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", text)
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe-inline" not in policy


def test_a_late_page_gets_the_whole_state_and_then_the_changes(served: LivePage) -> None:
    answer = ask(served, "/events")
    first = parts(answer, 7)
    assert len(first["verdicts"]) == 4  # type: ignore[arg-type]
    served.show(verdict(4))
    assert len(parts(answer, 1)["verdicts"]) == 5  # type: ignore[arg-type]


@pytest.mark.parametrize("path", ["/", "/events"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"},
        {"Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "cors"},  # an extension
        {"Origin": "chrome-extension://abcdef"},
    ],
    ids=str,
)
def test_other_sites_are_refused(served: LivePage, path: str, headers: dict[str, str]) -> None:
    assert ask(served, path, **headers).status == 403


def test_nothing_can_be_sent_to_it(served: LivePage) -> None:
    connection = http.client.HTTPConnection(served.address.removeprefix("http://"), timeout=10)
    connection.request("POST", "/events", "{}", {"Content-Type": "application/json"})
    assert connection.getresponse().status == 405


def test_it_listens_on_loopback_only_and_reports_a_port_in_use(served: LivePage) -> None:
    assert served.address.startswith("http://127.0.0.1:")
    port = int(served.address.rpartition(":")[2])
    with pytest.raises(PortError, match=str(port)):
        LivePage(port)
    with pytest.raises(OSError, match="refused"), socket.create_connection(("127.0.0.2", port)):
        pass


def test_the_page_is_notified_of_the_end_of_the_watch() -> None:
    with LivePage(0) as page:
        page.show(verdict(0))
        answer = ask(page, "/events")
        parts(answer, 1)
    assert "over" in parts(answer, 1)
