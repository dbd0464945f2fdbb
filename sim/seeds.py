"""Branches of randomness: draws on one branch of a seed do not affect other branches."""

import zlib

import numpy as np

SESSION, BLOCK, NODE, ATTACK = range(4)  # the branches of every testbed; it has its own from 4 on


def sequence(seed: int, *branch: int) -> np.random.SeedSequence:
    """Return the entropy of a branch."""
    return np.random.SeedSequence(seed, spawn_key=branch)


def generator(seed: int, *branch: int) -> np.random.Generator:
    """Return the generator of a branch."""
    return np.random.default_rng(sequence(seed, *branch))


def attack_seed(seed: int, block: int) -> int:
    """Return the key of the counter-based randomness of a block's attacks, 64 bits."""
    return int(sequence(seed, ATTACK, block).generate_state(1, np.uint64)[0])


def node_generator(seed: int, branch: int, block: int, node: str) -> np.random.Generator:
    """Return the randomness of one node of a block, by the node's name."""
    return generator(seed, branch, block, zlib.crc32(node.encode()))
