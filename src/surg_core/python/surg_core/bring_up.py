"""Home, enable or resume an arm; ask again while it does not obey.

=============  =========  =============================
state          homed      command
=============  =========  =============================
DISABLED       no         home
ENABLED        no         home
DISABLED       yes        enable
PAUSED         no, yes    home, resume (if allowed)
FAULT          no, yes    home, enable (if allowed)
ENABLED        yes        claim (if wanted), then done
=============  =========  =============================

Nothing happens before ``start``. An arm that another node holds is not claimed. An arm
that changes to any state but ENABLED was stopped by somebody else: bring-up then fails, and only a
new ``start`` asks again.

Pure: no ROS, no clock; time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_core.contract import SECOND_NS

RETRY_NS = SECOND_NS // 2
"""[ns] A command without effect is sent again after this."""
TIMEOUT_NS = 15 * SECOND_NS
"""[ns] Bring-up fails after this. A robot that has to be started anew meanwhile takes 3 to 5 s."""


@dataclass
class BringUp:
    """Brings one arm up.

    Attributes:
        resume: A PAUSED arm may be resumed.
        clear_fault: An arm in FAULT may be enabled.
        claim_as: Caller id to claim the arm for; empty: no claim.
        settle_ns: Views received this soon after ``start`` may predate it: they neither complete
            the bring-up nor make it fail [ns].
        timeout_ns: Longest duration [ns].
        active: Bring-up is under way.
        reason: Why the last bring-up failed; empty otherwise.
        last: The last command; empty: none since ``start``.
    """

    resume: bool = False
    clear_fault: bool = False
    claim_as: str = ""
    settle_ns: int = 0
    timeout_ns: int = TIMEOUT_NS
    active: bool = field(default=False, init=False)
    reason: str = field(default="", init=False)
    last: str = field(default="", init=False)
    _started: int = field(default=0, init=False, repr=False)
    _sent: int = field(default=0, init=False, repr=False)
    _state: ArmState | None = field(default=None, init=False, repr=False)

    def start(self, now_ns: int) -> None:
        """Begin; what went before is forgotten."""
        self.active, self.reason, self.last = True, "", ""
        self._started, self._state = now_ns, None

    def stop(self) -> None:
        """Ask for nothing more."""
        self.active = False

    def tick(self, view: ArmView, now_ns: int) -> ArmCommands:
        """One cycle.

        Args:
            view: The arm's newest cycle.
            now_ns: Time on the clock of ``start`` [ns].

        Returns:
            The commands to send now, which may be empty. Afterwards ``active`` is False where the
            bring-up is complete or has failed; ``reason`` tells which.
        """
        if not self.active:
            return ArmCommands()
        settled = now_ns - self._started >= self.settle_ns
        command, problem = self._next(view), self._problem(view)
        if now_ns - self._started > self.timeout_ns and command and not problem:
            cause = view.reason or "no reason given"
            problem = f"'{command}' had no effect in {self.timeout_ns / SECOND_NS:g} s: {cause}"
        if settled:
            self.active, self.reason = bool(command) and not problem, problem
            self._state = view.state
        if problem or not command:
            return ArmCommands()
        if command == self.last and now_ns - self._sent < RETRY_NS:
            return ArmCommands()
        self.last, self._sent = command, now_ns
        if command == "claim":
            return ArmCommands(claim=True)
        # The claim goes with the command that enables: no cycle lies between them.
        claim = bool(self.claim_as) and command != "home"
        return ArmCommands(state=command, claim=claim)

    def _next(self, view: ArmView) -> str:
        """The command that the arm needs next; empty: none."""
        if not view.homed:
            return "home"
        if view.state == ArmState.PAUSED:
            return "resume"
        if view.state != ArmState.ENABLED:
            return "enable"
        return "claim" if self.claim_as and view.holder != self.claim_as else ""

    def _problem(self, view: ArmView) -> str:
        """Why the arm must not be asked for anything."""
        cause = f" ({view.reason})" if view.reason else ""
        if view.state == ArmState.PAUSED and not self.resume:
            return f"the arm is PAUSED{cause}: send 'resume' first"
        if view.state == ArmState.FAULT and not self.clear_fault:
            return f"the arm is in FAULT{cause}: remove the cause, then send 'enable'"
        if self.claim_as and view.holder not in ("", self.claim_as):
            return f"the arm is held by {view.holder}: end that first"
        if self._state not in (None, view.state) and view.state != ArmState.ENABLED:
            return f"the arm was stopped: {view.state.name}{cause}"
        return ""
