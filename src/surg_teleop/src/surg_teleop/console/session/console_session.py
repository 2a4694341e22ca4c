"""Who drives, and whether anything may move: the one place of the console where that is decided.

One page has control, others watch. Control alone moves nothing: the operator presses Enable, the
teleoperation node makes the arm ready, and from then on each input that comes in time goes out. The
first doubt ends it: silence, a late message, a hidden tab, a picture that stands still, a
teleoperation that waits. Nothing resumes by itself: Enable must be pressed again. Stop is obeyed
from every page.

Time is an argument, on one steady clock.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from surg_teleop.console.session import operator_messages
from surg_teleop.console.session.console_orders import (
    Camera,
    Clutch,
    Follow,
    Move,
    Order,
    OtherMapping,
    Policy,
    Present,
    PutBack,
    Record,
    SetScale,
    StateCommand,
)
from surg_teleop.console.session.system_state import Robot
from surg_teleop.console.web.page_protocol import Input
from surg_teleop.follow.message_lateness import Lateness

SILENCE = 0.1
"""[s] without an input after which the arm holds; a page sends one every 20 ms."""
LATENESS = 0.1
"""[s] that a message may be longer under way than the quickest one; later ones are void."""
BLIND = 1.0
"""[s] for which the operator's picture may stand still."""
GONE = 2.0
"""[s] of silence after which another page may take control away."""
START_TIMEOUT = 6.0
"""[s] from Enable until the tip follows."""
SETTLED = 0.3
"""[s] after an act of the operator: the teleoperation may still speak of what was before."""
ENGAGED = ("FOLLOWING", "CLUTCHED")
LATCHED = ("FAULT", "DISABLED", "")
MAY_MAP = ("WAITING", "CLUTCHED")
"""States of the teleoperation node: the hand is on the arm; only Enable leads out (empty: the node
is silent); the mapping may be changed."""


class Phase(enum.Enum):
    """What the console is doing."""

    FREE = "free"
    READY = "ready"
    STARTING = "starting"
    DRIVING = "driving"
    HELD = "held"


@dataclass
class _Page:
    """What is remembered of one page."""

    name: str
    lateness: Lateness = field(default_factory=Lateness)
    visible: bool = True
    heard: float = -math.inf
    seq: int = -1
    picture_us: int = 0
    picture_changed: float = -math.inf
    late: int = 0


