"""The fourth testbed: an arm that picks an object and puts it down elsewhere."""

from sim.arm.recipes import ArmRecipe
from sim.testbed import Testbed, later

_FAULTS = "encoder_offset", "joint_friction", "payload", "gripper_slip", "force_bias", "speed_limit"
_STATES = "zero_velocity", "state_offset", "state_delay", "state_replay"
_ATTACKS = *_FAULTS, *_STATES, "phantom_object", "pose_offset"

ARM = Testbed(
    experiments=("arm_normal", *(f"arm_{name}" for name in _ATTACKS)),
    hard_negatives={"arm_benign_heavy": {}, "arm_benign_gains": {}},
    messages=frozenset({"control_msgs", "moveit_msgs"}),
    recipe=ArmRecipe,
    draw=later("sim.arm.drawing:draw"),
    bring_up=later("sim.arm.run:ArmRun"),
    made_by="sim.arm.run",
)
