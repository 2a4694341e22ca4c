"""The clock monitor: what pmc says is published once a second, recorded and judged."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.graph.ros import RosGraph
from helpers.graph.surg import argv_with, environment
from helpers.machines.machines import on_one_wire
from helpers.results import sync_results

rospy = pytest.importorskip("rospy")
surg_msgs = pytest.importorskip("surg_msgs.msg")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402

from surg_cli.commands import ptp  # noqa: E402
from surg_cli.graph.processes import Supervisor, wait_until  # noqa: E402
from surg_recording.clock import pmc, sync_report  # noqa: E402
from surg_recording.episode import episode_reader  # noqa: E402

pytestmark = pytest.mark.ros

# Answers like pmc, with the offset [ns] that the file `offset` holds; none: no daemon.
STAND_IN = """#!{python}
import pathlib
try:
    offset = pathlib.Path({file!r}).read_text()
except OSError:
    raise SystemExit(0)
print('''
\t0000b0.fffe.00000b-0 seq 0 RESPONSE MANAGEMENT TIME_STATUS_NP
\t\tingress_time 17
\t\tgmPresent true
\t\tgmIdentity 0000a0.fffe.00000a
\t0000b0.fffe.00000b-0 seq 1 RESPONSE MANAGEMENT CURRENT_DATA_SET
\t\toffsetFromMaster ''' + offset + '''
\t\tmeanPathDelay 40000.0
\t0000b0.fffe.00000b-1 seq 2 RESPONSE MANAGEMENT PORT_DATA_SET
\t\tportState SLAVE''')
"""


class Ears:
    """What the monitor says."""

    def __init__(self) -> None:
        self.said: list[Any] = []
        self.diagnosed: list[Any] = []
        self._subscribers = [
            rospy.Subscriber("/clock_sync/status", surg_msgs.ClockSync, self.said.append),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ]

    def _on_diagnostics(self, message: Any) -> None:
        self.diagnosed += [s for s in message.status if s.name.endswith("PTP clock")]

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()


@pytest.fixture
def ears(rospy_node: str, ros_graph: RosGraph) -> Iterator[Ears]:
    made = Ears()
    yield made
    made.close()


def test_the_monitor_says_what_pmc_says(ears: Ears, ros_graph: RosGraph, tmp_path: Path) -> None:
    offset, program = tmp_path / "offset", tmp_path / "pmc"
    offset.write_text("12000.0")
    program.write_text(STAND_IN.format(python=sys.executable, file=str(offset)))
    program.chmod(0o755)
    (tmp_path / "socket").touch()
    ros_graph.node(
        "surg_recording",
        "clock_sync_node",
        "/clock_sync",
        {"socket": str(tmp_path / "socket"), "rate": 10.0},
        env={"PATH": f"{tmp_path}:{os.environ['PATH']}"},
    )
    ros_graph.wait_for(lambda: bool(ears.said and ears.diagnosed), 20, "the clock monitor")
    first = ears.said[0]
    assert first.offset == pytest.approx(12e-6)
    assert first.path_delay == pytest.approx(40e-6)
    assert (first.port_state, first.grandmaster) == ("SLAVE", "0000a0.fffe.00000a")
    assert first.in_step
    assert abs(first.header.stamp.to_sec() - time.time()) < 30.0
    assert ears.diagnosed[0].level == 0
    offset.write_text("-2500000.0")  # injected: 2.5 ms behind
    ros_graph.wait_for(lambda: not ears.said[-1].in_step, 20, "the offset to be noticed")
    assert ears.said[-1].offset == pytest.approx(-2.5e-3)
    assert "-2.500 ms off its master" in ears.said[-1].problem
    ros_graph.wait_for(lambda: ears.diagnosed[-1].level == 1, 20, "the diagnosis")
    offset.unlink()
    ros_graph.wait_for(lambda: not ears.said[-1].port_state, 20, "the daemon's end")
    assert math.isnan(ears.said[-1].offset)
    assert "./surg ptp" in ears.said[-1].problem


# --- a real pair --------------------------------------------------------------------------------


@contextlib.contextmanager
def daemons(tmp_path: Path, asymmetry_ns: int) -> Iterator[Path]:
    """A master by `./surg ptp` and a slave that measures; yields the slave's socket.

    The slave is told that the way to it takes ``asymmetry_ns`` longer than the way back, which is
    not so: it measures an offset of that size.
    """
    slave = tmp_path / "slave"
    slave.mkdir(parents=True)
    with (
        on_one_wire("master", "slave") as wire,
        Supervisor(environment(), tmp_path / "logs") as supervisor,
    ):
        words = ("ptp", "master", wire.interfaces["master"])
        master = argv_with("surg_cli.commands.ptp", "FOLDER", tmp_path / "m", *words)
        supervisor.start("master", wire.on("master", *master))
        text = ptp.configuration("slave", wire.interfaces["slave"], slave / "ptp4l", True)
        (slave / "conf").write_text(text + f"delayAsymmetry {asymmetry_ns}\n")
        daemon = [str(pmc.program("ptp4l")), "-f", str(slave / "conf"), "-m"]
        supervisor.start("slave", wire.on("slave", *daemon))
        began = time.monotonic()
        assert wait_until(lambda: not math.isnan(pmc.ask(slave / "ptp4l").offset), 60, 0.2), (
            "no offset was measured: " + pmc.ask(slave / "ptp4l").fault()
        )
        print(f"measured after {time.monotonic() - began:.1f} s: {pmc.ask(slave / 'ptp4l')}")
        yield slave / "ptp4l"


def record(ears: Ears, graph: RosGraph, folder: Path, socket: Path, looks: int) -> Path:
    """Record what the monitor says of a clock, as an episode of two machines."""
    status: list[surg_msgs.RecordStatus] = []
    ear = rospy.Subscriber("/record/status", surg_msgs.RecordStatus, status.append)
    start = rospy.Publisher("/record/record", Bool, queue_size=1)
    graph.node("surg_recording", "clock_sync_node", "/clock_sync", {"socket": str(socket)})
    parameters = {"out": str(folder), "mode": "freerun", "min_free_bytes": 0}
    info = json.dumps({"machines": ["robot", "operator"]})
    graph.node("surg_recording", "recorder_node", "/recorder", {**parameters, "run_info": info})
    begun = len(ears.said)

    def heard() -> bool:
        streams = status[-1].streams if status else []
        rows = sum(one.received for one in streams if one.name == "clock_sync")
        return rows >= looks and len(ears.said) >= begun + looks

    graph.wait_for(heard, 30, "the monitor's looks in the recording")
    start.publish(False)
    graph.wait_for(lambda: bool(status and status[-1].finished), 30, "the episode")
    ear.unregister()
    return Path(status[-1].finished)


def possible() -> str:
    """Why there can be no pair here; empty when there can."""
    if pmc.program("ptp4l") is None:
        return "linuxptp is not installed"
    if shutil.which("setpriv") is None:
        return "setpriv is missing"
    try:
        with on_one_wire("master", "slave"):
            return ""
    except PermissionError as problem:
        return f"network namespaces are not permitted here: {problem}"


@pytest.mark.full
@pytest.mark.parametrize(("injected", "verdict"), [(0, "pass"), (5_000_000, "fail")])
def test_a_real_pair_is_monitored_and_recorded(
    ears: Ears, ros_graph: RosGraph, tmp_path: Path, injected: int, verdict: str
) -> None:
    """ptp4l against ptp4l in two network namespaces, whose true offset is 0: they share a clock."""
    why_not = possible()
    if why_not:
        pytest.skip(why_not)
    with daemons(tmp_path / "ptp", injected) as socket:
        folder = record(ears, ros_graph, tmp_path / "episode", socket, looks=4)
    assert wait_until((folder / sync_report.FILE).exists, 60), "the recorder has it made"
    found = sync_report.load(episode_reader.read(folder))
    assert found is not None
    clock = found["clock"]
    row = "a real ptp4l pair" + (" with an offset of 5 ms injected" if injected else "")
    told = f"largest offset {found['offset_s'] * 1e6:+.2f} µs, path delay"
    told += f" {found['path_delay_s'] * 1e6:.2f} µs, verdict on the clocks: {clock['verdict']}"
    sync_results.note(row, clock["samples"], told)
    assert clock["verdict"] == verdict, clock
    assert clock["samples"] >= 4
    # Software stamps on a loaded machine: half a millisecond is far away.
    assert abs(abs(found["offset_s"]) - injected * 1e-9) < 0.5e-3
    assert found["grandmaster"].count(".fffe.") == 1
    if injected:
        assert "ms off its master" in clock["reasons"][0]
