"""A draw depends on the seeds, the message, the operation and its place, and on nothing else."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.random import Draws

words = st.integers(0, 2**64 - 1)
seeds = st.builds(Draws, words, words)
counts = st.integers(0, 50)


def uniform(draws, message, operation, n):
    return draws.generator(message, operation).random(n)


def normal(draws, message, operation, n):
    return draws.generator(message, operation).standard_normal(n)


@given(seeds, words, words, st.lists(st.tuples(words, words, counts), max_size=5))
def test_a_draw_is_the_same_whatever_was_drawn_before(draws, message, operation, others):
    fresh = Draws(draws.run_seed, draws.scenario_seed)
    for other in others:
        uniform(draws, *other)
        normal(draws, *other)
    for law in (uniform, normal):
        np.testing.assert_array_equal(
            law(draws, message, operation, 20), law(fresh, message, operation, 20)
        )


@given(seeds, words, words, counts, counts)
def test_the_first_draws_do_not_depend_on_how_many_follow(draws, message, operation, n, more):
    for law in (uniform, normal):
        np.testing.assert_array_equal(
            law(draws, message, operation, n), law(draws, message, operation, n + more)[:n]
        )


@given(st.lists(st.tuples(*[words] * 5), min_size=2, max_size=8, unique=True))
def test_other_seeds_messages_operations_and_places_draw_other_numbers(keys):
    drawn = {
        Draws(run, scenario).generator(message, operation, place).random(4).tobytes()
        for run, scenario, message, operation, place in keys
    }
    assert len(drawn) == len(keys)


def test_the_seeds_are_not_exchangeable_and_neither_are_message_and_operation():
    one = uniform(Draws(1, 2), 3, 4, 8)
    assert not np.array_equal(one, uniform(Draws(2, 1), 3, 4, 8))
    assert not np.array_equal(one, uniform(Draws(1, 2), 4, 3, 8))


def test_draws_of_neighbouring_messages_are_uniform_and_normal():
    draws = Draws(7, 11)
    even = np.concatenate([uniform(draws, message, 0, 50) for message in range(400)])
    bell = np.concatenate([normal(draws, message, 0, 50) for message in range(400)])
    assert ((even >= 0.0) & (even < 1.0)).all()
    # Five standard errors of the mean and of the variance of 20,000 draws.
    assert abs(even.mean() - 0.5) < 5 * np.sqrt(1 / 12 / 20_000)
    assert abs(even.var() - 1 / 12) < 5 * np.sqrt(1 / 180 / 20_000)
    assert abs(bell.mean()) < 5 / np.sqrt(20_000)
    assert abs(bell.var() - 1.0) < 5 * np.sqrt(2 / 20_000)
