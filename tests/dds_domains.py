"""A DDS domain for each test that needs one, on the loopback interface only."""

import contextlib
import os
import random
import time

import pytest

from oracle_pipeline.bags import dds
from sim.outside import domains

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


# Linux gives the ports of higher domains to any socket, so ROS 2 advises against these.
NUMBERS = range(1, 102)


@contextlib.contextmanager
def a_free_domain():
    """Yield the number of a domain that no other process has now, and leave it at the end."""
    with domains.a_free_domain(random.SystemRandom().sample(NUMBERS, len(NUMBERS))) as number:
        yield number
        for participant in list(dds._joined):  # that are garbage, which others would still see
            if participant.domain_id == number:
                dds.leave(participant)


@pytest.fixture
def domain():
    with a_free_domain() as number:
        yield number


@pytest.fixture
def other_domain():
    with a_free_domain() as number:
        yield number


@pytest.fixture
def eventually():
    """Wait until a condition holds; fail if it does not within some seconds."""

    def wait(condition, seconds=300.0):
        until = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < until, "it did not happen in time"
            time.sleep(0.02)
        return found

    return wait
