import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import dump_qos_v8, dump_qos_v9, parse_qos

from oracle_pipeline.bags import qos_profiles

times = st.builds(QosTime, st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
profiles = st.builds(
    Qos,
    st.sampled_from(QosHistory),
    st.integers(0, 100),
    st.sampled_from(QosReliability),
    st.sampled_from(QosDurability),
    times,
    times,
    st.sampled_from(QosLiveliness),
    times,
    st.booleans(),
)


@given(st.lists(profiles, max_size=3))
def test_profiles_are_read_as_they_were_written(qos):
    """By number, as Humble writes them, and by name, as Jazzy does."""
    assert list(qos_profiles.parse(dump_qos_v8(qos))) == qos
    assert list(qos_profiles.parse(json.dumps(dump_qos_v9(qos)))) == qos


def test_profiles_of_real_bags_are_read_as_rosbags_does():
    forever = "{sec: 9223372036, nsec: 854775807}"
    humble = f"""- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline: {forever}
  lifespan: {forever}
  liveliness: 1
  liveliness_lease_duration: {forever}
  avoid_ros_namespace_conventions: false"""
    assert list(qos_profiles.parse(humble)) == parse_qos(humble)


@pytest.mark.parametrize(
    "text", ["{", "1", "- 1", "&a [*a]", "- !!python/name:os.system x", "[" * 100, "- ? [a]\n  : b"]
)
def test_a_text_that_is_no_profile_is_an_error(text):
    with pytest.raises(ValueError, match="."):
        qos_profiles.parse(text)
