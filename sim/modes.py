"""The experiment modes: what each one does to the attacked topic, when, and how it is labelled.

Names, order and pairs are those of the experiments this project reproduces; the node that does
the work is made in ``sim.fuzzing``.
"""

from dataclasses import dataclass, replace
from typing import Literal

Operation = Literal["passthrough", "random_noise", "fake_object"]

DELAY_S = 30.0  # from the first goal's acceptance to the appearance of a delayed mode's node


@dataclass(frozen=True, slots=True)
class Mode:
    """One experiment."""

    id: str
    label: Literal["malicious", "normal", "control"]
    operation: Operation
    title: str
    with_odometry: bool = False  # the node also listens to /odom
    delayed: bool = False  # the node appears ``DELAY_S`` after the first goal was accepted
    shadow: bool = False  # the node does its work and hands the message on unchanged


_THESIS = (
    Mode("lidar_passthrough", "normal", "passthrough", "Second LiDAR handed on unchanged"),
    Mode(
        "lidar_passthrough_odom",
        "normal",
        "passthrough",
        "Second LiDAR handed on unchanged, odometry heard",
        with_odometry=True,
    ),
    Mode(
        "fake_object",
        "malicious",
        "fake_object",
        "A cylinder that is not there, across the planned path",
        with_odometry=True,
    ),
    Mode("random_noise", "malicious", "random_noise", "Every range off by up to ten per cent"),
    Mode(
        "delayed_passthrough",
        "normal",
        "passthrough",
        "Handed on unchanged, from 30 s after the first goal",
        with_odometry=True,
        delayed=True,
    ),
    Mode(
        "delayed_fakeobject",
        "malicious",
        "fake_object",
        "The fake cylinder, from 30 s after the first goal",
        with_odometry=True,
        delayed=True,
    ),
)

_SHADOWS = tuple(
    replace(
        mode,
        id=f"{mode.id}_shadow",
        label="control",
        title=f"{mode.title}: worked out, and not sent",
        shadow=True,
    )
    for mode in _THESIS
    if mode.label == "malicious"
)

PAIRS: tuple[tuple[str, str], ...] = (
    ("lidar_passthrough", "random_noise"),
    ("lidar_passthrough_odom", "fake_object"),
    ("delayed_passthrough", "delayed_fakeobject"),
)
"""Control and attack whose graphs are equal by construction."""


def modes() -> dict[str, Mode]:
    """Return every mode by name, in the order in which they are shown."""
    return {mode.id: mode for mode in (*_THESIS, *_SHADOWS)}
