import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class, serialize
from sim.middleware import qos
from sim.middleware.action import ActionClient, ActionServer, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from tests.sim.introspection import clients_of, publishers_of, services_of, subscriptions_of

String = message_class("std_msgs/msg/String")
STRING = "std_msgs/msg/String"


@pytest.fixture
def domain():
    return Domain(Executor())


def test_a_sample_reaches_every_subscriber_after_its_own_latency(domain):
    heard = []
    talker = Node(domain, "/talker").create_publisher(STRING, "/chatter")
    for name, latency_ns in (("/slow", 7), ("/fast", 0)):
        node = Node(domain, name, latency_ns=latency_ns)
        node.create_subscription(
            STRING, "/chatter", lambda m, n=node: heard.append((n.name, n.now_ns, m.data))
        )
    talker.publish(String("hello"))
    domain.executor.run_until(10)
    assert heard == [("/fast", 0, "hello"), ("/slow", 7, "hello")]


def test_raw_subscribers_get_the_bytes_that_the_message_serialises_to(domain):
    heard = []
    node = Node(domain, "/node")
    node.create_subscription(STRING, "/chatter", heard.append, raw=True)
    publisher = node.create_publisher(STRING, "/chatter")
    publisher.publish(String("hello"))
    publisher.publish_serialized(serialize(String("bytes"), STRING))
    domain.executor.run_until(1)
    assert heard == [serialize(String("hello"), STRING), serialize(String("bytes"), STRING)]
    assert publisher.message_bytes == sum(map(len, heard))


def test_a_diverted_node_receives_only_diverted_messages_and_all_others_the_published_ones(domain):
    heard = {"/near": [], "/far": [], "/late": []}
    talker = Node(domain, "/talker").create_publisher(STRING, "/chatter")
    recorded = []
    Node(domain, "/recorder").create_subscription(STRING, "/chatter", recorded.append, raw=True)

    def listen(name):
        node = Node(domain, name, latency_ns=3)
        node.create_subscription(
            STRING, "/chatter", lambda m: heard[name].append((node.now_ns, m.data))
        )

    listen("/near")
    listen("/far")
    held = []
    talker.divert(["/far", "/late"], lambda sample: held.append(sample.message))
    listen("/late")
    talker.publish(String("one"))
    talker.publish_serialized(serialize(String("two"), STRING))
    domain.executor.run_until(10)
    assert heard == {"/near": [(3, "one"), (3, "two")], "/far": [], "/late": []}
    for message in reversed(held):
        talker.send_diverted(message)
    domain.executor.run_until(20)
    assert heard["/far"] == heard["/late"] == [(13, "two"), (13, "one")]
    assert len(heard["/near"]) == len(recorded) == talker.messages == 2


@given(published=st.integers(0, 20), depth=st.integers(1, 5))
def test_a_late_subscriber_gets_the_last_latched_samples_and_no_volatile_ones(published, depth):
    domain = Domain(Executor())
    node = Node(domain, "/node")
    latched = node.create_publisher(STRING, "/latched", qos.profile(depth, latched=True))
    volatile = node.create_publisher(STRING, "/volatile", qos.profile(depth))
    for i in range(published):
        latched.publish(String(str(i)))
        volatile.publish(String(str(i)))
    heard = []
    node.create_subscription(
        STRING, "/latched", lambda m: heard.append(m.data), qos.profile(depth, latched=True)
    )
    node.create_subscription(STRING, "/volatile", lambda m: heard.append(m.data))
    domain.executor.run_until(0)
    assert heard == [str(i) for i in range(published)][-depth:]


@pytest.mark.parametrize(
    ("offered", "requested", "connected"),
    [
        (qos.DEFAULT, qos.DEFAULT, True),
        (qos.DEFAULT, qos.SENSOR_DATA, True),
        (qos.SENSOR_DATA, qos.DEFAULT, False),
        (qos.DEFAULT, qos.LATCHED, False),
        (qos.LATCHED, qos.DEFAULT, True),
    ],
)
def test_endpoints_connect_only_if_the_offer_meets_the_request(
    domain, offered, requested, connected
):
    node = Node(domain, "/node")
    heard = []
    node.create_subscription(STRING, "/chatter", heard.append, requested)
    node.create_publisher(STRING, "/chatter", offered).publish(String("x"))
    domain.executor.run_until(0)
    assert bool(heard) is connected


