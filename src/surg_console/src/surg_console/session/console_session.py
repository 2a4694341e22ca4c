"""Decides which page drives, and whether anything may move.

One page has control, the others watch. Control alone moves nothing: the operator presses Enable,
the teleoperation node brings the arm up, and then every input that arrives in time is sent. Any
doubt ends this: silence, a late message, a hidden tab, a frozen picture, a waiting teleoperation.
Nothing resumes by itself; Enable must be pressed again. Stop works from every page.

Time is an argument, on one steady clock.
"""

from __future__ import annotations

import enum
import json
import math
from dataclasses import dataclass, field

from surg_console.session import console_orders as orders
from surg_console.session import operator_messages
from surg_console.session.dead_man import DeadMan
from surg_console.session.system_state import Robot
from surg_console.web.page_protocol import Input
from surg_core.hand.message_lateness import Lateness

SILENCE = 0.1
"""[s] Timeout of the inputs; a page sends one every 20 ms."""
LATENESS = 0.1
"""[s] Largest delay of a message above that of the fastest; later ones are ignored."""
FROZEN = 1.0
"""[s] Longest time without a new picture."""
GONE = 2.0
"""[s] Silence after which another page may take control."""
START_TIMEOUT = 6.0
"""[s] Longest time from Enable until the tip follows."""
SETTLED = 0.3
"""[s] After an operator's act the teleoperation may still report its earlier state."""
ENGAGED = ("FOLLOWING", "CLUTCHED")
LATCHED = ("FAULT", "DISABLED", "")
"""States of the teleoperation node: the hand drives the arm; only Enable leads out (empty: no
status)."""


class Phase(enum.Enum):
    """Phase of the session."""

    FREE = "free"
    READY = "ready"
    STARTING = "starting"
    DRIVING = "driving"
    HELD = "held"


@dataclass
class _Page:
    """State of one page."""

    name: str
    lateness: Lateness = field(default_factory=Lateness)
    visible: bool = True
    heard: float = -math.inf
    seq: int = -1
    picture_us: int = 0
    picture_changed: float = -math.inf
    late: int = 0
    dead_man: DeadMan | None = None  # of a headset's page, from its first input on


