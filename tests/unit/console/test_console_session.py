"""The console's session on a fake clock: one operator, deadlines, nothing resumes by itself."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from surg_console.session import operator_messages
from surg_console.session.console_orders import (
    Camera,
    Clutch,
    Describe,
    EnableTeleop,
    GuideHome,
    Move,
    NewEpisode,
    Policy,
    Record,
    SetMapping,
    SetOperatorPresent,
    SetScale,
    StateCommand,
)
from surg_console.session.console_session import (
    FROZEN,
    GONE,
    LATENESS,
    SILENCE,
    START_TIMEOUT,
    ConsoleSession,
    Phase,
)
from surg_console.session.page_status import report
from surg_console.session.system_state import (
    Arm,
    Follower,
    Gauges,
    PolicyServer,
    Recorder,
    Robot,
    SimTask,
)
from surg_console.web.page_protocol import HIDDEN, Input
from surg_core import Reason
from surg_core.hand.message_lateness import Lateness

PERIOD = 0.02
"""[s] between two inputs of a page."""
TICK = 0.01
PAGE_CLOCK = -731.5
"""[s] by which a page's clock differs from ours."""


class Bench:
    """A session, an obedient robot, and pages that speak every 20 ms."""

    def __init__(self, pictures: bool = True) -> None:
        self.session = ConsoleSession(pictures)
        self.now = 1000.0
        self.arm = Arm("PSM1", "ENABLED", True, self.now)
        self.follower = Follower("DISABLED", scale=0.2)
        self.task = SimTask()
        self.orders: list[object] = []
        self.seq: dict[str, int] = {}
        self.picture = 1
        self.obeys = True
        self.heard_moves = True  # False: it hears the first input after `EnableTeleop`

    @property
    def robot(self) -> Robot:
        return Robot((self.arm,), self.follower, task=self.task)

    def flush(self) -> list[object]:
        orders = self.session.take_orders()
        for order in orders:
            if isinstance(order, Move):
                self.heard_moves = True
            elif isinstance(order, EnableTeleop) and self.obeys:
                follows = "FOLLOWING" if self.heard_moves else "WAITING"
                state = follows if order.value else "DISABLED"
                self.follower = replace(self.follower, state=state)
        self.orders += orders
        return orders

    def speak(self, page: str = "a", late: float = 0.0, **keys: object) -> None:
        self.seq[page] = self.seq.get(page, 0) + 1
        sample = Input(
            self.seq[page], self.now + PAGE_CLOCK - late, picture_us=self.picture, **keys
        )
        self.session.receive(page, sample, self.now)

    def tick(self) -> None:
        self.session.tick(self.robot, self.now)
        self.flush()

    def run(self, seconds: float, page: str = "a", film: bool = True, **keys: object) -> None:
        """Time passes while a page speaks (an empty name: none) and pictures come."""
        steps = round(seconds / TICK)
        for step in range(steps):
            self.now += TICK
            if film and step % 5 == 0:
                self.picture += 1
            if page and step % 2 == 0:
                self.speak(page, **keys)
            self.tick()

    def drive(self) -> None:
        """Page a joins, enables, and the tip follows."""
        self.session.join("a", self.now)
        self.run(0.2)
        assert self.session.enable("a", self.robot, self.now) == ""
        self.flush()
        self.run(0.5)
        assert self.session.phase is Phase.DRIVING
        self.orders.clear()

    def given(self, kind: type) -> list[object]:
        return [order for order in self.orders if isinstance(order, kind)]

    def held(self) -> bool:
        """Whether the newest words to the teleoperation are: not present, do not follow."""
        return (
            self.given(SetOperatorPresent)[-1:] == [SetOperatorPresent(False)]
            and self.given(EnableTeleop)[-1:] == [EnableTeleop(False)]
            and self.session.phase in (Phase.HELD, Phase.FREE)
        )


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_control_alone_moves_nothing(bench: Bench) -> None:
    bench.session.join("a", bench.now)
    bench.run(1.0, v=(0.1, 0.0, 0.0), hand="rate", clutch=True)
    assert bench.session.holder == "a"
    assert bench.orders == []