def test_introspection_answers_what_node_list_and_node_info_answer(domain):
    node = Node(domain, "/talker", endpoints="P")
    Node(domain, "/listener", endpoints="CE").create_subscription(STRING, "/chatter", None)
    node.create_publisher(STRING, "/chatter")
    assert domain.node_names() == ["/listener", "/talker"]
    assert publishers_of(domain, "/talker") == {
        "/rosout": "rcl_interfaces/msg/Log",
        "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
        "/chatter": STRING,
    }
    assert subscriptions_of(domain, "/talker") == {}
    assert subscriptions_of(domain, "/listener") == {
        "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
        "/clock": "rosgraph_msgs/msg/Clock",
        "/chatter": STRING,
    }
    assert "/talker/get_parameters" in services_of(domain, "/talker")


def test_one_topic_has_one_type(domain):
    node = Node(domain, "/node")
    node.create_publisher(STRING, "/chatter")
    with pytest.raises(TypeError, match="/chatter is std_msgs/msg/String"):
        node.create_subscription("std_msgs/msg/Header", "/chatter", None)


def test_two_nodes_cannot_share_a_name(domain):
    Node(domain, "/node")
    with pytest.raises(ValueError, match="/node exists already"):
        Node(domain, "/node")


def test_a_timer_fires_every_period_until_cancelled(domain):
    node, fired = Node(domain, "/node"), []
    timer = node.create_timer(34 * MILLISECOND, lambda: fired.append(node.now_ns))
    domain.executor.run_until(SECOND)
    assert fired == [34 * MILLISECOND * (i + 1) for i in range(29)]
    timer.cancel()
    domain.executor.run_until(2 * SECOND)
    assert len(fired) == 29


def test_a_service_answers_its_caller(domain):
    Node(domain, "/server").create_service("std_srvs/srv/Trigger", "/double", lambda x: 2 * x)
    client = Node(domain, "/client").create_client("/double")
    answers = []
    client.call(21, answers.append)
    domain.executor.run_until(0)
    assert answers == [42]
    assert services_of(domain, "/server")["/double"] == "std_srvs/srv/Trigger"
    assert clients_of(domain, "/client") == {"/double": "std_srvs/srv/Trigger"}


def test_a_call_to_a_service_without_a_server_is_an_error(domain):
    client = Node(domain, "/client").create_client("/nowhere")
    with pytest.raises(LookupError, match="no node offers the service /nowhere"):
        client.call(None)


class TestAction:
    ACTION = "nav2_msgs/action/Wait"

    @pytest.fixture
    def server(self, domain):
        self.handles = []
        self.canceled = []
        return ActionServer(
            Node(domain, "/server"), self.ACTION, "/wait", self.handles.append, self.canceled.append
        )

    @pytest.mark.parametrize(
        ("end", "status"), [("succeed", GoalStatus.SUCCEEDED), ("abort", GoalStatus.ABORTED)]
    )
    def test_a_goal_is_accepted_executed_and_ends_with_its_result(
        self, domain, server, end, status
    ):
        results, feedback, statuses = [], [], []
        node = Node(domain, "/client")
        node.create_subscription(
            "action_msgs/msg/GoalStatusArray",
            "/wait/_action/status",
            lambda m: statuses.append(m.status_list[-1].status),
            qos.LATCHED,
        )
        client = ActionClient(node, self.ACTION, "/wait")
        client.send_goal("goal", lambda *r: results.append(r), feedback.append)
        domain.executor.run_until(0)
        (handle,) = self.handles
        handle.publish_feedback("halfway")
        getattr(handle, end)("result")
        domain.executor.run_until(1)
        assert results == [(status, "result")]
        assert feedback == ["halfway"]
        assert statuses == [GoalStatus.ACCEPTED, GoalStatus.EXECUTING, status]

    def test_a_cancelled_goal_ends_as_the_server_answers(self, domain, server):
        results = []
        client = ActionClient(Node(domain, "/client"), self.ACTION, "/wait")
        handle = client.send_goal("goal", lambda *r: results.append(r))
        domain.executor.run_until(0)
        handle.cancel()
        domain.executor.run_until(1)
        assert self.canceled == [handle]
        handle.canceled()
        domain.executor.run_until(2)
        assert results == [(GoalStatus.CANCELED, None)]

    def test_a_goal_ends_once(self, domain, server):
        client = ActionClient(Node(domain, "/client"), self.ACTION, "/wait")
        handle = client.send_goal("goal", lambda *_: None)
        handle.succeed()
        with pytest.raises(RuntimeError, match="SUCCEEDED already"):
            handle.abort()

    def test_goal_ids_differ_and_depend_on_client_and_action_only(self):
        def ids():
            domain = Domain(Executor())
            ActionServer(
                Node(domain, "/server"), self.ACTION, "/wait", lambda _: None, lambda _: None
            )
            client = ActionClient(Node(domain, "/client"), self.ACTION, "/wait")
            return [client.send_goal(None, lambda *_: None).goal_id for _ in range(3)]

        assert ids() == ids()
        assert len(set(ids())) == 3
