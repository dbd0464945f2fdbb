"""A DDS domain for each test, on the loopback interface only."""

import contextlib
import fcntl
import os
import random
import tempfile
import time
from pathlib import Path

import pytest

LOOPBACK = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
    <LeaseDuration>2 s</LeaseDuration>
  </Discovery>
</Domain></CycloneDDS>
"""

os.environ["CYCLONEDDS_URI"] = LOOPBACK  # before any domain is joined in this process


def _a_free_domain():
    """Yield the number of a domain that no other test process has now."""
    for number in random.SystemRandom().sample(range(1, 233), 232):
        path = Path(tempfile.gettempdir(), f"dds-domain-{number}.lock")
        with path.open("w") as lock, contextlib.suppress(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield number
            return


@pytest.fixture
def domain():
    yield from _a_free_domain()


@pytest.fixture
def other_domain():
    yield from _a_free_domain()


@pytest.fixture
def eventually():
    """Wait until a condition holds; fail if it does not within some seconds."""

    def wait(condition, seconds=15.0):
        until = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < until, "it did not happen in time"
            time.sleep(0.02)
        return found

    return wait