def test_enable_follows_and_inputs_go_out_as_they_came(bench: Bench) -> None:
    bench.drive()
    bench.run(1.0, p=(0.01, 0.02, 0.03), grip=0.4)
    moves = [order.sample for order in bench.given(Move)]
    assert len(moves) == 50
    assert all(m.p == (0.01, 0.02, 0.03) and m.grip == 0.4 for m in moves)
    assert [m.seq for m in moves] == sorted({m.seq for m in moves})


def test_enable_says_present_and_follow_with_pedals_up(bench: Bench) -> None:
    bench.session.join("a", bench.now)
    bench.run(0.2)
    bench.session.enable("a", bench.robot, bench.now)
    assert bench.flush() == [
        Clutch(False),
        Camera(False),
        SetOperatorPresent(True),
        EnableTeleop(True),
        SetMapping(False),
    ]


def test_the_tip_follows_although_enable_arrives_before_the_first_input(bench: Bench) -> None:
    """Each topic has a connection of its own. A request beside a silent hand does not count."""
    bench.session.join("a", bench.now)
    bench.run(0.2)
    bench.heard_moves = False
    bench.session.enable("a", bench.robot, bench.now)
    bench.flush()
    assert bench.follower.state == "WAITING"
    bench.run(1.0)
    assert bench.session.phase is Phase.DRIVING
    assert bench.given(EnableTeleop) == [EnableTeleop(True)] * 2


def test_an_arm_that_stops_while_it_starts_is_not_enabled_again(bench: Bench) -> None:
    bench.session.join("a", bench.now)
    bench.run(0.2)
    bench.heard_moves = False
    bench.session.enable("a", bench.robot, bench.now)
    bench.flush()
    bench.arm = Arm("PSM1", "FAULT", True, bench.now, reason=Reason.RCM_ERROR)
    bench.run(START_TIMEOUT - 0.1)
    assert bench.given(EnableTeleop) == [EnableTeleop(True)]


def test_f03_silence_holds_at_the_first_tick_after_its_limit(bench: Bench) -> None:
    bench.drive()
    last = bench.now
    bench.speak()
    while not bench.held():
        bench.now = round(bench.now + 0.001, 6)
        bench.tick()
        assert bench.now - last < 1.0
    assert bench.now - last == pytest.approx(SILENCE + 0.001, abs=1.1e-3)
    assert bench.session.reason == operator_messages.SILENT


@pytest.mark.parametrize("why", HIDDEN)
def test_a_page_that_gives_up_holds_at_once(bench: Bench, why: str) -> None:
    bench.drive()
    bench.session.hide("a", why)
    bench.flush()
    assert bench.held()
    assert bench.session.reason == operator_messages.HIDDEN[why]


def test_a_closed_page_holds_at_once_and_frees_control(bench: Bench) -> None:
    bench.drive()
    bench.session.leave("a", bench.now)
    bench.flush()
    assert bench.held()
    assert bench.session.holder == ""


# --- an arm that is off its trocar ------------------------------------------------------------


def test_a_simulated_arm_in_fault_is_put_back_and_stays_disabled(bench: Bench) -> None:
    bench.drive()
    torn = replace(bench.robot, arms=(replace(bench.robot.arms[0], state="FAULT"),))
    assert bench.session.guide_home("a", torn) == operator_messages.NO_FAULTED_ARM, (
        "a real arm is not ours"
    )
    simulated = replace(torn, simulated=True)
    assert report(bench.session, simulated, {}, bench.now)["faulted_arms"] == ["PSM1"]
    assert bench.session.guide_home("nobody", simulated) == operator_messages.NO_CONTROL
    bench.session.take_orders()
    assert bench.session.guide_home("a", simulated) == ""
    assert bench.session.take_orders() == [
        SetOperatorPresent(False),
        EnableTeleop(False),
        GuideHome("PSM1"),
    ]
    assert (
        bench.session.phase is Phase.HELD and bench.session.reason == operator_messages.GUIDED_HOME
    )
    assert bench.session.guide_home("a", replace(simulated, arms=bench.robot.arms))


# --- a policy on the same arm -----------------------------------------------------------------


def with_policy(bench: Bench, state: str, **more: object) -> Robot:
    """The robot with a model server that is in a state."""
    return replace(bench.robot, policy=PolicyServer(state, "Circle", **more))


