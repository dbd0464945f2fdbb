"""The sets of features that detectors are judged on."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import feature_columns, field_metadata

LEFT_OUT = ("thesis",)  # families that are no part of our oracle
ASPECTS = ("tampering", "misbehaviour")  # what a recording is scored by besides all features
# Families that compare sensors, a topic and its relay, or a sensor and what all sensors marked.
REDUNDANT = ("redundancy", "pairs", "costmap")


def feature_sets(df: pd.DataFrame) -> dict[str, list[str]]:
    """Return the sets of columns that are judged, by name.

    ``all`` is the oracle's own: every family but the thesis's, without shortcuts. It has two parts:
    ``misbehaviour``, features that declare to tell what the robot did, and ``tampering``, all
    others. Then each family alone; ``generic``, what any bag gives; ``without redundancy``, what is
    left if no second topic tells the same; and ``shortcuts``, which identify a run by its nodes.
    Features without any finite value are in none.
    """
    fields = field_metadata(df)
    has_value = np.isfinite(df[feature_columns(df)].to_numpy(dtype=np.float64)).any(axis=0)
    present = [c for c, finite in zip(feature_columns(df), has_value, strict=True) if finite]
    columns = [c for c in present if c.split(".", 1)[0] not in LEFT_OUT]
    shortcut = [c for c in columns if fields.get(c, {}).get("shortcut") == "true"]
    usable = [c for c in columns if c not in shortcut]
    families = dict.fromkeys(c.split(".", 1)[0] for c in usable)
    behaviour = [c for c in usable if fields.get(c, {}).get("behaviour") == "true"]
    sets = {
        "all": usable,
        "tampering": [c for c in usable if c not in behaviour],
        "misbehaviour": behaviour,
        **{family: [c for c in usable if c.startswith(f"{family}.")] for family in families},
        "generic": [c for c in usable if fields.get(c, {}).get("origin") == "generic"],
        "without redundancy": [c for c in usable if c.split(".", 1)[0] not in REDUNDANT],
        "shortcuts": shortcut,
    }
    return {name: chosen for name, chosen in sets.items() if chosen}
