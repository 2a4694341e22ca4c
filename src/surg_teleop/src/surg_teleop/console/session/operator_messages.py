"""What the console says to people: one sentence each, with the cure."""

from __future__ import annotations

import surg_core
from surg_core import Reason
from surg_teleop.console.session.system_state import Arm, Robot

NO_CONTROL = "another page has control: this one watches (Stop works from here too)"
CLOSED = "the page that had control was closed: the arm holds"
TAKEN_AWAY = "the page that had control no longer answers: control was taken over"
SILENT = (
    "nothing came from this page for 0.1 s (the tab was frozen, or the machine was busy): the arm "
    "holds; press Enable to go on"
)
LATE = "that came too late (the network or the machine stood still): press it again"
NO_PICTURE = "there is no picture yet: nothing is moved blindly; see that the endoscope node runs"
FROZEN_PICTURE = (
    "the picture has stood still for a second: the arm holds; press Enable when it moves again"
)
NO_ARM = "no arm has spoken yet: see that the controllers run (./surg status)"
NO_FOLLOWER = "the teleoperation node does not speak: see that it runs (./surg status)"
NOTHING_ASTRAY = "no simulated arm is in FAULT: nothing is to be put back"
PUT_BACK = "the arm is led home by hand; press Enable once it rests"
NO_POLICY = "no policy is connected: start one, it connects by itself (docs/reference/policies.md)"
POLICY_ASKED = "the arm goes to the policy"
POLICY_ENDED = "the policy gives the arm up; press Enable to have it yourself"
HIDDEN = {
    "hidden": "the tab was hidden: the arm holds; press Enable to go on",
    "closed": CLOSED,
    "gamepad": "the gamepad was unplugged: the arm holds; plug it in and press Enable",
    "pointer": "the mouse or the keyboard was lost: the arm holds; press Enable to go on",
}

REASONS = {
    Reason.STATE_NOT_FINITE: "the robot sends joint values that are not finite: check its link",
    Reason.STALE: "the commands stopped coming; press Enable to go on",
    Reason.LINK_LOST: "the robot sends no joint values: check that its link runs",
    Reason.RCM_UNSET: "no trocar point is known: teach it on rcm/set_cp",
    Reason.RCM_ERROR: "the shaft is off its trocar point: move the trocar or the arm, or teach the "
    "point again on rcm/set_cp",
    Reason.OVERRUN: "the control loop missed its deadlines: free the processor, then press Enable",
    Reason.JOINT_LIMIT: "a joint is at its limit: move the tip back",
    Reason.OPERATOR: "a person asked for it",
    Reason.NOT_FOLLOWING: "the robot does not follow its commands: look for a protective stop or a "
    "clamp, then press Enable",
    Reason.TRACK_STALE: "the trocar's tracker is silent: start it again, then press Enable",
    Reason.TOOL_LOST: "the tool sends no jaw angle: check the tool link",
    Reason.UNREACHABLE: "the arm cannot go further without leaving a limit or the trocar: move the "
    "tip back",
    Reason.FORCE: "too much force at the tip or on the trocar: press Enable and move away from the "
    "contact",
    Reason.MASTER_LOST: "the ROS master is gone: start it and every node again",
}
"""Why an arm is paused or in FAULT, for the operator; the controller's own words for the rest."""


def as_sentence(text: str) -> str:
    """With a capital letter and a full stop."""
    text = text.strip()
    return text and text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def taken(name: str) -> str:
    """Why control is not given to a second page."""
    return f"{name} has control; it must release it, or be closed or hidden"


def stopped(who: str) -> str:
    """Who pressed Stop; empty: the operator."""
    by = f" on {who}" if who else ""
    return f"Stop was pressed{by}: the arm is paused; press Enable to go on"


def scoping(arm: str, clutched: bool) -> str:
    """What the hand does while it holds the endoscope; no arm: it stands by itself."""
    if not arm:
        return "No arm of this cell holds the endoscope, so Camera only clutches: the tip stays."
    if clutched:
        return "The clutch is held: your hand moves, the endoscope stays."
    return f"Your hand moves the endoscope ({arm}); the instrument stays where it is."


def let_go(robot: Robot) -> str:
    """Why driving ended although the operator went on."""
    follower = robot.follower
    if not follower.state:
        return NO_FOLLOWER
    if follower.reason:
        return follower.reason
    lost = next((arm for arm in robot.arms if not arm.ready()), None)
    if lost is not None:
        return f"{lost.name}: {state_sentence(lost)}"
    return f"the teleoperation is {follower.state}: press Enable to go on"


def not_ready(robot: Robot, since: float, seconds: float) -> str:
    """Why driving did not begin.

    Args:
        robot: As it is now.
        since: When Enable was pressed [s].
        seconds: How long it was waited for.
    """
    if not robot.follower.state:
        return NO_FOLLOWER
    arm = next((arm for arm in robot.arms if not arm.ready()), None)
    if arm is None:
        return f"the tip does not follow after {seconds:g} s: {robot.follower.reason}"
    if not arm.state:
        return f"{arm.name} does not speak: see that its controller runs (./surg status)"
    warned = arm.warning if arm.warned >= since else ""
    fault = reason_sentence(arm) if arm.state == "FAULT" else ""
    said = fault or without_name(warned, arm.name) or robot.follower.reason
    because = f": {said}" if said else ""
    return f"{arm.name} did not become ready within {seconds:g} s and is {arm.state}{because}"


def state_sentence(arm: Arm) -> str:
    """An arm's state as a sentence for somebody who does not know CRTK."""
    if arm.state == "FAULT":
        return f"it stopped for a fault: {reason_sentence(arm) or 'it gave no reason'}"
    if arm.state == "PAUSED":
        why = reason_sentence(arm)
        return f"it holds, paused: {why}" if why else "it holds, paused"
    if arm.state == "DISABLED":
        return "it holds and obeys nothing; Enable wakes it"
    if arm.state == "ENABLED":
        return "it holds, ready to move" if arm.homed else "it holds; it is not homed yet"
    return "it has not spoken yet; see that its controller runs (./surg status)"


def reason_sentence(arm: Arm) -> str:
    """Why an arm is PAUSED or in FAULT; empty: unknown."""
    if arm.reason in (None, Reason.NONE):
        return ""
    return REASONS.get(arm.reason) or str(surg_core.sentence(arm.reason))


def without_name(text: str, name: str) -> str:
    """A message of a controller without the arm's name in front."""
    return text.removeprefix(f"{name}: ").strip()


def task_sentence(robot: Robot) -> str:
    """How the phantom's task stands; empty: there is none."""
    task = robot.task
    if task.state == "SUCCESS":
        return f"{task.name}: done, success"
    if task.state == "FAILURE":
        return f"{task.name}: over, {task.detail or 'no success'}"
    return f"{task.name}: {task.phase}" if task.state == "RUNNING" else ""


def policy_sentence(robot: Robot) -> str:
    """What the policy does with the arm; empty: nothing is to be said."""
    policy = robot.policy
    name = policy.name or "the policy"
    if policy.state == "RUNNING":
        return f"{name} moves the arm: Enable takes it back, Stop pauses it"
    if policy.state == "WAKING":
        return f"the arm is being enabled for {name}"
    if policy.refused:
        return f"the policy does not get the arm: {policy.refused}"
    if policy.state in ("PAUSED", "IDLE"):
        return f"the policy stands: {policy.detail}"
    return ""
