"""The second testbed: flights, radars, ADS-B and the controller's display."""

from sim.atc.recipes import AtcRecipe
from sim.testbed import Testbed, later

AIR_TRAFFIC_CONTROL = Testbed(
    experiments=(
        "atc_normal", "atc_delete_by_id", "atc_delete_timer_callsign", "atc_deadzone",
        "atc_ghost_static", "atc_ghost_following", "atc_altitude_decrease",
        "atc_gps_alteration", "atc_follow_closest",
    ),
    messages=frozenset({"atc_msgs"}),
    recipe=AtcRecipe,
    draw=later("sim.atc.drawing:draw"),
    bring_up=later("sim.atc.run:AtcRun"),
    made_by="sim.atc.run",
)  # fmt: skip
