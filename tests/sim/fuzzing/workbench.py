"""Messages, scenarios and runs of them, for the tests of the scenario language."""

import copy
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import message_class, serialize
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import parse_scenarios
from sim.fuzzing.value_types import message_type, zero
from sim.middleware.geometry import yaw_quaternion
from sim.middleware.stamps import header
from sim.scenarios import builtin_scenarios

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
REPORT = "atc_msgs/msg/AdsbReport"
PERIOD_NS = 200_000_000
INCREMENT = 6.28 / 359

ranges = hnp.arrays(
    np.float32,
    360,
    elements=st.floats(0.125, 20.0, width=32) | st.sampled_from([np.inf, -np.inf, np.nan, 0.0]),
    fill=st.just(np.float32(np.inf)),
)
BUILTINS = list(builtin_scenarios())


def stamp(number):
    return (number + 1) * PERIOD_NS


def scan(number=0, values=None, **fields):
    values = np.full(360, 2.0, np.float32) if values is None else np.asarray(values, np.float32)
    nothing = np.zeros(len(values), np.float32)
    message = message_class(SCAN)(
        header(stamp(number), "base_scan_tom"), 0.0, 6.28, INCREMENT, 0.0, 0.0, 0.12, 20.0,
        values, nothing,
    )  # fmt: skip
    return replace(message, **fields)


def scans(count, seed=1):
    rng = np.random.default_rng(seed)
    for number in range(count):
        values = rng.uniform(0.2, 19.0, 360)
        values[rng.random(360) < 0.2] = np.inf
        yield scan(number, values)


def odometry(number=0, x=0.0, y=0.0, yaw=0.0):
    message = zero(message_type(ODOMETRY))
    pose = message.pose.pose
    point = replace(pose.position, x=x, y=y)
    turned = type(pose.orientation)(*yaw_quaternion(yaw))
    pose = replace(message.pose, pose=replace(pose, position=point, orientation=turned))
    return replace(message, header=header(stamp(number), "odom"), pose=pose)


def report(number=0, icao24="C07AB1", **fields):
    message = replace(zero(message_type(REPORT)), header=header(stamp(number), "wgs84"))
    return replace(message, icao24=icao24, **fields)


def scenario(rest="", msgtype=SCAN):
    """Return a scenario of which only the rest matters."""
    text = (
        "schema: mutant/v1\nid: tried\nlabel: malicious\n"
        f"main: {{type: {msgtype}, input: /in, output: /out}}\n{rest}"
    )
    (parsed,) = parse_scenarios(text.encode(), "tried.yaml")
    return parsed


def program(rest="", msgtype=SCAN):
    return compile_scenario(scenario(rest, msgtype))


def doing(*operators, msgtype=SCAN, more=""):
    """Return the program of one action with these operators."""
    do = "".join(f"        - {operator}\n" for operator in operators)
    return program(f"transform:\n  actions:\n    - name: act\n      do:\n{do}{more}", msgtype)


def builtin(name):
    return compile_scenario(builtin_scenarios()[name], allow_actuation=True)


def start(compiled, seed=1, **parameters):
    """Begin a run in which every source has published."""
    execution = execute(compiled, seed, parameters)
    for name, source in compiled.sources.items():
        execution.on_source(name, zero(source.type), stamp(0))
    return execution


def results(compiled, messages, seed=1, **parameters):
    """Return the results for messages that arrive once per period, from the onset on."""
    execution = start(compiled, seed, **parameters)
    return [
        execution.on_message(message, stamp(number), number * PERIOD_NS / 1e9)
        for number, message in enumerate(messages)
    ]


def only(compiled, message, **parameters):
    """Return the single message that is published for an input message."""
    ((result,),) = [result.outputs for result in results(compiled, [message], **parameters)]
    return result.message


def examples(compiled, count=40):
    """Return messages of a program's main type that its built-in scenarios have something to do
    with."""
    match compiled.type.name:
        case "sensor_msgs/msg/LaserScan":
            return list(scans(count))
        case "nav_msgs/msg/Odometry":
            return [odometry(n, x=0.01 * n) for n in range(count)]
        case "atc_msgs/msg/AdsbReport":
            places = [(44.2253 + 0.001 * n, -76.5967 + 0.01 * (n % 3)) for n in range(count)]
            return [
                report(n, ("C07AB1", "C07AB2", "C07AB3")[n % 3], callsign="ACA123",
                       latitude=lat, longitude=lon, altitude_m=3000.0)
                for n, (lat, lon) in enumerate(places)
            ]  # fmt: skip
    return [zero(compiled.type) for _ in range(count)]


def data(message):
    return serialize(message, message.__msgtype__)


def frozen(messages):
    """Return copies of messages, to detect writes to the originals."""
    return copy.deepcopy(messages)
