"""Questions to a dashboard server that answers late, never, or something else."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
from collections.abc import Callable

import pytest

from helpers.results.hardware_results import FUZZ_DASHBOARD, note
from surg_hardware.ur import dashboard

ROUNDS = 30_000 if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 300
GREETING = b"Connected: Universal Robots Dashboard Server\n"


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes], list[str]]:
    """Asks two questions of a server that sends these bytes and closes."""

    def ask(said: bytes) -> list[str]:
        ours, theirs = socket.socketpair()
        ours.settimeout(0.5)
        monkeypatch.setattr(socket, "create_connection", lambda *given: ours)
        theirs.sendall(said)
        theirs.shutdown(socket.SHUT_WR)
        with theirs:
            return dashboard.ask("127.0.0.1", ("get serial number", "get robot model"), 0.5)

    return ask


def test_the_answers_come_in_order_wherever_the_lines_are_cut(
    ask: Callable[[bytes], list[str]],
) -> None:
    assert ask(GREETING + b"20225500001\nUR5\n") == ["20225500001", "UR5"]


def test_random_answers_are_read_or_refused(ask: Callable[[bytes], list[str]]) -> None:
    rng = random.Random(3)
    read = refused = 0
    for _ in range(ROUNDS):
        said = bytearray(GREETING if rng.random() < 0.8 else b"")
        for _ in range(rng.randrange(4)):
            said += rng.choice((b"true\n", b"\n", b"\0", rng.randbytes(rng.randrange(6000))))
        try:
            assert len(ask(bytes(said))) == 2
            read += 1
        except OSError:
            refused += 1
    note(FUZZ_DASHBOARD, ROUNDS, f"{read} read, {refused} refused")
    assert read > ROUNDS // 10 and refused > ROUNDS // 10


def test_a_server_that_sends_a_byte_now_and_then_is_left_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = socket.socketpair()
    ours.settimeout(0.2)
    monkeypatch.setattr(socket, "create_connection", lambda *given: ours)
    ended = threading.Event()

    def drip() -> None:
        while not ended.wait(0.05):
            theirs.send(b"x")

    thread = threading.Thread(target=drip)
    thread.start()
    began = time.monotonic()
    try:
        with pytest.raises(OSError):
            dashboard.ask("127.0.0.1", (), 0.2)
        assert time.monotonic() - began < 1.0
    finally:
        ended.set()
        thread.join()
        theirs.close()