def test_no_missing_status_gives_the_policy_an_arm(bench: Bench) -> None:
    bench.drive()
    for state in ("", "IDLE"):
        refused = bench.session.policy("a", with_policy(bench, state), bench.now)
        assert refused == operator_messages.NO_POLICY
    assert bench.session.policy("a", with_policy(bench, "READY"), bench.now) == ""
    bench.flush()
    bench.follower = Follower()  # the teleoperation's status is missing, old or invalid
    for _ in range(200):
        bench.now += TICK
        bench.session.tick(with_policy(bench, "READY"), bench.now)
        assert Policy(True) not in bench.flush()


@pytest.mark.parametrize("state", ["", "WAKING", "RUNNING"])
def test_stop_ends_a_policy_unless_it_states_that_it_rests(bench: Bench, state: str) -> None:
    bench.session.stop(with_policy(bench, state))
    assert Policy(False) in bench.flush()


def test_f30_the_policy_gets_the_arm_when_the_hand_is_off_it(bench: Bench) -> None:
    bench.drive()
    assert bench.session.policy("a", with_policy(bench, "READY"), bench.now) == ""
    assert EnableTeleop(False) in bench.flush() and Policy(True) not in bench.orders
    assert bench.session.phase is Phase.READY
    bench.follower = replace(bench.follower, state="WAITING")  # the teleoperation takes its time
    for _ in range(50):
        bench.now += TICK
        bench.session.tick(with_policy(bench, "READY"), bench.now)
        assert Policy(True) not in bench.flush()
    bench.follower = replace(bench.follower, state="DISABLED")
    bench.session.tick(with_policy(bench, "READY"), bench.now)
    assert bench.flush() == [Policy(True)]
    said = report(bench.session, with_policy(bench, "RUNNING"), {}, bench.now)
    assert said["headline"] == "Policy" and "Enable takes it back" in said["sentence"]
    assert said["policy"]["on"]


def test_a_policy_that_is_lost_is_said_also_when_another_session_is_ready(bench: Bench) -> None:
    """It was silent on a busy machine, and connected again by itself; nothing resumes by itself."""
    bench.drive()
    bench.follower = replace(bench.follower, state="DISABLED")
    assert bench.session.policy("a", with_policy(bench, "READY"), bench.now) == ""
    silent = "the policy has been silent for more than 150 ms"
    way = (("READY", ""), ("RUNNING", ""), ("PAUSED", "late"), ("IDLE", silent), ("READY", ""))
    for state, detail in way:
        for _ in range(50):
            bench.now += TICK
            robot = with_policy(bench, state, detail=detail)
            bench.session.tick(robot, bench.now)
    said = report(bench.session, robot, {}, bench.now)["sentence"]
    assert "was lost" in said and silent in said and "Press Policy" in said
    assert bench.flush()[-1] == Policy(True) and bench.flush() == []


def test_a_hand_that_is_not_let_go_is_said_instead_of_a_promise(bench: Bench) -> None:
    bench.drive()
    assert bench.session.policy("a", with_policy(bench, "READY"), bench.now) == ""
    assert (
        "takes over"
        in report(bench.session, with_policy(bench, "READY"), {}, bench.now)["sentence"]
    )
    bench.follower = replace(bench.follower, state="WAITING")
    bench.now += START_TIMEOUT + 0.01
    bench.session.tick(with_policy(bench, "READY"), bench.now)
    said = report(bench.session, with_policy(bench, "READY"), {}, bench.now)["sentence"]
    assert "did not get the arm" in said and "Press Policy" in said


def test_f30_a_promise_to_a_policy_ends_with_anything_else_the_operator_does() -> None:
    for act in ("enable", "stop", "late", "leave", "release", "hide", "take-over"):
        bench = Bench()
        bench.drive()
        assert bench.session.policy("a", with_policy(bench, "READY"), bench.now) == ""
        bench.flush()
        if act == "enable":
            bench.session.enable("a", bench.robot, bench.now)
        elif act == "stop":
            bench.session.stop(bench.robot)
        elif act == "leave":
            bench.session.leave("a", bench.now)
        elif act == "release":
            bench.session.release("a")
        elif act == "hide":
            bench.session.hide("a", "hidden")
            assert bench.session.reason == operator_messages.HIDDEN["hidden"]
        elif act == "take-over":
            bench.now += GONE + 0.01
            bench.session.join("b", bench.now)
            assert bench.session.take("b", bench.now) == ""
        else:
            bench.follower = replace(bench.follower, state="WAITING")
            bench.now += START_TIMEOUT + 0.01
            bench.session.tick(with_policy(bench, "READY"), bench.now)
        bench.follower = replace(bench.follower, state="DISABLED")
        for _ in range(100):
            bench.now += TICK
            bench.session.tick(with_policy(bench, "READY"), bench.now)
            assert Policy(True) not in bench.flush(), act


