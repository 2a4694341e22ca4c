"""What the tip's motion in the pictures says about the registration of the camera.

Pure geometry: places of the tip in one or two pictures in, a verdict in plain words out. With two
eyes the tip is triangulated, the sign of the disparity kept apart; the matrix S then has in its
columns how the tip was *seen* to move, in the camera's axes, per metre that it was *told* to move
right, down and away. A right registration shows S = identity.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_teleop.frames.probe_moves import AXES, REST, SIDE, WORDS, Step
from surg_teleop.frames.tip_tracker import Place

Array = NDArray[np.float64]

ANGLE = np.radians(20.0)
"""From which angle between hand and picture on a registration is wrong: less is not felt."""
SIZES = (0.6, 1.6)
"""Allowed lengths of what is seen, as shares of what was told."""
MATCHED = 0.8
"""[px] How well the difference of two disparities is known: far away it says little of depth."""
LEAST = 3.0
"""[px] Less than this between the two sides of an axis across the view is no motion."""


class Cause(enum.Enum):
    """What is most likely wrong."""

    NONE = "none"
    MIRRORED = "mirrored"
    UPSIDE_DOWN = "upside_down"
    TURNED = "turned"
    TILTED = "tilted"
    EYES_SWAPPED = "eyes_swapped"
    SIZE = "size"
    NOT_SEEN = "not_seen"


class Outcome(enum.Enum):
    """Whether the registration can be trusted. Only PASS allows teleoperation by this picture."""

    PASS = "pass"
    FAIL = "fail"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True)
class Lens:
    """The camera's model.

    Attributes:
        f: Focal length [px].
        centre: (2,) principal point of the left picture [px].
        baseline: Distance of the right eye to the right of the left one [m]; 0: one eye.
    """

    f: float
    centre: Array
    baseline: float = 0.0


@dataclass(frozen=True)
class Seen:
    """One axis: what was told and what was seen.

    Attributes:
        told: "right", "down" or "away".
        pixels: (2,) motion in the left picture from the one side to the other [px].
        disparity: Its change [px]; None with one eye.
        metres: (3,) the same in the camera's axes, per metre told; with one eye only its direction
            across the view counts, and z is not a number.
    """

    told: str
    pixels: Array
    disparity: float | None
    metres: Array


@dataclass(frozen=True)
class Verdict:
    """The outcome.

    Attributes:
        outcome: Pass, fail, or cannot tell.
        cause: What is most likely wrong.
        text: The same for a person: what was seen, the likely cause, the cure.
        seen: The axes, in the order right, down, away.
        angle: Between hand and picture [rad]; not a number where nothing was seen.
    """

    outcome: Outcome
    cause: Cause
    text: str
    seen: tuple[Seen, ...] = ()
    angle: float = float("nan")


def not_seen(reason: str) -> Verdict:
    """The verdict when the pictures show too little."""
    return Verdict(Outcome.CANNOT_TELL, Cause.NOT_SEEN, f"cannot tell: {reason}")


def judge(places: Mapping[Step, Place], lens: Lens, side: float = SIDE) -> Verdict:
    """Compare what was seen with what was told.

    Args:
        places: The tip at rest and at both sides of every axis.
        lens: Of the left eye.
        side: How far each side was from rest [m].
    """
    rest = places[REST]
    two_eyes = rest.disparity is not None and lens.baseline > 0.0
    seen = tuple(_axis(places, axis, lens, side, two_eyes) for axis in AXES)
    still = [s.told for s in seen[:2] if float(np.hypot(*s.pixels)) < LEAST]
    if still:
        return not_seen(
            f"told to go {' and '.join(still)}, the tip hardly moved in the picture. Is it held by "
            "tissue, is the picture delayed or frozen, or does the endoscope move along?"
        )
    if two_eyes:
        return _judge_pair(seen, rest, lens, side)
    return _judge_flat(seen)


def _axis(places: Mapping[Step, Place], axis: int, lens: Lens, side: float, two_eyes: bool) -> Seen:
    plus, minus = places[Step(axis, 1)], places[Step(axis, -1)]
    pixels, change = plus.left - minus.left, None
    metres = np.full(3, np.nan)
    if two_eyes:
        ends = [_triangulate(place, lens) for place in (plus, minus)]
        metres = (ends[0] - ends[1]) / (2.0 * side)
        sizes = [_signed(place) for place in (plus, minus)]
        change = abs(sizes[0]) - abs(sizes[1])
    else:
        metres[:2] = pixels
    return Seen(WORDS[axis, 1], pixels, change, metres)


def _signed(place: Place) -> float:
    """Disparity along the direction it has: a picture turned by a quarter has it upright."""
    assert place.disparity is not None
    return float(max(place.disparity, key=abs))


def _triangulate(place: Place, lens: Lens) -> Array:
    """Where the tip seems to be, in the camera's axes [m], (3,), whichever eye is which."""
    z = lens.f * lens.baseline / max(abs(_signed(place)), 1e-3)
    across = (place.left - lens.centre) * z / lens.f
    return np.array([across[0], across[1], z])


