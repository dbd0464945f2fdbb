import pytest

from oracle_pipeline.bags.types import deserialize
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.lifecycle import LifecycleManager, LifecycleNode


class Recording(LifecycleNode):
    """Records its transitions; activation waits until ``ready_ns``."""

    def __init__(self, domain, name, log, ready_ns=0, **options):
        super().__init__(domain, name, **options)
        self.log = log
        self.ready_ns = ready_ns

    def is_ready(self):
        return self.now_ns >= self.ready_ns

    def on_configure(self):
        self.log.append(("configure", self.name))

    def on_activate(self):
        self.log.append(("activate", self.name))


@pytest.fixture
def domain():
    return Domain(Executor())


def listen(domain, topic, msgtype):
    """Return a list that fills with (time, message)."""
    heard = []
    name = f"/listener{topic.replace('/', '_')}"
    node = Node(domain, name)
    node.create_subscription(msgtype, topic, lambda m: heard.append((node.now_ns, m)))
    return heard


def test_all_nodes_are_configured_in_order_before_any_is_activated_in_order(domain):
    log = []
    names = ["/first", "/second", "/third"]
    for name in names:
        Recording(domain, name, log)
    manager = LifecycleManager(domain, "/lifecycle_manager", names)
    domain.executor.run_until(1)
    assert log == [(step, name) for step in ("configure", "activate") for name in names]
    assert manager.is_active


def test_activation_waits_for_a_node_that_is_not_ready_and_for_nothing_behind_it(domain):
    log = []
    Recording(domain, "/quick", log)
    Recording(domain, "/slow", log, ready_ns=2 * SECOND + 1)
    Recording(domain, "/last", log)
    manager = LifecycleManager(domain, "/lifecycle_manager", ["/quick", "/slow", "/last"])
    domain.executor.run_until(2 * SECOND)
    assert ("activate", "/quick") in log
    assert ("activate", "/last") not in log
    assert not manager.is_active
    domain.executor.run_until(2 * SECOND + 200 * MILLISECOND)
    assert log[-2:] == [("activate", "/slow"), ("activate", "/last")]
    assert manager.is_active


def test_transition_events_name_both_states_and_the_wait_is_one_transition(domain):
    Recording(domain, "/node", [], ready_ns=SECOND)
    events = listen(domain, "/node/transition_event", "lifecycle_msgs/msg/TransitionEvent")
    LifecycleManager(domain, "/lifecycle_manager", ["/node"])
    domain.executor.run_until(3 * SECOND)
    assert [(m.start_state.label, m.goal_state.label) for _, m in events] == [
        ("unconfigured", "configuring"),
        ("configuring", "inactive"),
        ("inactive", "activating"),
        ("activating", "active"),
    ]
    assert [m.start_state.id for _, m in events] == [1, 10, 2, 13]
    assert {m.transition.label for _, m in events} == {""}


def test_both_ends_of_a_bond_send_ten_heartbeats_a_second_with_new_stamps(domain):
    LifecycleNode(domain, "/node")
    LifecycleNode(domain, "/silent", bond=False)
    data = []
    Node(domain, "/recorder").create_subscription("bond/msg/Status", "/bond", data.append, raw=True)
    LifecycleManager(domain, "/lifecycle_manager", ["/node"])
    domain.executor.run_until(2 * SECOND - 1)
    beats = [deserialize(d, "bond/msg/Status") for d in data]
    assert len(beats) == 40
    assert {b.id for b in beats} == {"node"}
    instances = {b.instance_id for b in beats}
    assert len(instances) == 2
    assert {len(i) for i in instances} == {36}
    assert {(b.active, b.heartbeat_timeout, round(b.heartbeat_period, 3)) for b in beats} == {
        (True, 4.0, 0.1)
    }
    for instance in instances:
        stamps = [b.header.stamp for b in beats if b.instance_id == instance]
        times = [s.sec * SECOND + s.nanosec for s in stamps]
        assert times == [i * 100 * MILLISECOND for i in range(20)]


def test_the_manager_reports_every_second_whether_nav2_is_active(domain):
    Recording(domain, "/node", [], ready_ns=2 * SECOND + 1)
    reports = listen(domain, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    LifecycleManager(domain, "/lifecycle_manager_navigation", ["/node"])
    domain.executor.run_until(4 * SECOND)
    assert [(t // SECOND, m.status[0].level, m.status[0].message) for t, m in reports] == [
        (1, 2, "Nav2 is inactive"),
        (2, 2, "Nav2 is inactive"),
        (3, 0, "Nav2 is active"),
        (4, 0, "Nav2 is active"),
    ]
    assert reports[0][1].status[0].name == "lifecycle_manager_navigation: Nav2 Health"
