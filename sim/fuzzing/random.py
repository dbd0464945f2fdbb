"""Draws that depend on what they are for, not on what was drawn before.

The generator is counter-based (Philox): its key is the seed of the run and of the scenario, its
counter the message, the operation and the place of the draw in it. So online, offline and after
lost messages a message meets the same numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_WORD = (1 << 64) - 1


@dataclass(frozen=True, slots=True)
class Draws:
    """The randomness of one scenario in one run.

    Parameters
    ----------
    run_seed, scenario_seed
        Integers; 64 bits of each count.
    """

    run_seed: int
    scenario_seed: int

    def generator(self, message: int, operation: int, place: int = 0) -> np.random.Generator:
        """Return the generator of one operation on one message.

        Parameters
        ----------
        message
            Which message: any integer, 64 bits of it count.
        operation
            Which operation of the scenario.
        place
            Which of the draws of that operation, where it has several.
        """
        key = np.array([self.run_seed & _WORD, self.scenario_seed & _WORD], np.uint64)
        counter = np.array([0, place & _WORD, operation & _WORD, message & _WORD], np.uint64)
        return np.random.Generator(np.random.Philox(key=key, counter=counter))

    def uniform(self, message: int, operation: int, n: int) -> NDArray[np.float64]:
        """Return ``n`` draws from [0, 1); the first ones are the same for every ``n``."""
        return self.generator(message, operation).random(n)

    def normal(self, message: int, operation: int, n: int) -> NDArray[np.float64]:
        """Return ``n`` standard normal draws; the first ones are the same for every ``n``."""
        return self.generator(message, operation).standard_normal(n)
