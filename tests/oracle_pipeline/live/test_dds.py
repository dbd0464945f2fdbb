"""Bytes and names on a DDS domain: messages arrive unchanged."""

import os
import random
import socket
import subprocess
import sys
import time

import hypothesis.strategies as st
import pytest
from hypothesis import given

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import (
    dds_topic,
    dds_type,
    default_domain,
    from_wire,
    ros_topic,
    ros_type,
    to_wire,
)
from oracle_pipeline.bags.errors import DdsError
from oracle_pipeline.bags.types import message_class, serialize, typestore
from sim.middleware.qos import DEFAULT, LATCHED
from tests.oracle_pipeline.live.robots import STRING, TEXT
from tools.soak.watch import packet, udp_ports

names = st.from_regex(r"/[a-z][a-z0-9_]{0,8}(/[a-z][a-z0-9_]{0,8}){0,2}", fullmatch=True)


@given(names)
def test_the_name_of_a_topic_comes_back(topic):
    assert ros_topic(dds_topic(topic)) == topic


@pytest.mark.parametrize("name", ["rq/add_twoRequest", "rr/add_twoReply", "DCPSTopic", "rt", "rt/"])
def test_a_dds_topic_that_is_not_of_ros_has_no_name(name):
    assert ros_topic(name) is None


def test_the_name_of_every_known_type_comes_back():
    assert all(ros_type(dds_type(msgtype)) == msgtype for msgtype in typestore().fielddefs)
    assert ros_type("Temperature") is None


@given(st.binary(max_size=40))
def test_bytes_come_back_whatever_padding_they_need(content):
    data = b"\0\1\0\0" + content
    assert len(to_wire(data)) % 4 == 0
    assert from_wire(to_wire(data)) == data


def test_every_known_message_type_is_a_dds_type():
    for msgtype in typestore().fielddefs:
        assert dds.idl_type(msgtype, typestore()).__idl_typename__ == dds_type(msgtype)


def test_an_unknown_type_is_refused():
    with pytest.raises(DdsError, match="no_msgs/msg/None"):
        dds.idl_type("no_msgs/msg/None", typestore())


def test_messages_come_with_the_bytes_that_were_sent(domain, eventually):
    participant = dds.join(domain)
    writer = dds.RawWriter(participant, "rt/words", STRING, LATCHED)
    reader = dds.RawReader(participant, "rt/words", STRING, DEFAULT)
    ready = dds.ReadyReaders(participant)
    ready.add(reader)
    sent = [serialize(message_class(STRING)("x" * size), STRING) for size in range(9)]
    for data in sent:
        writer.write(data)
    assert eventually(lambda: list(ready.wait(1.0))) == [reader]
    assert [raw.data for raw in reader.take()] == sent
    assert list(ready.wait(0.0)) == []


def test_without_a_reader_it_waits_too(domain):
    participant = dds.join(domain)
    ready = dds.ReadyReaders(participant)
    began_s = time.monotonic()
    assert list(ready.wait(0.2)) == []
    assert time.monotonic() - began_s > 0.19
    dds.leave(participant)
    with pytest.raises(DdsError, match="waited"):
        ready.wait(0.2)


def test_a_reader_counts_exactly_what_it_loses(domain):
    participant = dds.join(domain)
    reader = dds.RawReader(participant, "rt/words", STRING, DEFAULT._replace(depth=7))
    writer = dds.RawWriter(participant, "rt/words", STRING, DEFAULT)
    taken = 0
    for sent in (3, 1000, 7, 8, 0):  # delivered at once, since the writer is in this process
        for _ in range(sent):
            writer.write(TEXT)
        taken += len(reader.take())
    assert taken == 3 + 7 + 7 + 7
    assert taken + reader.lost == 1018


def test_a_profile_comes_back_from_dds():
    for profile in (DEFAULT, LATCHED):
        assert dds.ros_qos(dds.dds_qos(profile)) == profile


def test_an_invalid_domain_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(DdsError, match="seven"):
        default_domain()


def test_malformed_packets_harm_nothing(domain):
    participant = dds.join(domain)
    writer = dds.RawWriter(participant, "rt/words", STRING, LATCHED)
    reader = dds.RawReader(participant, "rt/words", STRING, DEFAULT)
    rng, ports = random.Random(0), udp_ports(os.getpid())  # noqa: S311 -- no secret
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(2000):
            out.sendto(packet(rng), ("127.0.0.1", rng.choice(ports)))
    writer.write(TEXT)
    assert [raw.data for raw in reader.take()] == [TEXT]


@pytest.mark.slow
def test_a_process_that_is_on_a_domain_ends(domain):
    code = (
        "from oracle_pipeline.bags import dds; from sim.middleware.qos import DEFAULT;"
        f"here = dds.join({domain}); there = dds.join({domain});"
        f"readers = [dds.RawReader(here, f'rt/t{{n}}', '{STRING}', DEFAULT) for n in range(50)]"
    )
    for _ in range(3):
        subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
