"""A value in another unit than the parameter's is refused, and the error has it converted."""

import re

import pytest

from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from tests.sim.fuzzing.workbench import builtin


@pytest.mark.parametrize(
    ("scenario", "name", "value", "expected"),
    [
        ("blinded_sector", "half_width", 30.0,
         "expected 0.0 to 3.15 rad, found 30.0 (30 deg is 0.5236 rad)."),
        ("blinded_sector", "half_width", "30 deg",
         "expected a number in rad, found '30 deg' (30 deg is 0.5236 rad)."),
        ("blinded_sector", "half_width", "30°",
         "expected a number in rad, found '30°' (30° is 0.5236 rad)."),
        ("fake_object", "radius", 25.0, "expected 0.02 to 2.0 m, found 25.0 (25 cm is 0.25 m)."),
        ("fake_object", "radius", 500.0, "expected 0.02 to 2.0 m, found 500.0 (500 mm is 0.5 m)."),
        ("odometry_drift", "rate", "10 deg/s",
         "expected a number in rad/s, found '10 deg/s' (10 deg/s is 0.1745 rad/s)."),
        ("sensor_drop", "share", 30.0, "expected 0.0 to 1.0, found 30.0 (30 % is 0.3)."),
        # What has no sensible meaning gets no hint.
        ("sensor_drop", "share", -30.0, "expected 0.0 to 1.0, found -30.0."),
        ("sensor_drop", "share", float("nan"), "expected 0.0 to 1.0, found nan."),
        ("fake_object", "radius", "25 deg", "expected a number in m, found '25 deg'."),
        ("fake_object", "radius", "1 km", "expected a number in m, found '1 km'."),
        ("topic_flood", "copies", 500, "expected 2 to 64, found 500."),
    ],
)  # fmt: skip
def test_a_value_in_another_unit_is_refused_with_its_conversion(scenario, name, value, expected):
    with pytest.raises(ScenarioError, match=re.escape(expected)):
        execute(builtin(scenario), 1, {name: value})
