"""The magnitude of each built-in attack, which is the default sweep of a kill matrix."""

from collections.abc import Mapping

from sim.commands.parameter_values import ParameterError, Sweep, sweep
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.value_types import Number
from sim.testbed import Mode

# Of the built-in attacks, from hardly visible to obvious. The smallest ranges are below
# the noise of the sensor, or the jitter of the topic.
BUILT_IN: Mapping[str, str] = {
    "fake_object": "radius=0.02:0.4:8:log",
    "delayed_fakeobject": "radius=0.02:0.4:8:log",
    "random_noise": "level=0.005:0.2:8:log",
    "random_noise_thesis": "level=0.005:0.2:8:log",
    "held_object": "radius=0.02:0.4:8:log",
    "blinded_sector": "half_width=0.02:1.6:8:log",
    "message_mutator": "share=0.001:0.3:8:log",
    "range_drift": "rate=0.0005:0.05:8:log",
    "odometry_spoof": "rate=0.001:0.1:8:log",
    "sensor_delay": "seconds=0.02:2:8:log",
    "sensor_drop": "share=0.01:0.9:8:log",
    "topic_flood": "copies=2:64:6:log",
    "command_injection": "rate=0.1:20:8:log",
    "command_scale": "share=0.05:1:8:log",
    "odometry_drift": "rate=0.002:0.5:8:log",
    "odometry_reordered": "latest=0.01:5:8:log",
    "scan_link_drop": "share=0.01:0.95:8:log",
    "infrared_ghost": "share=0.01:1:8:log",
    "speed_limit": "percentage=10:100:8:log",
    "atc_delete_timer_callsign": "length_s=4:240:8:log",
    "atc_deadzone": "radius_m=500:50000:8:log",
    "atc_ghost_following": "behind_m=100:20000:8:log",
    "atc_altitude_decrease": "rate_m_s=0.1:20:8:log",
    "atc_gps_alteration": "drift_m_s=0.5:100:8:log",
    "atc_follow_closest": "gap_m=50:10000:8:log",
    "cf_propeller_cut": "cut=0.25:6:8:log",
    "cf_blade_cut": "cut=0.1:3:8:log",
    "cf_payload": "mass=0.25:8:8:log",
    "cf_string": "mass=0.25:8:8:log",
    "cf_tape": "mass=1:60:8:log",
    "cf_gyro_bias": "bias=0.002:0.5:8:log",
    "cf_pose_offset": "offset=0.005:0.5:8:log",
    "cf_pose_drift": "rate=0.001:0.1:8:log",
    "cf_pose_delay": "seconds=0.01:0.3:8:log",
    "cf_pose_freeze": "seconds=0.05:2:8:log",
    "cf_battery_spoof": "volts=0.05:1:8:log",
    "cf_setpoint_offset": "offset=0.005:0.5:8:log",
}
# These have no magnitude: they happen or not.
WITHOUT = ("sensor_freeze", "sensor_replay", "atc_delete_by_id", "atc_ghost_static",
           "tf_best_effort", "cf_pose_replay")  # fmt: skip

_VALUES = 8


def sweeps_of(mode: Mode) -> list[Sweep]:
    """Return the sweeps of a scenario: those of a built-in one, or else of each bounded number.

    Raises
    ------
    ParameterError
        If there is nothing to sweep.
    """
    if mode.id in BUILT_IN:
        return [sweep(mode, BUILT_IN[mode.id])]
    if mode.id in WITHOUT:
        raise ParameterError(f"{mode.id} has no magnitude; sweep a parameter with --over.")
    program = compile_scenario(mode.scenario, allow_actuation=True)
    found = [
        sweep(mode, f"{name}={parameter.low!r}:{parameter.high!r}:{_VALUES}")
        for name, parameter in program.parameters.items()
        if isinstance(parameter.type, Number)
        and name not in mode.scenario.drawn
        and parameter.low is not None
        and parameter.high is not None
    ]
    if not found:
        raise ParameterError(
            f"{mode.id} has no number with a min and a max; sweep a parameter with --over."
        )
    return found
