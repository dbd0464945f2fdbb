"""Synthetic features of a campaign, with attacks of a given effect."""

import json

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import Fields
from oracle_pipeline.windows import HOP_S, MIN_WINDOW_S, WINDOW_S

MODES = {
    "lidar_passthrough": "normal",
    "lidar_passthrough_odom": "normal",
    "fake_object": "malicious",
    "random_noise": "malicious",
    "delayed_passthrough": "normal",
    "delayed_fakeobject": "malicious",
}
CONTROLS = {
    "fake_object_shadow": "control",
    "random_noise_shadow": "control",
    "delayed_fakeobject_shadow": "control",
    "benign_noise": "normal",
    "benign_obstacle": "normal",
}
DECLARED = {"origin": "generic", "shortcut": "false", "behaviour": "false"}
BEHAVIOUR = {**DECLARED, "behaviour": "true"}
FIELDS = {
    "structural.density": {"unit": "1", "floor": "0.0001", **DECLARED},
    "structural.entropy": {"unit": "1", **DECLARED},
    "contextual.yaw_variance": {"unit": "1", **BEHAVIOUR},
    "contextual.range_variance": {"unit": "m^2", **DECLARED, "origin": "domain"},
    "contextual.duration": {"unit": "s", "floor": "0.1", **BEHAVIOUR, "origin": "navigation"},
}
ATTACKED = {"structural.entropy": 0.05, "contextual.yaw_variance": 0.1}  # deviations of a run's
DELAY_S = 30.0


def run_features(
    runs: int = 15, effect: float = 0.0, seed: int = 0, modes: dict[str, str] = MODES
) -> pd.DataFrame:
    """Return ``runs`` runs of each mode; attacks shift two features by ``effect`` deviations.

    Durations have a heavy tail, and runs of one block are alike, as in a real campaign.
    """
    rng = np.random.default_rng(seed)
    blocks = rng.normal(size=runs)
    rows = []
    for mode, label in modes.items():
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
                    "world": f"random-{run // 2}",
                    "structural.density": 0.02 + 1e-4 * density,
                    "structural.entropy": 2.0 + 0.05 * (entropy + shift),
                    "contextual.yaw_variance": 0.5 + 0.1 * (turning + shift),
                    "contextual.range_variance": 1.0 + 0.2 * blocks[run] + 0.1 * ranges,
                    "contextual.duration": np.exp(5.3 + 0.2 * tail + 0.3 * blocks[run]) * recovery,
                    "where": "{}",
                    "missing": "{}",
                }
            )
    table = pd.DataFrame(rows)
    table.attrs["fields"] = Fields(FIELDS)
    return table


def _behaviour(features: pd.DataFrame, effect: float) -> list[str]:
    """Return what robots did: attacked ones drive a tenth of a metre more for each deviation."""
    attacked = (features["label"] == "malicious").to_numpy()
    chance = 0.01 * np.random.default_rng(len(features)).normal(size=len(features))
    driven_m = 10.0 + features["block"].to_numpy() + 0.1 * effect * attacked + chance
    return [json.dumps({"driven_m": float(metres), "under_way_s": 60.0}) for metres in driven_m]


def campaign(
    runs: int = 15, effect: float = 0.0, seed: int = 0, modes: dict[str, str] = MODES | CONTROLS
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Return run table, window table and truth of one campaign.

    Windows scatter about their run's mean; those of attacks are shifted from the onset on.
    """
    features = run_features(runs, effect, seed, modes)
    rng = np.random.default_rng([seed, 1])
    lengths = rng.uniform(70.0, 110.0, len(features))
    delayed = features["mode"].str.startswith("delayed").to_numpy()
    onsets = np.where(delayed, DELAY_S, 0.0)
    counts = np.ceil((lengths - MIN_WINDOW_S) / HOP_S).astype(int)
    starts = np.concatenate([HOP_S * np.arange(n) for n in counts])
    windows = features.loc[np.repeat(features.index, counts)].reset_index(drop=True)
    windows = windows.drop(columns="contextual.duration").assign(window_start_s=starts)
    malicious = (windows["label"] == "malicious").to_numpy()
    attacked = malicious & (starts + WINDOW_S > np.repeat(onsets, counts))
    for column, deviation in ATTACKED.items():
        of_run = deviation * effect * malicious  # what the run's own value has of the attack
        noise = deviation * rng.normal(size=len(windows))
        windows[column] += noise - of_run + deviation * effect * attacked
    windows.attrs["fields"] = Fields({**FIELDS, "window_start_s": {"unit": "s"}})
    truth = pd.DataFrame(
        {
            "run_id": features["run_id"],
            "onset_s": onsets,
            "recording_s": lengths,
            "behaviour": _behaviour(features, effect),
            "conditions": "{}",
            "outcome": "succeeded",
            "attack": "{}",
            "changes": "[]",
        }
    )
    return features, windows, truth
