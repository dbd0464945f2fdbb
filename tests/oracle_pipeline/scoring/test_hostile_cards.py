"""A card from a stranger is refused with one clear line, or judges as it did."""

import io
import json
import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from oracle_pipeline.datasets import Fields, table_bytes
from oracle_pipeline.scoring.card import CardError, ReferenceCard, checked_card
from oracle_pipeline.scoring.learning import learned_scorer
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from tests.oracle_pipeline.scoring.test_contract import CONTRACT
from tests.oracle_pipeline.scoring.test_cross_conformal import ATTACKED, NORMAL, runs

pytestmark = pytest.mark.slow

SIGNALS = [f"signals./{topic}/{name}" for topic in ("odom", "imu") for name in ("x.mean", "y.std")]
ODD = [None, [], {}, "", "nan", True, -1, 0, 3, 1.5, 1e308, np.nan, np.inf, [[]], {"a": [0]}]
NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e308, 1e-308]


def with_signals(number, seed, modes=NORMAL, effect=0.0):
    of, rng = runs(number, seed, modes, effect), np.random.default_rng(seed)
    values = pd.DataFrame(rng.normal(effect, 1.0, (len(of.features), len(SIGNALS))))
    features = pd.concat([of.features, values.set_axis(SIGNALS, axis=1)], axis=1)
    declared = {**of.features.attrs["fields"], **{name: {"unit": "1"} for name in SIGNALS}}
    features.attrs["fields"] = Fields(declared)
    return MeasuredRuns(features, of.windows, of.run)


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    """What a card holds: features and their windows, signals by topic, a contract."""
    normal, file = with_signals(12, seed=0), tmp_path_factory.mktemp("card") / "robot.card"
    ReferenceCard(learned_scorer(normal), normal.features, CONTRACT, ("a note",)).save(file)
    assert {"run", "windows", "topics"} <= set(checked_card(file).scorer.levels_)
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def attacked():
    return with_signals(6, seed=1, modes=ATTACKED, effect=60.0)


def written(members, path, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def refused(path, attacked):
    """Return whether a card is refused; else it notices attacks as the unaltered card does."""
    try:
        card = checked_card(path)
    except CardError as error:
        told = str(error)
    else:
        noticed(card, attacked)
        return False
    assert told.startswith(str(path))
    assert len(told) < 600
    assert "\n" not in told
    return True


def noticed(card, attacked):
    assert card.scorer.p_values(card.scorer.scores(attacked)).max() <= 2 / 13
    assert np.isfinite(card.scorer.window_scores(attacked.windows)).all()


def places(value, place=()):
    """Yield the path of each value in a JSON document, of lists only the first two."""
    yield place
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*place, key))
    elif isinstance(value, list):
        for number in range(min(2, len(value))):
            yield from places(value[number], (*place, number))


def test_facts_of_a_wrong_type_or_size_are_refused_or_change_nothing(members, attacked, tmp_path):
    rng, count = np.random.default_rng(0), 0
    known = list(places(json.loads(members["card.json"])))[1:]
    for number in range(150):
        facts = json.loads(members["card.json"])
        *above, last = known[rng.integers(len(known))]
        within = facts
        for key in above:
            within = within[key]
        if number % 5 == 0:
            del within[last]
        elif number % 5 == 1 and isinstance(within[last], list):
            within[last] = within[last] * 2
        else:
            within[last] = ODD[rng.integers(len(ODD))]
        file = written({**members, "card.json": json.dumps(facts).encode()}, tmp_path / "a.card")
        count += refused(file, attacked)
    assert count > 100