def _judge_pair(seen: tuple[Seen, ...], rest: Place, lens: Lens, side: float) -> Verdict:
    assert rest.disparity is not None
    S = np.column_stack([s.metres for s in seen])
    U, _, Vt = np.linalg.svd(S)
    R = U @ Vt
    upright = abs(rest.disparity[1]) > abs(rest.disparity[0])
    swapped = not upright and rest.disparity[0] < 0.0
    angle = _angle(R)
    if np.linalg.det(R) < 0.0:
        return _mirrored(seen, R, swapped)
    if angle < ANGLE:
        if swapped or upright:
            text = (
                "left and right eye are swapped: the tip stands farther left in the left picture "
                "than in the right one, as nothing in front of the lenses can. Near and far are "
                "exchanged for the viewer. Swap the two cameras' cables, devices or topics"
            )
            return Verdict(Outcome.FAIL, Cause.EYES_SWAPPED, text, seen, angle)
        sizes = np.linalg.norm(S, axis=0)
        # Of depth, the disparity changes by d^2 / (f b) per metre.
        change = _signed(rest) ** 2 * 2.0 * side / (lens.f * lens.baseline)
        slack = np.array([0.0, 0.0, MATCHED / change])
        if (sizes < SIZES[0] - slack).any() or (sizes > SIZES[1] + slack).any():
            return _wrong_size(seen, sizes, angle)
        text = f"hand and picture agree within {np.degrees(angle):.0f} degrees"
        return Verdict(Outcome.PASS, Cause.NONE, text, seen, angle)
    return _turned(seen, R, angle, swapped or upright)


def _judge_flat(seen: tuple[Seen, ...]) -> Verdict:
    """With one eye: only what is across the view."""
    S = np.column_stack([s.metres[:2] for s in seen[:2]])
    U, sizes, Vt = np.linalg.svd(S)
    R = np.eye(3)
    R[:2, :2] = U @ Vt
    angle = _angle(R)
    if np.linalg.det(R) < 0.0:
        return _mirrored(seen, R, False)
    if angle >= ANGLE:
        return _turned(seen, R, angle, False)
    if sizes.max() > sizes.min() * SIZES[1]:
        return _wrong_size(seen, sizes / sizes.max(), angle)
    text = (
        f"hand and picture agree within {np.degrees(angle):.0f} degrees across the view; with one "
        "eye near and far are not judged"
    )
    return Verdict(Outcome.PASS, Cause.NONE, text, seen, angle)


def _mirrored(seen: tuple[Seen, ...], R: Array, swapped: bool) -> Verdict:
    """A hand that goes one way and a tip that goes the other, as in a mirror."""
    _, vectors = np.linalg.eigh((R + R.T) / 2.0)
    normal = np.abs(vectors[:, 0])  # of the mirror: the direction that is reversed
    axis = int(np.argmax(normal))
    pair = ("left and right", "up and down", "near and far")[axis]
    where = (
        "each picture is flipped by itself: look for a mirror setting of capture or display"
        if swapped or axis == 1
        else "the pictures are flipped as in a mirror, or the camera's pose is left-handed"
    )
    if axis == 2:
        where = "the sign of the camera's z axis is wrong: z points away from the viewer"
    text = f"the picture is mirrored: {pair} are exchanged ({_told(seen)}). Likely {where}"
    return Verdict(Outcome.FAIL, Cause.MIRRORED, text, seen, _angle(R))


def _turned(seen: tuple[Seen, ...], R: Array, angle: float, each: bool) -> Verdict:
    """Hand and picture differ by a rotation."""
    turn = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    size = float(np.linalg.norm(turn))
    axis = turn / size if size > 0.05 else _half_turn_axis(R)
    about_view = abs(axis[2]) > 0.9
    degrees = float(np.degrees(angle))
    if about_view and degrees > 160.0:
        cause, what = Cause.UPSIDE_DOWN, "the picture is upside down"
    elif about_view:
        way = "clockwise" if axis[2] > 0 else "anticlockwise"
        cause, what = Cause.TURNED, f"the picture is turned by {degrees:.0f} degrees {way}"
    else:
        cause = Cause.TILTED
        what = (
            f"hand and picture differ by a turn of {degrees:.0f} degrees that is not about the view"
        )
    if each:
        why = "each picture is turned by itself: look for a rotation setting of capture or display"
    elif about_view:
        why = (
            "the camera head is turned in its holder, or the camera's frame is, in the endoscope's "
            "URDF or in calibration/camera_<arm>.yaml"
        )
    else:
        why = (
            "the base of one of the two arms in cell.yaml (arms.….base), or the endoscope's tool "
            "calibration"
        )
    return Verdict(Outcome.FAIL, cause, f"{what} ({_told(seen)}). Likely {why}", seen, angle)


def _wrong_size(seen: tuple[Seen, ...], sizes: Array, angle: float) -> Verdict:
    text = (
        f"directions agree, sizes do not: seen were {sizes.min():.1f} to {sizes.max():.1f} times "
        "what was told. Likely focal length or baseline of the camera, or the tip was held up"
    )
    return Verdict(Outcome.FAIL, Cause.SIZE, text, seen, angle)


def _told(seen: tuple[Seen, ...]) -> str:
    return ", ".join(f"told {s.told}, seen {direction(s.metres)}" for s in seen)


def direction(v: Array) -> str:
    """The words for a direction in V, such as "right", or "left and up".

    Args:
        v: (3,), z may be not a number: then only what is across the view is named.
    """
    v = np.nan_to_num(v)
    size = float(np.linalg.norm(v))
    parts = [
        (abs(v[axis]), WORDS[axis, 1 if v[axis] > 0 else -1])
        for axis in AXES
        if abs(v[axis]) > 0.38 * size
    ]
    return " and ".join(word for _, word in sorted(parts, reverse=True)) or "nothing"


def _angle(R: Array) -> float:
    return float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))


def _half_turn_axis(R: Array) -> Array:
    """The axis of a rotation by about half a turn."""
    _, vectors = np.linalg.eigh((R + R.T) / 2.0)
    return np.asarray(vectors[:, -1])
