"""The ground truth of each run as a table, from manifests; no feature uses it.

Labels of runs are in the feature tables.
"""

import json
from collections.abc import Iterable

import numpy as np
import pandas as pd

from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.manifest import Manifest

COLUMNS = (
    "run_id", "onset_s", "recording_s", "behaviour", "conditions", "outcome", "attack", "changes",
)  # fmt: skip


def truth_table(manifests: Iterable[Manifest]) -> pd.DataFrame:
    """Return one row for each run, sorted by ``run_id``.

    Columns are ``run_id``, ``onset_s`` (NaN: never), ``recording_s`` [s of the recording],
    ``behaviour`` (what the robot did, by quantity), ``conditions`` (changes to the testbed, such as
    an obstacle), ``outcome``, ``attack`` (its parameters) and ``changes`` (the bins of 5 s in which
    messages were changed, as start, number of messages and largest change). The last five are JSON,
    except ``outcome``.
    """
    rows = [
        (
            manifest.key,
            np.nan if manifest.onset_s is None else manifest.onset_s,
            manifest.recording_s,
            json.dumps(behaviour(manifest), sort_keys=True),
            json.dumps(manifest.recipe.get("conditions", {}), sort_keys=True),
            manifest.outcome,
            json.dumps(dict(manifest.attack), sort_keys=True),
            json.dumps([tuple(change) for change in manifest.changes]),
        )
        for manifest in manifests
    ]
    return pd.DataFrame(rows, columns=COLUMNS).sort_values("run_id", ignore_index=True)