def altered(row, column, rng):
    """Return a row of a table with one value altered."""
    value, kind = row[column], rng.integers(4)
    if not isinstance(value, list) or not value:
        return {**row, column: [None, "", -1, 99][kind] if isinstance(value, str | int) else [1.0]}
    if kind == 0:
        return {**row, column: value[:-1]}
    if kind == 1:
        return {**row, column: value + value}
    if isinstance(value[0], float):
        odd = NUMBERS[rng.integers(len(NUMBERS))]
        return {**row, column: [odd] * len(value) if kind == 2 else [odd, *value[1:]]}
    return {**row, column: value[:1] * len(value) if kind == 2 else None}


@pytest.mark.parametrize("member", ["models.parquet", "windows.parquet"])
def test_odd_values_of_a_model_are_refused_or_change_nothing(member, members, attacked, tmp_path):
    rng, count = np.random.default_rng(1), 0
    table = pq.read_table(pa.BufferReader(members[member]))
    for _ in range(60):
        rows, column = table.to_pylist(), str(rng.choice(table.column_names))
        chosen = [int(rng.integers(len(rows)))] if rng.random() < 0.5 else range(len(rows))
        for number in chosen:
            rows[number] = altered(rows[number], column, rng)
        try:
            content = pa.Table.from_pylist(rows, table.schema)
        except (pa.ArrowException, TypeError):
            continue
        sink = io.BytesIO()
        pq.write_table(content, sink)
        file = written({**members, member: sink.getvalue()}, tmp_path / "a.card")
        count += refused(file, attacked)
    assert count > 25


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.iloc[:-1],
        lambda table: table.iloc[::-1],
        lambda table: pd.concat([table, table]),
        lambda table: table.drop(columns=table.columns[-3]),
        lambda table: table.drop(columns="block"),
        lambda table: table.drop(columns="signals./odom/x.mean"),
        lambda table: table.assign(block="a"),
        lambda table: table.assign(label="malicious"),
        lambda table: table.assign(run_id=table["run_id"].iloc[0]),
        lambda table: table.assign(missing="[]no JSON"),
        lambda table: table.assign(**dict.fromkeys(SIGNALS, 1e300)),
    ],
)
def test_recordings_that_do_not_fit_the_models_are_refused(change, members, attacked, tmp_path):
    file = written(members, tmp_path / "a.card")
    table = checked_card(file).runs
    altered_table = change(table)
    altered_table.attrs = table.attrs
    content = {**members, "runs.parquet": table_bytes(altered_table)}
    assert refused(written(content, file), attacked)


def schema_of(members):
    return pq.read_schema(pa.BufferReader(members["models.parquet"]))


def repeated(text, rows, schema):
    """Return a small models table of very many rows, all of one scorer."""
    name = pa.DictionaryArray.from_arrays(np.zeros(rows, np.int8), [text])
    others = [pa.nulls(rows, field.type) for field in schema if field.name != "scorer"]
    sink = io.BytesIO()
    pq.write_table(pa.table([name, *others], names=schema.names), sink, compression="zstd")
    assert len(sink.getvalue()) < 500_000
    return sink.getvalue()


def test_a_small_card_that_claims_much_is_refused_before_it_is_decoded(members, tmp_path):
    models = repeated("all", 5_000_000, schema_of(members))
    bombs = {
        "values": written({**members, "models.parquet": models}, tmp_path / "values.card"),
        "compressed": written(members, tmp_path / "zip.card", zipfile.ZIP_DEFLATED),
        "bytes": written({**members, "card.json": b" " * (1 << 25)}, tmp_path / "facts.card"),
        "recursion": written({**members, "card.json": b"[" * 200_000}, tmp_path / "deep.card"),
    }
    for reason, file in bombs.items():
        with pytest.raises(CardError, match=reason):
            checked_card(file)


def test_a_card_that_takes_too_much_memory_is_an_error_of_its_process(members, tmp_path):
    models = repeated("x" * 8000, 1_000_000, schema_of(members))
    file = written({**members, "models.parquet": models}, tmp_path / "a.card")
    with pytest.raises(CardError, match="more memory than the limit of 2 GiB.*oracle learn"):
        ReferenceCard.load(file)
