import hypothesis.extra.numpy as hnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from oracle_pipeline.features.geometry.clearance import clearance

grids = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12))


@given(grids.filter(np.any))
def test_clearance_is_the_distance_to_the_next_blocked_cell(blocked):
    assert (clearance(blocked) == distance_transform_edt(~blocked).astype(np.float32)).all()


@given(st.integers(0, 2**32), st.floats(0.001, 0.2))
def test_clearance_of_large_grids_too(seed, share):
    blocked = np.random.default_rng(seed).random((60, 90)) < share
    blocked[0, 0] = True
    assert (clearance(blocked) == distance_transform_edt(~blocked).astype(np.float32)).all()
