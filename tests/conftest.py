"""Fixtures and options of all tests."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from helpers.graph import worker_groups
from helpers.graph.ros import (
    RosGraph,
    close_own_topics,
    forget_dead_nodes,
    private_master,
    stop_serving,
)
from surg_cli import __main__ as cli
from surg_cli.graph import master
from surg_cli.graph.processes import Supervisor

if TYPE_CHECKING:
    from helpers.graph.control_rig import Rig

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
ON_REQUEST = ("oracle", "vm", "mutants")


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Give way to the worker that runs in real time."""
    with worker_groups.priority(item, Path(__file__).parent):
        yield


@pytest.hookimpl(tryfirst=True)  # xdist appends the groups to the tests' ids
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Group the tests for xdist; skip the tiers that run on request, unless `-m` names one."""
    worker_groups.assign(config, items, Path(__file__).parent)
    chosen = config.getoption("-m")
    for item in items:
        for tier in ON_REQUEST:
            if item.get_closest_marker(tier) and tier not in chosen:
                item.add_marker(pytest.mark.skip(reason=f"./surg test --tier {tier}"))
        if item.get_closest_marker("full") and not FULL:
            item.add_marker(pytest.mark.skip(reason="./surg test --full"))


@pytest.fixture(scope="session")
def full() -> bool:
    """Whether the long counts are asked for (SURG_TEST_FULL=1)."""
    return FULL


@pytest.fixture
def surg(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Runs a command in this process, as `./surg` would when everything is set up."""

    def run(*words: object) -> int:
        monkeypatch.setenv(cli.READY, "1")
        return cli.run([str(word) for word in words])

    return run


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> random.Random:
    """A generator seeded by the test's own name: the same numbers in every run."""
    group = worker_groups.group(request.node)
    return random.Random(request.node.nodeid.removesuffix(f"@{group}"))


@pytest.fixture(scope="session")
def ros_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Supervisor]:
    """One private ROS master for the whole run."""
    with private_master(tmp_path_factory.mktemp("ros")) as supervisor:
        yield supervisor


@pytest.fixture(scope="session")
def rospy_node(ros_session: Supervisor) -> Iterator[str]:
    """This process as a ROS node of the session's master; yields its name."""
    import rospy

    rospy.init_node("pytest", anonymous=True, disable_signals=True)
    yield rospy.get_name()
    stop_serving()
    rospy.signal_shutdown("tests are over")


@pytest.fixture
def rig(rospy_node: str) -> Iterator[Rig]:
    """The fake side of a controller's graph, in this process."""
    from helpers.graph.control_rig import Rig  # needs ROS

    made = Rig(rospy_node)
    yield made
    made.close()


@pytest.fixture
def ros_graph(ros_session: Supervisor, tmp_path: Path) -> Iterator[RosGraph]:
    """The session's master with an empty parameter server; ends the test's nodes afterwards."""
    uri = ros_session.env["ROS_MASTER_URI"]
    for name in master.call(uri, "getParamNames"):
        if not name.startswith(("/run_id", "/rosversion", "/rosdistro", "/roslaunch")):
            master.call(uri, "deleteParam", name)
    with Supervisor(dict(ros_session.env), tmp_path / "logs") as supervisor:
        yield RosGraph(uri, supervisor.env, tmp_path, supervisor)
        for child in supervisor.children:
            child.send(signal.SIGKILL)  # how a node ends by itself is for a test to ask
    close_own_topics()
    forget_dead_nodes()
