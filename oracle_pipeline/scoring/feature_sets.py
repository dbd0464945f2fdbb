"""The sets of features that detectors are judged on."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import feature_columns, field_metadata

LEFT_OUT = ("thesis",)  # families that our oracle does not use
ASPECTS = ("tampering", "misbehaviour")  # sets that get a score beside that of all features
# Families that compare sensors, a topic and its relay, or a sensor and the costmap.
REDUNDANT = ("redundancy", "pairs", "costmap")


def feature_sets(df: pd.DataFrame) -> dict[str, list[str]]:
    """Return the sets of columns that are judged, by name.

    ``all`` has every family but the thesis's, without shortcuts. It has two parts:
    ``misbehaviour``, features declared to describe what the robot did, and ``tampering``, all
    others. Further sets are each family alone; ``generic``, features of any bag; ``without
    redundancy``, without comparisons of redundant topics; and ``shortcuts``, which identify a run
    by its nodes. Features without a finite value are in no set.
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
