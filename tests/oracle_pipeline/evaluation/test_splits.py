import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.splits import block_folds, group_folds, without_hard_negatives
from tests.oracle_pipeline.datasets.synthetic import CONTROLS, MODES, run_features


def session_folds(df, seed):
    return group_folds(df, "session", seed)


def runs(blocks=12, **more):
    return run_features(runs=blocks, modes=MODES | CONTROLS, **more)


@settings(max_examples=15, deadline=None)
@given(st.integers(3, 25), st.integers(0, 9), st.sampled_from([block_folds, session_folds]))
def test_no_block_is_split_and_every_run_is_tested_once(blocks, seed, split):
    df = runs(blocks)
    block = df["block"].to_numpy()
    folds = split(df, seed)
    assert sum(fold.test.astype(int) for fold in folds).tolist() == [1] * len(df)
    for fold in folds:
        sides = [set(block[side]) for side in (fold.fit, fold.calibrate, fold.test)]
        assert all(sides)
        assert sum(map(len, sides)) == len(set().union(*sides))
        assert not is_malicious(df)[fold.fit | fold.calibrate].any()
        assert set(block[fold.train]).isdisjoint(sides[2])


@settings(max_examples=15, deadline=None)
@given(st.integers(4, 25), st.integers(0, 9))
def test_no_world_is_split_and_every_run_is_tested_once(blocks, seed):
    df = runs(blocks)
    world = df["world"].to_numpy()
    folds = group_folds(df, "world", seed)
    assert len(folds) > 1
    assert sum(fold.test.astype(int) for fold in folds).tolist() == [1] * len(df)
    for fold in folds:
        assert set(world[fold.test]).isdisjoint(world[fold.train])
        assert not (fold.fit & ~fold.train).any()
    assert group_folds(df.assign(world="hexagon-0"), "world", seed) == []


def test_sessions_are_spread_over_folds_and_halves_unless_one_is_held_out():
    df = runs(15)
    session = df["session"].to_numpy()
    for fold in block_folds(df, 0):
        for side in (fold.fit, fold.calibrate, fold.test):
            assert set(session[side]) == {0, 1, 2}
    held_out = [set(session[fold.test]) for fold in group_folds(df, "session", 0)]
    assert sorted(held_out, key=min) == [{0}, {1}, {2}]


@settings(max_examples=15, deadline=None)
@given(st.integers(6, 40), st.integers(2, 40), st.integers(0, 9))
def test_whole_sessions_are_held_out_in_five_folds_at_most(blocks, sessions, seed):
    df = runs(blocks)
    df["session"] = df["block"] % sessions
    folds = group_folds(df, "session", seed)
    assert len(folds) == min(5, sessions, blocks)
    assert sum(fold.test.astype(int) for fold in folds).tolist() == [1] * len(df)
    for fold in folds:
        assert set(df.loc[fold.test, "session"]).isdisjoint(df.loc[fold.train, "session"])


def test_without_hard_negatives_they_are_tested_but_not_trained_on():
    df = runs(9)
    harmless = df["mode"].str.startswith("benign_").to_numpy()
    for fold, shown in zip(
        without_hard_negatives(df, block_folds(df, 0)), block_folds(df, 0), strict=True
    ):
        assert not harmless[fold.fit | fold.calibrate].any()
        assert (fold.fit == shown.fit & ~harmless).all()
        assert (fold.test == shown.test).all()


def test_hard_negatives_and_shadows_are_used_for_training():
    df = runs(9)
    for fold in block_folds(df, 0):
        assert {"benign_noise", "fake_object_shadow"} <= set(df.loc[fold.fit, "mode"])
        assert {"benign_noise", "fake_object_shadow"} <= set(df.loc[fold.calibrate, "mode"])


@pytest.mark.parametrize("blocks", [1, 2])
def test_too_few_blocks_give_no_folds(blocks):
    assert block_folds(runs(blocks), 0) == []
    assert group_folds(runs(1), "session", 0) == []


def test_a_split_is_a_function_of_its_seed_and_does_not_depend_on_the_order_of_runs():
    df = runs(10)
    shuffled = df.iloc[np.random.default_rng(0).permutation(len(df))]
    for one, other in zip(block_folds(df, 4), block_folds(shuffled, 4), strict=True):
        assert set(df.loc[one.fit, "run_id"]) == set(shuffled.loc[other.fit, "run_id"])
        assert set(df.loc[one.test, "run_id"]) == set(shuffled.loc[other.test, "run_id"])
