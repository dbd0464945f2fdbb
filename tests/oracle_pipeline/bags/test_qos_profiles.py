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
from rosbags.rosbag2 import metadata, storage_mcap, writer

from oracle_pipeline.bags.qos_profiles import remember_profiles

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


@given(st.lists(st.lists(profiles, max_size=3), max_size=4))
def test_remembered_profiles_are_those_of_rosbags(topics):
    remember_profiles()
    for qos in [*topics, *topics]:  # the second time from memory
        text = writer.dump_qos_v8(qos)
        assert text == metadata.dump_qos_v8(qos)
        assert storage_mcap.parse_qos(text) == metadata.parse_qos(text) == qos
        storage_mcap.parse_qos(text).clear()  # what a caller does to its list is its own affair
