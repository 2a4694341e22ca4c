"""The client library against a server of the test, over real sockets."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.policy.policy_bench import WiredBench
from helpers.policy.policy_server import PolicyServer, spec
from surg_policy_client import (
    BadAction,
    Chunk,
    NoServer,
    Observation,
    Refused,
    RemoteEnv,
    Served,
    SpecMismatch,
    VersionMismatch,
    keys,
    serve,
)
from surg_policy_client.link import Link
from surg_policy_client.serving import wanted
from surg_policy_client.wire import Message, decode

STATE = "observation.state"


class Policy:
    """Answers with what a test gives it, and notes what it saw."""

    def __init__(self, answer: Callable[[Observation], Any] = lambda o: np.zeros((4, 5))) -> None:
        self.resets: list[tuple[str, int | None]] = []
        self.seen: list[Observation] = []
        self.acks: list[dict[str, Any]] = []
        self.answer = answer

    def reset(self, instruction: str, seed: int | None) -> None:
        self.resets.append((instruction, seed))

    def act(self, observation: Observation) -> Any:
        self.seen.append(observation)
        return self.answer(observation)

    def acknowledged(self, ack: dict[str, Any]) -> None:
        self.acks.append(ack)


class Client(threading.Thread):
    """`serve` in a thread; `end` returns what it returned or raises what it raised."""

    def __init__(self, policy: Any, address: str, **options: Any) -> None:
        super().__init__(daemon=True)
        self.said: list[str] = []
        self.served: Served | None = None
        self.error: BaseException | None = None
        self._call = lambda: serve(policy, address, say=self.said.append, **options)
        self.start()

    def run(self) -> None:
        try:
            self.served = self._call()
        except BaseException as error:
            self.error = error

    def end(self) -> Served:
        self.join(10.0)
        assert not self.is_alive(), self.said
        if self.error is not None:
            raise self.error
        assert self.served is not None
        return self.served


@contextmanager
def serving(policy: Any, server: PolicyServer, **options: Any) -> Iterator[Client]:
    """A client that has been welcomed; ended by the end of an episode."""
    client = Client(policy, server.address, episodes=1, **options)
    server.wait("PING")
    yield client
    server.episode(99, "end")
    client.end()


def test_observations_are_answered_with_chunks() -> None:
    policy = Policy(lambda o: np.full((3, 5), o.step, np.float32))
    with PolicyServer() as server:
        with serving(policy, server, name="test", seed=100) as client:
            server.episode(4)
            for step in (0, 1, 7):
                act = server.ask(step, episode=4)
                assert act.head["step0"] == step + 1
                assert act.head["stamp_ns"] == step * 50_000_000
                assert act.arrays["chunk"].dtype == np.float32
                assert act.arrays["chunk"].tolist() == [[step] * 5] * 3
        assert policy.resets == [("retract the bowel", 104)]
        assert [o.step for o in policy.seen] == [0, 1, 7]
        assert policy.seen[2][STATE].tolist() == [7.0] * 9
        hello = server.wait("HELLO").head
        assert (hello["policy"], hello["wants"]) == ("test", None)
        assert server.wait("BYE").head["reason"] == "the policy ended"
    served = client.end()
    assert (served.sessions, served.episodes, served.observations) == (1, 1, 3)
    assert served.skipped == 0
    assert "task bgr, 20 Hz" in client.said[0]
    assert "privileged.task_state 2 (privileged)" in client.said[0]


@pytest.mark.parametrize(
    ("answer", "step0", "rows"),
    [
        (None, 11, 0),
        (np.ones(5), 11, 1),
        ([[1, 2, 3, 4, 5]], 11, 1),
        (Chunk(np.ones((2, 5)), 30), 30, 2),
    ],
)
def test_a_policy_may_answer_in_several_ways(answer: Any, step0: int, rows: int) -> None:
    with PolicyServer() as server, serving(lambda o: answer, server):
        act = server.ask(10)
        assert act.head["step0"] == step0
        assert act.arrays["chunk"].shape == (rows, 5)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.zeros((3, 4)), r"a chunk is \[K, 5\] \(PSM1/x"),
        (np.full((3, 5), np.nan), "row 0, PSM1/x is nan"),
        ("forward", "numbers"),
    ],
)
def test_what_is_no_action_is_not_sent_and_ends_the_policy(answer: Any, said: str) -> None:
    with PolicyServer() as server:
        client = Client(lambda o: answer, server.address)
        server.wait("PING")
        server.observe(0)
        with pytest.raises(BadAction, match=said):
            client.end()
        assert "the policy failed: BadAction" in server.wait("BYE").head["reason"]
        assert not [m for _, m in server.heard if m.kind == "ACT"]


def test_only_wanted_observations_are_asked_for() -> None:
    policy = Policy()
    with PolicyServer() as server, serving(policy, server, wants=[STATE]):
        server.observe(0, keys=[STATE])
        server.wait("ACT")
        assert list(policy.seen[0].spec.observation) == [STATE]
        assert list(policy.seen[0].arrays) == [STATE]


def test_pings_go_on_while_the_policy_thinks() -> None:
    with PolicyServer() as server, serving(lambda o: time.sleep(0.4), server):
        server.forget()
        server.observe(0)
        server.wait("ACT")
        times = [t for t, m in server.heard if m.kind == "PING"]
        assert len(times) >= 5  # of eight
        assert max(np.diff(times)) < 0.15  # the server's patience


def test_only_the_newest_observation_waits() -> None:
    policy = Policy(lambda o: time.sleep(0.2))
    with PolicyServer() as server:
        with serving(policy, server) as client:
            for step in range(10):
                server.observe(step)
                time.sleep(0.01)
            last = server._seq
            server.wait(lambda m: m.kind == "ACT" and m.head["seq"] == last)
            assert [o.step for o in policy.seen] == [0, 9]
        assert client.end().skipped == 8


def test_only_the_newest_observation_waits_also_between_acknowledgements() -> None:
    counts = {"accepted": 1, "clipped": 0, "late": 0, "stale": 0, "rejected": [], "queue": 0}
    with PolicyServer() as server:
        link = Link(server.address)
        try:
            server.wait("PING")
            for step in range(3):
                server.observe(step)
                server.say(Message("ACK", {"session": server.session, "seq": step, **counts}))
            until = time.monotonic() + 5.0
            while link.skipped < 2 and time.monotonic() < until:
                time.sleep(0.01)
            found = list(iter(lambda: link.next(0.2), None))
        finally:
            link.close()
        assert [m.kind for m in found] == ["WELCOME", "ACK", "ACK", "OBS", "ACK"]
        assert found[3].head["step"] == 2 and link.skipped == 2


def test_acknowledgements_are_counted_and_refusals_said_once() -> None:
    policy = Policy()
    with PolicyServer() as server:
        with serving(policy, server) as client:
            for seq in range(3):
                rejected = [{"step": 5, "rule": "step", "text": "90 mm in one step"}]
                counts = {"accepted": 2, "clipped": 1, "late": 3, "stale": 4, "queue": 0}
                head = {"session": 1, "seq": seq, **counts, "rejected": rejected}
                server.say(Message("ACK", head))
        served = client.end()
        assert (served.accepted, served.clipped, served.late, served.stale) == (6, 3, 9, 12)
        assert served.rejected == 3
        assert len(policy.acks) == 3
        assert client.said.count("the server rejected step 5: 90 mm in one step") == 1


# --- connections ----------------------------------------------------------------------------------


def test_nobody_there_is_said_with_what_to_do() -> None:
    with pytest.raises(NoServer, match=r"tcp://127.0.0.1:9.*0.3 s.*no server listens.*\./surg run"):
        serve(Policy(), "tcp://127.0.0.1:9", timeout_s=0.3, say=str)


@pytest.mark.parametrize("address", ["", "127.0.0.1:5555", "tcp://robot", "udp://x:1"])
def test_an_address_that_is_none_is_refused_at_once(address: str) -> None:
    with pytest.raises(ValueError, match=r"is not an address.*tcp://HOST:PORT"):
        serve(Policy(), address, say=str)


def test_a_client_waits_for_a_server_that_comes_later(tmp_path: Path) -> None:
    address = f"ipc://{tmp_path / 'wire'}"
    client = Client(Policy(), address, episodes=1)
    time.sleep(0.3)
    with PolicyServer(address=address) as server:
        server.wait("PING")
        assert server.ask(3).head["step0"] == 4
        server.episode(0, "end")
        client.end()


@pytest.mark.timed  # a server that waits a second for a core is a lost one
@pytest.mark.parametrize("how", ["killed", "silent", "restarted", "forgetful"])
def test_a_lost_server_is_found_again(how: str, tmp_path: Path) -> None:
    """Whatever ends a session: a new one begins by itself, and the policy starts afresh."""
    address = f"ipc://{tmp_path / 'wire'}"
    policy = Policy()
    server = PolicyServer(address=address)
    client = Client(policy, address, episodes=1)
    server.wait("PING")
    server.ask(3, episode=2)
    if how in ("killed", "restarted"):
        if how == "restarted":
            server.say(Message("BYE", {"session": 1, "reason": "the operator said so"}))
            time.sleep(0.1)
        server.close()
        server = PolicyServer(address=address, session=2)
    elif how == "silent":
        server.deaf = True
        time.sleep(1.1)  # the client's patience is 1 s
        server.session, server.deaf = 3, False
    else:
        server.session = 4
    server.forget()
    server.wait("HELLO")
    server.wait(lambda m: m.kind == "PING" and m.head["session"] == server.session)
    server.ask(4, episode=2)
    server.episode(2, "end", success=True)
    served = client.end()
    server.close()
    assert (served.sessions, served.episodes, served.successes) == (2, 1, 1)
    assert len(policy.resets) == 2
    assert [o.step for o in policy.seen] == [3, 4]


def test_an_observation_against_the_servers_own_spec_reaches_no_policy() -> None:
    policy = Policy()
    with PolicyServer() as server:
        client = Client(policy, server.address)
        server.wait("PING")
        server.observe(0, keys=[STATE])
        with pytest.raises(SpecMismatch, match="is missing"):
            client.end()
    assert not policy.seen


def test_what_the_codec_overlooks_ends_no_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    def overlooks(parts: Any) -> Message:
        if bytes(parts[0].buffer) == b"odd":
            raise ValueError("an oversight")
        return decode(parts)

    monkeypatch.setattr("surg_policy_client.link.decode", overlooks)
    with PolicyServer() as server, serving(Policy(), server) as client:
        server.send([server._peer, b"odd"])
        assert server.ask(1).kind == "ACT" and client.error is None


def test_the_hint_follows_the_connection() -> None:
    server = PolicyServer()
    link = Link(server.address)
    try:
        assert link.wait_for_welcome(10.0)
        server.close()
        until = time.monotonic() + 20.0
        while "no server listens" not in link.hint() and time.monotonic() < until:
            time.sleep(0.02)
        assert "no server listens" in link.hint()
    finally:
        link.close()


def test_a_connection_that_breaks_inside_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Link, wire: Any) -> None:
        raise OSError("no buffer space")

    with PolicyServer() as server:
        client = Client(Policy(), server.address)
        server.wait("PING")
        monkeypatch.setattr(Link, "_listen", broken)
        with pytest.raises(OSError, match="no buffer space"):
            client.end()


def test_another_version_is_said_with_what_to_do() -> None:
    def refuse(hello: dict[str, Any]) -> Message:
        return Message("ERR", {"code": "version", "text": "this server speaks version 3 to 4"})

    with PolicyServer(answer=refuse) as server:
        client = Client(Policy(), server.address)
        with pytest.raises(VersionMismatch, match=r"versions 1 to 2.*3 to 4.*Install"):
            client.end()


def test_a_busy_server_is_waited_for() -> None:
    busy = [True]

    def answer(hello: dict[str, Any]) -> Message | None:
        return Message("ERR", {"code": "busy", "text": "policy 'act' of host 3"}) if busy else None

    with PolicyServer(answer=answer) as server:
        with pytest.raises(NoServer, match="the server is busy: policy 'act'"):
            serve(Policy(), server.address, timeout_s=0.4, say=str)
        client = Client(Policy(), server.address, episodes=1)
        time.sleep(0.1)
        busy.clear()
        server.wait("PING")
        server.episode(0, "end")
        assert client.end().sessions == 1


def test_garbage_from_the_server_is_survived() -> None:
    with PolicyServer() as server, serving(Policy(), server):
        for parts in ([b""], [b"x" * 100], [b""] * 50, [b"SPB1\x03\x80", b"y"]):
            server.send([server._peer, *parts])
        assert server.ask(0).head["seq"] == 1


# --- keys -----------------------------------------------------------------------------------------


def test_with_keys_policy_and_server_find_each_other(tmp_path: Path) -> None:
    keys.make(tmp_path)
    with PolicyServer(keys=tmp_path) as server, serving(Policy(), server, keys=tmp_path):
        assert server.ask(0).arrays["chunk"].shape == (4, 5)


@pytest.mark.parametrize(
    ("server_has", "client_has", "said"),
    [
        ("ours", None, "uses keys"),
        (None, "ours", "uses keys"),
        ("ours", "unknown", "does not know this client's key"),
        ("ours", "other server", "uses keys"),
    ],
)
def test_keys_that_do_not_fit_are_told_apart(
    server_has: str | None, client_has: str | None, said: str, tmp_path: Path
) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    keys.make(ours)
    keys.make(theirs)
    mine = {None: None, "ours": keys.client_keys(ours)}.get(client_has)
    if client_has == "unknown":  # knows the server, and is not known there
        own = keys.client_keys(theirs)
        mine = keys.ClientKeys(own.public, own.secret, keys.client_keys(ours).server)
    elif client_has == "other server":
        own = keys.client_keys(ours)
        mine = keys.ClientKeys(own.public, own.secret, keys.client_keys(theirs).server)
    with PolicyServer(keys=ours if server_has else None) as server:
        with pytest.raises(NoServer, match=said):
            serve(Policy(), server.address, keys=mine, timeout_s=0.4, say=str)
        assert server.heard == []


def test_a_server_that_gets_the_right_keys_is_found(tmp_path: Path) -> None:
    """A handshake that failed is not the end: the client tries again by itself."""
    keys.make(tmp_path)
    address = f"ipc://{tmp_path / 'wire'}"
    with PolicyServer(address=address, keys=tmp_path):
        client = Client(Policy(), address, episodes=1)
        time.sleep(0.2)
        assert client.is_alive()
    with PolicyServer(address=address) as server:
        server.wait("PING")
        server.episode(0, "end")
        client.end()


# --- as an environment ----------------------------------------------------------------------------


def test_an_environment_steps_and_ends() -> None:
    with PolicyServer() as server, RemoteEnv(server.address, timeout_s=5.0) as env:
        server.wait("PING")
        server.episode(0)
        server.observe(0)
        observation, info = env.reset()
        assert (observation.step, info["success"]) == (0, None)
        answer = threading.Timer(0.1, lambda: server.observe(1))
        answer.start()
        observation, reward, terminated, truncated, info = env.step(np.zeros(5))
        assert (observation.step, reward, terminated, truncated) == (1, 0.0, False, False)
        assert server.wait("ACT").head["step0"] == 1
        threading.Timer(0.1, lambda: server.episode(0, "end", True)).start()
        observation, _, terminated, _, info = env.step(np.zeros(5))
        assert terminated
        assert (info["success"], observation.step) == (True, 1)
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(np.zeros(5))
        threading.Timer(0.2, lambda: (server.wait("RESET"), server.observe(0, 1))).start()
        observation, _ = env.reset()
        assert observation.episode == 1


def test_an_episode_that_is_broken_off_is_truncated_and_the_next_one_is_not_its_next_step() -> None:
    with PolicyServer() as server, RemoteEnv(server.address, timeout_s=5.0) as env:
        server.wait("PING")
        server.observe(3)
        env.reset()
        threading.Timer(0.1, lambda: server.observe(0, 1)).start()
        observation, _, terminated, truncated, info = env.step(np.zeros(5))
        assert (observation.episode, observation.step) == (0, 3)
        assert (terminated, truncated, info["success"]) == (False, True, None)
        assert "another session or episode" in info["reason"]
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(np.zeros(5))
        observation, info = env.reset()
        assert (observation.episode, observation.step, info["reason"]) == (1, 0, "")
        threading.Timer(0.1, lambda: server.observe(1, 1)).start()
        observation, _, _, truncated, _ = env.step(np.zeros(5))
        assert (observation.step, truncated) == (1, False)


def test_an_environment_that_is_refused_says_so() -> None:
    with PolicyServer() as server, RemoteEnv(server.address, timeout_s=5.0) as env:

        def refuse() -> None:
            server.wait("RESET")
            server.say(Message("ERR", {"code": "refused", "text": "the operator starts episodes"}))

        server.wait("PING")
        server.observe(0)
        env.reset()
        threading.Timer(0.1, lambda: server.observe(1)).start()
        env.step(np.zeros(5))
        threading.Thread(target=refuse, daemon=True).start()
        with pytest.raises(Refused, match="the operator starts episodes") as caught:
            env.reset()
        assert caught.value.code == "refused"


def test_an_environment_waits_for_the_episodes_that_the_model_server_begins() -> None:
    """As under `./surg run`: welcomed before the arm is there; the next one begins by itself."""

    def begin() -> None:
        with server.lock:
            assert server.server.enable(True, server.now) == ""

    def end() -> None:
        with server.lock:
            server.server.episode_over(True, "done")
        if episode == 1:
            threading.Timer(0.7, begin).start()

    with WiredBench() as server, RemoteEnv(server.address, timeout_s=10.0) as env:
        threading.Timer(0.7, begin).start()
        for episode in (1, 2):
            observation, info = env.reset()
            assert (observation.episode, info["success"]) == (episode, None)
            _, _, terminated, _, _ = env.step(observation.held_action())
            assert not terminated
            with pytest.raises(Refused, match="server's side"):
                env.reset()  # in the middle of one, which goes on
            threading.Timer(0.1, end).start()
            while not terminated:
                observation, _, terminated, _, info = env.step(observation.held_action())
            assert info["success"] is True


def test_an_environment_without_episodes_gives_up_in_time() -> None:
    began_none = pytest.raises(NoServer, match="began no episode within")
    with PolicyServer() as server, RemoteEnv(server.address, timeout_s=0.2) as env, began_none:
        env.reset()


def test_an_environment_that_was_paused_says_why() -> None:
    with PolicyServer() as server, RemoteEnv(server.address, timeout_s=0.5) as env:
        server.wait("PING")
        server.observe(0)
        env.reset()
        server.episode(0, "paused")
        with pytest.raises(NoServer, match="was paused: as the test says"):
            env.step(np.zeros(5))


# --- what a policy sees ---------------------------------------------------------------------------


def test_numbers_have_names_and_holding_is_an_action() -> None:
    state = np.arange(9, dtype=np.float32)
    observation = Observation({STATE: state}, 0, 0, 0, "", spec())
    assert observation.named("PSM1/set_y") == 6.0
    assert observation.held_action().tolist() == [5.0, 6.0, 7.0, 8.0, 4.0]
    with pytest.raises(KeyError, match="PSM1/tip_x"):
        observation.named("PSM1/speed")
    with pytest.raises(KeyError, match="name it in `wants`"):
        Observation({}, 0, 0, 0, "", spec()).held_action()
    with pytest.raises(KeyError, match=r"images.left: not served.*`wants`.*observation.state"):
        observation["observation.images.left"]


def test_wants_may_be_one_key() -> None:
    assert wanted(STATE) == wanted([STATE])
