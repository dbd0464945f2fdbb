import numpy as np
import pytest

from oracle_pipeline.bags.types import deserialize
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.map_server import MapServer, OccupancyMap

GRID = "nav_msgs/msg/OccupancyGrid"


@pytest.fixture
def rig():
    executor = Executor()
    domain = Domain(executor)
    cells = np.array([[0, 100, -1], [0, 0, 0]], np.int8)
    server = MapServer(domain, OccupancyMap(cells, 0.05, (-1.0, -2.0)))
    heard = []
    Node(domain, "/late").create_subscription(GRID, "/map", heard.append, qos.LATCHED, raw=True)
    server.configure()
    executor.run_until(SECOND)
    assert heard == []  # inactive
    server.activate()
    return executor, domain, heard


def test_map_is_published_once_and_reaches_late_subscribers(rig):
    executor, domain, heard = rig
    executor.run_until(60 * SECOND)
    late = []
    Node(domain, "/later").create_subscription(GRID, "/map", late.append, qos.LATCHED, raw=True)
    executor.run_until(61 * SECOND)
    assert len(heard) == 1
    assert late == heard


def test_map_message_has_the_cells_of_the_map(rig):
    executor, _, heard = rig
    executor.run_until(2 * SECOND)
    message = deserialize(heard[0], GRID)
    assert message.header.frame_id == "map"
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.05)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.0, -2.0)
    assert message.data.tolist() == [0, 100, -1, 0, 0, 0]
