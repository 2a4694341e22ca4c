"""All messages of the console to the operator: what is wrong and what to do."""

from __future__ import annotations

from pathlib import Path

import surg_core
from surg_console.session.system_state import Arm, Robot
from surg_core import Reason

NO_CONTROL = "Another page has control. Stop works from here too"
CLOSED = "The page in control was closed. The arm holds"
TAKEN_AWAY = "The page in control no longer answers. Control was taken over"
SILENT = (
    "No input from this page for 0.1 s (frozen tab or busy machine). The arm holds. Press Enable "
    "to continue"
)
LATE = "The command arrived too late (network or machine stalled). Press the button again"
NO_PICTURE = "No camera image yet; motion is blocked. Check the endoscope node"
FROZEN_PICTURE = (
    "The picture has been frozen for 1 s. The arm holds. Press Enable when the picture is live"
)
NO_ARM = "No state from any arm. Check that the controllers run (./surg status)"
NO_FOLLOWER = "No status from the teleoperation node. Check that it runs (./surg status)"
NO_FAULTED_ARM = "No simulated arm is in FAULT, so there is nothing to guide home"
GUIDED_HOME = "The arm is being guided home. Press Enable when it is at rest"
NO_TASK = "No simulated task runs here, so there is no other episode to begin"
NEW_WHILE_RECORDED = "An episode is being recorded. Stop the recording (V), then begin a new one"
NEW_ASKED = "The arms are being disabled; then they are put home and a new episode begins"
NEW_EPISODE = "A new episode: the arms are home, and the phantom is as at first. Press Enable"
NOT_NEW = "No new episode: not every arm was disabled. Press New episode again"
STILL_RECORDED = "The recording still runs. Stop it (V), then judge it"
NOTHING_RECORDED = "No recording has finished, so there is nothing to judge. Nothing was written"
NO_POLICY = "No policy is connected. Start one; it connects by itself (docs/reference/policies.md)"
POLICY_ASKED = "The policy takes over the arm"
POLICY_NOT_GIVEN = (
    "The policy did not get the arm: the teleoperation did not let go of it. Press Policy again"
)
POLICY_ENDED = "The policy releases the arm. Press Enable to take it over"
HIDDEN = {
    "hidden": "The tab was hidden. The arm holds. Press Enable to continue",
    "closed": CLOSED,
    "gamepad": "The gamepad was unplugged. The arm holds. Plug it in and press Enable",
    "pointer": "Mouse or keyboard was lost. The arm holds. Press Enable to continue",
    "headset": "The headset was taken off, or its menu is open. The arm holds. Press Enable (A) to "
    "continue",
    "recentred": "The headset's room was recentred. The arm holds. Press Enable (A) to continue",
}

REASONS = {
    Reason.STATE_NOT_FINITE: "the robot sends joint values that are not finite; check its link",
    Reason.STALE: "no more commands have arrived; press Enable to continue",
    Reason.LINK_LOST: "the robot sends no joint values; check that its link runs",
    Reason.RCM_UNSET: "no trocar point is set; set it on rcm/set_cp",
    Reason.RCM_ERROR: "the shaft is off its trocar point; move the trocar or the arm, or set the "
    "point again on rcm/set_cp",
    Reason.OVERRUN: "the control loop missed its deadlines; free the processor, then press Enable",
    Reason.JOINT_LIMIT: "a joint is at its limit; move the tip back",
    Reason.OPERATOR: "requested by the operator",
    Reason.NOT_FOLLOWING: "the robot does not follow its commands; check for a protective stop or "
    "an obstacle, then press Enable",
    Reason.TRACK_STALE: "the trocar's tracker is silent; restart it, then press Enable",
    Reason.TOOL_LOST: "the tool sends no jaw angle; check the tool link",
    Reason.UNREACHABLE: "the arm cannot move on within its limits and through the trocar; move the "
    "tip back",
    Reason.FORCE: "too much force at the tip or on the trocar; press Enable and move away from the "
    "contact",
    Reason.MASTER_LOST: "the ROS master has ended; restart it and every node",
}
"""Why an arm is PAUSED or in FAULT; other reasons use the controller's own text."""


