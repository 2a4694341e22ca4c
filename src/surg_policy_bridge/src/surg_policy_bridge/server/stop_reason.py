"""Why a policy does not move the arms, as a code; the names are those of surg_msgs/PolicyStatus."""

from __future__ import annotations

import enum


class StopReason(enum.Enum):
    """``REASON_...`` of surg_msgs/PolicyStatus, which documents each."""

    NONE = enum.auto()
    NO_POLICY = enum.auto()
    NOT_ENABLED = enum.auto()
    EPISODE_OVER = enum.auto()
    OPERATOR = enum.auto()
    TELEOP_STATUS = enum.auto()
    NOT_PRESENT = enum.auto()
    CAMERA = enum.auto()
    ARM = enum.auto()
    POLICY_SILENT = enum.auto()
    POLICY_LEFT = enum.auto()
    NO_ACTION = enum.auto()
    NO_OBSERVATION = enum.auto()
    REJECTED = enum.auto()
    SERVER_ENDED = enum.auto()
