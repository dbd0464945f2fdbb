"""`oracle watch --view`, started from a shell, shows the robot on its page."""

import contextlib
import os
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from tests.oracle_pipeline.live.robots import TEXT, Robot

ORACLE = Path(sys.executable).with_name("oracle")


@pytest.mark.slow
def test_the_page_receives_the_robot_while_it_is_watched(domain, eventually, tmp_path):
    robot = Robot(domain).node("talker", publishes=["/words"]).announce()
    command = [ORACLE, "watch", "--domain", str(domain), "--view", "0"]
    said = tmp_path / "said"
    with (
        said.open("w") as sink,
        subprocess.Popen(command, stderr=sink, stdout=sink, env=dict(os.environ)) as watch,
    ):
        try:
            page = eventually(lambda: re.search(r"Page: (\S+)", said.read_text()), 60)[1]

            def received():
                robot.writers["talker", "/words"].write(TEXT)
                with (
                    contextlib.suppress(TimeoutError),  # there is no event before a message
                    urllib.request.urlopen(f"{page}/events", timeout=1) as events,  # noqa: S310
                ):
                    return b"event: status\n" in [events.readline() for _ in range(3)]
                return False

            assert eventually(received, 30)
        finally:
            watch.terminate()
            watch.wait(30)
    assert watch.returncode == 0
    assert "messages received, 0 dropped." in said.read_text()