class Session:
    """The console's state. Every call may leave orders behind; `take_orders` hands them out.

    Args:
        pictures: Whether there is a camera: without its picture nothing may be enabled.
        leads: Whether the page is the leader. Otherwise another device moves the arm, and the page
            enables, clutches and stops it.
    """

    def __init__(self, pictures: bool, leads: bool = True) -> None:
        self.phase = Phase.FREE
        self.reason = ""
        """Why nothing moves, in words; empty while all is well."""
        self._pictures, self._leads = pictures, leads
        self._pages: dict[str, _Page] = {}
        self._holder: _Page | None = None
        self._orders: list[Order] = []
        self._enabled = self._acted = self._tapped = -math.inf
        self._promised = -math.inf
        self._clutch = self._camera = False
        self._hand = "position"

    # --- who is there -------------------------------------------------------------------------

    @property
    def holder(self) -> str:
        """Name of the page that has control; empty: none has."""
        return "" if self._holder is None else self._holder.name

    @property
    def pages(self) -> int:
        """Number of pages that are open."""
        return len(self._pages)

    @property
    def clutched(self) -> bool:
        """Whether the operator holds the clutch."""
        return self._clutch and self.phase is Phase.DRIVING

    @property
    def scoping(self) -> bool:
        """Whether the operator holds the endoscope instead of the instrument."""
        return self._camera and self.phase is Phase.DRIVING

    def take_orders(self) -> list[Order]:
        """What is to be sent now, in this order; handed out once."""
        orders, self._orders = self._orders, []
        return orders

    def join(self, name: str, now: float) -> None:
        """A page has connected. It gets control when nobody has it, which moves nothing."""
        self._pages[name] = _Page(name)
        if self._holder is None:
            self.take(name, now)

    def leave(self, name: str, now: float) -> None:
        """A page's connection has ended."""
        page = self._pages.pop(name, None)
        if page is not None and page is self._holder:
            self._give_up(operator_messages.CLOSED)

    def take(self, name: str, now: float) -> str:
        """A page wants control.

        Returns:
            Why it does not get it; empty: it has it.
        """
        page = self._pages[name]
        other = self._holder
        if other is page:
            return ""
        if other is not None:
            if other.visible and now - other.heard < GONE:
                return operator_messages.taken(other.name)
            self._give_up(operator_messages.TAKEN_AWAY)
        self._holder, self.phase, self.reason = page, Phase.READY, ""
        page.visible, page.heard = True, now
        return ""

    def release(self, name: str) -> None:
        """A page gives control back."""
        if self.holder == name:
            self._give_up("")

    # --- what the operator does ---------------------------------------------------------------

    def in_time(self, name: str, at: float, now: float) -> bool:
        """Whether a message was not held up on its way; every message that matters asks this.

        Args:
            name: The page.
            at: When the page sent it, on the page's clock [s].
            now: When it came [s].
        """
        page = self._pages[name]
        late = page.lateness.add(at, now) > LATENESS
        page.late += late
        return not late

    def enable(self, name: str, robot: Robot, now: float) -> str:
        """Enable is pressed.

        Returns:
            Why it is refused; empty: the arm is being made ready.
        """
        page = self._pages[name]
        if page is not self._holder:
            return operator_messages.NO_CONTROL
        if self.phase in (Phase.STARTING, Phase.DRIVING):
            return ""
        why = self._doubt(page, now) or ("" if robot.arms else operator_messages.NO_ARM)
        if why:
            self._hold(why)
            return why
        self.phase, self.reason, self._promised = Phase.STARTING, "", -math.inf
        self._enabled = self._acted = now
        self._clutch = self._camera = False
        self._orders += [Clutch(False), Camera(False), Present(True), Follow(True)]
        return ""

    def policy(self, name: str, robot: Robot, now: float) -> str:
        """Policy is pressed: the arm goes to the policy, or comes back from it.

        The hand lets go first; the policy is told when the teleoperation has given the arm up.

        Returns:
            Why it is refused; empty: it is under way.
        """
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if robot.policy.active:
            self._orders.append(Policy(False))
            self.reason = operator_messages.POLICY_ENDED
            return ""
        if robot.policy.state not in ("READY", "PAUSED"):
            return operator_messages.NO_POLICY
        self._hold(operator_messages.POLICY_ASKED)
        self.phase, self._promised = Phase.READY, now
        return ""

    def put_back(self, name: str, robot: Robot) -> str:
        """Simulated arms in FAULT shall be led home; it takes Enable to move them again.

        Returns:
            Why it is refused; empty: they are on their way.
        """
        if self.holder != name:
            return operator_messages.NO_CONTROL
        if not robot.astray:
            return operator_messages.NOTHING_ASTRAY
        self._hold(operator_messages.PUT_BACK)
        self._orders += [PutBack(arm) for arm in robot.astray]
        return ""

    def stop(self, robot: Robot, who: str = "") -> None:
        """Stop is pressed, on any page: the arms pause.

        Args:
            robot: Which arms there are.
            who: Name of the page.
        """
        self._hold(operator_messages.stopped(who if who != self.holder else ""))
        self._orders += [
            StateCommand(arm.name, "pause") for arm in robot.arms if arm.state == "ENABLED"
        ]
        if not robot.policy.passive:
            self._orders.append(Policy(False))

    def hide(self, name: str, why: str) -> None:
        """The page says that it can no longer be trusted with the arm.

        Args:
            name: The page.
            why: A word of `protocol.HIDDEN`.
        """
        page = self._pages[name]
        page.visible = why in ("gamepad", "pointer")
        active = self.phase in (Phase.STARTING, Phase.DRIVING) or self._promised > -math.inf
        if page is self._holder and active:
            self._hold(operator_messages.HIDDEN[why])

    def scale(self, name: str, value: float) -> str:
        """Another scale is wanted; returns why not."""
        if self.holder != name:
            return operator_messages.NO_CONTROL
        self._orders.append(SetScale(value))
        return ""

    def record(self, name: str, on: bool) -> str:
        """Recording shall start or stop; returns why not."""
        if self.holder != name:
            return operator_messages.NO_CONTROL
        self._orders.append(Record(on))
        return ""

    def receive(self, name: str, sample: Input, now: float) -> None:
        """An input has come; only that of the page in control, in order and in time, counts."""
        page = self._pages[name]
        if not self.in_time(name, sample.at, now) or sample.seq <= page.seq:
            return
        if page.picture_us != sample.picture_us:
            page.picture_us, page.picture_changed = sample.picture_us, now
        silent = now - page.heard > SILENCE
        page.seq, page.heard, page.visible = sample.seq, now, True
        if page is not self._holder or self.phase not in (Phase.STARTING, Phase.DRIVING):
            return
        if silent:  # it was frozen, and wakes up before anybody has looked
            self._hold(operator_messages.SILENT)
            return
        if sample.clutch != self._clutch:
            self._clutch, self._acted = sample.clutch, now
            self._orders.append(Clutch(sample.clutch))
        if sample.camera != self._camera:
            self._camera, self._acted = sample.camera, now
            self._orders.append(Camera(sample.camera))
        if self._leads:
            self._hand = sample.hand
            self._orders.append(Move(sample))

    # --- what happens by itself ---------------------------------------------------------------

    def tick(self, robot: Robot, now: float) -> None:
        """Look at everything; called at least every 20 ms.

        Args:
            robot: As it is now.
            now: Steady clock [s].
        """
        self._hand_over(robot, now)
        if self._holder is None or self.phase not in (Phase.STARTING, Phase.DRIVING):
            return
        why = self._doubt(self._holder, now)
        if why:
            self._hold(why)
            return
        follower = robot.follower
        if self._leads and follower.state in MAY_MAP and follower.mapping != self._hand:
            if now - self._tapped >= SETTLED:
                self._tapped = self._acted = now
                self._orders.append(OtherMapping())
        elif now - self._acted < SETTLED:
            return
        elif follower.state in ENGAGED:
            self.phase = Phase.DRIVING
        elif self.phase is Phase.DRIVING or follower.state in LATCHED:
            if not self._clutch or follower.state in LATCHED:
                self._hold(operator_messages.let_go(robot))
        elif now - self._enabled > START_TIMEOUT:
            self._hold(operator_messages.not_ready(robot, self._enabled, START_TIMEOUT))

    def _hand_over(self, robot: Robot, now: float) -> None:
        """The policy gets the arm once the teleoperation states that no hand wants it."""
        since = now - self._promised
        if since > START_TIMEOUT:
            self._promised = -math.inf
        elif since >= SETTLED and robot.follower.state == "DISABLED":
            self._promised = -math.inf
            self._orders.append(Policy(True))

    def _doubt(self, page: _Page, now: float) -> str:
        """Why the page must not drive now."""
        if not page.visible:
            return operator_messages.HIDDEN["hidden"]
        if not now - page.heard <= SILENCE:
            return operator_messages.SILENT
        if self._pictures and not page.picture_us:
            return operator_messages.NO_PICTURE
        if self._pictures and not now - page.picture_changed <= BLIND:
            return operator_messages.FROZEN_PICTURE
        return ""

    def _hold(self, why: str) -> None:
        """Nothing moves any more, until Enable is pressed again."""
        self._orders += [Present(False), Follow(False)]
        self.reason, self._promised = why, -math.inf
        if self._holder is not None:
            self.phase = Phase.HELD

    def _give_up(self, why: str) -> None:
        """Nobody has control any more."""
        if self.phase in (Phase.STARTING, Phase.DRIVING):
            self._hold(why)
        self._holder, self.phase, self.reason = None, Phase.FREE, why
        self._promised = -math.inf  # a policy gets no arm from somebody who is not there
