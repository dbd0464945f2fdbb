"""The features of domains together, on bags that were not made for them."""

import json

import pytest

from oracle_pipeline import features
from oracle_pipeline.features.air_traffic import adsb_reports, fused_tracks
from oracle_pipeline.features.lidar import local_costmap, map_consistency, redundancy, scan
from oracle_pipeline.features.manager import FeatureManager
from oracle_pipeline.features.motion import localisation, velocity
from oracle_pipeline.features.navigation import progress
from oracle_pipeline.opened_run import open_run

MODULES = (
    redundancy, scan, map_consistency, progress, velocity, localisation, local_costmap,
    adsb_reports, fused_tracks,
)  # fmt: skip
MANAGER = FeatureManager(tuple(p for module in MODULES for p in module.register_features()))


def test_no_foreign_bag_makes_a_plugin_fail(foreign_bag):
    with open_run(foreign_bag) as run:
        tables = features.extract(run, MANAGER)
    for table in tables:
        for reasons in map(json.loads, table["missing"]):
            assert not [reason for reason in reasons.values() if "Error" in reason]
            assert not [reason for reason in reasons.values() if "the plugin returned" in reason]


@pytest.mark.parametrize("feature", ["scan.roughness", "scan.innovation"])
def test_a_bag_with_a_scanner_and_odometry_has_features(bag_of, messages, feature):
    recorded = [
        each
        for t in range(8)
        for each in (
            (t, "/odom", messages.odometry(t, 0.1 * t, 0.0, 0.0, 0.0)),
            (t, "/scan", messages.scan(t, [1.0 + 0.1 * ray for ray in range(20)])),
        )
    ]
    with open_run(bag_of(recorded)) as run:
        tables = features.extract(run, MANAGER)
    assert tables.run[feature].notna().all()
    assert tables.windows[feature].notna().all()


def test_units_floors_and_origins_are_given():
    offered = MANAGER.features()
    assert {name.partition(".")[0] for name in offered} == {
        "redundancy", "scan", "map", "navigation", "atc"
    }  # fmt: skip
    for name, feature in offered.items():
        assert feature.floor > 0.0, name
        assert feature.origin in ("domain", "navigation"), name
        assert not feature.shortcut, name
