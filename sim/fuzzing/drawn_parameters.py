"""Parameters of a scenario that each run draws between their bounds.

The draws depend on the run's seed and the parameter's name, so a shadow control and an offline
mutation have the same values as the attack.
"""

import math
import zlib
from typing import Any

from sim.fuzzing.random import Draws
from sim.fuzzing.scenario import Scenario

_PARAMETERS = -1  # the operation that draws them; those of messages count from 0


def drawn_values(scenario: Scenario, run_seed: int) -> dict[str, Any]:
    """Return a value for each parameter with ``draw``, uniform or log-uniform.

    Integers include both bounds.
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
