"""The clock monitor: queries the machine's PTP daemon once a second and publishes its status.

``/clock_sync/status`` (surg_msgs/ClockSync) is recorded; ``/diagnostics`` gets an entry. Private
parameters: ``socket`` of the daemon (/run/surg_ptp/ptp4l), ``bound`` on the offset (0.001) [s],
``rate`` (1.0) [Hz]. Run one per machine whose stamps are recorded, each under its own name.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from surg_msgs.msg import ClockSync
from surg_recording.clock import clock_sync, pmc
from surg_recording.clock.clock_sync import ClockStatus
from surg_ros.params import ParamError, read, real, text

TOPIC = "/clock_sync/status"


class ClockSyncNode:
    """Queries, judges, publishes."""

    def __init__(self, socket: str, bound: float, rate: float) -> None:
        self._socket, self._bound, self._period = socket, bound, 1.0 / rate
        self._reported: str | None = None
        self._status = rospy.Publisher(TOPIC, ClockSync, queue_size=10)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)

    def spin(self) -> None:
        """Query the clock until shutdown, paced by the steady clock."""
        due = time.monotonic()
        while not rospy.is_shutdown():
            asked = rospy.Time(*divmod(time.time_ns(), 10**9))
            self._publish(pmc.ask(self._socket), asked)
            due = max(due + self._period, time.monotonic())
            while not rospy.is_shutdown() and time.monotonic() < due:
                time.sleep(min(0.05, self._period / 10.0))

    def _publish(self, status: ClockStatus, asked: Any) -> None:
        fault = status.fault(self._bound)
        if fault != self._reported:  # log changes only
            (rospy.logwarn if fault else rospy.loginfo)("clock: %s", fault or "in step")
            self._reported = fault
        fields = {**asdict(status), "in_step": not fault, "problem": fault}
        message = ClockSync(**fields)
        message.header.stamp = asked
        self._status.publish(message)
        entry = DiagnosticStatus(
            name=f"{rospy.get_name().strip('/')}: PTP clock",
            hardware_id=status.clock,
            level=DiagnosticStatus.WARN if fault else DiagnosticStatus.OK,
            message=fault or "in step",
            values=[
                KeyValue("port state", status.port_state or "unknown"),
                KeyValue("offset [us]", _microseconds(status.offset)),
                KeyValue("path delay [us]", _microseconds(status.path_delay)),
                KeyValue("grandmaster", status.grandmaster or "none"),
            ],
        )
        array = DiagnosticArray(status=[entry])
        array.header.stamp = asked
        self._diagnostics.publish(array)


def _microseconds(seconds: float) -> str:
    return "not measured" if math.isnan(seconds) else f"{seconds * 1e6:.3f}"


@dataclass(frozen=True)
class Parameters:
    """Socket of ptp4l, largest offset of a synchronised clock [s], rate of the reports [Hz]."""

    socket: str = text(clock_sync.SOCKET)
    bound: float = real(1e-9, 3600.0, clock_sync.OFFSET_BOUND)
    rate: float = real(1e-3, 100.0, 1.0)


def main() -> int:
    """Run the node; returns the exit code (2: broken parameters)."""
    rospy.init_node("clock_sync")
    try:
        given = read(Parameters, rospy.get_param("~", {}))
    except ParamError as problem:
        print(f"clock_sync: {problem}", file=sys.stderr)
        return 2
    ClockSyncNode(given.socket, given.bound, given.rate).spin()
    return 0
