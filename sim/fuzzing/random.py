"""Random draws that depend on their purpose, not on earlier draws.

The generator is counter-based (Philox): its key is the seed of the run and of the scenario, its
counter the message, the operation and the place of the draw in it. So a message gets the same
numbers online, offline and after lost messages.
"""

import math
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from sim.fuzzing.scenario import Scenario

_PARAMETERS = -1  # the operation that draws them; those of messages count from 0
_WORD = (1 << 64) - 1


class _Key(ISeedSequence):
    """A key in the form of a seed for Philox; passing it as a key takes four times as long.

    With a key, NumPy also requests a seed from the operating system, which is not used.
    """

    def __init__(self, *words: int) -> None:
        self._words = np.array([word & _WORD for word in words], np.uint64)

    def generate_state(self, n_words: int, dtype: Any = np.uint64) -> NDArray[np.uint64]:  # noqa: ARG002
        """Return the key."""
        return self._words


@dataclass(frozen=True, slots=True)
class Draws:
    """The randomness of one scenario in one run.

    Parameters
    ----------
    run_seed, scenario_seed
        Integers, of which 64 bits each are used.
    """

    run_seed: int
    scenario_seed: int
    _key: Any = field(init=False, repr=False, compare=False)  # NumPy's stubs know no own seeds

    def __post_init__(self) -> None:
        object.__setattr__(self, "_key", _Key(self.run_seed, self.scenario_seed))

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
        counter = np.array([0, place & _WORD, operation & _WORD, message & _WORD], np.uint64)
        return np.random.Generator(np.random.Philox(self._key, counter=counter))


def drawn_values(scenario: Scenario, run_seed: int) -> dict[str, Any]:
    """Return a value for each parameter with ``draw``, uniform or log-uniform.

    Integers include both bounds. The draws depend on the run's seed and the parameter's name, so a
    shadow control and an offline mutation have the same values as the attack.
    """
    draws = Draws(run_seed, scenario.seed)
    values: dict[str, Any] = {}
    for name, spec in scenario.document.get("parameters", {}).items():
        if "draw" not in spec:
            continue
        share = draws.generator(zlib.crc32(name.encode()), _PARAMETERS).random()
        low, high = spec["min"], spec["max"]
        is_whole = spec["type"] == "int"
        if is_whole:
            low, high = math.ceil(low), math.floor(high)
        if spec["draw"] == "log":
            value = low * (high / low) ** share
            value = round(value) if is_whole else value
        elif is_whole:
            value = low + math.floor(share * (high - low + 1))
        else:
            value = low + share * (high - low)
        values[name] = min(max(value, low), high)
    return values
