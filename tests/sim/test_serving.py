"""Serving on DDS does not change a run, and mirrors its graph and messages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.bags.graph_files import vertex_id
from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.live.graph_snapshot import snapshot
from sim.experiments import recipe_for, record_run
from sim.fuzzing.scenario import ScenarioError
from sim.middleware.executor import SECOND
from sim.serving import ServedDomain, switch
from tests.recorded_runs import ONE_GOAL

MODE = "lidar_passthrough_odom"
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow(5)
@pytest.mark.parametrize(
    ("mode", "after_s"), [(MODE, 20), ("arm_normal", 5), ("cf_normal", 5), ("atc_normal", 5)]
)
def test_serving_does_not_change_a_run_and_puts_its_graph_on_dds(
    mode, after_s, domain, eventually, recorded_run, tmp_path
):
    compared = []

    def accompany(run):
        served = ServedDomain(run.domain, domain)
        discovery = DdsDiscovery(dds.join(domain))

        def look(now_ns):
            served.look(now_ns)
            if now_ns > after_s * SECOND and not compared:
                expected = graph_of(run.domain)
                eventually(lambda: discovery.update() or graph_on(discovery) == expected)
                compared.append(expected)

        run.domain.executor.accompany(look)

    served = record_run(
        recipe_for(mode, 0, ONE_GOAL), RunDirectory(tmp_path, mode, 0), accompany=accompany
    )
    assert served.content_hash == recorded_run(mode).manifest().content_hash
    assert compared


def graph_on(discovery):
    graph = snapshot(discovery, {})
    return set(graph.nodes(data="type")), set(graph.edges)


def graph_of(domain):
    """Return vertices with their types, and edges, by the domain's own introspection."""
    topics = {t: kind for t, kind in domain.topics.items() if not is_hidden(t)}
    nodes = {vertex_id("node", name): "" for name in domain.node_names()}
    nodes |= {vertex_id("topic", topic): kind for topic, kind in topics.items()}
    edges = {
        (vertex_id("node", p.node), vertex_id("topic", p.topic))
        for p in domain.publishers()
        if p.topic in topics
    } | {
        (vertex_id("topic", s.topic), vertex_id("node", s.node))
        for s in domain.subscriptions()
        if s.topic in topics
    }
    return set(nodes.items()), edges


@pytest.mark.slow
def test_an_attack_that_is_switched_on_changes_messages_from_then_on(recorded_run, tmp_path):
    switched_ns = 8 * SECOND
    done = []

    def accompany(run):
        def advance(now_ns):
            if now_ns >= switched_ns and not done:
                done.append(now_ns)
                switch(run, recipe_for("fake_object", 0, ONE_GOAL))
                for name in ("random_noise", MODE, "random_noise"):  # the noise needs no odometry
                    switch(run, recipe_for(name, 0, ONE_GOAL))

        run.domain.executor.accompany(advance)

    made = record_run(recipe_for(MODE, 0, ONE_GOAL), RunDirectory(tmp_path, MODE, 0),
                      accompany=accompany)  # fmt: skip
    assert not recorded_run(MODE).manifest().changes
    onset_s = switched_ns / SECOND - 2.1  # of the recording
    assert made.changes
    assert all(change.start_s >= onset_s - 5.0 for change in made.changes)


@pytest.mark.slow
def test_a_scenario_on_other_topics_is_refused(tmp_path):
    refused = []

    def accompany(run):
        def advance(now_ns):
            if run.node is not None and not refused:
                with pytest.raises(ScenarioError, match="scan") as error:
                    switch(run, recipe_for("atc_normal", 0, ONE_GOAL))
                refused.append(error)

        run.domain.executor.accompany(advance)

    record_run(recipe_for(MODE, 0, ONE_GOAL), RunDirectory(tmp_path, MODE, 0), accompany=accompany)
    assert refused


@pytest.mark.slow(3)
def test_a_system_of_commands_is_not_served_for_it_is_on_dds_by_itself(domain):
    environment = os.environ | {"ORACLE_TESTBEDS": str(EXAMPLES / "tank")}
    words = ["serve", "-m", "tank_normal", "--domain", str(domain)]
    done = subprocess.run(
        [sys.executable, "-c", "from sim.commands.main import main; main()", *words],
        capture_output=True, text=True, check=False, env=environment, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("Error: tank_normal is on DDS by itself")