class ConsoleSession:
    """State of the console. Every call may queue orders; `take_orders` returns them.

    Args:
        pictures: There is a camera, whose picture is required to enable.
        leads: The page is the leader. Otherwise another device moves the arm, and the page enables,
            clutches and stops it.
    """

    def __init__(self, pictures: bool, leads: bool = True) -> None:
        self.phase = Phase.FREE
        self.reason = ""
        """Why nothing moves, for the operator; empty: no problem."""
        self._pictures, self._leads = pictures, leads
        self._pages: dict[str, _Page] = {}
        self._holder: _Page | None = None
        self._orders: list[orders.Order] = []
        self._enabled = self._asked = self._acted = -math.inf
        self._policy_ran = False
        self._policy_requested = self._new_requested = -math.inf
        self._clutch = self._camera = False
        self._hand = "position"

    # --- pages -------------------------------------------------------------------------

    @property
    def holder(self) -> str:
        """Name of the page in control; empty: none."""
        return "" if self._holder is None else self._holder.name

    @property
    def pages(self) -> int:
        """Number of open pages."""
        return len(self._pages)

    @property
    def clutched(self) -> bool:
        """Whether the operator holds the clutch."""
        return self._clutch and self.phase is Phase.DRIVING

    @property
    def scoping(self) -> bool:
        """Whether the operator drives the endoscope."""
        return self._camera and self.phase is Phase.DRIVING

    def take_orders(self) -> list[orders.Order]:
        """Orders to send now, in sequence; the queue is empty afterwards."""
        queue, self._orders = self._orders, []
        return queue

    def join(self, name: str, now: float) -> None:
        """A page has connected; it gets control if no page has it."""
        self._pages[name] = _Page(name)
        if self._holder is None:
            self.take(name, now)

    def leave(self, name: str, now: float) -> None:
        """A page has disconnected."""
        page = self._pages.pop(name, None)
        if page is not None and page is self._holder:
            self._release(operator_messages.CLOSED)

    def take(self, name: str, now: float) -> str:
        """A page requests control; returns why it is refused, empty: it has control."""
        page = self._pages[name]
        other = self._holder
        if other is page:
            return ""
        if other is not None:
            if other.visible and now - other.heard < GONE:
                return operator_messages.taken(other.name)
            self._release(operator_messages.TAKEN_AWAY)
        self._holder, self.phase, self.reason = page, Phase.READY, ""
        page.visible, page.heard = True, now
        return ""

    def release(self, name: str) -> None:
        """A page releases control."""
        if self.holder == name:
            self._release("")

    # --- the operator ---------------------------------------------------------------

    def in_time(self, name: str, at: float, now: float) -> bool:
        """Whether a message, sent at a time on the page's clock [s], came without delay."""
        page = self._pages[name]
        late = page.lateness.add(at, now) > LATENESS
        page.late += late
        return not late

    def enable(self, name: str, robot: Robot, now: float) -> str:
        """Enable was pressed; returns why it is refused, empty: the arm is being brought up."""
        page = self._pages[name]
        if page is not self._holder:
            return operator_messages.NO_CONTROL
        if self.phase in (Phase.STARTING, Phase.DRIVING):
            return ""
        why = self._problem(page, now) or ("" if robot.arms else operator_messages.NO_ARM)
        if why:
            self._hold(why)
            return why
        self.phase, self.reason, self._policy_requested = Phase.STARTING, "", -math.inf
        self._enabled = self._asked = self._acted = now
        self._camera = False
        self._clutch = page.dead_man is not None  # nothing follows before a squeeze
        self._orders += [
            orders.Clutch(self._clutch),
            orders.Camera(False),
            orders.SetOperatorPresent(True),
            orders.EnableTeleop(True),
        ]
        if self._leads:
            self._orders.append(orders.SetMapping(self._hand == "rate"))
        return ""

    def policy(self, name: str, robot: Robot, now: float) -> str:
        """Policy was pressed: start or stop the policy; returns why it is refused.

        The policy is enabled once the teleoperation has released the arm.
        """
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if robot.policy.active:
            self._orders.append(orders.Policy(False))
            self.reason = operator_messages.POLICY_ENDED
            return ""
        if robot.policy.state not in ("READY", "PAUSED"):
            return operator_messages.NO_POLICY
        self._hold(operator_messages.POLICY_ASKED)
        self.phase, self._policy_requested = Phase.READY, now
        return ""

    def guide_home(self, name: str, robot: Robot) -> str:
        """Guide simulated arms in FAULT home, to be enabled again; returns why it is refused."""
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if not robot.faulted_arms:
            return operator_messages.NO_FAULTED_ARM
        self._hold(operator_messages.GUIDED_HOME)
        self._orders += [orders.GuideHome(arm) for arm in robot.faulted_arms]
        return ""

    def new_episode(self, name: str, robot: Robot, now: float) -> str:
        """Begin another episode of the simulator's task; returns why it is refused.

        The simulator puts its arms home at once, so this waits until no controller holds one.
        """
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if robot.task.state in ("", "NONE"):
            return operator_messages.NO_TASK
        if robot.recorder.recording:
            return operator_messages.NEW_WHILE_RECORDED
        self._hold(operator_messages.NEW_ASKED)
        if not robot.policy.passive and robot.policy.state:
            self._orders.append(orders.Policy(False))
        self._orders += [orders.StateCommand(arm.name, "disable") for arm in robot.arms]
        self._new_requested = now
        return ""

    def stop(self, robot: Robot, who: str = "") -> None:
        """Stop was pressed on a page, whoever has control: pause all arms."""
        self._hold(operator_messages.stopped(who if who != self.holder else ""))
        self._orders += [
            orders.StateCommand(arm.name, "pause") for arm in robot.arms if arm.state == "ENABLED"
        ]
        if not robot.policy.passive:
            self._orders.append(orders.Policy(False))

    def hide(self, name: str, why: str) -> None:
        """The page is hidden or has lost its input device; `why`: of `page_protocol.HIDDEN`."""
        page = self._pages[name]
        page.visible = why in ("gamepad", "pointer", "recentred")
        active = self.phase in (Phase.STARTING, Phase.DRIVING) or self._policy_requested > -math.inf
        if page is self._holder and active:
            self._hold(operator_messages.HIDDEN[why])

    def scale(self, name: str, value: float) -> str:
        """Set the scale; returns why it is refused."""
        return self._order_by(name, orders.SetScale(value))

    def record(self, name: str, robot: Robot, on: bool) -> str:
        """Start or stop recording; returns why it is refused."""
        if on and self.holder == name and robot.task.name:
            self._orders.append(orders.Describe(json.dumps({"seed": robot.task.seed})))
        return self._order_by(name, orders.Record(on))

    def judge(self, name: str, robot: Robot) -> str:
        """Why the last recording cannot be judged; empty: it can."""
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if robot.recorder.recording:
            return operator_messages.STILL_RECORDED
        return "" if robot.recorder.finished else operator_messages.NOTHING_RECORDED

    def _order_by(self, name: str, order: orders.Order) -> str:
        if self.holder != name:
            return operator_messages.NO_CONTROL
        self._orders.append(order)
        return ""

    def receive(self, name: str, sample: Input, now: float) -> None:
        """Take in an input; only those of the page in control, in order and in time, count."""
        page = self._pages[name]
        if not self.in_time(name, sample.at, now) or sample.seq <= page.seq:
            return
        if page.picture_us != sample.picture_us:
            page.picture_us, page.picture_changed = sample.picture_us, now
        silent = now - page.heard > SILENCE
        page.seq, page.heard, page.visible = sample.seq, now, True
        if sample.squeeze is not None and page.dead_man is None:
            page.dead_man = DeadMan()
        if page is not self._holder or self.phase not in (Phase.STARTING, Phase.DRIVING):
            return
        if silent:  # the page was frozen since the last tick
            self._hold(operator_messages.SILENT)
            return
        if page.dead_man is not None:
            sample = page.dead_man.pass_on(sample, now)
        if sample.clutch != self._clutch:
            self._clutch, self._acted = sample.clutch, now
            self._orders.append(orders.Clutch(sample.clutch))
        if sample.camera != self._camera:
            self._camera, self._acted = sample.camera, now
            self._orders.append(orders.Camera(sample.camera))
        if self._leads:
            if sample.hand != self._hand:  # the teleoperation changes it under the clutch
                self._hand, self._acted = sample.hand, now
                self._orders.append(orders.SetMapping(sample.hand == "rate"))
            self._orders.append(orders.Move(sample))

    # --- periodic checks ---------------------------------------------------------------

    def tick(self, robot: Robot, now: float) -> None:
        """Check everything; called at least every 20 ms."""
        self._start_policy(robot, now)
        self._start_episode(robot, now)
        if self._holder is None or self.phase not in (Phase.STARTING, Phase.DRIVING):
            return
        why = self._problem(self._holder, now)
        if why:
            self._hold(why)
            return
        follower = robot.follower
        if now - self._acted < SETTLED:
            return
        if follower.state in ENGAGED:
            self.phase = Phase.DRIVING
        elif self.phase is Phase.DRIVING or follower.state in LATCHED:
            if not self._clutch or follower.state in LATCHED:
                self._hold(operator_messages.let_go(robot))
        elif now - self._enabled > START_TIMEOUT:
            self._hold(operator_messages.not_ready(robot, self._enabled, START_TIMEOUT))
        elif self._leads and now - self._asked >= SETTLED and robot.ready:
            # The teleoperation drops a request that reaches it before the first input does.
            self._asked = now
            self._orders.append(orders.EnableTeleop(True))

    def _watch_policy(self, robot: Robot) -> None:
        """A policy whose session has ended does not take over the arm any longer."""
        gone = self._policy_ran and robot.policy.state in ("IDLE", "READY")
        if gone and self.reason == operator_messages.POLICY_ASKED:
            self.reason = operator_messages.policy_lost(robot.policy.detail)
        self._policy_ran = robot.policy.active or (self._policy_ran and not gone)

    def _start_policy(self, robot: Robot, now: float) -> None:
        """The policy gets the arm once the teleoperation states that no hand wants it."""
        self._watch_policy(robot)
        since = now - self._policy_requested
        if since == math.inf:
            return
        if since > START_TIMEOUT:
            self._policy_requested = -math.inf
            self.reason = operator_messages.POLICY_NOT_GIVEN
        elif since >= SETTLED and robot.follower.state == "DISABLED":
            self._policy_requested = -math.inf
            self._orders.append(orders.Policy(True))

    def _start_episode(self, robot: Robot, now: float) -> None:
        """The simulator begins another episode once every arm is off."""
        since = now - self._new_requested
        if since == math.inf:
            return
        if since > START_TIMEOUT:
            self.reason, self._new_requested = operator_messages.NOT_NEW, -math.inf
        elif all(arm.state in ("DISABLED", "FAULT") for arm in robot.arms):
            self._orders.append(orders.NewEpisode(True))
            self.phase, self.reason = Phase.READY, operator_messages.NEW_EPISODE
            self._new_requested = -math.inf

    def _problem(self, page: _Page, now: float) -> str:
        """Why the page must not drive now; empty: it may."""
        if not page.visible:
            return operator_messages.HIDDEN["hidden"]
        if not now - page.heard <= SILENCE:
            return operator_messages.SILENT
        if self._pictures and not page.picture_us:
            return operator_messages.NO_PICTURE
        if self._pictures and not now - page.picture_changed <= FROZEN:
            return operator_messages.FROZEN_PICTURE
        return ""

    def _hold(self, why: str) -> None:
        """Stop all motion until Enable is pressed again."""
        self._orders += [orders.SetOperatorPresent(False), orders.EnableTeleop(False)]
        self.reason, self._policy_requested, self._new_requested = why, -math.inf, -math.inf
        if self._holder is not None:
            self.phase = Phase.HELD
            if self._holder.dead_man is not None:
                self._holder.dead_man.reset()

    def _release(self, why: str) -> None:
        """Release control."""
        if self.phase in (Phase.STARTING, Phase.DRIVING):
            self._hold(why)
        self._holder, self.phase, self.reason = None, Phase.FREE, why
        self._policy_requested = self._new_requested = -math.inf  # nobody asks any more