def test_a_policy_is_ended_from_the_page_and_by_stop(bench: Bench) -> None:
    bench.drive()
    running = with_policy(bench, "RUNNING")
    assert bench.session.policy("a", running, bench.now) == ""
    assert bench.flush() == [Policy(False)]
    bench.session.stop(running)
    assert Policy(False) in bench.flush()
    assert (
        bench.session.policy("a", with_policy(bench, "IDLE"), bench.now)
        == operator_messages.NO_POLICY
    )
    assert bench.session.policy("a", bench.robot, bench.now) == operator_messages.NO_POLICY
    bench.session.join("b", bench.now)
    assert bench.session.policy("b", running, bench.now) == operator_messages.NO_CONTROL


# --- the operator again ------------------------------------------------------------------------


def test_nothing_resumes_by_itself(bench: Bench) -> None:
    for stop in ("silence", "hide", "arm", "picture"):
        bench = Bench()
        bench.drive()
        if stop == "silence":
            bench.run(0.3, page="")
        elif stop == "hide":
            bench.session.hide("a", "hidden")
        elif stop == "arm":
            bench.follower = replace(bench.follower, state="WAITING", reason="PSM1 is PAUSED")
            bench.run(0.1)
        else:
            bench.run(FROZEN + 0.2, film=False)
        bench.flush()
        assert bench.held(), stop
        bench.orders.clear()
        bench.follower = replace(bench.follower, state="FOLLOWING")
        bench.run(3.0)
        assert bench.orders == [], stop
        bench.follower = replace(bench.follower, state="DISABLED")
        assert bench.session.enable("a", bench.robot, bench.now) == ""
        bench.flush()
        bench.run(0.5)
        assert bench.session.phase is Phase.DRIVING, stop


def test_a_page_that_wakes_up_before_the_tick_cannot_go_on(bench: Bench) -> None:
    bench.drive()
    bench.now += SILENCE + 0.5  # the server stood still as well: no tick has been there
    bench.speak()
    bench.flush()
    assert bench.held()
    assert bench.given(Move) == []


def test_messages_that_were_held_up_are_void(bench: Bench) -> None:
    bench.drive()
    for step in range(40):  # 0.8 s of inputs arrive in one moment, after a stall
        bench.speak(late=0.8 - 0.02 * step)
    moves = [order for order in bench.session.take_orders() if isinstance(order, Move)]
    assert len(moves) <= 1 + LATENESS / PERIOD
    assert not bench.session.in_time("a", bench.now + PAGE_CLOCK - 0.11, bench.now)
    assert bench.session.in_time("a", bench.now + PAGE_CLOCK - 0.09, bench.now)


def test_lateness_forgets_a_drift_of_the_clocks() -> None:
    lateness, worst = Lateness(), 0.0
    for step in range(30_000):  # ten minutes, 100 ppm
        sent = 0.02 * step
        worst = max(worst, lateness.add(sent, sent * (1 + 1e-4)))
    assert worst < 0.003


def test_an_older_input_is_ignored(bench: Bench) -> None:
    bench.drive()
    bench.speak()
    bench.flush()
    before = len(bench.given(Move))
    bench.session.receive("a", Input(1, bench.now + PAGE_CLOCK), bench.now)
    bench.flush()
    assert len(bench.given(Move)) == before


def test_without_a_picture_nothing_is_enabled(bench: Bench) -> None:
    bench.picture = 0
    bench.session.join("a", bench.now)
    bench.run(0.2, film=False)
    assert bench.session.enable("a", bench.robot, bench.now) == operator_messages.NO_PICTURE
    bench.flush()
    assert EnableTeleop(True) not in bench.orders


def test_f08_a_picture_that_stands_still_holds(bench: Bench) -> None:
    bench.drive()
    bench.run(FROZEN - 0.1, film=False)
    assert bench.session.phase is Phase.DRIVING
    bench.run(0.2, film=False)
    assert bench.held()
    assert bench.session.reason == operator_messages.FROZEN_PICTURE


