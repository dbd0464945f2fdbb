"""In a real browser: a page of another origin starts no run, and the UI itself does."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from playwright.sync_api import sync_playwright

from tests.browser.chromium import CHROMIUM
from tests.ui import LAUNCH, web_server

pytestmark = pytest.mark.slow(10)

ATTACK = """<!doctype html><title>attack</title><body><script>
const target = "TARGET", query = QUERY, body = JSON.stringify({query});
const tries = [
  () => fetch(target + "/graphql?query=" + encodeURIComponent(query), {mode: "no-cors"}),
  () => fetch(target + "/graphql", {method: "POST", mode: "no-cors", body}),
  () => fetch(target + "/graphql?query=" + encodeURIComponent(query),
              {method: "POST", mode: "no-cors", body: new FormData()}),
  () => fetch(target + "/graphql", {method: "POST", mode: "no-cors",
              headers: {"Content-Type": "text/plain; application/json"}, body}),
  () => fetch(target + "/graphql", {method: "POST",
              headers: {"Content-Type": "application/json"}, body}),
  () => new Promise(done => { const image = new Image(); image.onerror = image.onload = done;
              image.src = target + "/graphql?query=" + encodeURIComponent(query); }),
  () => new Promise(done => { const frame = document.createElement("iframe"); frame.name = "f";
              frame.onload = done; document.body.append(frame);
              const form = document.createElement("form"); form.method = "POST"; form.target = "f";
              form.action = target + "/graphql?query=" + encodeURIComponent(query);
              document.body.append(form); form.submit(); }),
  () => new Promise((done, failed) => {
              const wire = new WebSocket(target.replace("http", "ws") + "/graphql", "graphql-ws");
              wire.onopen = () => failed("a websocket was opened"); wire.onerror = done; }),
];
window.attack = async () => {
  const answers = [];
  for (const attempt of tries) {
    try { const answer = await attempt(); answers.push(answer && answer.type || "ended"); }
    catch (error) { answers.push(String(error)); }
  }
  return answers;
};
</script>"""

FRAME = """address => new Promise(done => {
  const frame = document.createElement("iframe");
  frame.onload = done; frame.src = address; document.body.append(frame);
})"""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with web_server(tmp_path_factory.mktemp("ui")) as started:
        yield started


@pytest.fixture(scope="module")
def elsewhere(server):
    """A foreign web site, on another port; the browser knows it by two names."""
    page = ATTACK.replace("TARGET", server.origin).replace("QUERY", repr(" ".join(LAUNCH.split())))

    class Site(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page.encode())

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Site) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        yield site.server_address[1]
        site.shutdown()


@pytest.fixture(scope="module")
def browser():
    names = "--host-resolver-rules=MAP *.example 127.0.0.1"
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=[names])
        yield chromium
        chromium.close()


@pytest.mark.parametrize("name", ["evil.example", "127.0.0.1"])
def test_a_page_of_another_origin_starts_no_run(browser, server, elsewhere, name):
    page = browser.new_page()
    page.goto(f"http://{name}:{elsewhere}/")
    answers = page.evaluate("attack()")
    assert len(answers) == 8
    assert "a websocket was opened" not in answers
    assert server.runs() == 0


def test_a_name_that_is_rebound_to_this_machine_shows_nothing(browser, server):
    answer = browser.new_page().goto(f"http://rebound.example:{server.port}/")
    assert answer.status == 403


def test_no_frame_of_another_origin_shows_the_ui(browser, server, elsewhere):
    page = browser.new_page()
    page.goto(f"http://evil.example:{elsewhere}/")
    page.evaluate(
        """address => new Promise(done => { const frame = document.createElement("iframe");
        frame.onload = done; frame.src = address; document.body.append(frame); })""",
        server.origin,
    )
    assert all("Dagster" not in frame.content() for frame in page.frames[1:])


def test_a_link_on_another_page_opens_the_ui_which_starts_a_run(browser, server, elsewhere):
    page = browser.new_page()
    refused = []
    page.on("response", lambda answer: answer.status < 400 or refused.append(answer.url))
    page.goto(f"http://evil.example:{elsewhere}/")
    address = f"{server.origin}/locations/here/jobs/nothing/playground"
    page.evaluate("address => { location.href = address }", address)
    page.get_by_role("button", name="Launch run").click(timeout=60_000)
    page.wait_for_url("**/runs/**", timeout=60_000)
    assert server.runs() == 1
    assert refused == []
