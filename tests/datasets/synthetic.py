"""Run features as a campaign would give them, with as much of an attack in them as is asked for."""

import numpy as np
import pandas as pd

MODES = {
    "lidar_passthrough": "normal",
    "lidar_passthrough_odom": "normal",
    "fake_object": "malicious",
    "random_noise": "malicious",
    "delayed_passthrough": "normal",
    "delayed_fakeobject": "malicious",
}
FIELDS = {
    "structural.density": {"unit": "1", "floor": "0.0001"},
    "contextual.duration": {"unit": "s", "floor": "0.1"},
}


def run_features(runs: int = 15, effect: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """Return ``runs`` runs of each mode; attacks shift two features by ``effect`` deviations.

    Durations have a heavy tail, and runs of one block are alike, as in a real campaign.
    """
    rng = np.random.default_rng(seed)
    blocks = rng.normal(size=runs)
    rows = []
    for mode, label in MODES.items():
        shift = effect if label == "malicious" else 0.0
        for run in range(runs):
            density, entropy, turning, ranges, tail = rng.normal(size=5)
            recovery = 4.0 if rng.random() < 0.05 else 1.0
            rows.append(
                {
                    "run_id": f"{mode}|run{run:03d}",
                    "mode": mode,
                    "label": label,
                    "block": run,
                    "session": run % 3,
                    "structural.density": 0.02 + 1e-4 * density,
                    "structural.entropy": 2.0 + 0.05 * (entropy + shift),
                    "contextual.yaw_variance": 0.5 + 0.1 * (turning + shift),
                    "contextual.range_variance": 1.0 + 0.2 * blocks[run] + 0.1 * ranges,
                    "contextual.duration": np.exp(5.3 + 0.2 * tail + 0.3 * blocks[run]) * recovery,
                    "missing": "{}",
                }
            )
    table = pd.DataFrame(rows)
    table.attrs["fields"] = FIELDS
    return table
