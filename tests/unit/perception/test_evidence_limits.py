"""Each limit of a calibration from both sides: at the limit accepted, just beyond it refused.

The results are made up, without a solver: only their evidence counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from helpers.perception.made_up_fits import SIZE, base, handeye, stereo
from surg_perception.calibration import evidence
from surg_perception.calibration.bases import SeenBase
from surg_perception.calibration.handeye import HandEyeFit
from surg_perception.calibration.stereo import StereoFit

HAIR = 1e-9
"""Share beyond a limit that must already be refused."""


def tips(apart: float = 0.04) -> np.ndarray:
    return np.array([[0.0, 0.0, 0.0], [apart, 0.0, 0.0], [apart / 2, 0.0, 0.0]])


def refusals(check: Callable[[], None]) -> tuple[str, ...]:
    """The limits that are not met, by name."""
    try:
        check()
    except evidence.Refused as refused:
        return tuple(reason.split(":")[0] for reason in refused.reasons)
    return ()


def beyond(limit: float) -> float:
    return limit * (1.0 + HAIR)


def below(limit: float) -> float:
    return limit * (1.0 - HAIR)


def of_stereo() -> Iterator[tuple[str, StereoFit, StereoFit]]:
    yield "views", stereo(views=12), stereo(views=11)
    for key, name, limit in (
        ("held_out", "held-out error", 0.5),
        ("rows", "rows", 0.5),
    ):
        yield name, stereo(**{key: limit}), stereo(**{key: beyond(limit)})
        yield name, stereo(**{key: limit}), stereo(**{key: float("nan")})
    for eye in ("left", "right"):
        good, bad = stereo(**{eye: 0.9 + HAIR}), stereo(**{eye: 0.9 - HAIR})
        yield f"coverage of the {eye} picture", good, bad
    yield "baseline", stereo(baseline=0.0005), stereo(baseline=below(0.0005))
    yield "baseline", stereo(baseline=0.05), stereo(baseline=beyond(0.05))
    yield "baseline", stereo(), stereo(baseline=-0.004)
    at, over = np.full(9, 0.002), np.full(9, beyond(0.002))
    yield "error in space (95 %)", stereo(errors=at), stereo(errors=over)


@pytest.mark.parametrize(("name", "good", "bad"), of_stereo())
def test_a_limit_of_the_lenses(name: str, good: StereoFit, bad: StereoFit) -> None:
    assert refusals(lambda: evidence.check_stereo(good, SIZE)) == ()
    assert refusals(lambda: evidence.check_stereo(bad, SIZE)) == (name,)


def of_handeye() -> Iterator[tuple[str, HandEyeFit, HandEyeFit]]:
    yield "views", handeye(views=10), handeye(views=9)
    yield "turns", handeye(turns=(40.0, 20.0 + HAIR)), handeye(turns=(40.0, 20.0 - HAIR))
    yield "rms", handeye(rms=below(1.0)), handeye(rms=beyond(1.0))
    limit = np.radians(0.5)
    yield "expected error", handeye(turn=below(limit)), handeye(turn=beyond(limit))
    yield "expected error", handeye(shift=below(0.001)), handeye(shift=beyond(0.001))
    yield "focal length", handeye(factor=below(0.0025)), handeye(factor=beyond(0.0025))
    far = {"sd": 0.001}
    yield "focal length", handeye(factor=0.00399, **far), handeye(factor=0.00401, **far)


@pytest.mark.parametrize(("name", "good", "bad"), of_handeye())
def test_a_limit_of_the_hand_eye_pose(name: str, good: HandEyeFit, bad: HandEyeFit) -> None:
    assert refusals(lambda: evidence.check_handeye(good)) == ()
    assert refusals(lambda: evidence.check_handeye(bad)) == (name,)


def of_touch() -> Iterator[tuple[str, SeenBase, SeenBase]]:
    turn, shift = np.radians(0.08), 0.0002
    yield "touches", base(n=6), base(n=5)
    yield "touches", base(patch=0.004), base(patch=below(0.004))
    yield "expected error", base(turn=below(turn)), base(turn=beyond(turn))
    yield "expected error", base(shift=below(shift)), base(shift=beyond(shift))
    yield "expected error", base(), base(turn=float("nan"))


@pytest.mark.parametrize(("name", "good", "bad"), of_touch())
def test_a_limit_of_a_base_by_touch(name: str, good: SeenBase, bad: SeenBase) -> None:
    assert refusals(lambda: evidence.check_touch(good)) == ()
    assert refusals(lambda: evidence.check_touch(bad)) == (name,)


def test_a_refused_base_states_how_many_touches_would_do() -> None:
    twice = base(turn=2.0 * np.radians(0.08), n=16)
    assert twice.points_for(np.radians(0.08), 0.0002) == 64
    assert base(shift=0.0006, n=16).points_for(np.radians(0.08), 0.0002) == 144
    with pytest.raises(evidence.Refused, match="64 touches"):
        evidence.check_touch(twice)
    for share in (1.0, 0.8):  # more touches would not do, or too many
        with pytest.raises(evidence.Refused, match="handeye"):
            evidence.check_touch(base(turn=np.radians(0.09), by_eye=share))


def of_tip() -> Iterator[tuple[str, tuple[SeenBase, float], tuple[SeenBase, float]]]:
    limit = np.radians(2.0)
    yield "rests", (base(n=8), 0.04), (base(n=7), 0.04)
    yield "rests", (base(), 0.030), (base(), below(0.030))
    yield "expected error", (base(turn=below(limit)), 0.04), (base(turn=beyond(limit)), 0.04)


@pytest.mark.parametrize(("name", "good", "bad"), of_tip())
def test_a_limit_of_a_base_by_tip(
    name: str, good: tuple[SeenBase, float], bad: tuple[SeenBase, float]
) -> None:
    assert refusals(lambda: evidence.check_tip(good[0], tips(good[1]))) == ()
    assert refusals(lambda: evidence.check_tip(bad[0], tips(bad[1]))) == (name,)
