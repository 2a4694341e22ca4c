"""What both eyes and both arms of a running system show at a moment. It moves nothing."""

from __future__ import annotations

import surg_core
from surg_perception.collecting.arm_joints_node import SILENT_S, ArmJoints
from surg_perception.collecting.base_views import Moment
from surg_perception.collecting.collect_views_node import grey_of
from surg_perception.stereo.newest_pair_node import EYES, NewestPair


class BaseMoments:
    """Listens to the eyes and to two arms until `close`.

    Args:
        cell: Whose endoscope and arms they are.
        arms: Names of both arms.
        eyes: Of the endoscope, 1 or 2.
    """

    def __init__(self, cell: surg_core.Cell, arms: tuple[str, str], eyes: int) -> None:
        self._pairs = NewestPair(EYES[:eyes])
        self._pairs.listen(True)
        self._joints = {arm: ArmJoints(cell.arms[arm]) for arm in arms}

    def next(self, wait: float = SILENT_S) -> Moment | str:
        """The next pair of pictures with the joints at its exposure; a text: what is silent."""
        self._pairs.take(0.0)  # one of before
        pair = self._pairs.take(wait)
        if pair is None:
            silent = self._pairs.silent()
            if not silent:
                return "the endoscope is silent, or its eyes have different stamps"
            topics = " and ".join(f"/endoscope/{eye}/image_raw" for eye in silent)
            return f"no pictures on {topics}: start the endoscope's node"
        try:
            pictures = tuple(grey_of(image) for image in pair)
        except ValueError as error:
            return str(error)
        stamp, joints = pair[0].header.stamp.to_sec(), {}
        for arm, states in self._joints.items():
            if states.silent(stamp):
                return f"{arm} states no joints ({states.topic})"
            joints[arm] = states.resting(stamp)
        return Moment(stamp, pictures, joints)

    def close(self) -> None:
        """Leave the graph."""
        self._pairs.listen(False)
        for each in self._joints.values():
            each.close()