def test_a_system_without_a_camera_can_be_driven() -> None:
    bench = Bench(pictures=False)
    bench.picture = 0
    bench.session.join("a", bench.now)
    bench.run(0.2, film=False)
    assert bench.session.enable("a", bench.robot, bench.now) == ""
    bench.flush()
    bench.run(3.0, film=False)
    assert bench.session.phase is Phase.DRIVING


def test_one_drives_and_the_other_watches(bench: Bench) -> None:
    bench.drive()
    bench.session.join("b", bench.now)
    bench.run(0.1)
    bench.orders.clear()
    for _ in range(10):
        bench.now += PERIOD
        bench.speak("b", v=(0.1, 0, 0), hand="rate", clutch=True, camera=True)
        bench.speak("a")
        bench.tick()
    assert {type(order) for order in bench.orders} == {Move}
    assert all(order.sample.v == (0, 0, 0) for order in bench.given(Move))
    assert "a has control" in bench.session.take("b", bench.now)
    assert bench.session.enable("b", bench.robot, bench.now) == operator_messages.NO_CONTROL
    assert bench.session.scale("b", 0.5) == operator_messages.NO_CONTROL
    assert bench.session.record("b", bench.robot, True) == operator_messages.NO_CONTROL
    assert bench.flush() == []


def test_control_changes_hands_only_when_given_or_lost(bench: Bench) -> None:
    bench.drive()
    bench.session.join("b", bench.now)
    bench.session.release("a")
    bench.flush()
    assert bench.held()
    assert bench.session.take("b", bench.now) == ""
    assert bench.session.phase is Phase.READY
    bench.run(GONE + 0.1, page="")
    assert bench.session.take("a", bench.now) == ""
    assert bench.session.holder == "a"


def test_a_hidden_page_gives_way(bench: Bench) -> None:
    bench.drive()
    bench.session.join("b", bench.now)
    assert bench.session.take("b", bench.now) != ""
    bench.session.hide("a", "hidden")
    assert bench.session.take("b", bench.now) == ""


def test_stop_is_obeyed_from_every_page_and_pauses(bench: Bench) -> None:
    for who in ("a", "b"):
        bench = Bench()
        bench.drive()
        bench.session.join("b", bench.now)
        bench.session.stop(bench.robot, who)
        orders = bench.flush()
        pause = StateCommand("PSM1", "pause")
        assert orders == [SetOperatorPresent(False), EnableTeleop(False), pause, Policy(False)]
        assert ("on b" in bench.session.reason) == (who == "b")


def test_a_pedal_is_sent_when_it_changes(bench: Bench) -> None:
    bench.drive()
    bench.run(0.1, clutch=True)
    bench.run(0.1)
    bench.run(0.1, camera=True)
    assert bench.given(Clutch) == [Clutch(True), Clutch(False)]
    assert bench.given(Camera) == [Camera(True)]


def test_the_mapping_is_asked_for_once_with_each_change_of_the_hand(bench: Bench) -> None:
    bench.drive()
    bench.run(0.5, hand="rate")
    assert bench.given(SetMapping) == [SetMapping(True)]
    bench.follower = replace(bench.follower, state="WAITING")
    bench.run(1.0, hand="rate", clutch=True)
    assert bench.session.phase is Phase.DRIVING
    assert bench.given(SetMapping) == [SetMapping(True)]
    bench.run(0.1, hand="position", clutch=True)
    assert bench.given(SetMapping) == [SetMapping(True), SetMapping(False)]


def test_a_page_that_does_not_lead_enables_and_clutches_only(bench: Bench) -> None:
    bench.session = ConsoleSession(pictures=True, leads=False)
    bench.drive()
    bench.run(0.5, clutch=True)
    assert bench.orders == [Clutch(True)]
    bench.run(0.3, page="")
    assert bench.held()


def test_what_does_not_become_ready_is_named(bench: Bench) -> None:
    cases = {
        "PSM1 is FAULT 6 s after Enable: the shaft": (
            Arm("PSM1", "FAULT", True, reason=Reason.RCM_ERROR),
            Follower("WAITING"),
        ),
        "No state from PSM1": (Arm("PSM1"), Follower("WAITING")),
        "The tip does not follow after 6 s: it is busy": (
            Arm("PSM1", "ENABLED", True),
            Follower("WAITING", reason="it is busy"),
        ),
    }
    for said, (arm, follower) in cases.items():
        bench = Bench()
        bench.session.join("a", bench.now)
        bench.run(0.2)
        bench.session.enable("a", bench.robot, bench.now)
        bench.flush()
        bench.arm, bench.follower, bench.obeys = arm, follower, False
        bench.run(START_TIMEOUT - 0.1)
        assert bench.session.phase is Phase.STARTING
        bench.run(0.2)
        assert bench.held()
        assert bench.session.reason.startswith(said)


