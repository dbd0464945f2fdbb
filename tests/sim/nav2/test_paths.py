import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import serialize
from sim.nav2.paths import PATH, length_ahead, path_bytes, path_message, path_poses

paths = st.integers(0, 40).flatmap(
    lambda n: hnp.arrays(np.float64, (n, 3), elements=st.floats(-math.pi, math.pi))
)
frames = st.sampled_from(["", "map", "odom", "base_footprint", "abcd", "abcdefgh"])


@given(st.integers(0, 2**40), frames, paths)
def test_path_bytes_are_those_of_the_serialised_message(time_ns, frame, poses):
    fast = path_bytes(time_ns, frame, poses)
    assert fast == serialize(path_message(time_ns, frame, poses), PATH)


@given(paths)
def test_poses_survive_the_message(poses):
    assert path_poses(path_message(0, "map", poses)) == pytest.approx(poses)


@given(paths)
def test_poses_are_those_of_the_objects_in_the_message_to_the_last_bit(poses):
    path = path_message(0, "map", poses)
    objects = dataclasses.replace(path, poses=list(path.poses))
    assert path_poses(path).tobytes() == path_poses(objects).tobytes()


def test_length_ahead_starts_at_the_closest_pose():
    corner = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 3.0, 0.0)])
    assert length_ahead(corner, 0.9, 0.4) == pytest.approx(4.0)
    assert length_ahead(corner, 2.1, 3.0) == 0.0
