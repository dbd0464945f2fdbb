"""The quantities that are compared: features, signals, and the presence of topics, nodes and edges.

The presence of a topic is a feature with value 0 or 1, so one test covers behaviour and interface.
Signals are the numbers of any robot's messages, so a robot without known features is compared, too.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.datasets import feature_columns, feature_floors, field_metadata, signal_columns
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.feature_sets import LEFT_OUT
from oracle_pipeline.scoring.reference import Reference

INTERFACE = "interface"  # family of the presence of topics, nodes and edges
RATE = "rate"  # family of the rate of each topic
PAYLOAD = "payload"  # family of the entropy of each topic's bytes
PARAMETER = "parameter"  # family of the numbers that nodes have as parameters
# Resolution of a set of recordings, in floors; a floor is what a queue or rounding does to one.
_STEP = 0.2
_OF_SPREAD = 0.1  # floor of a signal's statistic, which declares none: this share of its spread
_UNITS = {INTERFACE: "1", RATE: "Hz", PAYLOAD: "bit"}
_FLOORS = {INTERFACE: 0.0, RATE: 0.1, PAYLOAD: 0.02}


def family_of(column: str) -> str:
    """Return the family of a column."""
    return column.split(".", 1)[0]


def unit_of(column: str, table: pd.DataFrame) -> str:
    """Return the unit of a column of a feature table, or of one added here."""
    return field_metadata(table).get(column, {}).get("unit") or _UNITS.get(family_of(column), "1")


def measurements(reference: Reference, signals: Sequence[str]) -> pd.DataFrame:
    """Return the values to compare, one row per recording in the order of its table."""
    columns = [c for c in feature_columns(reference.table) if family_of(c) not in LEFT_OUT]
    columns += [column for column in signals if column in reference.table]
    features = reference.table[columns].reset_index(drop=True)
    if not reference.observations:
        return features
    return pd.concat([features, _interface(reference.observations)], axis=1)


def aligned(first: pd.DataFrame, second: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return both tables with the same columns.

    Missing columns are filled with 0 (absent) for the interface, and NaN for features.
    """
    columns = list(dict.fromkeys([*first.columns, *second.columns]))
    return _with(first, columns), _with(second, columns)


def resolved_values(
    tables: Sequence[pd.DataFrame], declared: pd.DataFrame
) -> list[NDArray[np.float64]]:
    """Return the values of each set in steps of each feature, shape (n_rows, n_columns).

    A difference below the step becomes a tie. `declared` is the feature table whose columns declare
    their floors.
    """
    together = pd.concat(tables)
    floors = {c: _OF_SPREAD * float(together[c].std()) for c in signal_columns(together)}
    floors |= feature_floors(declared)
    sizes = {column: _STEP * floor for column, floor in floors.items()}
    steps = np.array([sizes.get(c, _FLOORS.get(family_of(c), 0.0)) for c in together.columns])
    is_stepped = steps > 0.0
    units = np.where(is_stepped, steps, 1.0)
    values = (table.to_numpy(dtype=np.float64) for table in tables)
    return [np.where(is_stepped, np.round(each / units), each) for each in values]


def varying_columns(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the columns with values in both sets that are not all equal."""
    lowest, highest = (
        function([function(rows, axis=0) for rows in (first, second)], axis=0)
        for function in (np.fmin.reduce, np.fmax.reduce)
    )
    in_both = np.isfinite(first).any(axis=0) & np.isfinite(second).any(axis=0)
    return np.asarray(in_both & (lowest < highest), dtype=np.bool_)


def _with(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    table = table.reindex(columns=list(columns))
    interface = [column for column in columns if family_of(column) == INTERFACE]
    table[interface] = table[interface].fillna(0.0)
    return table


def _interface(observations: Sequence[Observation]) -> pd.DataFrame:
    rows = [{**dict.fromkeys(_elements(seen), 1.0), **_numbers(seen)} for seen in observations]
    table = pd.DataFrame(rows, dtype=np.float64)
    return _with(table, list(table.columns))


def _elements(seen: Observation) -> list[str]:
    topics = [f"topic {name} ({kind})" for name, (kind, _, _) in seen.topics.items()]
    qos = [
        f"topic {name}, QoS {words}" for name, (_, all_qos, _) in seen.topics.items()
        for words in all_qos
    ]  # fmt: skip
    texts = [
        f"parameter {name} = {value}"
        for name, value in seen.parameters.values.items() if isinstance(value, str)
    ]  # fmt: skip
    elements = (*topics, *qos, *texts, *sorted(seen.graph or ()))
    return [f"{INTERFACE}.{element}" for element in elements]


def _numbers(seen: Observation) -> dict[str, float]:
    """Return the rates and payloads of topics, and the parameters that are numbers."""
    rates = {name: hz for name, (_, _, hz) in seen.topics.items() if hz is not None}
    known = seen.parameters.values
    numbers = {name: each for name, each in known.items() if not isinstance(each, str)}
    families = {RATE: rates, PAYLOAD: seen.entropies, PARAMETER: numbers}
    return {f"{family}.{n}": value for family, of in families.items() for n, value in of.items()}
