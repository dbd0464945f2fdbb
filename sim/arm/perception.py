"""The nodes that publish where things are: transforms of the robot, and poses of objects."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from oracle_pipeline.bags.manifest import Pose
from oracle_pipeline.bags.template import STAMP, Template
from sim.arm.cell import LINKS, OBJECT_M, POST_M, local
from sim.arm.messages import BASE, COLLISION_OBJECT, JOINT_STATE, POSE, box, joints_of, make, pose
from sim.arm.recipes import ArmSession
from sim.arrays import Floats
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D, quaternion_yaw
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns
from sim.middleware.tf import TransformBroadcaster, planar_transform, transforms_template

TF_NS, POSE_NS, SCENE_NS = 50 * MILLISECOND, 100 * MILLISECOND, 500 * MILLISECOND
OBJECT, POST = "object", "post"
_URDF = Path(__file__).with_name("ur5e.urdf")


class RobotStatePublisher(Node):
    """``/tf`` from the joint states, at most 20 times a second; ``/robot_description``."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/robot_state_publisher")
        text = self.create_publisher("std_msgs/msg/String", "/robot_description", qos.LATCHED)
        text.publish(make("std_msgs/msg/String", data=_URDF.read_text("utf8")))
        chain = [BASE, *LINKS, "tool0"]
        *moved, still = (planar_transform(0, parent, child, Pose2D())
                         for parent, child in itertools.pairwise(chain))  # fmt: skip
        TransformBroadcaster(self, static=True).send([still])
        self._template = transforms_template(moved)
        self._tf = self.create_publisher("tf2_msgs/msg/TFMessage", "/tf", qos.TF)
        self._last_ns = -TF_NS
        self.create_subscription(JOINT_STATE, "/joint_states", self._on_joints, qos.SENSOR_DATA)

    def _on_joints(self, message: Any) -> None:
        time_ns, joints = stamp_ns(message.header.stamp), joints_of(message)
        if joints is None or 0 <= time_ns - self._last_ns < TF_NS:
            return
        self._last_ns = time_ns
        places, turns = local(joints[:-1])
        rows, stamp = np.hstack([places, turns.as_quat()]).tolist(), divmod(time_ns, SECOND)
        values = itertools.chain.from_iterable((*stamp, row) for row in rows)
        self._tf.publish_serialized(self._template.data(*values))


class ObjectDetector(Node):
    """A camera's view of the table: the object's pose, and boxes for the planning scene.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        Returns exact position and orientation of the object.
    session
        Errors of the poses.
    post
        Foot of the obstacle.
    """

    def __init__(
        self, domain: Domain, measure: Callable[[], tuple[Floats, Floats]], session: ArmSession,
        post: Pose, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        super().__init__(domain, "/object_detector", rng=rng)
        self._measure, self._noise_m = measure, session.camera_m
        self._error = np.array([*session.camera, 0.0])
        self._post = pose(post.x, post.y, POST_M[2], post.yaw)
        self._pose = self.create_publisher(POSE, "/object_pose", qos.SENSOR_DATA)
        self._boxes = self.create_publisher(COLLISION_OBJECT, "/collision_object", qos.RELIABLE)
        empty = make(POSE, header=header(0, BASE))
        self._template = Template(empty, POSE, (*STAMP, "pose"))
        self.create_timer(POSE_NS, self._publish)

    def _publish(self) -> None:
        position, (w, a, b, c) = self._measure()
        x, y, z = (position + self._error + self._noise_m * self.rng.standard_normal(3)).tolist()
        row = [x, y, z, a, b, c, w]
        self._pose.publish_serialized(self._template.data(*self.stamp, row))
        if self.now_ns % SCENE_NS == 0:
            thing = pose(x, y, z, quaternion_yaw(a, b, c, w))
            for name, where, half in ((OBJECT, thing, OBJECT_M), (POST, self._post, POST_M)):
                self._boxes.publish(box(name, where, half, self.now_ns))
