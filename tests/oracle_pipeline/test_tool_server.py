"""``oracle mcp``: an assistant learns, scores and sees evidence, and writes in one folder only."""

import json

import anyio
import pytest
from mcp.client import Client

from oracle_pipeline.tool_server import build_server
from tests.recorded_runs import RecordedRuns

pytestmark = pytest.mark.slow


@pytest.fixture
def call(tmp_path):
    """A function that calls tools one after the other, in one session."""
    (tmp_path / "mine").mkdir()

    def answers(*calls):
        async def session():
            async with Client(build_server(tmp_path / "mine")) as client:
                listed = await client.list_tools()
                return listed.tools, [await client.call_tool(*each) for each in calls]

        return anyio.run(session)

    return answers


def text(answer) -> str:
    return "\n".join(part.text for part in answer.content if part.type == "text")


def test_an_assistant_scores_a_run_and_sees_evidence_and_film(
    call, recorded_run: RecordedRuns, normal_card, tmp_path
):
    run, card = str(recorded_run("random_noise").path), str(normal_card)
    tools, (scored, evidence, replayed) = call(
        ("score", {"recordings": [run], "reference": card, "far": 0.25}),
        ("evidence", {"recording": run, "reference": card}),
        ("replay", {"recording": run, "film": "run.gif"}),
    )
    assert {tool.name for tool in tools} == {"learn", "score", "compare", "evidence", "replay"}
    assert all(tool.description for tool in tools)
    assert json.loads(text(scored))["outcome"] == "anomalous"
    assert "normal runs" in text(evidence)
    assert [part.type for part in replayed.content] == ["image", "text"]
    assert (tmp_path / "mine/run.gif").read_bytes().startswith(b"GIF8")


@pytest.mark.parametrize(
    "place", ["../out.gif", "/tmp/out.gif", "film.sh", "link/out.gif"]  # noqa: S108
)  # fmt: skip
def test_nothing_is_written_outside_the_folder_or_with_another_suffix(call, tmp_path, place):
    (tmp_path / "other").mkdir()
    (tmp_path / "mine").mkdir(exist_ok=True)
    (tmp_path / "mine/link").symlink_to(tmp_path / "other")
    _, (film, card) = call(
        ("replay", {"recording": "bag", "film": place}),
        ("learn", {"good": ["bag"], "card": place.replace(".gif", ".card")}),
    )
    for answer in (film, card):
        assert answer.is_error
        assert "is refused" in text(answer)
    assert not list((tmp_path / "other").iterdir())


def test_errors_are_told_in_a_sentence(call, tmp_path):
    _, (compared, learned, of_none) = call(
        ("compare", {"first": "no/such", "second": "folder"}),
        ("learn", {"good": [str(tmp_path)], "card": "robot.card"}),
        ("learn", {"good": [], "card": "robot.card"}),
    )
    for answer in (compared, learned):
        assert answer.is_error
        assert "no recording" in text(answer) or "no/such" in text(answer)
    assert of_none.is_error
    assert "No recording is given" in text(of_none)


def test_a_recording_that_is_not_judged_does_not_pass_for_one_without_evidence(call, normal_card):
    _, (answer,) = call(("evidence", {"recording": "no/such", "reference": str(normal_card)}))
    assert answer.is_error
    assert "There is no bag no/such" in text(answer)
