"""What the client says and when, on a clock of the test."""

import itertools

import pytest

from helpers.policy.policy_server import spec
from surg_policy_client import PolicyClientError, Refused, Spec, SpecMismatch, VersionMismatch
from surg_policy_client.conversation import HELLO_S, LOST_S, Conversation, ConversationState
from surg_policy_client.wire import Message

ADDRESS = "tcp://robot:5555"


def hello(wants: Spec | None = None) -> dict[str, object]:
    return {"client": "c", "software": "s", "policy": "p", "wants": wants and wants.to_map()}


def welcome(session: int = 7, version: int = 1, served: Spec | None = None) -> Message:
    head = {"version": version, "session": session, "spec": (served or spec()).to_map()}
    return Message("WELCOME", {**head, "max_obs_age_s": 0.6, "ping_s": 0.05, "silence_s": 0.15})


def live(now: float = 0.0) -> Conversation:
    talk = Conversation(ADDRESS, hello())
    talk.tick(now)
    assert talk.take(welcome(), now) is not None
    return talk


def error(code: str) -> Message:
    return Message("ERR", {"code": code, "text": "what the server says"})


def test_it_greets_until_somebody_answers() -> None:
    talk = Conversation(ADDRESS, hello())
    said = [t / 1000 for t in range(2000) if talk.tick(t / 1000)]
    assert said == pytest.approx([i * HELLO_S for i in range(8)])
    assert talk.tick(10.0)[0].head["versions"] == [1, 2]


def test_it_greets_at_once_when_somebody_can_hear() -> None:
    talk = Conversation(ADDRESS, hello())
    assert talk.tick(0.0)
    assert not talk.tick(0.01)
    talk.reached()
    assert [m.kind for m in talk.tick(0.01)] == ["HELLO"]
    assert not talk.tick(0.02)
    talk.take(welcome(), 0.02)
    talk.reached()  # of no meaning once a session stands
    assert [m.kind for m in talk.tick(0.02)] == ["PING"]
    assert not talk.tick(0.03)


def test_it_pings_every_50_ms_and_never_in_a_salvo() -> None:
    talk = live()
    pings = []
    for t in range(1000):
        for message in talk.tick(t / 1000):
            pings.append((t / 1000, message.head["n"]))
            talk.take(Message("PONG", dict(message.head)), t / 1000)
    assert [t for t, _ in pings] == pytest.approx([i * 0.05 for i in range(20)], abs=0.02)
    assert all(b - a <= 0.0511 for (a, _), (b, _) in itertools.pairwise(pings))
    assert [n for _, n in pings] == list(range(1, 21))
    talk.take(Message("PONG", {"session": 7, "n": 1}), 1.4)
    assert len(talk.tick(1.5)) == 1  # after a halt: one, not ten
    assert talk.tick(1.5) == []
    assert talk.due() == pytest.approx(1.55)


def test_a_server_that_falls_silent_is_greeted_anew_on_another_socket() -> None:
    talk = live()
    talk.take(Message("PONG", {"session": 7, "n": 1}), 0.5)
    assert [m.kind for m in talk.tick(0.5 + LOST_S - 1e-6)] == ["PING"]
    assert [m.kind for m in talk.tick(0.5 + LOST_S)] == ["HELLO"]
    assert (talk.state, talk.session, talk.generation) == (ConversationState.GREETING, None, 1)
    assert talk.take(welcome(8), 2.0) is not None
    assert talk.session == 8


@pytest.mark.parametrize("word", ["session", "goodbye"])
def test_a_session_that_ended_is_followed_by_another(word: str) -> None:
    talk = live()
    message = (
        error("session") if word == "session" else Message("BYE", {"session": 7, "reason": ""})
    )
    talk.take(message, 0.1)
    assert (talk.state, talk.generation) == (ConversationState.GREETING, 1)
    talk.reached()
    assert bool(talk.tick(0.1)) == (
        word == "session"
    )  # who says goodbye is left in peace for a bit
    assert [m.kind for m in talk.tick(0.1 + HELLO_S)] == ["HELLO"]


def test_words_of_another_session_are_not_heard() -> None:
    talk = live()
    for session in (6, 8):
        assert talk.take(Message("BYE", {"session": session, "reason": ""}), 0.1) is None
    assert talk.state is ConversationState.LIVE
    assert talk.take(Message("RESET", {"session": 7}), 0.1) is not None
    # One that crossed a repeated HELLO: the server's newest session is the one that counts.
    assert talk.take(welcome(7), 0.1) is None
    assert talk.take(welcome(9), 0.1) is not None
    assert talk.session == 9


@pytest.mark.parametrize(
    ("message", "kind", "words"),
    [
        (welcome(version=3), VersionMismatch, ["versions 1 to 2", "version 3", "Install"]),
        (error("version"), VersionMismatch, ["versions 1 to 2", "what the server says", "Install"]),
        (error("spec"), SpecMismatch, ["what the server says", "wants"]),
        (error("refused"), Refused, ["what the server says"]),
    ],
)
def test_what_cannot_go_on_says_so_and_stops(
    message: Message, kind: type[PolicyClientError], words: list[str]
) -> None:
    talk = Conversation(ADDRESS, hello())
    talk.tick(0.0)
    talk.take(message, 0.1)
    assert type(talk.failure) is kind
    assert all(word in str(talk.failure) for word in [*words, ADDRESS])
    assert talk.tick(100.0) == []
    assert talk.take(welcome(), 100.0) is None


def test_the_client_checks_what_it_is_served() -> None:
    talk = Conversation(ADDRESS, hello(Spec(task="pick_and_place")))
    assert talk.take(welcome(), 0.0) is None
    assert isinstance(talk.failure, SpecMismatch)
    assert "'pick_and_place'" in str(talk.failure)
    assert "'bgr'" in str(talk.failure)


def test_a_busy_server_is_asked_again() -> None:
    talk = Conversation(ADDRESS, hello())
    talk.tick(0.0)
    talk.take(error("busy"), 0.1)
    assert talk.busy == "what the server says"
    assert [m.kind for m in talk.tick(HELLO_S)] == ["HELLO"]
    talk.take(welcome(), 0.3)
    assert talk.busy == ""


def test_errors_within_a_session_are_the_policys_to_judge() -> None:
    talk = live()
    assert talk.take(error("refused"), 0.1) is not None
    assert talk.state is ConversationState.LIVE
