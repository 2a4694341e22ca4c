"""A header's map: as msgpack reads it, within its limits, and nothing is kept of a wrong one."""

from __future__ import annotations

import gc
import random
from contextlib import suppress
from typing import Any

import msgpack
import numpy as np
import pytest

from surg_policy_client import header


def value(rng: random.Random, depth: int) -> Any:
    """Anything that a header may hold."""
    kind = rng.randrange(8 if depth else 6)
    if kind == 6:
        return [value(rng, depth - 1) for _ in range(rng.randrange(5))]
    if kind == 7:
        return {f"k{i}": value(rng, depth - 1) for i in range(rng.randrange(5))}
    scale = 2.0 ** rng.randrange(63)
    return (None, rng.random() < 0.5, int(scale), -int(scale), rng.gauss(0, scale), "x" * int(
        rng.random() * 300
    ))[kind]  # fmt: skip


def maps(count: int) -> list[dict[str, Any]]:
    rng = random.Random(5)
    return [{f"f{i}": value(rng, 4) for i in range(rng.randrange(20))} for _ in range(count)]


def test_it_reads_what_msgpack_wrote(full: bool) -> None:
    number = 20_000 if full else 300
    for each in maps(number):
        assert header.read_map(memoryview(msgpack.packb(each))) == each
    print(f"{number} maps")


def test_what_it_takes_of_broken_ones_msgpack_reads_alike(full: bool) -> None:
    """Bytes changed, cut off, doubled: refused with a ValueError, or what msgpack says."""
    rng = random.Random(6)
    number, taken = (200_000 if full else 3000), 0
    whole = [msgpack.packb(each) for each in maps(300)]
    for _ in range(number):
        data = bytearray(rng.choice(whole))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        if rng.random() < 0.3:
            del data[rng.randrange(len(data)) :]
        try:
            found = header.read_map(bytes(data))
        except ValueError:
            continue
        taken += 1
        wanted = msgpack.unpackb(bytes(data), raw=False)
        assert str(found) == str(wanted)  # nan is not itself
    print(f"{number} broken maps, {taken} of them still maps")
    assert 0 < taken < number


WRONG = {
    "a depth bomb of lists": b"\x81\xa1a" + b"\x91" * 100_000,
    "a depth bomb of maps": b"\x81\xa1a" * 30_000,
    "lists that end in nothing known": b"\x81\xa1a" + b"\x9a\x01\x02" * 10 + b"\xc1",
    "lists that are cut off": b"\x81\xa1a" + b"\xdc\x03\xff" * 10,
    "many values": msgpack.packb({"a": [[1] * 1000] * 17}),
    "text in lists that is no UTF-8": b"\x81\xa1a\x9a\x93" + b"\x01" * 9 + b"\xa1\xff",
    "a twin in lists": b"\x81\xa1a\x92\x93\x01\x02\x03\x82\xa1b\x01\xa1b\x02",
}


@pytest.mark.parametrize("name", WRONG)
def test_nothing_is_kept_of_a_wrong_one(name: str) -> None:
    """The reader of msgpack keeps every list that it had begun, for good."""

    def refuse(times: int) -> int:
        for _ in range(times):
            with pytest.raises(ValueError):
                header.read_map(WRONG[name])
        gc.collect()
        return len(gc.get_objects())

    before = refuse(3)
    assert refuse(100) < before + 50


def test_the_limits_are_limits() -> None:
    """The last that is allowed, and one more."""
    for inside, outside, words in (
        ({"a": [1] * 1024}, {"a": [1] * 1025}, "1025 entries; at most 1024"),
        ({str(i): 1 for i in range(256)}, {str(i): 1 for i in range(257)}, "at most 256"),
        ({"a": "x" * 65536}, {"a": "x" * 65537}, "65536"),
        (nested(15), nested(16), "more than 16 deep"),
        (wide(0), wide(1), "more than 16384 values"),
    ):
        assert header.read_map(msgpack.packb(inside)) == inside
        with pytest.raises(ValueError, match=words):
            header.read_map(msgpack.packb(outside))


def nested(depth: int) -> dict[str, Any]:
    """A map with lists within it."""
    found: Any = 1
    for _ in range(depth):
        found = [found]
    return {"a": found}


def wide(more: int) -> dict[str, Any]:
    """As many values as there may be: the map, its key, a list, the lists in it and theirs."""
    lists = [[1] * 1000] * 16
    rest = header.MAX_VALUES - 3 - 16 * 1001 - 1
    return {"a": [*lists, [1] * (rest + more)]}


def test_what_is_no_map() -> None:
    for data in (b"", b"\x01", b"\x91\x01", b"\xc0", b"\x80\x80", b"\x81", b"\x81\x01\x01"):
        with pytest.raises(ValueError):
            header.read_map(data)
    assert header.read_map(b"\x80") == {}
    rng = np.random.default_rng(7)
    for _ in range(2000):
        with suppress(ValueError):
            header.read_map(rng.bytes(int(rng.integers(1, 300))))
