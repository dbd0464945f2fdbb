"""DWB's debug topics ``/evaluation`` and ``/marker``, built only for subscribers.

A cycle has some 400 trajectories of some 20 poses each. They are scored again here, by the
planner's own critics and in Nav2's order, and laid out straight as CDR: the bytes are those that
serialising the messages would give, without a hundred thousand objects.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.jit import jit
from sim.middleware import qos
from sim.middleware.node import Node
from sim.nav2.cdr_words import CDR_LITTLE_ENDIAN, header_words, put, string_words
from sim.nav2.dwb_critics import (
    Scoring,
    map_cells,
    map_score,
    obstacle_cost,
    rotate_to_goal,
)
from sim.nav2.dwb_sampling import most_poses, roll, twists
from sim.nav2.paths import Poses

EVALUATION = "dwb_msgs/msg/LocalPlanEvaluation"
MARKERS = "visualization_msgs/msg/MarkerArray"

# In the order in which a trajectory meets them.
CRITICS = (
    "RotateToGoal",
    "Oscillation",
    "BaseObstacle",
    "GoalAlign",
    "PathAlign",
    "PathDist",
    "GoalDist",
)
_ROTATE_TO_GOAL, _OSCILLATION, _BASE_OBSTACLE = range(3)
_GOAL_ALIGN, _PATH_ALIGN, _PATH_DIST, _GOAL_DIST = range(3, 7)

LINE_STRIP = 4  # visualization_msgs/msg/Marker.type
LINE_WIDTH_M = 0.002
LIFETIME_NS = 100_000_000
VALID, INVALID = "ValidTrajectories", "InvalidTrajectories"  # namespaces of the markers

_NAME_WORDS = np.array([len(string_words(name)) for name in CRITICS])
_NAMES = np.array([np.resize(string_words(name), _NAME_WORDS.max()) for name in CRITICS])

# A marker after its points: colors, texture_resource, texture (stamp, frame_id, format, data),
# uv_coordinates, text, mesh_resource, mesh_file (filename, data), mesh_use_embedded_materials.
# An empty string is a length of one and a zero.
_MARKER_TAIL = np.array([0, 1, 0, 0, 0, 1, 0, 1, 0, 0, 0, 1, 0, 1, 0, 1, 0, 0, 0], np.uint32)


class Evaluation(NamedTuple):
    """Every twist that was tried, in order, with the scores of the critics."""

    sim_time: float  # of every trajectory [s]
    twists: NDArray[np.float64]  # (n, 2) [m/s, rad/s]
    poses: Poses  # of all trajectories, one after the other
    ends: NDArray[np.int64]  # (n,) where in ``poses`` a trajectory ends
    raw_scores: NDArray[np.float64]  # (n, 7)
    scales: NDArray[np.float64]  # (7,)
    asked: NDArray[np.int64]  # (n,) how many critics are reported
    refused_by: NDArray[np.int64]  # (n,) the critic to which it is illegal, -1 if it is to none
    totals: NDArray[np.float32]  # (n,) -1 if illegal
    best: int
    worst: int


class DebugTopics:
    """The two publishers, on behalf of the controller server.

    Parameters
    ----------
    node
        The node that publishes.
    """

    def __init__(self, node: Node) -> None:
        self._evaluation = node.create_publisher(EVALUATION, "/evaluation", qos.RELIABLE)
        self._markers = node.create_publisher(MARKERS, "/marker", qos.RELIABLE)

    def publish(self, time_ns: int, frame: str, scoring: Scoring) -> None:
        """Publish one cycle, on topics with a receiver."""
        evaluation_is_received, markers_are_received = (
            self._evaluation.has_receiver(),
            self._markers.has_receiver(),
        )
        if not (evaluation_is_received or markers_are_received):
            return
        evaluation = evaluate(scoring)
        if evaluation_is_received:
            self._evaluation.publish_serialized(evaluation_bytes(time_ns, frame, evaluation))
        if markers_are_received:
            self._markers.publish_serialized(marker_bytes(time_ns, frame, evaluation))


@jit
def evaluate(scoring: Scoring) -> Evaluation:
    """Score every trajectory of a cycle as Nav2 does, short circuit included.

    A trajectory is rejected as soon as its sum is above the best so far, and its later critics are
    not evaluated. The best is the twist that the planner chose.
    """
    parameters = scoring.parameters
    forward, turning = twists(parameters, scoring.velocity)
    most = len(forward) * len(turning)
    longest = most_poses(parameters, forward, turning)
    tried = np.empty((most, 2))
    poses = np.empty((most * longest, 3))
    ends = np.empty(most, np.int64)
    raw_scores = np.zeros((most, len(CRITICS)))
    asked = np.empty(most, np.int64)
    refused_by = np.empty(most, np.int64)
    totals = np.empty(most, np.float32)
    scales = _scales(scoring)
    n, end, best, worst, lowest, highest = 0, 0, 0, 0, math.inf, -1.0
    for v in forward:
        for w in turning:
            if v == 0.0 and w == 0.0:
                continue
            start = end
            end += roll(parameters, scoring.pose, scoring.velocity, (v, w), poses[start:])
            refused_by[n], asked[n], total = _score(
                scoring, (v, w), poses[start:end], scales, lowest, raw_scores[n]
            )
            if refused_by[n] < 0 and total < lowest:
                lowest, best = total, n
            if refused_by[n] < 0 and total > highest:
                highest, worst = total, n
            tried[n, 0], tried[n, 1] = v, w
            ends[n], totals[n] = end, total
            n += 1
    return Evaluation(
        parameters.sim_time,
        tried[:n],
        poses[:end],
        ends[:n],
        raw_scores[:n],
        scales,
        asked[:n],
        refused_by[:n],
        totals[:n],
        best,
        worst,
    )


@jit
def _scales(scoring: Scoring) -> NDArray[np.float64]:
    parameters = scoring.parameters
    scales = np.empty(len(CRITICS))
    scales[_ROTATE_TO_GOAL] = parameters.rotate_to_goal_scale
    scales[_OSCILLATION] = 1.0
    scales[_BASE_OBSTACLE] = parameters.base_obstacle_scale
    half_cell = 0.5 * scoring.grid.resolution
    scales[_GOAL_ALIGN] = half_cell * parameters.goal_align_scale
    scales[_PATH_ALIGN] = half_cell * parameters.path_align_scale
    scales[_PATH_DIST] = half_cell * parameters.path_dist_scale
    scales[_GOAL_DIST] = half_cell * parameters.goal_dist_scale
    if not scoring.critics.align_path:
        scales[_PATH_ALIGN] = 0.0
    return scales


@jit
def _score(
    scoring: Scoring,
    twist: tuple[float, float],
    rollout: Poses,
    scales: NDArray[np.float64],
    lowest: float,
    raw_scores: NDArray[np.float64],
) -> tuple[int, int, float]:
    """Return which critic refuses a trajectory (-1: none), how many were evaluated, and its total.

    ``raw_scores`` of those that were evaluated are filled in; ``lowest`` is the best total so far.
    """
    parameters, grid, critics = scoring.parameters, scoring.grid, scoring.critics
    v, w = twist
    cost = obstacle_cost(grid, rollout)
    rotate = rotate_to_goal(parameters, critics, v, rollout[-1, 2])
    cells = map_cells(parameters, grid, critics, rollout[-1])
    align_goal, align_path, path, goal = cells
    too_fast = (critics.rotating and v > 0.0) or (
        critics.slowing and v * v >= critics.speed_squared
    )
    opinions = (
        (too_fast, rotate),
        (critics.turn * w < 0.0, 0.0),
        (cost < 0, float(cost)),
        (align_goal < 0, float(align_goal)),
        (False, float(align_path)),
        (critics.goal_x < 0, float(path)),
        (False, float(goal)),
    )
    # As the planner sums it up, so that rounding cannot make another trajectory the best.
    total = map_score(parameters, grid, cells)
    total += parameters.rotate_to_goal_scale * rotate
    total += parameters.base_obstacle_scale * cost
    so_far = 0.0
    for critic, (refuses, raw_score) in enumerate(opinions):
        if refuses:
            return critic, 1, -1.0
        raw_scores[critic] = raw_score
        so_far += scales[critic] * raw_score
        if 0.0 < lowest < min(so_far, total):
            return -1, critic + 1, so_far
    return -1, len(opinions), total


def evaluation_bytes(time_ns: int, frame: str, evaluation: Evaluation) -> bytes:
    """Return ``dwb_msgs/msg/LocalPlanEvaluation`` as CDR."""
    words, size = _evaluation_words(header_words(time_ns, frame), evaluation)
    return CDR_LITTLE_ENDIAN + words[:size].tobytes()


@jit
def _evaluation_words(
    header: NDArray[np.uint32], evaluation: Evaluation
) -> tuple[NDArray[np.uint32], int]:
    """Return the message in a buffer of words that begins it, and how many they are."""
    n = len(evaluation.ends)
    words = np.zeros(2 * (len(header) // 2 + 2 + 32 * n + 4 * len(evaluation.poses)), np.uint32)
    singles, doubles = words.view(np.float32), words.view(np.float64)
    at = put(words, 0, header)
    words[at] = n
    at += 1
    start = 0
    for i in range(n):
        end = evaluation.ends[i]
        at += at % 2  # doubles are aligned to 8 bytes
        doubles[at // 2] = evaluation.twists[i, 0]
        doubles[at // 2 + 2] = evaluation.twists[i, 1]  # the one between them is y
        at += 6
        at = _put_time_offsets(words, at, evaluation.sim_time, end - start)
        words[at] = end - start
        at += 1
        at += at % 2
        for pose in evaluation.poses[start:end]:
            for value in pose:
                doubles[at // 2] = value
                at += 2
        start = end
        words[at] = evaluation.asked[i]
        at += 1
        for critic in range(evaluation.asked[i]):
            refused_by = evaluation.refused_by[i]
            name = critic if refused_by < 0 else refused_by
            at = put(words, at, _NAMES[name, : _NAME_WORDS[name]])
            singles[at] = -1.0 if refused_by >= 0 else evaluation.raw_scores[i, critic]
            singles[at + 1] = 0.0 if refused_by >= 0 else evaluation.scales[critic]
            at += 2
        singles[at] = evaluation.totals[i]
        at += 1
    words[at] = evaluation.best | evaluation.worst << 16
    return words, at + 1


@jit
def _put_time_offsets(words: NDArray[np.uint32], at: int, sim_time: float, poses: int) -> int:
    """Write when each pose is reached; the last one, which stands twice, has no time."""
    words[at] = poses - 1
    at += 1
    step, offset = sim_time / (poses - 2), 0.0
    for _ in range(poses - 1):
        offset_ns = int(offset * 1e9)
        words[at] = offset_ns // 1_000_000_000
        words[at + 1] = offset_ns % 1_000_000_000
        at += 2
        offset += step
    return at


def marker_bytes(time_ns: int, frame: str, evaluation: Evaluation) -> bytes:
    """Return ``visualization_msgs/msg/MarkerArray`` as CDR: one line per trajectory.

    The best is green, the worst red, illegal ones are black.
    """
    header = header_words(time_ns, frame)
    heads = (np.append(header, string_words(VALID)), np.append(header, string_words(INVALID)))
    words, size = _marker_words(*heads, evaluation)
    # The last field of the last marker is a single byte.
    return CDR_LITTLE_ENDIAN + words[:size].tobytes()[:-3]


@jit
def _marker_words(
    valid: NDArray[np.uint32], invalid: NDArray[np.uint32], evaluation: Evaluation
) -> tuple[NDArray[np.uint32], int]:
    """Return the message in a buffer of words that begins it, and how many they are."""
    n = len(evaluation.ends)
    words = np.zeros(2 * (2 + n * (len(invalid) // 2 + 27) + 3 * len(evaluation.poses)), np.uint32)
    singles, doubles = words.view(np.float32), words.view(np.float64)
    best = float(evaluation.totals[evaluation.best])
    spread = float(evaluation.totals[evaluation.worst]) - best
    if abs(spread) < 1e-9:
        spread = 1.0
    words[0] = n
    at, start, valid_id, invalid_id = 1, 0, 0, 0
    for i in range(n):
        is_valid = evaluation.totals[i] >= 0.0
        at = put(words, at, valid if is_valid else invalid)
        words[at] = valid_id if is_valid else invalid_id
        words[at + 1] = LINE_STRIP
        at += 3  # the action is 0, add
        valid_id += is_valid
        invalid_id += not is_valid
        at += at % 2  # doubles are aligned to 8 bytes
        doubles[at // 2 + 6] = 1.0  # pose.orientation.w
        doubles[at // 2 + 7] = LINE_WIDTH_M
        at += 20
        if is_valid:
            level = (float(evaluation.totals[i]) - best) / spread
            singles[at], singles[at + 1] = level, 1.0 - level
        singles[at + 3] = 1.0
        words[at + 5] = LIFETIME_NS
        end = evaluation.ends[i]
        words[at + 7] = end - start
        at += 8
        at += at % 2
        for pose in evaluation.poses[start:end]:
            doubles[at // 2], doubles[at // 2 + 1] = pose[0], pose[1]
            at += 6
        start = end
        at = put(words, at, _MARKER_TAIL)
    return words, at
