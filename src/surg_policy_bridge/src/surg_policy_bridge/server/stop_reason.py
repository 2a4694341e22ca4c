"""Why a policy does not move the arms, as a code; the names are those of surg_msgs/PolicyStatus."""

from __future__ import annotations

import enum


class StopReason(enum.Enum):
    """``REASON_...`` of surg_msgs/PolicyStatus, which documents each."""

    NONE, NO_POLICY, NOT_ENABLED, EPISODE_OVER = range(1, 5)
    OPERATOR, TELEOP_STATUS, NOT_PRESENT, CAMERA, ARM = range(5, 10)
    POLICY_SILENT, POLICY_LEFT, NO_ACTION, NO_OBSERVATION = range(10, 14)
    REJECTED, SERVER_ENDED, CAMERA_MOVED = range(14, 17)
