"""The command compares the results of each kind of oracle."""

from oracle_pipeline.evaluation.kinds_comparison import compare_kinds
from oracle_pipeline.oracles.human import answered_by_labels
from oracle_pipeline.oracles.implicit import Implicit
from oracle_pipeline.oracles.invariants import Invariants
from oracle_pipeline.oracles.kind import Material
from oracle_pipeline.oracles.requirements import Requirements
from oracle_pipeline.reporting.kinds_tables import as_json, as_text
from tests.oracle_pipeline.oracles.made_runs import campaign


def test_there_is_a_row_for_each_kind_and_a_row_for_each_mode():
    comparison = compare_kinds([Implicit(), Invariants()], campaign(errors=2.0))
    assert comparison.oracles["oracle"].tolist() == ["implicit", "invariants", "union"]
    text = as_text(comparison, 0.05)
    lines = [line.split() for line in text.splitlines()]
    assert ["label", "mode", "implicit", "invariants", "union"] in lines
    assert ["malicious", "attack", "1.000", "1.000", "1.000"] in lines
    assert '"far": 0.05' in as_json(comparison, 0.05)


def test_few_runs_give_no_rate_but_the_number_that_is_needed():
    runs = campaign(4, errors=2.0)
    assert answered_by_labels(Material(runs.where(runs.block < 0), Requirements()), 5).answers == {}
    comparison = compare_kinds([Implicit(), Invariants()], runs)
    assert "4 blocks of normal runs cannot support" in comparison.oracles["note"].iloc[0]
    text = as_text(comparison, 0.05)
    assert "implicit, invariants, union: 4 blocks of normal runs cannot support" in text
    assert text.count("record 20, or allow a higher rate") == 1


def test_the_list_of_recordings_says_how_many_it_does_not_show():
    runs = campaign(24)
    tonight = runs.table.assign(label=runs.table["label"].replace("malicious", "unknown"))
    comparison = compare_kinds([Implicit()], type(runs)(tonight, runs.traces))
    assert "    4 more recordings; --format json lists all." in as_text(comparison, 0.05)
