"""`oracle watch`, started from a shell, shows the robot in its views."""

import json
import os
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from websockets.sync.client import connect

from tests.oracle_pipeline.live.robots import TEXT, Robot

ORACLE = Path(sys.executable).with_name("oracle")


@pytest.mark.slow
def test_page_and_foxglove_receive_the_robot_while_it_is_watched(domain, eventually, tmp_path):
    robot = Robot(domain).node("talker", publishes=["/words"]).announce()
    command = [ORACLE, "watch", "--domain", str(domain), "--view", "0", "--foxglove", "0"]
    with (
        (tmp_path / "said").open("w") as said,
        subprocess.Popen(command, stderr=said, stdout=said, env=dict(os.environ)) as watch,
    ):
        try:

            def address(name):
                return re.search(rf"{name}: (\S+)", (tmp_path / "said").read_text())

            page = eventually(lambda: address("Page"), 60)[1]
            foxglove = eventually(lambda: address("Foxglove"), 60)[1]

            def received():
                robot.writers["talker", "/words"].write(TEXT)
                with urllib.request.urlopen(f"{page}/events", timeout=10) as events:  # noqa: S310
                    return b"retry" in events.readline() and watch.poll() is None

            assert received()

            def advertised():
                robot.writers["talker", "/words"].write(TEXT)
                with connect(foxglove, subprotocols=["foxglove.sdk.v1"]) as client:
                    told = [json.loads(client.recv(10)) for _ in range(2)]
                channels = [each for message in told for each in message.get("channels", ())]
                return "/words" in {channel["topic"] for channel in channels}

            eventually(advertised, 30)
        finally:
            watch.terminate()
            watch.wait(30)
    assert watch.returncode == 0
    assert "messages received, 0 dropped." in (tmp_path / "said").read_text()
