"""The terminal keyboard: what keys mean, and a terminal that is always given back."""

import os
import random

import numpy as np
import pytest

from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.leaders.bundled.keyboard import HELP, HOLD, IDLE, KEYS, SPEEDS, Keyboard, Typing
from surg_teleop.leaders.leader import LeaderError

TICK = 0.01


def rate(sample: LeaderSample | None) -> list[float]:
    assert sample is not None
    assert sample.rate is not None
    return [*sample.rate.v_V.tolist(), sample.rate.roll]


@pytest.mark.parametrize(
    ("keys", "axis", "sign"),
    [
        (("d", "\x1b[C", "\x1bOC"), 0, 1),
        (("a", "\x1b[D", "\x1bOD"), 0, -1),
        (("s", "\x1b[B", "\x1bOB"), 1, 1),
        (("w", "\x1b[A", "\x1bOA"), 1, -1),
        (("e",), 2, 1),
        (("q",), 2, -1),
        (("l",), 3, 1),
        (("j",), 3, -1),
    ],
)
def test_a_key_moves_the_picture_its_way(keys: tuple[str, ...], axis: int, sign: int) -> None:
    for key in keys:
        typing = Typing()
        typing.type(key, 1.0)
        moved = rate(typing.sample(1.0))
        assert np.sign(moved[axis]) == sign
        assert [v for i, v in enumerate(moved) if i != axis] == [0.0] * 3


def test_a_tap_counts_for_a_moment_and_a_held_key_until_it_is_let_go() -> None:
    typing = Typing()
    typing.type("d", 0.0)
    assert rate(typing.sample(HOLD))[0] > 0
    assert rate(typing.sample(HOLD + 0.001))[0] == 0
    for i in range(100):  # the slowest console: 10.9 repeats a second
        typing.type("d", 1.0 + i / 10.9)
        assert rate(typing.sample(1.0 + (i + 0.99) / 10.9))[0] > 0
    assert rate(typing.sample(1.0 + 99 / 10.9 + HOLD + 0.001))[0] == 0


def test_nobody_at_the_keys_is_silence() -> None:
    typing = Typing()
    assert typing.sample(0.0) is None
    typing.type("d", 5.0)
    assert typing.sample(5.0 + IDLE) is not None
    assert typing.sample(5.0 + IDLE + 0.001) is None
    typing.type("?", 30.0)  # a key without a meaning is nobody's act
    assert typing.sample(30.0) is None


def test_sequences_may_come_in_pieces_and_rubbish_is_passed_over() -> None:
    typing = Typing()
    for piece in "\x1b[D":
        typing.type(piece, 0.0)
    assert rate(typing.sample(0.0))[0] < 0
    typing = Typing()
    typing.type("\x1b[15~\x1b\ufffd\x00d", 0.0)
    assert rate(typing.sample(0.0))[0] > 0


def test_clutch_enable_record_speed_and_jaw() -> None:
    typing = Typing()
    typing.type(" ", 0.0)
    sample = typing.sample(0.0)
    assert sample is not None
    assert sample.buttons == {"clutch", "present"}
    assert sample.grip is None
    typing.type(" \rR", 1.0)
    sample = typing.sample(1.0)
    assert sample is not None
    assert sample.buttons == {"enable", "record", "present"}
    sample = typing.sample(2.0)
    assert sample is not None
    assert sample.buttons == {"present"}
    typing.type("+++++++++d", 3.0)
    assert rate(typing.sample(3.0))[0] == SPEEDS[-1]
    typing.type("---------d", 3.0)
    assert rate(typing.sample(3.0))[0] == SPEEDS[0]
    now, grip = 4.0, []
    for _ in range(60):
        typing.type("o", now)
        sample = typing.sample(now)
        assert sample is not None
        grip.append(sample.grip)
        now += TICK
    assert grip[-1] == pytest.approx(0.6, abs=0.06)
    assert np.all(np.diff(np.array(grip, dtype=float)) <= TICK + 1e-9)


def test_random_typing_never_moves_longer_than_its_last_key(rng: random.Random) -> None:
    for _ in range(200):
        typing, now, last = Typing(), 0.0, -np.inf
        for _ in range(100):
            now += rng.choice((0.005, 0.05, 0.3))
            if rng.random() < 0.4:
                typing.type("".join(rng.choices([*KEYS, "\x1b", "x", "é"], k=3)), now)
                last = now
            sample = typing.sample(now)
            if sample is None:
                continue
            speeds = rate(sample)
            assert np.isfinite(speeds).all()
            assert np.linalg.norm(speeds[:3]) <= np.sqrt(3) * SPEEDS[-1] + 1e-12
            assert now - last <= HOLD or speeds == [0.0] * 4


def test_the_help_names_every_key() -> None:
    for key in "wasdeqljop+-R":
        assert key in HELP


def test_what_is_no_terminal_is_refused() -> None:
    read, write = os.pipe()
    with pytest.raises(LeaderError, match="standard input is no terminal; start it in a terminal"):
        Keyboard(fd=read).open()
    os.close(read)
    os.close(write)
