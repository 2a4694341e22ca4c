"""Two devices' pictures are paired by the nearest stamps within half a period."""

import random

import pytest

from surg_perception.capture.eye_pairing import NOT_SYNCHRONISED, EyePairer, OffsetReport

MS = 1_000_000
PERIOD = 33 * MS


def run(
    pairer: EyePairer, right_offset: int, right_period: int = PERIOD, seconds: float = 10.0
) -> list[tuple[int, int]]:
    """Feed both eyes in the order of their stamps; the stamps of each pair, by the pictures."""
    count = int(seconds * 1e9 / PERIOD)
    begin = 1_000 * MS
    stamps = [(begin + n * PERIOD, 0) for n in range(count)]
    stamps += [(begin + right_offset + n * right_period, 1) for n in range(count)]
    pairs = [pairer.add(eye, stamp, stamp) for stamp, eye in sorted(stamps)]
    return [(pair.left, pair.right) for pair in pairs if pair is not None]


@pytest.mark.parametrize("offset", [0, 3 * MS, -7 * MS, 15 * MS])
def test_a_constant_offset_pairs_every_picture_and_is_reported(offset: int) -> None:
    pairer = EyePairer(PERIOD)
    pairs = run(pairer, offset)
    assert len(pairs) == 303
    assert {right - left for left, right in pairs} == {offset}
    assert pairer.report() == OffsetReport(303, offset, 0.0, "")
    assert pairer.report().pairs == 0


def test_both_eyes_leave_with_the_mean_stamp() -> None:
    pairer = EyePairer(PERIOD)
    pairer.add(1, 1010 * MS, "right")
    pair = pairer.add(0, 1000 * MS, "left")
    assert pair == (1005 * MS, "left", "right")


def test_stamps_half_a_period_apart_make_no_pair() -> None:
    pairer = EyePairer(PERIOD)
    pairer.add(0, 1000 * MS, "left")
    assert pairer.add(1, 1000 * MS + PERIOD // 2 + 1, "right") is None
    assert pairer.add(0, 1000 * MS + PERIOD, "left 2") is not None  # 16 ms after the right one


def test_lost_pictures_never_pair_with_the_wrong_one() -> None:
    choose = random.Random(5)
    pairer = EyePairer(PERIOD)
    pairs = []
    for n in range(2000):
        for eye, late in ((0, 0), (1, 4 * MS)):
            if choose.random() < 0.2:
                continue
            pair = pairer.add(eye, 1000 * MS + n * PERIOD + late, n)
            pairs += [pair] if pair else []
    assert len(pairs) > 1100
    assert all(pair.left == pair.right for pair in pairs)


def test_other_rates_are_not_synchronised() -> None:
    pairer = EyePairer(PERIOD)
    run(pairer, 0, right_period=40 * MS)
    assert pairer.report().problem == NOT_SYNCHRONISED


def test_a_period_that_nobody_stated_is_estimated() -> None:
    pairer = EyePairer()
    pairs = run(pairer, 5 * MS)
    assert pairer.period_ns == PERIOD
    assert len(pairs) >= 301


def test_silence_of_one_eye_makes_no_pair_and_is_bounded() -> None:
    pairer = EyePairer(PERIOD)
    assert all(pairer.add(0, n * PERIOD, n) is None for n in range(1, 100))
    assert [len(each) for each in pairer._waiting] == [4, 0]


def test_a_clock_set_back_begins_anew() -> None:
    pairer = EyePairer(PERIOD)
    run(pairer, 0)
    assert len(run(pairer, 0, seconds=1.0)) == 30