def test_a_silent_teleoperation_is_named(bench: Bench) -> None:
    bench.drive()
    bench.follower = Follower()
    bench.run(0.1)
    assert bench.held()
    assert bench.session.reason == operator_messages.NO_FOLLOWER


def test_scale_and_record_are_orders(bench: Bench) -> None:
    bench.drive()
    assert bench.session.scale("a", 0.5) == ""
    assert bench.session.record("a", bench.robot, True) == ""
    assert bench.flush() == [SetScale(0.5), Record(True)]
    played = replace(bench.robot, task=SimTask("RUNNING", "bgr", "point", seed=4))
    assert bench.session.record("a", played, True) == ""
    assert bench.flush() == [Describe('{"seed": 4}'), Record(True)]


# --- episodes of a simulated task ---------------------------------------------------------------


def test_a_new_episode_begins_when_no_controller_holds_an_arm(bench: Bench) -> None:
    bench.drive()
    bench.flush()
    assert bench.session.new_episode("a", bench.robot, bench.now) == operator_messages.NO_TASK
    bench.task = SimTask("SUCCESS", "bgr", "done")
    assert bench.session.new_episode("b", bench.robot, bench.now) == operator_messages.NO_CONTROL
    recorded = replace(bench.robot, recorder=Recorder("RECORDING"))
    why = bench.session.new_episode("a", recorded, bench.now)
    assert why == operator_messages.NEW_WHILE_RECORDED
    assert bench.flush() == []
    assert bench.session.new_episode("a", bench.robot, bench.now) == ""
    orders = [SetOperatorPresent(False), EnableTeleop(False), StateCommand("PSM1", "disable")]
    assert bench.flush() == orders
    bench.run(0.2)
    assert bench.given(NewEpisode) == [], "the arm is still enabled"
    bench.arm = replace(bench.arm, state="DISABLED")
    bench.run(0.1)
    assert bench.given(NewEpisode) == [NewEpisode(True)]
    assert (bench.session.phase, bench.session.reason) == (
        Phase.READY,
        operator_messages.NEW_EPISODE,
    )


def test_an_arm_that_is_not_disabled_or_a_stop_keeps_the_episode(bench: Bench) -> None:
    bench.drive()
    bench.task = SimTask("RUNNING", "bgr", "point")
    assert bench.session.new_episode("a", bench.robot, bench.now) == ""
    bench.run(START_TIMEOUT + 0.1)
    assert bench.session.reason == operator_messages.NOT_NEW
    assert bench.session.new_episode("a", bench.robot, bench.now) == ""
    bench.session.stop(bench.robot, "a")
    bench.arm = replace(bench.arm, state="DISABLED")
    bench.run(0.1)
    assert bench.given(NewEpisode) == []


def test_a_judgement_without_a_finished_recording_is_refused(bench: Bench) -> None:
    def judge(name: str, recorder: Recorder) -> str:
        return bench.session.judge(name, replace(bench.robot, recorder=recorder))

    bench.drive()
    assert judge("a", Recorder("IDLE")) == operator_messages.NOTHING_RECORDED
    assert judge("a", Recorder("RECORDING", "", "/runs/1/episode")) == (
        operator_messages.STILL_RECORDED
    )
    assert judge("b", Recorder("IDLE", "", "/runs/1/episode")) == operator_messages.NO_CONTROL
    assert judge("a", Recorder("IDLE", "", "/runs/1/episode")) == ""


