"""The model server on a fake clock: sessions, chunks, timers, hand-over. Deadlines are exact."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from helpers.policy.policy_bench import ARM, HOME, MS, Bench, spec
from helpers.results.policy_results import note
from surg_core.arm_view import ArmState
from surg_core.bring_up import RETRY_NS, TIMEOUT_NS
from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server import sessions
from surg_policy_bridge.server.chunk_queue import LONGEST, ChunkQueue, plan_shares
from surg_policy_bridge.server.sessions import BURST, PEERS, RATE, RateLimiter
from surg_policy_bridge.server.timers import MAX_OBS_AGE, SILENCE
from surg_policy_client.spec import Spec


@pytest.fixture
def bench() -> Bench:
    return Bench()


# --- sessions -------------------------------------------------------------------------------------


def test_a_hello_is_answered_with_the_specification(bench: Bench) -> None:
    bench.hello()
    (welcome,) = bench.of("WELCOME")
    assert Spec.from_map(welcome.head["spec"]) == spec()
    assert (welcome.head["session"], welcome.head["version"]) == (7001, 1)
    assert welcome.head["max_obs_age_s"] == 0.6 and welcome.head["silence_s"] == 0.15
    bench.hello()  # it crossed the answer
    assert [m.head["session"] for m in bench.of("WELCOME")] == [7001, 7001]
    assert bench.server.state.value == "READY", "connected, and nothing moves"


def test_what_is_not_wanted_is_not_sent(bench: Bench) -> None:
    bench.hello(wants=Spec.of_keys(["observation.state"]).to_map())
    assert list(Spec.from_map(bench.of("WELCOME")[-1].head["spec"]).observation) == [
        "observation.state"
    ]


def test_a_hello_before_the_specification_is_answered_with_it() -> None:
    bench = Bench()
    bench.server._spec = None
    bench.hello()
    assert not bench.heard and bench.server.waiting
    bench.server.serve(spec(), bench.now)
    bench._hear()
    assert len(bench.of("WELCOME")) == 1


@pytest.mark.parametrize("early", [False, True])
def test_who_was_refused_does_not_count_as_waiting(early: bool) -> None:
    bench = Bench()
    bench.server._spec = None if early else spec()
    bench.hello(wants=replace(spec(), task="suturing").to_map())
    assert bench.server.waiting is early
    bench.server.serve(spec(), bench.now)
    bench._hear()
    assert bench.errors[-1][1] == "spec" and bench.server.waiting is False
    bench.hello(b"b")
    assert bench.server.waiting is True


@pytest.mark.parametrize("versions", [[3, 4], [9, 9]])
def test_another_version_is_refused_naming_both(bench: Bench, versions: list[int]) -> None:
    bench.hello(versions=versions)
    ((_, code, text),) = bench.errors
    assert code == "version" and str(versions[0]) in text and "1 to 2" in text
    assert bench.server.session is None


def test_another_specification_is_refused_naming_both(bench: Bench) -> None:
    bench.hello(wants=replace(spec(), task="suturing").to_map())
    ((_, code, text),) = bench.errors
    assert code == "spec" and "'suturing'" in text and "'bench'" in text


def test_one_policy_at_a_time(bench: Bench) -> None:
    bench.hello(b"a")
    bench.hello(b"b")
    assert bench.errors[-1][:2] == (b"b", "busy")
    bench.now += SILENCE
    bench.tick()
    bench.hello(b"b")
    assert bench.errors[-1][:2] == (b"b", "busy"), "150 ms are not more than 150 ms"
    bench.now += 1
    bench.hello(b"b")
    assert bench.session == 7002


def test_f29_a_former_session_is_not_obeyed() -> None:
    bench = Bench()
    bench.start()
    bench.period([bench.here(0.001)])
    old = bench.session
    bench.say("BYE", session=old, reason="")
    assert bench.server.state.value == "IDLE"
    bench.hello()
    bench.tick()
    assert bench.server.state.value == "READY", "nothing resumes by itself"
    assert bench.server.enable(True, bench.now) == ""
    for _ in range(3):
        bench.tick()
    bench.observe()
    assert bench.session != old
    sent = len(bench.sent)
    for peer in (b"a", b"b"):  # a replay on the same connection, and on another
        bench.act(bench.here(0.002), peer, session=old)
        assert bench.errors[-1][:2] == (peer, "session")
    assert bench.server.counters.strangers == 2
    assert bench.execute() is None and len(bench.sent) == sent


def test_a_flood_is_not_looked_into_and_a_good_message_is() -> None:
    limiter, now = RateLimiter(), 0
    admitted = sum(limiter.admits(b"a", now) for _ in range(10_000))
    assert admitted == BURST
    assert limiter.admits(b"b", now), "another peer has its own"
    for _ in range(RATE):
        now += SECOND_NS // RATE
        assert limiter.admits(b"a", now) and not limiter.admits(b"a", now)
    for n in range(10 * PEERS):
        limiter.admits(str(n).encode(), now)
    assert len(limiter._buckets) == PEERS


# --- chunks ---------------------------------------------------------------------------------------


def test_the_queue_against_a_slow_book(rng: random.Random, full: bool) -> None:
    """Seeded storms of chunks against a list of everything that was ever said."""
    chunks = 0
    for _ in range(300 if full else 30):
        queue, said, now, past = ChunkQueue(), [], 0, 0
        queue.take(now)
        for seq in range(60):
            for _ in range(rng.randint(0, 3)):
                now += 1
                # In free-run the time of a step is not over yet when it begins to be played.
                past = max(past, now - rng.randint(0, 1))
                taken = queue.take(now, past)
                # From its first step on, the newest chunk with a future counts alone.
                wanted = None
                for first, rows, at in said:
                    if now >= first and first + len(rows) > at:
                        wanted = rows[now - first] if now < first + len(rows) else None
                assert (None if taken is None else taken.row[0]) == wanted
            first = now + rng.randint(-5, 5)
            rows = [seq + 0.001 * i for i in range(rng.randint(1, 9))]
            late = queue.splice(first, np.array(rows)[:, None], seq, 0)
            assert late == sum(first + i <= past for i in range(len(rows)))
            said.append((first, rows, now + 1))
            chunks += 1
    note(2, chunks, "the same steps, the same number of late ones")


def test_the_queue_is_bounded() -> None:
    queue = ChunkQueue()
    queue.splice(0, np.zeros((1024, 5)), 1, 0)
    queue.splice(2**61, np.zeros((1024, 5)), 1, 0)
    assert len(queue) <= LONGEST


def test_late_steps_are_dropped_and_counted(bench: Bench) -> None:
    bench.start()
    for _ in range(3):
        bench.period(np.array([bench.here()] * 6))
    bench.ping()
    bench.tick()
    bench.observe()
    bench.now += 2 * STEP_NS  # the answer takes two periods
    bench.step += 2
    bench.ping()
    bench.execute()
    rows = [bench.here(1e-4 * i) for i in range(6)]
    bench.act(rows, first=bench.step - 1)
    assert bench.server.counters.late == 3
    assert bench.of("ACK")[-1].head["late"] == 3
    bench.now += STEP_NS
    bench.step += 1
    done = bench.execute()
    joined = rows[3][0] * (1.0 - plan_shares(3)[0])  # from where it stood
    assert done is not None and done.p[0] == pytest.approx(joined), "by absolute step"


@pytest.mark.parametrize("width", [5, 0, 3])
def test_an_answer_without_steps_lets_the_former_go_on(bench: Bench, width: int) -> None:
    bench.start()
    rows = np.array([bench.here(1e-4 * i) for i in range(1, 5)])
    bench.period(rows)
    for i in range(1, 4):
        done = bench.period(np.zeros((0, width)))
        assert done is not None and np.array_equal(done.p, rows[i][:3])
        assert not bench.server.unanswered
    assert bench.period(np.zeros((0, 5))) is None


def test_answers_out_of_order_and_to_nothing_are_not_obeyed(bench: Bench) -> None:
    bench.start()
    for _ in range(3):
        bench.ping()
        bench.tick()
        bench.observe()
        bench.now += STEP_NS
        bench.step += 1
    first, second = (m.head for m in bench.of("OBS")[-2:])
    good = {"seq": second["seq"], "stamp_ns": second["stamp_ns"]}
    bench.act([bench.here(1e-3)] * 9, **good)
    queued = len(bench.server.steps.queue)
    bench.act([bench.here(2e-3)] * 9, seq=first["seq"], stamp_ns=first["stamp_ns"])
    bench.act([bench.here(2e-3)] * 9, **good)
    assert bench.server.counters.stale == 18 and len(bench.server.steps.queue) == queued
    for wrong in ({"seq": 999}, {"stamp_ns": second["stamp_ns"] + 1}):
        bench.act([bench.here(2e-3)] * 9, **{**good, **wrong})
        assert bench.of("ACK")[-1].head["rejected"][0]["rule"] == "observation"
    done = bench.execute()
    assert done is not None and done.p[0] == pytest.approx(1e-3)


def test_an_answer_to_what_was_seen_before_a_pause_is_not_obeyed(bench: Bench) -> None:
    bench.start()
    bench.observe()  # and the policy thinks
    bench.server.enable(False, bench.now)
    bench.tick()
    bench.server.enable(True, bench.now)
    for _ in range(3):
        bench.tick()
    assert bench.server.state.value == "RUNNING"
    bench.say("RESET", session=bench.session)
    assert not bench.errors, "nothing has moved"
    bench.act([bench.here(1e-3)] * 5)
    assert bench.server.counters.stale == 5 and bench.server.steps.coming(1) is None
    assert bench.period([bench.here(1e-3)]) is not None


# --- timers ---------------------------------------------------------------------------------------


def test_f04_silence_flushes_holds_and_needs_a_new_session() -> None:
    bench = Bench()
    bench.start()
    bench.period(np.array([bench.here(1e-3 * i) for i in range(1, 12)]))
    since = bench.now - STEP_NS
    bench.now = since + SILENCE
    bench.tick()
    assert bench.server.state.value == "RUNNING", "150 ms are not more than 150 ms"
    bench.now += 1
    bench.tick()
    assert bench.server.state.value == "IDLE" and "150 ms" in bench.server.reason
    assert len(bench.server.steps.queue) == 0 and bench.execute() is None
    assert bench.arm.told[-2:] == ["hold", "pause"]
    assert bench.arm.view.state == ArmState.PAUSED and bench.arm.view.holder == ""
    bench.say("PING", session=bench.session, n=2)
    assert bench.errors[-1][1] == "session"


def test_f04_a_run_without_an_operator_goes_on_with_a_new_session() -> None:
    bench = Bench(autostart=True)
    bench.hello()
    for _ in range(5):
        bench.tick()
    assert bench.server.state.value == "RUNNING"
    bench.now += SILENCE + 1
    bench.tick()
    assert bench.arm.view.state == ArmState.PAUSED
    bench.hello(b"b")
    for _ in range(5):
        bench.tick()
    assert bench.server.state.value == "RUNNING"
    events = [m.head["event"] for m in bench.of("EPISODE")]
    assert events == ["begin", "paused", "resumed"] and bench.server.episode == 1


@pytest.mark.parametrize("against", ["operator", "fault", "holder"])
def test_f30_a_start_by_itself_waits_for_no_person(against: str) -> None:
    bench = Bench(autostart=True)
    free = bench.arm.view
    bench.obstacle = "the operator wants PSM1" if against == "operator" else ""
    if against == "fault":
        bench.arm.view = replace(free, state=ArmState.FAULT)
    elif against == "holder":
        bench.arm.view = replace(free, holder="/teleop")
    bench.hello()
    bench.tick()
    assert ARM in bench.server.reason
    bench.obstacle, bench.arm.view = "", free
    for _ in range(5):
        bench.tick()
    assert bench.server.state.value == "READY" and not bench.arm.told
    assert bench.server.enable(True, bench.now) == ""


def test_a_start_by_itself_waits_for_arms_and_cameras() -> None:
    bench = Bench(autostart=True)
    bench.hello()
    bench.server.tick({}, bench.now, bench.now)
    assert "silent" in bench.server.reason
    bench.server.tick({ARM: bench.arm.view}, bench.now, bench.now, "", "a picture is 151 ms old")
    assert "picture" in bench.server.reason and not bench.arm.told
    for _ in range(5):
        bench.tick()
    assert bench.server.state.value == "RUNNING"


def test_f05_a_step_is_executed_only_while_its_observation_is_young(bench: Bench) -> None:
    bench.start()
    bench.period(np.array([bench.here(1e-4 * i) for i in range(1, 60)]))
    seen = bench.now - STEP_NS
    while bench.period() is not None:
        pass
    newest = bench.sent[-1][0]
    assert newest - seen == MAX_OBS_AGE, "12 periods old, and no step after it"
    assert bench.server.state.value == "RUNNING" and bench.server.counters.stale > 0


def test_f05_without_a_step_for_two_seconds_the_arm_is_paused(bench: Bench) -> None:
    bench.start()
    bench.period([bench.here()])
    empty = bench.now
    while bench.server.state.value == "RUNNING":
        assert bench.period() is None
    paused = bench.now - STEP_NS
    assert paused - empty == 2 * SECOND_NS + STEP_NS, "the first grid time after more than 2 s"
    assert "no action" in bench.server.reason and bench.server.counters.empty == 42
    bench.tick()
    assert bench.arm.view.state == ArmState.PAUSED


def test_f05_without_an_observation_the_source_is_named(bench: Bench) -> None:
    bench.start()
    bench.period([bench.here()])
    while bench.server.state.value == "RUNNING":
        bench.ping()
        bench.tick()
        bench.server.observe_nothing("endoscope is 400 ms behind the arms' state")
        bench.execute()
        bench.now += STEP_NS
        bench.step += 1
    assert "endoscope is 400 ms behind" in bench.server.reason


def test_f05_an_answer_that_is_too_old_when_it_comes_is_counted(bench: Bench) -> None:
    bench.start()
    bench.tick()
    bench.observe()
    for _ in range(13):
        bench.now += STEP_NS
        bench.step += 1
        bench.ping()
        bench.tick()
    bench.act(np.array([bench.here(1e-3)] * 50))
    assert bench.server.counters.stale == 50 and len(bench.server.steps.queue) == 0


def test_three_refusals_in_a_row_pause_and_are_told(bench: Bench) -> None:
    bench.start()
    for n in range(2):
        assert bench.period([bench.here(0.05)]) is None
        assert bench.server.state.value == "RUNNING", n
    assert bench.period([bench.here(0.0005)]) is not None, "in a row"
    for _ in range(3):
        bench.period([bench.here(0.05)])
    assert bench.server.state.value == "PAUSED"
    assert "3 rejected steps in a row" in bench.server.reason and "50 mm" in bench.server.reason
    told = [each for m in bench.of("ACK") for each in m.head["rejected"]]
    assert [each["rule"] for each in told] == ["start", "start", "step", "step", "start"]
    assert [j.rule for j in bench.server.steps.judged if not j.passed] == [e["rule"] for e in told]
    assert bench.of("EPISODE")[-1].head["event"] == "paused"
    bench.tick()
    assert bench.arm.view.state == ArmState.PAUSED


@pytest.mark.parametrize("rows", [np.zeros((1, 4)), np.zeros((3, 10)), np.zeros((1, 1))])
def test_a_chunk_of_the_wrong_width_is_refused(bench: Bench, rows: np.ndarray) -> None:
    bench.start()
    bench.period(rows)
    (told,) = bench.of("ACK")[-1].head["rejected"]
    assert told["rule"] == "shape" and "[K, 5]" in told["text"] and "PSM1/x" in told["text"]


# --- hand-over ------------------------------------------------------------------------------------


def test_f30_the_arm_comes_and_goes_through_paused_only(bench: Bench) -> None:
    bench.hello()
    arm = bench.arm
    arm.view = replace(arm.view, homed=True, state=ArmState.ENABLED, holder="/teleop")
    bench.tick()
    assert "/teleop" in bench.server.enable(True, bench.now)
    assert not arm.told, "not fought for"
    arm.view = replace(arm.view, state=ArmState.PAUSED, holder="")
    bench.tick()
    assert bench.server.enable(True, bench.now) == ""
    for _ in range(2):
        bench.tick()
    assert arm.told == ["resume"] and bench.server.state.value == "RUNNING"
    assert bench.period([bench.here(0.0021)]) is None, "the first within 2 mm of the set-point"
    assert bench.period([bench.here(0.0019)]) is not None
    bench.obstacle = "the operator wants PSM1"
    bench.tick()
    assert bench.server.state.value == "PAUSED" and arm.told[-2:] == ["hold", "pause"]
    assert "operator" in bench.server.enable(True, bench.now)
    bench.obstacle = ""
    bench.tick()
    assert bench.server.state.value == "PAUSED", "nothing resumes by itself"


@pytest.mark.parametrize("change", ["paused", "fault", "disabled", "taken", "silent"])
def test_an_arm_that_is_lost_stops_the_policy(bench: Bench, change: str) -> None:
    bench.start()
    bench.period([bench.here(1e-3)])
    changes = {
        "paused": {"state": ArmState.PAUSED, "reason": "force", "holder": ""},
        "fault": {"state": ArmState.FAULT, "reason": "rcm_error", "holder": ""},
        "disabled": {"state": ArmState.DISABLED, "holder": ""},
        "taken": {"holder": "/teleop"},
    }
    told = len(bench.arm.told)
    if change == "silent":
        for command in bench.server.tick({}, bench.now, bench.now).values():
            bench.arm.obey(command)
    else:
        bench.arm.view = replace(bench.arm.view, **changes[change])  # type: ignore[arg-type]
        bench.tick()
    assert bench.server.state.value == "PAUSED" and ARM in bench.server.reason
    assert bench.execute() is None
    if change == "taken":
        assert len(bench.arm.told) == told, "what another holds is left to it"


@pytest.mark.parametrize("end", ["enable", "operator", "bye"])
def test_an_arm_that_is_about_to_wake_is_not_left_alone(bench: Bench, end: str) -> None:
    bench.arm.view = replace(bench.arm.view, homed=True, state=ArmState.PAUSED)
    bench.hello()
    bench.tick()
    bench.server.enable(True, bench.now)
    before = {ARM: bench.arm.view}  # the arm obeys, and shows it a cycle later
    bench.tick()
    assert bench.arm.view.holder == "/policy" and bench.server.state.value == "WAKING"
    if end == "enable":
        bench.server.enable(False, bench.now)
    elif end == "bye":
        bench.say("BYE", session=bench.session, reason="")
    obstacle = "the operator wants PSM1" if end == "operator" else ""
    for command in bench.server.tick(before, bench.now, bench.now, obstacle).values():
        bench.arm.obey(command)
    assert bench.arm.view.state == ArmState.PAUSED and bench.arm.view.holder == ""


def test_waking_that_shows_no_effect_is_said_again_and_given_up(bench: Bench) -> None:
    bench.hello()
    bench.tick()
    assert bench.server.enable(True, bench.now) == ""
    words = []
    begin = bench.now
    while bench.server.state.value == "WAKING":
        views = {ARM: bench.arm.view}  # it does not obey
        words += [c.state for c in bench.server.tick(views, bench.now, bench.now).values()]
        bench.ping()
        bench.now += 2 * MS
    assert words.count("home") == 1 + TIMEOUT_NS // RETRY_NS and "'home'" in bench.server.reason
    assert bench.now - begin == TIMEOUT_NS + 4 * MS


def test_an_episode_ends_with_its_verdict(bench: Bench) -> None:
    bench.start()
    bench.period([bench.here()])
    bench.server.episode_over(True, "")
    bench._hear()
    bench.tick()
    end = bench.of("EPISODE")[-1].head
    assert (end["event"], end["success"], end["instruction"]) == ("end", True, "do it")
    assert bench.server.state.value == "READY" and bench.arm.view.state == ArmState.PAUSED
    assert bench.server.enable(True, bench.now) == ""
    for _ in range(3):
        bench.tick()
    assert bench.of("EPISODE")[-1].head["event"] == "begin" and bench.server.episode == 2


def test_a_reset_is_granted_where_nothing_has_moved_and_refused_elsewhere(bench: Bench) -> None:
    bench.start()
    bench.say("RESET", session=bench.session)
    assert not bench.errors
    bench.period([bench.here()])
    bench.say("RESET", session=bench.session)
    assert bench.errors[-1][1] == "reset" and "/policy/enable" in bench.errors[-1][2]


def test_the_end_of_the_server_is_said(bench: Bench) -> None:
    bench.start()
    bench.period([bench.here(1e-3)])
    bench.server.end("the model server has ended")
    bench.tick()
    assert bench.of("BYE")[-1].head["reason"] == "the model server has ended"
    assert bench.arm.view.state == ArmState.PAUSED
    np.testing.assert_allclose(bench.arm.view.p_set, HOME + np.array([1e-3, 0, 0]))


def test_a_recording_can_hold_the_number_of_any_session() -> None:
    """Tables hold 64-bit integers with a sign; half of all 64-bit numbers have no place there."""
    numbers = [sessions.new_number() for _ in range(200)]
    assert all(1 <= number <= np.iinfo(np.int64).max for number in numbers)
    assert len(set(numbers)) == 200
