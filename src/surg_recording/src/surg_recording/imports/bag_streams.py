"""The topics of a bag as samples and pictures, in the order of their stamps."""

from __future__ import annotations

import dataclasses
import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.imports import stamps as stamped
from surg_recording.imports.arm_series import Picture, header
from surg_recording.imports.bag_file import BagFile
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.picture_decoder import PictureDecoder
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Values = Callable[[Any], list[float]]
"""The numbers of a message."""

IMAGES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")


@dataclasses.dataclass(frozen=True)
class Samples:
    """Stamps (N,) [ns], strictly increasing, and values (N, D)."""

    stamps: Stamps
    values: Array

    def only(self, good: npt.NDArray[Any]) -> Samples:
        """Some of them."""
        return Samples(self.stamps[good], self.values[good])

    def at(self, times: Stamps) -> Array:
        """Values at other times, linear; the first and last value hold beyond the ends."""
        if not len(self.stamps):
            return np.zeros((len(times), self.values.shape[1]))
        begin = self.stamps[0]
        at, known = (times - begin).astype(float), (self.stamps - begin).astype(float)
        return np.column_stack([np.interp(at, known, column) for column in self.values.T])


class BagStreams:
    """Reads topics of one bag; what it leaves out is in the ledger."""

    def __init__(self, bag: BagFile, ledger: Ledger, own_stamps: bool = True) -> None:
        """``own_stamps`` False: the times at which the bag received the messages count."""
        self._bag, self.ledger, self._own = bag, ledger, own_stamps
        self._lags: dict[str, float | None] = {}

    def samples(self, topic: str, values: Values) -> Samples:
        """The usable messages of a topic as numbers.

        Raises:
            EpisodeError: Messages of this type cannot be used, or their stamps.
        """
        own: list[int] = []
        received: list[int] = []
        rows: list[list[float]] = []
        for _, message, time_ns in self._bag.messages([topic]):
            try:
                rows.append(values(message))
            except AttributeError:
                kind = self._bag.kinds[topic]
                raise EpisodeError(
                    f"{topic}: messages of type {kind} cannot be used; allowed: PoseStamped or"
                    " TransformStamped for a pose, JointState for joints and jaw"
                ) from None
            own.append(self._stamp(topic, message))
            received.append(time_ns)
        if not rows:
            raise EpisodeError(f"{topic}: holds no message")
        self.ledger.hold(topic, len(rows))
        widths = Counter(map(len, filter(None, rows))) or Counter([0])
        width = widths.most_common(1)[0][0]
        fits = np.array([len(row) == width for row in rows])
        blank = [np.nan] * width
        numbers = np.array([row if len(row) == width else blank for row in rows], np.float64)
        numbers = numbers.reshape(len(rows), width)
        good = np.ones(len(rows), bool)
        why = f"without the {width} numbers, or with other joints than the first"
        good = self.ledger.sieve(topic, ~fits, why, good)
        broken = ~np.isfinite(numbers).all(axis=1)
        good = self.ledger.sieve(topic, broken, "with a value that is not a number", good)
        return self._ordered(topic, np.array(own), np.array(received), numbers, good)

    def _stamp(self, topic: str, message: Any) -> int:
        """A message's own stamp [ns]; 0: it is empty."""
        if not self._own:
            return 0
        header = getattr(message, "header", None)
        if header is None:
            raise EpisodeError(
                f"{topic}: messages of type {self._bag.kinds[topic]} have no stamp; allowed: their"
                f" stamped kind. {stamped.CURE}"
            )
        return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)

    def _ordered(
        self, topic: str, own: Stamps, received: Stamps, numbers: Array, good: npt.NDArray[np.bool_]
    ) -> Samples:
        stamps, received = self._times(topic, own, received)[good], received[good]
        used = stamped.in_order(stamps, received, topic, self.ledger)
        self._agree(topic, stamps[used], received[used])
        self.ledger.check()
        if not len(used):
            raise EpisodeError(f"{topic}: holds no message that can be used")
        return Samples(stamps[used], numbers[good][used])

    def _times(self, topic: str, own: Stamps, received: Stamps) -> Stamps:
        """The stamps that count: of a message without one the time of its reception."""
        without = own == 0
        if without.any():
            count = f"{int(without.sum())} of {len(own)} messages"
            self.ledger.assume(f"{topic}: the bag's time is the stamp of {count}")
        return np.where(without, received, own)

    def _agree(self, topic: str, stamps: Stamps, received: Stamps) -> None:
        if len(stamps):
            self._lags[topic] = stamped.lag(stamps, received)
            stamped.check_agreement(self._lags, self.ledger)

    def pictures(self, cameras: Mapping[str, str]) -> Iterator[Picture]:
        """The pictures of cameras (name → topic), each in the order of its stamps.

        Raises:
            EpisodeError: Before the first picture: a camera has none, or their stamps cannot be
                used.
        """
        times = {topic: self._order(camera, topic) for camera, topic in cameras.items()}
        return self._decoded({topic: camera for camera, topic in cameras.items()}, times)

    def _order(self, camera: str, topic: str) -> tuple[Stamps, Stamps]:
        """Of each message of an image topic: stamp, and place among those kept; -1: left out."""
        if self._bag.kinds[topic] not in IMAGES:
            raise EpisodeError(
                f"{topic}: messages of type {self._bag.kinds[topic]} cannot be used; allowed:"
                f" {' and '.join(IMAGES)}"
            )
        own, received = [], []
        for _, message, time_ns in self._bag.messages([topic]):
            own.append(self._stamp(topic, message))
            received.append(time_ns)
        if not own:
            raise EpisodeError(f"{topic}: holds no message")
        self.ledger.hold(camera, len(own))
        seen = np.array(received)
        stamps = self._times(topic, np.array(own), seen)
        used = stamped.in_order(stamps, seen, camera, self.ledger)
        self._agree(topic, stamps[used], seen[used])
        places = np.full(len(stamps), -1, np.int64)
        places[used] = np.arange(len(used))
        return stamps, places

    def _decoded(
        self, cameras: Mapping[str, str], times: Mapping[str, tuple[Stamps, Stamps]]
    ) -> Iterator[Picture]:
        """Pictures wait until those stamped before them have come."""
        if not cameras:
            return
        decoders = {t: PictureDecoder(camera, self.ledger) for t, camera in cameras.items()}
        waiting: dict[str, list[tuple[int, int, Any]]] = {topic: [] for topic in cameras}
        seen, due = Counter[str](), Counter[str]()
        for topic, message, time_ns in self._bag.messages(cameras):
            stamps, places = times[topic]
            number = seen[topic]
            seen[topic] += 1
            if places[number] < 0:
                continue
            message.data = message.data.tobytes()
            heapq.heappush(waiting[topic], (int(places[number]), number, message))
            while waiting[topic] and waiting[topic][0][0] == due[topic]:
                _, number, ready = heapq.heappop(waiting[topic])
                due[topic] += 1
                made = decoders[topic](ready)
                if made is not None:
                    stamp = int(stamps[number])
                    made.header = header(stamp)
                    yield Picture(cameras[topic], made, time_ns)
