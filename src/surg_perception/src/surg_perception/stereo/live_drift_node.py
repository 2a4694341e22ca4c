"""The watch over the running system's pictures, and what it says as a topic."""

from __future__ import annotations

import time

import rospy

import surg_core
from surg_core.contract import SECOND_NS
from surg_core.lens_file import Lens
from surg_core.transforms import FloatArray
from surg_msgs.msg import DriftStatus
from surg_perception.depth.rectification import Picture
from surg_perception.drift.drift_state import MOVED, STEADY, UNKNOWN, DriftState, state_of
from surg_perception.drift.drift_watch import DriftWatch
from surg_perception.drift.stated_parts import stated_parts
from surg_perception.stereo.live_marks_node import Joints

TOPIC = "/endoscope/drift"
WORDS = {
    UNKNOWN: DriftStatus.STATE_UNKNOWN,
    STEADY: DriftStatus.STATE_STEADY,
    MOVED: DriftStatus.STATE_MOVED,
}
PERIOD_S = 1.0
"""[s] Longest time between two messages."""
SILENT_S = 2.0
"""[s] Without a pair of pictures for so long, nobody can tell any more."""
CURE = "look with ./surg calibrate CELL drift --from EPISODE, correct with --accept, then restart"


class LiveDrift:
    """Looks at the newest pictures, and publishes.

    Args:
        cell: A calibrated cell.
        joints: Of its arms.

    Raises:
        ConfigError: The calibration does not state its errors.
    """

    def __init__(self, cell: surg_core.Cell, joints: Joints) -> None:
        self._cell, self._joints, self._parts = cell, joints, stated_parts(cell)
        self._watch: DriftWatch | None = None
        self._told: tuple[DriftState, float] | None = None
        self._since, self.refusal = rospy.Time(), ""
        self._begin: int | None = None
        self._looked = time.monotonic()
        self._topic = rospy.Publisher(TOPIC, DriftStatus, queue_size=2, latch=True)

    def use(self, lenses: tuple[Lens, Lens] | None) -> None:
        """Watch through these lenses, without what was seen before; None: they are not known."""
        self._watch = None if lenses is None else DriftWatch(self._cell, lenses, self._parts)

    def look(self, pictures: tuple[Picture, Picture], stamp_ns: int) -> None:
        """Take in the pictures of one moment."""
        self._looked = time.monotonic()
        if not stamp_ns:
            self.blind("the pictures have no stamp")
        if self._watch is None or not stamp_ns:
            return
        begin = self._begin = stamp_ns if self._begin is None else self._begin

        def joints(arm: str, at: float) -> FloatArray | None:
            return self._joints.between(arm, begin + round(at * SECOND_NS))

        self._watch.look((stamp_ns - begin) / SECOND_NS, pictures, joints)
        state = state_of(self._watch.verdict, self._watch.unseen)
        if state.far and not self.refusal:
            since = begin + round(state.since * SECOND_NS)
            self._since = rospy.Time(*divmod(since, SECOND_NS))
            off = f"instruments are seen {1e3 * state.beside[1]:.1f} mm beside their place"
            self.refusal = f"the picture is not what was calibrated, {off}; {CURE}"
            rospy.logwarn("eyes: %s", self.refusal)
        self._tell(state)

    def idle(self) -> None:
        """No pair of pictures has arrived."""
        if time.monotonic() - self._looked > SILENT_S:
            self.blind("no pictures of both eyes with one stamp")

    def blind(self, why: str) -> None:
        """Nobody can tell now; what was refused before stays refused."""
        self._tell(DriftState(UNKNOWN, why))

    def _tell(self, state: DriftState) -> None:
        """Publish a state that is another one, and each of them periodically."""
        now = time.monotonic()
        if self._told is not None:
            before, at = self._told
            same = (before.word, before.cause) == (state.word, state.cause)
            if same and now - at < PERIOD_S:
                return
        self._told = state, now
        message = DriftStatus(
            version=DriftStatus.VERSION,
            state=WORDS[state.word],
            cause=state.cause,
            detail=state.sentence(),
            since=self._since,
            refusal=self.refusal,
        )
        message.least, message.expected, message.most = state.beside
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
        self._topic.publish(message)
