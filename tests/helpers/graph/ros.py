"""A private ROS graph for tests."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from surg_cli.graph import master, system
from surg_cli.graph.processes import Child, Supervisor, wait_until
from surg_cli.host import paths


@dataclass
class RosGraph:
    """A running master and the nodes a test starts beside it.

    Attributes:
        uri: ROS_MASTER_URI of the private master.
        env: Environment for further processes.
        folder: The test's own folder; logs lie in `folder/logs`.
        supervisor: Owner of the test's nodes.
    """

    uri: str
    env: dict[str, str]
    folder: Path
    supervisor: Supervisor = field(repr=False)

    def node(
        self,
        package: str,
        executable: str,
        name: str,
        params: dict[str, object] | None = None,
        env: dict[str, str] | None = None,
        arguments: Sequence[str] = (),
    ) -> Child:
        """Start a node of the workspace.

        Args:
            package: ROS package.
            executable: As `rosrun` takes it; `.py` may be left out.
            name: Absolute node name, such as `/PSM1/controller`.
            params: Private parameters.
            env: Added to its environment.
            arguments: Further words of its command line.

        Returns:
            The running child.
        """
        namespace, _, base = name.rpartition("/")
        words = [str(find_executable(package, executable)), *arguments]
        words += [f"__name:={base}", f"__ns:={namespace or '/'}"]
        self.set_params(name, params or {})
        return self.supervisor.start(name, words, extra_env=env)

    def set_params(self, node: str, params: dict[str, object]) -> None:
        """Set private parameters of a node, typed (a list stays a list)."""
        for key, value in params.items():
            plain = str(value) if isinstance(value, Path) else value
            master.call(self.uri, "setParam", f"{node}/{key}", plain)

    def wait_for(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Wait for a condition; fail naming it, the dead child and its last words."""
        if wait_until(condition, timeout_s):
            return
        text = f"waited {timeout_s} s for {what}"
        for child in self.supervisor.children:
            state = "runs" if child.exit_code is None else f"ended with {child.exit_code}"
            text += f"\n-- {child.name} {state}:\n{child.log_tail(8)}"
        raise AssertionError(text)


def find_executable(package: str, executable: str) -> Path:
    """What `rosrun PACKAGE EXECUTABLE` would start; `.py` may be left out."""
    script = paths.DEVEL / "lib" / package / f"{executable}.py"
    return script if script.is_file() else system.executable(package, executable)


@contextlib.contextmanager
def private_master(folder: Path) -> Iterator[Supervisor]:
    """Run a master on a free port with ROS_HOME and ROS_LOG_DIR of its own.

    `os.environ` follows, so that rospy in the test process talks to the same master.

    Args:
        folder: For its logs.

    Yields:
        The supervisor that holds the master; `supervisor.env` is the nodes' environment.
    """
    env = dict(os.environ)
    env.update(
        ROS_HOME=str(folder / "ros"),
        ROS_LOG_DIR=str(folder / "ros" / "log"),
        ROS_IP="127.0.0.1",
        ROS_HOSTNAME="localhost",
        ROS_VERSION="1",
        PYTHONUNBUFFERED="1",
    )
    env.setdefault("MUJOCO_GL", "egl")
    with Supervisor(env, folder / "logs") as supervisor:
        # Another process may take the port between the probe and the start.
        for attempt in range(3):
            try:
                master.start(supervisor, master.free_port())
                break
            except Exception:
                if attempt == 2:
                    raise
                time.sleep(0.1)
        os.environ.update(supervisor.env)
        yield supervisor


def forget_dead_nodes() -> None:
    """Remove registrations of nodes that no longer answer: a killed node cannot do it itself.

    Without this the next test's publishers and subscribers would try to reach them.
    """
    import rosgraph
    import rosnode

    _, dead = rosnode.rosnode_ping_all()
    if dead:
        rosnode.cleanup_master_blacklist(rosgraph.Master("/pytest_cleanup"), dead)


def close_own_topics() -> None:
    """Close the publishers and subscribers a test has left open in this process.

    A failing test keeps its objects alive in its traceback: they must not take part in the next.
    """
    import rospy.topics
    from rospy.impl.registration import Registration

    manager = rospy.topics.get_topic_manager()
    for kind, table in ((Registration.PUB, manager.pubs), (Registration.SUB, manager.subs)):
        for name in [name for name in table if name not in ("/rosout", "/clock")]:
            while name in table:
                manager.release_impl(kind, name)


def stop_serving() -> None:
    """Stop this process's XML-RPC server before rospy closes its socket.

    rospy closes the socket while a thread still polls it. That thread then takes a whole core,
    beside the other workers' tests, until the process ends.
    """
    from rosgraph.xmlrpc import XmlRpcNode

    for node in [thing for thing in gc.get_objects() if isinstance(thing, XmlRpcNode)]:
        node.is_shutdown = True
        if node.server is not None:
            node.server.shutdown()
