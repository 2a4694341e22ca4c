"""Every topic and service of the arm against docs/reference/topics.yaml.

Type, md5, rate, frame, latching, and what is said before there is something to say. And the page
docs/reference/topics.md: it is what the generator makes of the file and the running graph.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import roslib.message
import rospy

import surg_core
from helpers.graph.crtk_client import TICK, Arm, LockstepTime, WallTime
from helpers.graph.ros import RosGraph
from surg_cli.commands.dev import topics
from surg_cli.graph import system
from surg_cli.graph.graph_probe import GraphEnd, observe
from surg_cli.graph.topic_contract import PAGE, REFERENCE, Contract, Entry, compare, load
from surg_cli.host.terminal import CliError

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

ARM = topics.ARM
TICK_NS = round(TICK * 1e9)


@pytest.fixture(scope="module")
def contract() -> Contract:
    return load()


class Ear:
    """Hears one topic: stamp [ns] and frame of every message.

    A listener can be connected to one publisher twice (its registration and an update by the master
    may race); what both connections bring has been said once.
    """

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.heard: list[tuple[int, str]] = []
        self._by_connection: dict[int, set[tuple[int, str, int]]] = {}
        kind = roslib.message.get_message_class(entry.type)
        self.subscriber = rospy.Subscriber(
            entry.resolved(ARM), kind, self._hear, queue_size=None, tcp_nodelay=True
        )

    def _hear(self, message: Any) -> None:
        connection = id(message._connection_header)  # one object for each connection
        if hasattr(message, "transforms"):
            message = message.transforms[0]
        header = getattr(message, "header", None)
        stamp, frame, seq = -1, "", -1
        if header is not None:
            stamp, frame, seq = header.stamp.to_nsec(), header.frame_id, header.seq
        others = [said for by, said in self._by_connection.items() if by != connection]
        self._by_connection.setdefault(connection, set()).add((stamp, frame, seq))
        if not any((stamp, frame, seq) in said for said in others):
            self.heard.append((stamp, frame))

    @property
    def connections(self) -> int:
        """Over how many it heard something."""
        return len(self._by_connection)

    def between(self, first: int, last: int) -> int:
        """Messages whose stamp lies in these ticks."""
        return sum(first * TICK_NS < stamp <= last * TICK_NS for stamp, _ in list(self.heard))


@pytest.fixture
def ears(rospy_node: str, contract: Contract) -> Iterator[list[Ear]]:
    """One ear for each topic that comes at a rate; its stamp must be time, so not /diagnostics."""
    made = [
        Ear(entry)
        for entry in contract.entries
        if entry.direction == "out" and entry.hz and entry.name != "/diagnostics"
    ]
    yield made
    for ear in made:
        ear.subscriber.unregister()


def start(graph: RosGraph, mode: str, participant: str) -> None:
    """The reference graph in one of the two modes."""
    for node in topics.reference_nodes(mode):
        params = dict(node.params)
        if mode == "lockstep" and node.name != "/dvrk_compat":
            tracker = ["sim"] if node.name != "/sim" else []
            params["participants"] = [participant.lstrip("/"), *tracker]
        graph.node(node.package, node.executable, node.name, params)


def differences(
    graph: RosGraph, contract: Contract, lockstep: bool
) -> tuple[list[str], list[GraphEnd]]:
    """Compare until there is none, or a while has passed."""
    end = time.monotonic() + 20.0
    while True:
        try:
            seen = observe(graph.uri)
            wrong = compare(contract, seen, ARM, topics.NODES, lockstep)
        except (OSError, CliError) as error:
            seen, wrong = [], [str(error)]
        if not wrong or time.monotonic() > end:
            return wrong, seen
        time.sleep(0.2)


def frame_of(entry: Entry) -> str:
    assert entry.frame is not None
    return entry.frame.replace("<frame>", f"{ARM}_rcm").replace("<arm>", ARM)


def test_the_graph_is_the_contract(
    ros_graph: RosGraph, rospy_node: str, contract: Contract, ears: list[Ear]
) -> None:
    start(ros_graph, "freerun", rospy_node)
    wrong, seen = differences(ros_graph, contract, lockstep=False)
    assert wrong == []
    print(f"{len(contract.entries)} topics and services, {len(seen)} ends on the graph")

    # Rates in real time, by the stamps: a slow listener is not a slow arm.
    arm = Arm(ARM, WallTime())
    arm.check_connections()
    assert arm.home(5.0)
    time.sleep(2.0)
    arm.close()
    for ear in ears:
        entry, stamps = ear.entry, [stamp for stamp, _ in list(ear.heard) if stamp > 0]
        assert entry.hz is not None and stamps, entry.name
        span = (stamps[-1] - stamps[0]) / 1e9
        rate = (len(stamps) - 1) / span
        # A busy machine costs cycles, so that the lower bound is a loose one; the exact counts are
        # those of lock-step. The state is also said at every change.
        fastest = 1.05 if entry.name != "<arm>/operating_state" else 2.0
        assert 0.5 * entry.hz[1] < rate < fastest * entry.hz[1], f"{entry.name}: {rate:.1f} Hz"
        print(f"{entry.name:28s} {rate:6.1f} Hz")
        assert abs(stamps[-1] / 1e9 - time.time()) < 5.0, "stamps are wall time"
    every_command_connects_with_its_md5(ros_graph, contract)


def every_command_connects_with_its_md5(ros_graph: RosGraph, contract: Contract) -> None:
    """A roscpp subscriber refuses a publisher of another md5: who connects has the same one."""
    inputs = [
        e
        for e in contract.entries
        if e.direction == "in" and e.node in topics.NODES and e.only in {None, *REFERENCE}
    ]
    publishers = {}
    for entry in inputs:
        kind = roslib.message.get_message_class(entry.type)
        assert kind is not None and kind._md5sum == contract.types.get(entry.type, kind._md5sum)
        publishers[entry.name] = rospy.Publisher(entry.resolved(ARM), kind, queue_size=1)
    rest = dict(publishers)

    def all_connected() -> bool:
        for name in [name for name, p in rest.items() if p.get_num_connections() > 0]:
            del rest[name]
        return not rest

    try:
        ros_graph.wait_for(all_connected, 20.0, "a listener for each command")
    finally:
        for publisher in publishers.values():
            publisher.unregister()
    assert len(inputs) > 30
    for entry in contract.entries:
        kind = roslib.message.get_message_class(entry.type)
        kind = kind or roslib.message.get_service_class(entry.type)
        assert kind is not None, entry
        assert kind._md5sum == contract.types.get(entry.type, kind._md5sum), entry


def test_rates_frames_and_silence_in_lockstep(
    ros_graph: RosGraph, rospy_node: str, contract: Contract, ears: list[Ear]
) -> None:
    """Simulated time is exact, so the counts are: before home, at work, and after unhome."""
    start(ros_graph, "lockstep", rospy_node)
    clock = LockstepTime(rospy_node, ARM)
    arm = Arm(ARM, clock)
    try:
        arm.check_connections()
        ros_graph.wait_for(clock.connected, 20.0, "the clock")
        ros_graph.wait_for(
            lambda: all(ear.subscriber.get_num_connections() > 0 for ear in ears), 20.0, "ears"
        )
        wrong, _ = differences(ros_graph, contract, lockstep=True)
        assert not wrong, "\n".join(wrong)
        arm.sleep(0.1)
        before = clock.tick
        assert arm.home(1.0) and arm.enable(1.0)
        arm.sleep(0.1)
        first = 50 * (clock.tick // 50 + 1)
        last = first + 500
        arm.sleep((last - clock.tick) * TICK + 0.02)
        assert arm.disable(1.0)
        arm._state_command(arm_word("unhome"))
        arm.sleep(0.1)
        end = clock.tick

        def all_heard() -> bool:
            return all(
                ear.between(first, last) >= round(ear.entry.hz[0] * 500 * TICK) for ear in ears
            )

        ros_graph.wait_for(all_heard, 10.0, f"all messages: {[e.entry.name for e in ears]}")
        time.sleep(0.3)
    finally:
        arm.close()
        clock.close()
    for ear in ears:
        entry = ear.entry
        assert entry.hz is not None
        count = round(entry.hz[0] * 500 * TICK)
        ticks = [s // TICK_NS for s, _ in list(ear.heard) if first * TICK_NS < s <= last * TICK_NS]
        assert len(ticks) == count, (
            f"{entry.name}: {len(ticks)} of {count}, {len(set(ticks))} different, by "
            f"{ear.connections} connections; the first ones are {ticks[:10]}"
        )
        valid = [(stamp, frame) for stamp, frame in ear.heard if stamp != 0]
        silent = [i for i, (stamp, _) in enumerate(ear.heard) if stamp == 0]
        if entry.frame is not None:
            assert {frame for _, frame in valid} == {frame_of(entry)}, entry.name
        if entry.valid == "homed":
            # Once before home, once after unhome, each time followed by nothing that is not valid.
            assert len(silent) == 2, f"{entry.name}: {len(silent)} with stamp 0"
            assert silent == [0, len(ear.heard) - 1]
            assert min(s for s, _ in valid) > before * TICK_NS
            assert max(s for s, _ in valid) < (end - 30) * TICK_NS
        elif entry.valid is not None:
            # operating_state: the state before the first tick, at 10 Hz if that tick is late.
            assert silent == list(range(len(silent))), entry.name
            assert len(silent) <= 1 or entry.name.endswith("/operating_state"), entry.name


def arm_word(word: str) -> Any:
    from crtk_msgs.msg import StringStamped

    return StringStamped(string=word)


def test_the_page_names_every_reason() -> None:
    page = PAGE.read_text("utf-8")
    names = {surg_core.reason_name(reason) for reason in surg_core.Reason.__members__.values()} - {
        "none"
    }
    assert len(names) > 20
    assert {name for name in names if f"`{name}`" not in page} == set()


def test_the_reference_nodes_are_those_of_the_system() -> None:
    """What is checked is what a user starts."""
    assert {node.name for node in topics.reference_nodes("freerun")} == {
        "/sim", f"/{ARM}/controller", "/dvrk_compat",
    }  # fmt: skip
    for node in topics.reference_nodes("freerun"):
        assert system.executable(node.package, node.executable).exists()
