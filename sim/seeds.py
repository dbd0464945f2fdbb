"""Randomness that branches: what is drawn on one branch of a seed does not move another's draws."""

import zlib

import numpy as np


def sequence(seed: int, *branch: int) -> np.random.SeedSequence:
    """Return the entropy of a branch."""
    return np.random.SeedSequence(seed, spawn_key=branch)


def generator(seed: int, *branch: int) -> np.random.Generator:
    """Return the generator of a branch."""
    return np.random.default_rng(sequence(seed, *branch))


def node_generator(seed: int, branch: int, block: int, node: str) -> np.random.Generator:
    """Return the randomness of one node of a block, by the node's name."""
    return generator(seed, branch, block, zlib.crc32(node.encode()))
