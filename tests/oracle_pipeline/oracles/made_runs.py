"""Synthetic traces of a robot on patrol, and runs with them."""

import numpy as np
import pandas as pd

from oracle_pipeline.oracles.kind import TracedRuns
from oracle_pipeline.oracles.traces import SIGNALS, STEP_S, TIME


def trace(seed: int, seconds: float = 20.0, **altered: float) -> pd.DataFrame:
    """Return a patrol; altered signals get a number added to them from the middle on."""
    rng = np.random.default_rng(seed)
    clock = np.arange(0.0, seconds, STEP_S)
    speed = 0.2 + 0.02 * np.sin(clock) + 0.005 * rng.normal()
    columns = {name: np.zeros(len(clock)) for name in SIGNALS}
    columns |= {
        "command_speed": speed,
        "speed": speed + 0.002 * rng.normal(size=len(clock)),
        "travelled": np.cumsum(speed) * STEP_S,
        "acceleration": 9.81 + 0.05 * rng.normal(size=len(clock)),
        "nearest_min": 0.5 + 0.02 * rng.normal() + 0.01 * rng.normal(size=len(clock)),
        "goal_time": clock + STEP_S,
    }
    columns["nearest_max"] = columns["nearest_min"] + 0.05
    columns["goal_time"][-5:] = 0.0
    for name, change in altered.items():
        columns[name] = columns[name] + change * (clock >= seconds / 2)
    return pd.DataFrame({TIME: clock, **columns})


def campaign(blocks: int = 24, repeats: int = 3, **altered: float) -> TracedRuns:
    """Return normal runs of some blocks, each a session, and an attacked one of each block."""
    rows, traces = [], []
    for block in range(blocks):
        for repeat in range(repeats + 1):
            attacked = repeat == repeats
            mode = "attack" if attacked else f"patrol{repeat}"
            label = "malicious" if attacked else "normal"
            rows.append((f"{mode}|run{block:03d}", mode, label, block, block, "hall"))
            traces.append(trace(100 * block + repeat, **(altered if attacked else {})))
    keys = ["run_id", "mode", "label", "block", "session", "world"]
    return TracedRuns(pd.DataFrame(rows, columns=keys), tuple(traces))
