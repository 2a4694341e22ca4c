"""Home, enable, resume, claim: what is asked, how often, and when nothing is asked any more."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from surg_core.arm_view import ArmCommands, ArmState, ArmView
from surg_core.bring_up import RETRY_NS, TIMEOUT_NS, BringUp
from surg_core.contract import SECOND_NS, TICK_NS

ME, OTHER = "/me", "/other"


def view(
    state: ArmState = ArmState.DISABLED, homed: bool = False, holder: str = "", reason: str = ""
) -> ArmView:
    return ArmView(
        stamp_ns=0,
        state=state,
        homed=homed,
        busy=False,
        reason=reason,
        refused=0,
        p_BTip=np.zeros(3),
        p_BSet=np.zeros(3),
        holder=holder,
    )


@dataclass
class Arm:
    """An arm that obeys by the table of its controller, `delay` cycles late, or not at all."""

    state: ArmState
    homed: bool
    holder: str = ""
    deaf: bool = False

    def view(self) -> ArmView:
        return view(self.state, self.homed, self.holder)

    def obey(self, commands: ArmCommands) -> None:
        if self.deaf:
            return
        if commands.state == "home":
            self.homed = True
        enables = {
            "enable": (ArmState.DISABLED, ArmState.FAULT),
            "resume": (ArmState.PAUSED,),
        }
        if self.state in enables.get(commands.state or "", ()):
            self.state = ArmState.ENABLED
        if commands.claim and self.state == ArmState.ENABLED:
            self.holder = ME


def run(bring_up: BringUp, arm: Arm, cycles: int) -> list[ArmCommands]:
    sent = []
    for cycle in range(cycles):
        commands = bring_up.tick(arm.view(), cycle * TICK_NS)
        arm.obey(commands)
        if commands:
            sent.append(commands)
    return sent


@pytest.mark.parametrize(
    ("state", "homed", "words"),
    [
        (ArmState.DISABLED, False, ["home", "enable"]),
        (ArmState.DISABLED, True, ["enable"]),
        (ArmState.ENABLED, False, ["home"]),
        (ArmState.ENABLED, True, []),
        (ArmState.PAUSED, True, ["resume"]),
        (ArmState.PAUSED, False, ["home", "resume"]),
        (ArmState.FAULT, True, ["enable"]),
    ],
)
def test_the_shortest_sequence_is_asked_once_each(
    state: ArmState, homed: bool, words: list[str]
) -> None:
    bring_up, arm = BringUp(resume=True, clear_fault=True), Arm(state, homed)
    bring_up.start(0)
    sent = run(bring_up, arm, 10)
    assert [commands.state for commands in sent] == words
    assert arm.view().ready and not bring_up.active and bring_up.reason == ""


def test_the_claim_goes_with_the_command_that_enables_and_stands_alone_where_none_is_needed() -> (
    None
):
    for state, words in ((ArmState.DISABLED, ["enable"]), (ArmState.ENABLED, [None])):
        bring_up, arm = BringUp(claim_as=ME), Arm(state, homed=True)
        bring_up.start(0)
        sent = run(bring_up, arm, 10)
        assert [(c.state, c.claim) for c in sent] == [(word, True) for word in words]
        assert arm.holder == ME and not bring_up.active and bring_up.reason == ""


def test_a_command_without_effect_is_sent_again_every_half_second_until_the_timeout() -> None:
    bring_up, arm = BringUp(), Arm(ArmState.DISABLED, homed=False, deaf=True)
    bring_up.start(0)
    times = [
        now
        for now in range(0, 2 * TIMEOUT_NS, TICK_NS)
        if bring_up.tick(arm.view(), now).state == "home"
    ]
    assert times == list(range(0, TIMEOUT_NS + 1, RETRY_NS))
    assert not bring_up.active and "home" in bring_up.reason


def test_a_paused_or_faulty_arm_is_left_alone_where_that_is_not_allowed() -> None:
    for state in (ArmState.PAUSED, ArmState.FAULT):
        bring_up = BringUp()
        bring_up.start(0)
        assert not run(bring_up, Arm(state, homed=True), 1000)
        assert not bring_up.active and state.name in bring_up.reason


@pytest.mark.parametrize("stopped", [ArmState.PAUSED, ArmState.DISABLED, ArmState.FAULT])
@pytest.mark.parametrize("first", [ArmState.DISABLED, ArmState.PAUSED, ArmState.ENABLED])
def test_nothing_is_asked_after_an_operators_stop(first: ArmState, stopped: ArmState) -> None:
    """The stop comes while the bring-up still waits for its claim."""
    if first == stopped:
        return
    bring_up = BringUp(resume=True, clear_fault=True, claim_as=ME)
    bring_up.start(0)
    bring_up.tick(view(first, homed=True), 0)
    for cycle in range(1, 2000):
        assert not bring_up.tick(view(stopped, homed=True, reason="operator"), cycle * TICK_NS)
    assert not bring_up.active and "operator" in bring_up.reason


def test_an_arm_that_another_node_holds_is_left_alone() -> None:
    bring_up = BringUp(claim_as=ME)
    bring_up.start(0)
    assert not run(bring_up, Arm(ArmState.ENABLED, homed=True, holder=OTHER), 1000)
    assert OTHER in bring_up.reason


def test_nothing_is_asked_before_start_nor_after_stop() -> None:
    bring_up = BringUp(resume=True, clear_fault=True)
    assert not run(bring_up, Arm(ArmState.DISABLED, homed=False), 1000)
    bring_up.start(0)
    bring_up.stop()
    assert not run(bring_up, Arm(ArmState.DISABLED, homed=False), 1000)


def test_views_from_before_the_start_neither_complete_nor_fail_it() -> None:
    settle = SECOND_NS // 10
    for stale in (ArmState.ENABLED, ArmState.FAULT):
        bring_up = BringUp(resume=True, settle_ns=settle)
        bring_up.start(0)
        for now in range(0, settle, TICK_NS):
            assert not bring_up.tick(view(stale, homed=True), now)
        assert bring_up.tick(view(ArmState.PAUSED, homed=True), settle).state == "resume"


def test_random_stories_keep_the_rules() -> None:
    """Random states of an arm that others command too; the rules are checked at every cycle."""
    rng = np.random.default_rng(18)
    asked = 0
    for _ in range(3000):
        resume, clear = bool(rng.integers(2)), bool(rng.integers(2))
        bring_up = BringUp(
            resume=resume, clear_fault=clear, claim_as=ME if rng.random() < 0.5 else ""
        )
        arm = Arm(ArmState(int(rng.integers(4))), bool(rng.integers(2)), deaf=rng.random() < 0.2)
        now, ended, last = 0, True, (-RETRY_NS, "")
        states: list[ArmState] = []
        for _ in range(30):
            now += int(rng.integers(1, SECOND_NS // 2))
            if rng.random() < 0.05:
                bring_up.start(now)
                ended, last, states = False, (-RETRY_NS, ""), []
            if rng.random() < 0.2:  # somebody else commands the arm
                arm.state = ArmState(int(rng.integers(4)))
                arm.holder = str(rng.choice(["", ME, OTHER]))
            seen = arm.view()
            states.append(seen.state)
            commands = bring_up.tick(seen, now)
            word = commands.state or ("claim" if commands.claim else "")
            if ended:
                assert not commands, "nothing resumes by itself"
            if word:
                asked += 1
                assert resume or seen.state != ArmState.PAUSED
                assert clear or seen.state != ArmState.FAULT
                assert not bring_up.claim_as or seen.holder != OTHER
                assert word != last[1] or now - last[0] >= RETRY_NS
                assert word in ("home", "claim") or not seen.ready
                # Since the start: one state as it was found, then ENABLED, and no other.
                changes = [b for a, b in itertools.pairwise(states) if a != b]
                assert changes in ([], [ArmState.ENABLED])
                last = (now, word)
            ended = ended or not bring_up.active
            arm.obey(commands)
    assert asked > 1500