def as_sentence(text: str) -> str:
    """Add a capital letter and a full stop."""
    text = text.strip()
    return text and text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def not_here(folder: Path) -> str:
    """Why a recording cannot be judged: its folder is not on the console's machine, or is gone."""
    return (
        f"{folder} is not on the console's machine, or was discarded. Nothing was written. "
        "Judge it where it lies (./surg episode label)"
    )


def taken(name: str) -> str:
    """Why a second page does not get control."""
    return f"{name} has control. Release it there, or close or hide that page"


def stopped(who: str) -> str:
    """Stop was pressed; ``who``: on another page."""
    by = f" on {who}" if who else ""
    return f"Stop was pressed{by}. The arm is paused. Press Enable to continue"


def driving_endoscope(arm: str, clutched: bool) -> str:
    """What the hand does while the camera pedal is down; empty arm: no arm holds the endoscope."""
    if not arm:
        return "No arm holds the endoscope, so Camera only clutches. The tip stays."
    if clutched:
        return "The clutch is held. The endoscope stays."
    return f"Your hand moves the endoscope ({arm}). The instrument stays."


def let_go(robot: Robot) -> str:
    """Why following ended although the operator did not stop."""
    follower = robot.follower
    if not follower.state:
        return NO_FOLLOWER
    if follower.reason:
        return follower.reason
    lost = next((arm for arm in robot.arms if not arm.ready()), None)
    if lost is not None:
        return f"{lost.name}: {state_sentence(lost)}"
    return f"The teleoperation is {follower.state}. Press Enable to continue"


def not_ready(robot: Robot, since: float, seconds: float) -> str:
    """Why following did not begin `seconds` after Enable, which was pressed at `since` [s]."""
    if not robot.follower.state:
        return NO_FOLLOWER
    arm = next((arm for arm in robot.arms if not arm.ready()), None)
    if arm is None:
        return f"The tip does not follow after {seconds:g} s: {robot.follower.reason}"
    if not arm.state:
        return f"No state from {arm.name}. Check that its controller runs (./surg status)"
    warned = arm.warning if arm.warned >= since else ""
    fault = reason_sentence(arm) if arm.state == "FAULT" else ""
    cause = fault or without_name(warned, arm.name) or robot.follower.reason
    because = f": {cause}" if cause else ""
    return f"{arm.name} is {arm.state} {seconds:g} s after Enable{because}"


def state_sentence(arm: Arm) -> str:
    """State of an arm for operators who do not know CRTK."""
    if arm.state == "FAULT":
        return f"stopped by a fault: {reason_sentence(arm) or 'no reason given'}"
    if arm.state == "PAUSED":
        why = reason_sentence(arm)
        return f"holds, paused: {why}" if why else "holds, paused"
    if arm.state == "DISABLED":
        return "disabled; press Enable to bring it up"
    if arm.state == "ENABLED":
        return "holds, ready to move" if arm.homed else "holds, not homed yet"
    return "no state yet; check that its controller runs (./surg status)"


def reason_sentence(arm: Arm) -> str:
    """Why an arm is PAUSED or in FAULT; empty: unknown."""
    if arm.reason is None or arm.reason == Reason.NONE:
        return ""
    return REASONS.get(arm.reason) or str(surg_core.sentence(arm.reason))


def without_name(text: str, name: str) -> str:
    """A controller's message without the name of the arm."""
    return text.removeprefix(f"{name}: ").strip()


def policy_lost(detail: str) -> str:
    """The policy has the arm no longer, and nobody took it away."""
    why = f" ({detail})" if detail else ""
    return f"The policy was lost{why}. The arm holds. Press Policy to give it the arm again"


def policy_sentence(robot: Robot) -> str:
    """What the policy does; empty: nothing to report."""
    policy = robot.policy
    name = policy.name or "the policy"
    if policy.state == "RUNNING":
        return f"{name} moves the arm. Enable takes it back, Stop pauses it"
    if policy.state == "WAKING":
        return f"the arm is being enabled for {name}"
    if policy.refused:
        return f"the policy was refused: {policy.refused}"
    if policy.state in ("PAUSED", "IDLE"):
        return f"the policy is stopped: {policy.detail}"
    return ""
