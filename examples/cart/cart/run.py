"""One run: the world, four ROS nodes, and the node of the mode between encoder and controller."""

import math
from pathlib import Path

import mujoco
import numpy as np

from cart.testbed import CartRecipe
from oracle_pipeline.bags.types import message_class
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.timed_run import TimedRun

MODEL = """<mujoco><worldbody><body>
  <joint name="rail" type="slide" axis="1 0 0" damping="{damping}"/>
  <geom type="box" size=".2 .1 .1" mass="{mass_kg}"/>
</body></worldbody><actuator><motor joint="rail" ctrlrange="-20 20"/></actuator></mujoco>"""
JointState = message_class("sensor_msgs/msg/JointState")
Float64 = message_class("std_msgs/msg/Float64")


class CartRun(TimedRun):
    """The cart, for one run."""

    def __init__(self, recipe: CartRecipe, folder: Path) -> None:
        model = MODEL.format(damping=recipe.damping, mass_kg=recipe.mass_kg)
        self.model = mujoco.MjModel.from_xml_string(model)
        self.data = mujoco.MjData(self.model)
        super().__init__(
            recipe,
            folder,
            self.advance_to,
            duration_s=recipe.duration_s,
            settling_s=1.0,
            session=recipe.session,
            world="rail",
        )
        self.period_s, self.noise = recipe.period_s, recipe.generator("/encoder")
        self.target_m = self.force_n = 0.0
        encoder, planner = Node(self.domain, "/encoder"), Node(self.domain, "/planner")
        self.joints = encoder.create_publisher("sensor_msgs/msg/JointState", "/joint_states")
        self.targets = planner.create_publisher("std_msgs/msg/Float64", "/target")
        self.add_mode("/joint_state_relay", latency_ns=2 * MILLISECOND)
        controller, motor = Node(self.domain, "/controller"), Node(self.domain, "/motor")
        self.forces = controller.create_publisher("std_msgs/msg/Float64", "/force")
        controller.create_subscription("std_msgs/msg/Float64", "/target", self.aim)
        controller.create_subscription("sensor_msgs/msg/JointState", "/joint_relayed", self.push)
        motor.create_subscription("std_msgs/msg/Float64", "/force", self.drive)
        encoder.create_timer(20 * MILLISECOND, self.measure)
        planner.create_timer(100 * MILLISECOND, self.plan)

    def advance_to(self, now_ns: int) -> None:
        """Let the physics go on to a time."""
        while self.data.time < now_ns / SECOND:
            mujoco.mj_step(self.model, self.data)

    def measure(self) -> None:
        """Publish what the encoder reads."""
        now, noise = self.domain.executor.now_ns, self.noise.normal(0.0, 0.001, 2)
        place, speed = self.data.qpos + noise[:1], self.data.qvel + noise[1:]
        self.joints.publish(JointState(header(now, "rail"), ["rail"], place, speed, np.zeros(0)))

    def plan(self) -> None:
        """Publish where the cart should be."""
        phase = 2.0 * math.pi * self.domain.executor.now_ns / SECOND / self.period_s
        self.targets.publish(Float64(0.5 * math.sin(phase)))

    def aim(self, target: Float64) -> None:
        """Take the newest target."""
        self.target_m = target.data

    def push(self, joint: JointState) -> None:
        """Publish the force that brings the cart to the target."""
        error_m = self.target_m - joint.position[0]
        self.forces.publish(Float64(float(40.0 * error_m - 8.0 * joint.velocity[0])))

    def drive(self, force: Float64) -> None:
        """Apply the force that the motor was told."""
        self.data.ctrl[0] = force.data
