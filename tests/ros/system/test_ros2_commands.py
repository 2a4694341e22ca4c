"""`./surg up`, `teleop` and `run` with `--ros2`, and without."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.graph.ros import RosGraph
from helpers.graph.surg import Started, start, surg
from helpers.graph.two_arms import write_two_arms
from helpers.ros2.dds_peers import Dds, udp_sockets
from helpers.sim.nudge_task import LUCKY
from surg_cli.graph import master, running
from surg_cli.graph.processes import Child, session_members, wait_until
from surg_cli.host.paths import ROOT
from surg_msgs.msg import SimStatus
from surg_ros2.cdr import Codec
from surg_ros2.message_types_node import fields

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.untimed]

NUDGE = ROOT / "tests" / "helpers" / "sim" / "nudge_task.py"
WAIT_S = 120.0
STATUS = "/sim/status"
CPP = ("/PSM1/controller", "/PSM1/robot_state_publisher")


@pytest.fixture
def dds(ros_graph: RosGraph, monkeypatch: pytest.MonkeyPatch) -> Dds:
    """A domain, which the commands use too."""
    made = Dds(ros_graph)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(made.domain))
    return made


@contextlib.contextmanager
def running_command(folder: Path, said: str, *words: object) -> Iterator[tuple[Started, int, Path]]:
    """A command that has said something, ended by Ctrl-C; its process, port and output."""
    port, log = master.free_port(), folder / "log"
    with start(log, *words, "--cameras", "none", "--port", port) as process:
        assert wait_until(lambda: process.poll() is not None or said in log.read_text(), WAIT_S)
        assert process.poll() is None, log.read_text()
        yield process, port, log
        assert process.poll() is None, log.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(WAIT_S) == 130


def sockets_of(process: Started, port: int) -> list[str]:
    """The UDP sockets of what a command has started; those of ROS 1 in C++ are its UDPROS."""
    (system,) = running.systems(port)
    leaders = [process.pid, *(pid for name, pid in system.nodes.items() if name not in CPP)]
    pids = {pid for leader in leaders for pid in session_members(leader)}
    return [each for pid in pids for each in udp_sockets(pid)]


def test_without_the_option_nothing_is_opened(tmp_path: Path) -> None:
    with running_command(tmp_path, "is up:", "up", "sim_ur5e") as (process, port, _):
        assert sockets_of(process, port) == []


def test_a_system_is_seen_over_the_loopback_and_outlives_its_gateway(
    dds: Dds, tmp_path: Path
) -> None:
    peer = listener(dds)
    words = ("up", "sim_ur5e", "--ros2")
    with running_command(tmp_path, "is up:", *words) as (process, port, log):
        assert wait_until(lambda: STATUS in peer.log_tail(1), WAIT_S)
        found = sockets_of(process, port)
        assert len(found) > 2
        assert [each for each in found if not each.startswith(("127.", "0.0.0.0%lo:"))] == []
        (system,) = running.systems(port)
        os.kill(system.nodes["/ros2"], signal.SIGKILL)
        said = "/ros2 ended (-9), the rest runs on"
        assert wait_until(lambda: said in log.read_text(), WAIT_S), log.read_text()


def listener(dds: Dds) -> Child:
    """A process that hears the simulator's status in ROS 2, and has nothing to say."""
    return dds.peer("looks", "", f"{STATUS}=surg_msgs/SimStatus")


@pytest.mark.full
def test_ros_2_sees_every_episode_of_a_run(dds: Dds, tmp_path: Path) -> None:
    peer = listener(dds)
    words = ["run", NUDGE, "--robot", write_two_arms(tmp_path / "cell"), "--episodes", 2]
    done = surg(*words, "--seed", LUCKY, "--out", tmp_path / "out", "--ros2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "/ros2" not in done.stderr
    codec = Codec("surg_msgs/SimStatus", fields)
    heard = [bytes.fromhex(line.split()[1]) for line in whole_lines(peer) if STATUS in line]
    ticks = [SimStatus().deserialize(codec.to_ros1(each)).tick for each in heard]
    assert sum(b < a for a, b in itertools.pairwise(ticks)) == 1, "two episodes"


@pytest.mark.full
def test_a_run_whose_gateway_ends_goes_on_and_says_so(
    ros_graph: RosGraph, rospy_node: str, dds: Dds, tmp_path: Path
) -> None:
    dds.gateway()
    ros_graph.wait_for(lambda: "/ros2" in master.nodes(ros_graph.uri), WAIT_S, "the first one")
    words = ["run", NUDGE, "--robot", write_two_arms(tmp_path / "cell"), "--seed", LUCKY]
    done = surg(*words, "--out", tmp_path / "out", "--ros2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "/ros2 ended (2), the rest runs on: ros2: another gateway" in done.stderr


def whole_lines(child: Child) -> list[str]:
    """What it has printed, without a last line that is half written."""
    return child.log.read_text("utf-8", "replace").splitlines()[:-1]