def test_random_lives_never_move_without_an_operator(full: bool) -> None:
    """An input goes out only from the page in control, after its Enable, and in time."""
    moves = holds = 0
    for seed in range(3000 if full else 100):
        rng = random.Random(seed)
        bench = Bench(pictures=rng.random() < 0.8)
        names = ["a", "b"]
        enabled = ""
        for _ in range(300):
            bench.now += rng.choice((0.002, 0.02, 0.02, 0.02, 0.15))
            bench.picture += rng.random() < 0.4
            name = rng.choice(names)
            known = name in bench.session._pages
            act = rng.random()
            if not known:
                bench.session.join(name, bench.now)
            elif act < 0.70:
                bench.speak(name, late=rng.choice((0.0, 0.0, 0.0, 0.3)), clutch=act < 0.1)
            elif act < 0.80:
                if bench.session.enable(name, bench.robot, bench.now) == "":
                    enabled = name
            elif act < 0.84:
                bench.session.hide(name, rng.choice(HIDDEN))
            elif act < 0.87:
                bench.session.leave(name, bench.now)
            elif act < 0.90:
                bench.session.take(name, bench.now)
            elif act < 0.93:
                bench.session.stop(bench.robot, name)
            elif act < 0.96:
                bench.follower = replace(
                    bench.follower, state=rng.choice(("WAITING", "FAULT", "FOLLOWING", ""))
                )
            for order in bench.flush():
                if isinstance(order, Move):
                    moves += 1
                    assert enabled == name == bench.session.holder or bench.held(), seed
                elif order == EnableTeleop(False):
                    holds += 1
                    enabled = ""
            bench.tick()
            for order in bench.orders[-4:]:
                if order == EnableTeleop(False):
                    enabled = ""
            bench.orders.clear()
    print(f"{moves} inputs went out, {holds} holds")
    assert moves > 400
    assert holds > 100


def test_every_reason_of_a_cycle_has_a_sentence() -> None:
    for name, reason in Reason.__members__.items():
        arm = Arm("PSM1", "FAULT", reason=reason)
        assert bool(operator_messages.reason_sentence(arm)) == (name != "NONE"), name
    for reason in (None, Reason.NONE):
        assert "no reason" in operator_messages.state_sentence(Arm("PSM1", "FAULT", reason=reason))


def test_the_report_is_json_in_words(bench: Bench) -> None:
    import json

    bench.drive()
    robot = replace(bench.robot, gauges=Gauges(math.nan, 0.001, 0.1, None, math.inf))
    said = report(bench.session, robot, {"depth_max": 0.22}, bench.now)
    text = json.dumps(said, allow_nan=False)
    assert said["gauges"] == {
        "rcm": None,
        "rcm_peak": 0.001,
        "depth": 0.1,
        "trocar": None,
        "tip": None,
        "clearance": None,
        "stop_tip": None,
        "stop_pivot": None,
    }
    assert said["headline"] == "Following" and "follows your hand" in text
    bench.session.hide("a", "hidden")
    bench.flush()
    said = report(bench.session, bench.robot, {}, bench.now)
    assert said["headline"] == "Held" and "tab was hidden" in said["sentence"]


def test_the_camera_button_says_what_the_hand_holds(bench: Bench) -> None:
    def said(scope: Follower) -> tuple[str, str]:
        robot = replace(bench.robot, follower=Follower("CLUTCHED"), scope=scope)
        found = report(bench.session, robot, {}, bench.now)
        return found["headline"], found["sentence"]

    bench.drive()
    bench.run(0.2, camera=True)
    assert Camera(True) in bench.orders and bench.session.phase is Phase.DRIVING
    following = Follower("FOLLOWING", leader="browser", arm="ECM")
    assert said(following) == (
        "Endoscope",
        "Your hand moves the endoscope (ECM). The instrument stays.",
    )
    why = "ECM is PAUSED (operator); press enable"
    waits = replace(following, state="WAITING", reason=why)
    assert said(waits) == ("Waiting", "ECM is PAUSED (operator); press enable.")
    assert said(Follower())[0] == "Clutched" and "No arm holds the endoscope" in said(Follower())[1]
    bench.run(0.2, camera=True, clutch=True)
    assert said(replace(following, state="CLUTCHED"))[0] == "Clutched"
    bench.run(0.2)
    assert Camera(False) in bench.orders
    assert report(bench.session, bench.robot, {}, bench.now)["headline"] == "Following"


def test_a_second_hand_has_a_line_of_its_own(bench: Bench) -> None:
    why = "gamepad is silent: is it connected and switched on? then press the clutch or enable"
    second = Follower("WAITING", reason=why, leader="gamepad", arm="assistant")
    found = report(bench.session, replace(bench.robot, helpers=(second,)), {}, bench.now)
    assert found["helpers"] == [
        {"name": "assistant (gamepad)", "state": "WAITING", "sentence": why}
    ]
