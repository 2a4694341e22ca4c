"""What the console says to people: one sentence each, with the cure."""

from __future__ import annotations

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
POLICY_ACTIVE = ("WAKING", "RUNNING")
"""States of the model server in which the policy has the arm, or is about to."""
HIDDEN = {
    "hidden": "the tab was hidden: the arm holds; press Enable to go on",
    "closed": CLOSED,
    "gamepad": "the gamepad was unplugged: the arm holds; plug it in and press Enable",
    "pointer": "the mouse or the keyboard was lost: the arm holds; press Enable to go on",
}


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
    fault = arm.because if arm.state == "FAULT" else ""
    said = fault or without_name(warned, arm.name) or robot.follower.reason
    because = f": {said}" if said else ""
    return f"{arm.name} did not become ready within {seconds:g} s and is {arm.state}{because}"


def state_sentence(arm: Arm) -> str:
    """An arm's state as a sentence for somebody who does not know CRTK."""
    if arm.state == "FAULT":
        return f"it stopped for a fault: {arm.because or 'it gave no reason'}"
    if arm.state == "PAUSED":
        return f"it holds, paused: {arm.because}" if arm.because else "it holds, paused"
    if arm.state == "DISABLED":
        return "it holds and obeys nothing; Enable wakes it"
    if arm.state == "ENABLED":
        return "it holds, ready to move" if arm.homed else "it holds; it is not homed yet"
    return "it has not spoken yet; see that its controller runs (./surg status)"


def reason_of(text: str, name: str, state: str) -> str | None:
    """Why an arm is in a state, of what its controller says: ``PSM1: FAULT(link): no joint state``.

    Args:
        text: What it said.
        name: The arm.
        state: The state.

    Returns:
        The reason in words, empty where it gave none; None: it speaks of something else.
    """
    head = f"{name}: {state}"
    if not text.startswith(head):
        return None
    rest = text[len(head) :]
    if rest.startswith("("):
        rest = rest.partition("): ")[2]
    return rest.strip()


def without_name(text: str, name: str) -> str:
    """A message of a controller without the arm's name in front."""
    return text.removeprefix(f"{name}: ").strip()


def task_sentence(robot: Robot) -> str:
    """How the phantom's task stands; empty: there is none."""
    task = robot.sim.get("task")
    if not isinstance(task, dict):
        return ""
    name = str(task.get("name", "task"))
    if task.get("success"):
        return f"{name}: done, success"
    if task.get("done"):
        return f"{name}: over, {task.get('reason') or 'no success'}"
    return f"{name}: {task.get('phase', '')}"


def policy_sentence(robot: Robot) -> str:
    """What the policy does with the arm; empty: nothing is to be said."""
    policy = robot.policy
    state, name = policy.get("state", ""), policy.get("policy") or "the policy"
    if state == "RUNNING":
        return f"{name} moves the arm: Enable takes it back, Stop pauses it"
    if state == "WAKING":
        return f"the arm is being enabled for {name}"
    if policy.get("refused"):
        return f"the policy does not get the arm: {policy['refused']}"
    if state in ("PAUSED", "IDLE"):
        return f"the policy stands: {policy.get('reason', '')}"
    return ""


def record_sentence(robot: Robot) -> str:
    """What the recorder does; the problem first."""
    record = robot.record
    if record.get("problem"):
        return f"recording: {record['problem']}"
    if record.get("finishing"):
        return "the recording is being finished"
    if record.get("recording"):
        return "recording"
    return ""
