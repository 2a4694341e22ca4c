"""From the stamps of a device's own clock to ROS time.

A picture is received some time after its stamp, never before it. So the least difference of
reception and stamp follows the offset of the clocks, and a line below all differences follows their
drift. The line is the edge of the lower convex hull below the mean time: of all lines below the
differences it has the least sum of distances (Zhang, Liu, Xia: "Clock synchronization algorithms
for network measurements", INFOCOM 2002). The least delay of the device is part of the offset; a
clock pattern measures it (`clock_pattern`).
"""

from __future__ import annotations

from collections import deque

BIN_NS = 1_000_000_000
"""Only the least difference of each bin is kept."""
BINS = 60
LEAST_BINS = 5
"""Fewer give an offset without drift."""
MOST_DRIFT = 500e-6
"""Quartz clocks drift by less."""
STEP_NS = 100_000_000
"""A difference so far below the line means that a clock was set; so far above it, too, if it
remains for `LATE` pictures in a row."""
LATE = 15


class DeviceClock:
    """Maps one device's stamps [ns] to ROS time [ns]."""

    def __init__(self) -> None:
        self._bins: deque[tuple[int, int]] = deque(maxlen=BINS)  # device time, least difference
        self._late = 0
        self._line = (0, 0.0, 0.0)  # device time, offset there, drift
        self.steps = 0
        """Times that one of the clocks was set."""

    @property
    def drift(self) -> float:
        """Rate of ROS time minus that of the device, relative."""
        return self._line[2]

    def ros_time(self, device_ns: int, received_ns: int) -> int:
        """ROS time of a device's stamp; at the latest the reception.

        Args:
            device_ns: The stamp, by the device's clock.
            received_ns: When the picture arrived, by ROS's clock.
        """
        difference = received_ns - device_ns
        if self._bins:
            above = difference - self._offset(device_ns)
            self._late = self._late + 1 if above > STEP_NS else 0
            backwards = device_ns < self._bins[-1][0] - BIN_NS
            if above < -STEP_NS or self._late >= LATE or backwards:
                self._bins.clear()
                self._late = 0
                self.steps += 1
        self._add(device_ns, difference)
        return min(received_ns, round(device_ns + self._offset(device_ns)))

    def _offset(self, device_ns: int) -> float:
        at, offset, drift = self._line
        return offset + drift * (device_ns - at)

    def _add(self, device_ns: int, difference: int) -> None:
        if self._bins and device_ns - self._bins[-1][0] < BIN_NS:
            at, least = self._bins[-1]
            if difference >= least:
                return
            self._bins[-1] = (at, difference)
        else:
            self._bins.append((device_ns, difference))
        self._line = _line_below(list(self._bins))


def _line_below(points: list[tuple[int, int]]) -> tuple[int, float, float]:
    """A point of the line, its value and its slope."""
    at, least = points[0][0], float(min(difference for _, difference in points))
    if len(points) < LEAST_BINS:
        return at, least, 0.0
    hull: list[tuple[int, int]] = []
    for x, y in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], (x, y)):
            hull.pop()
        hull.append((x, y))
    mean = sum(x - at for x, _ in points) / len(points)
    edge = next(i for i in range(1, len(hull)) if hull[i][0] - at >= mean)
    (x0, y0), (x1, y1) = hull[edge - 1], hull[edge]
    slope = (y1 - y0) / (x1 - x0)
    if abs(slope) > MOST_DRIFT:
        return at, least, 0.0
    return x0, float(y0), slope


def _turns_down(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether b lies on or above the line from a to c; exact, in integers."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
