"""The third testbed: a Crazyflie that hovers, flies to points, and flies a figure of eight."""

from sim.crazyflie.recipes import CrazyflieRecipe
from sim.testbed import Testbed, later

_ATTACKS = (
    *("propeller_cut", "blade_cut", "payload", "string", "tape", "gyro_bias", "pose_offset"),
    *("pose_drift", "pose_delay", "pose_freeze", "pose_replay", "battery_spoof"),
)

CRAZYFLIE = Testbed(
    experiments=("cf_normal", *(f"cf_{name}" for name in _ATTACKS)),
    hard_negatives={"cf_benign_wind": {}, "cf_benign_battery": {}},
    messages=frozenset({"crazyflie_interfaces", "motion_capture_tracking_interfaces"}),
    recipe=CrazyflieRecipe,
    draw=later("sim.crazyflie.drawing:draw"),
    bring_up=later("sim.crazyflie.run:CrazyflieRun"),
    made_by="sim.crazyflie.run",
)
