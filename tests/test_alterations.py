"""The attacks of the ladder alter what features are computed from."""

import numpy as np
import pytest

from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from tools.bench.alterations import FIVE, SCAN, Alteration, open_altered, ranges_by
from tools.bench.ladder import ATTACKS, CONTROL

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "attack",
    [each for each in ATTACKS if each.alteration],
    ids=lambda attack: f"{attack.rung.name}: {attack.name}",
)
def test_every_attack_changes_messages(recorded_run, attack):
    """Opening raises an error if nothing changes."""
    with open_altered(recorded_run(CONTROL).path, attack.alteration, attack.rung.left_out) as run:
        assert not run.bag.topics.keys() & set(attack.rung.left_out)


def test_an_alteration_without_effect_is_an_error(recorded_run):
    with pytest.raises(RuntimeError, match="changes no message"):
        open_altered(recorded_run(CONTROL).path, Alteration({SCAN: lambda: lambda *_: None}))


def test_features_are_those_of_the_altered_messages(recorded_run):
    path, manager = recorded_run(CONTROL).path, build_manager()
    with open_run(path) as run:
        recorded = extract(run, manager).run
    tables = {}
    for name, alteration in (
        ("none", Alteration()),
        ("longer", ranges_by(lambda m: m.ranges * FIVE)),
    ):
        with open_altered(path, alteration) as run:
            tables[name] = extract(run, manager).run
    of_messages = [c for c in feature_columns(recorded) if recorded[c].notna().all()]
    of_messages = [c for c in of_messages if tables["none"][c].notna().all()]  # no graphs
    assert len(of_messages) > 100
    np.testing.assert_allclose(tables["none"][of_messages], recorded[of_messages], rtol=1e-9)
    scale = "kinematics.travel_scale_pose_scan"
    change = float(tables["longer"][scale].iloc[0] - recorded[scale].iloc[0])
    assert change > 0.01
