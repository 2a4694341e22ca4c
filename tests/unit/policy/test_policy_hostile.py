"""Bad frames against the model server, with a good message accepted in the same run."""

from __future__ import annotations

import random
import resource

import msgpack
import numpy as np
import pytest

from helpers.policy.policy_bench import HOME, MS, Bench
from helpers.results.policy_results import note
from surg_policy_bridge.server.timers import SILENCE
from surg_policy_client import wire
from surg_policy_client.wire import Message


def mutated(good: list[bytes], rng: random.Random) -> list[bytes]:
    """A good message with something wrong in it."""
    parts = list(good)
    kind = rng.randrange(7)
    at = rng.randrange(len(parts))
    if kind == 0:  # bytes turned over
        data = bytearray(parts[at])
        for _ in range(rng.randint(1, 8)):
            if data:
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        parts[at] = bytes(data)
    elif kind == 1:
        parts[at] = parts[at][: rng.randrange(len(parts[at]) + 1)]
    elif kind == 2:
        parts[at] += rng.randbytes(rng.randint(1, 50))
    elif kind == 3:
        parts = parts * rng.randint(2, 30)
    elif kind == 4:
        del parts[at]
    elif kind == 5:
        parts[0] = b"SPB1" + bytes([rng.randrange(14)]) + rng.randbytes(rng.randint(0, 200))
    else:
        head = msgpack.unpackb(parts[0][5:])
        lies = [-1, 2**70, 1e308, "x" * 70_000, None, [[[]]] * 50, {}, float("nan"), True]
        head[rng.choice([*head, "more"])] = rng.choice(lies)
        parts[0] = parts[0][:5] + msgpack.packb(head, default=str)
    return parts


def test_f17_a_storm_of_bad_frames_and_a_good_one(full: bool) -> None:
    """Whatever comes, the server goes on, and takes the good answer behind every hundredth."""
    rng = random.Random(29)
    bench = Bench()
    bench.start()
    x, bad, good = 0.0, 0, 0
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(1000 if full else 30):
        step = 2e-4 if k // 50 % 2 == 0 else -2e-4  # to and fro, inside the workspace
        bench.ping()
        bench.tick()
        bench.observe()
        parts = bench.frames(bench.here(1.0))  # a metre: no mutant may be obeyed
        for n in range(100):
            # Of strangers: what a mutant of a real action says might otherwise be one.
            peer = b"stranger" + bytes([n % 4])
            bench.endpoint.receive(peer, mutated(parts, rng), bench.now)
            bad += 1
            bench.now += 2 * MS // 10
        bench.server.replies.clear()
        x += step
        bench.act([bench.here(step)])
        done = bench.execute()
        assert done is not None and abs(done.p[0] - x) < 1e-12
        good += 1
        bench.heard = bench.heard[-50:] + bench.of("WELCOME")[:1]
        bench.now += 30 * MS
        bench.step += 1
    counters = bench.server.counters
    assert counters.accepted == good and bench.server.state.value == "RUNNING"
    assert sum(counters.malformed.values()) + counters.strangers + counters.flooded == bad
    assert sum(counters.malformed.values()) > bad / 2
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown
    note(3, bad, f"{good} good ones taken, {grown / 1024:.0f} MiB more memory")
    assert grown < 64 << 10


def test_f17_what_the_policy_in_session_sends_is_told_and_moves_nothing() -> None:
    """The same storm from the policy itself: refused or stale, but never a step of a metre."""
    rng = random.Random(31)
    for _ in range(40):
        bench = Bench()
        bench.start()
        bench.ping()
        bench.observe()
        parts = bench.frames(bench.here(1.0))
        for _ in range(20):
            bench.endpoint.receive(b"a", mutated(parts, rng), bench.now)
            bench._hear()
            bench.execute()
        assert not [t for _, t in bench.sent if np.abs(t.p - [0, 0, 0.12]).max() > 2.1e-3]


@pytest.mark.parametrize(("jump", "state"), [(1e-4, "RUNNING"), (0.05, "PAUSED")])
def test_f18_a_thousand_chunks_a_second_of_the_policy_in_session(jump: float, state: str) -> None:
    """The first answer to each observation is judged; a good policy works right after."""
    bench = Bench()
    bench.start()
    for _ in range(20):
        bench.tick()
        bench.observe()
        for n in range(50):
            bench.act([bench.here((1 + n) * jump)])
            bench.now += MS
        bench.execute()
        bench.step += 1
    server = bench.server
    assert server.state.value == state
    assert ("3 rejected steps in a row" in server.reason) == (state == "PAUSED")
    assert len(bench.sent) == (20 if state == "RUNNING" else 0)
    moved = np.diff([HOME[0], *(target.p[0] for _, target in bench.sent)])
    np.testing.assert_allclose(moved, jump, atol=1e-12)
    counters = server.counters
    assert counters.flooded > 100 and counters.stale > 500
    assert counters.flooded + counters.stale + len(bench.sent or "abc") == 1000
    bench.now += SILENCE + 1
    bench.tick()
    bench.start(b"b")
    bench.observe()
    bench.act(bench.here(1e-3), peer=b"b")
    assert bench.execute() is not None


def test_f17_what_the_codec_overlooks_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def overlooks(parts: object) -> Message:
        raise ValueError("an oversight")

    bench = Bench()
    bench.start()
    with monkeypatch.context() as patch:
        patch.setattr(wire, "decode", overlooks)
        bench.endpoint.receive(b"stranger", [b"odd"], bench.now)
    assert bench.server.counters.malformed == {"other": 1}
    assert bench.period([bench.here(1e-3)]) is not None


def test_f17_numbers_that_are_none_count_as_refusals() -> None:
    bench = Bench()
    bench.start()
    bench.observe()
    parts = bench.frames(bench.here(1e-3))
    parts[1] = np.array([np.nan] * 5).tobytes()
    for n in range(3):
        assert bench.server.state.value == "RUNNING", n
        bench.endpoint.receive(b"a", parts, bench.now)
    bench._hear()
    assert bench.server.state.value == "PAUSED" and not bench.sent
    rules = [each["rule"] for m in bench.of("ACK") for each in m.head["rejected"]]
    assert rules == ["not_finite"] * 3
