"""The sets of features that detectors are judged on."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import feature_columns, field_metadata

LEFT_OUT = ("thesis",)  # families that our oracle does not use
ASPECTS = ("tampering", "misbehaviour")  # sets that get a score beside that of all features


def feature_sets(df: pd.DataFrame) -> dict[str, list[str]]:
    """Return the sets of columns that are judged, by name.

    ``all`` has every family but the thesis's, without shortcuts, which identify a run by its nodes.
    It has two parts: ``misbehaviour``, features declared to describe what the robot did, and
    ``tampering``, all others. Features without a finite value are in no set.
    """
    fields, columns = field_metadata(df), feature_columns(df)
    has_value = np.isfinite(df[columns].to_numpy(dtype=np.float64)).any(axis=0)
    present = [c for c, finite in zip(columns, has_value, strict=True) if finite]
    declared = {c: fields.get(c, {}) for c in present if c.split(".", 1)[0] not in LEFT_OUT}
    usable = [c for c, field in declared.items() if field.get("shortcut") != "true"]
    behaviour = [c for c in usable if declared[c].get("behaviour") == "true"]
    sets = {
        "all": usable,
        "tampering": [c for c in usable if c not in behaviour],
        "misbehaviour": behaviour,
    }
    return {name: chosen for name, chosen in sets.items() if chosen}
