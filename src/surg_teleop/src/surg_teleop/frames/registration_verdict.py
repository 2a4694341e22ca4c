"""Judges the registration of the camera from the motion of the tip in the pictures.

Pure geometry: tip positions in one or two pictures in, a verdict out. With two eyes the tip is
triangulated from the absolute disparity. The columns of the matrix S hold the observed motion, in
the camera's axes, per metre of commanded motion right, down and away. A correct registration gives
S = identity.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from surg_core.arm_view import Array
from surg_teleop.frames.probe_moves import AXES, REST, SIDE, WORDS, ProbeMove
from surg_teleop.frames.tip_tracker import Place

ANGLE = np.radians(20.0)
"""[rad] Largest rotation error between hand and picture that operators do not notice."""
CALIBRATED_ANGLE = np.radians(8.0)
"""[rad] The same in a cell whose camera and bases are measured; the check itself errs by 3."""
SIZES = (0.6, 1.6)
"""Allowed ratio of observed to commanded motion."""
MATCHED = 0.8
"""[px] Accuracy of the difference of two disparities; it limits the depth far away."""
LEAST = 3.0
"""[px] Smallest motion between the two sides of an axis across the view."""


class Cause(enum.Enum):
    """Most likely cause."""

    NONE = "none"
    MIRRORED = "mirrored"
    UPSIDE_DOWN = "upside_down"
    TURNED = "turned"
    TILTED = "tilted"
    EYES_SWAPPED = "eyes_swapped"
    SIZE = "size"
    NOT_SEEN = "not_seen"


class RegistrationOutcome(enum.Enum):
    """Result; only PASS allows teleoperation with this picture."""

    PASS = "pass"
    FAIL = "fail"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True)
class Lens:
    """Pinhole model of the camera."""

    f: float  # focal length [px]
    centre: Array  # (2,) principal point of the left picture [px]
    baseline: float = 0.0  # distance from the left to the right eye [m]; 0: one eye


@dataclass(frozen=True)
class AxisMotion:
    """Commanded and observed motion along one axis."""

    commanded: str  # "right", "down" or "away"
    pixels: Array  # (2,) motion in the left picture from one side to the other [px]
    disparity: float | None  # change of the disparity [px]; None with one eye
    # (3,) observed motion in the camera's axes per metre commanded. With one eye only the direction
    # across the view counts, and z is NaN
    metres: Array


@dataclass(frozen=True)
class Verdict:
    """Verdict on the registration."""

    outcome: RegistrationOutcome
    cause: Cause
    text: str  # what was observed, the likely cause, and what to do
    seen: tuple[AxisMotion, ...] = ()  # motions along the axes right, down, away
    # rotation between hand and picture [rad]; NaN if the tip was not seen
    angle: float = float("nan")


def not_seen(reason: str) -> Verdict:
    """Verdict if the pictures do not show the tip."""
    return Verdict(RegistrationOutcome.CANNOT_TELL, Cause.NOT_SEEN, f"cannot tell: {reason}")


def judge(places: Mapping[ProbeMove, Place], lens: Lens, limit: float = ANGLE) -> Verdict:
    """Compare observed with commanded motion, at rest and at both sides of every axis.

    Args:
        places: The tip in the pictures of pinholes, by step.
        lens: Of these pinholes.
        limit: Largest rotation between hand and picture that passes [rad].
    """
    rest = places[REST]
    two_eyes = rest.disparity is not None and lens.baseline > 0.0
    seen = tuple(_axis(places, axis, lens, two_eyes) for axis in AXES)
    still = [s.commanded for s in seen[:2] if float(np.hypot(*s.pixels)) < LEAST]
    if still:
        return not_seen(
            f"commanded to move {' and '.join(still)}, the tip hardly moved in the picture. Check "
            "that no tissue holds it, that the picture is live, and that the endoscope is at rest"
        )
    if two_eyes:
        return _judge_pair(seen, rest, lens, limit)
    return _judge_flat(seen, limit)


def _axis(places: Mapping[ProbeMove, Place], axis: int, lens: Lens, two_eyes: bool) -> AxisMotion:
    plus, minus = places[ProbeMove(axis, 1)], places[ProbeMove(axis, -1)]
    pixels, change = plus.left - minus.left, None
    metres = np.full(3, np.nan)
    if two_eyes:
        ends = [_triangulate(place, lens) for place in (plus, minus)]
        metres = (ends[0] - ends[1]) / (2.0 * SIDE)
        sizes = [_signed(place) for place in (plus, minus)]
        change = abs(sizes[0]) - abs(sizes[1])
    else:
        metres[:2] = pixels
    return AxisMotion(WORDS[axis, 1], pixels, change, metres)


def _signed(place: Place) -> float:
    """Disparity along its larger component; it is vertical in a picture turned by 90 degrees."""
    assert place.disparity is not None
    return float(max(place.disparity, key=abs))


def _triangulate(place: Place, lens: Lens) -> Array:
    """Apparent tip in the camera's axes [m], (3,), whichever eye is which."""
    z = lens.f * lens.baseline / max(abs(_signed(place)), 1e-3)
    across = (place.left - lens.centre) * z / lens.f
    return np.array([across[0], across[1], z])


def _judge_pair(seen: tuple[AxisMotion, ...], rest: Place, lens: Lens, limit: float) -> Verdict:
    assert rest.disparity is not None
    S = np.column_stack([s.metres for s in seen])
    U, _, Vt = np.linalg.svd(S)
    R = U @ Vt
    upright = abs(rest.disparity[1]) > abs(rest.disparity[0])
    swapped = not upright and rest.disparity[0] < 0.0
    angle = _angle(R)
    if np.linalg.det(R) < 0.0:
        return _mirrored(seen, R, swapped)
    if angle < limit:
        if swapped or upright:
            text = (
                "left and right eye are swapped: the tip is farther left in the left picture than "
                "in the right one. The viewer sees near and far exchanged. Swap the cables, "
                "devices or topics of the two cameras"
            )
            return Verdict(RegistrationOutcome.FAIL, Cause.EYES_SWAPPED, text, seen, angle)
        sizes = np.linalg.norm(S, axis=0)
        # The disparity changes by d^2 / (f b) per metre of depth.
        change = _signed(rest) ** 2 * 2.0 * SIDE / (lens.f * lens.baseline)
        slack = np.array([0.0, 0.0, MATCHED / change])
        if (sizes < SIZES[0] - slack).any() or (sizes > SIZES[1] + slack).any():
            return _wrong_size(seen, sizes, angle)
        text = f"hand and picture agree within {np.degrees(angle):.0f} degrees"
        return Verdict(RegistrationOutcome.PASS, Cause.NONE, text, seen, angle)
    return _turned(seen, R, angle, swapped or upright)


def _judge_flat(seen: tuple[AxisMotion, ...], limit: float) -> Verdict:
    """With one eye: only motion across the view."""
    S = np.column_stack([s.metres[:2] for s in seen[:2]])
    U, sizes, Vt = np.linalg.svd(S)
    R = np.eye(3)
    R[:2, :2] = U @ Vt
    angle = _angle(R)
    if np.linalg.det(R) < 0.0:
        return _mirrored(seen, R, False)
    if angle >= limit:
        return _turned(seen, R, angle, False)
    if sizes.max() > sizes.min() * SIZES[1]:
        return _wrong_size(seen, sizes / sizes.max(), angle)
    text = (
        f"hand and picture agree within {np.degrees(angle):.0f} degrees across the view; "
        "one eye cannot judge near and far"
    )
    return Verdict(RegistrationOutcome.PASS, Cause.NONE, text, seen, angle)


def _mirrored(seen: tuple[AxisMotion, ...], R: Array, swapped: bool) -> Verdict:
    """One direction is reversed, as in a mirror."""
    _, vectors = np.linalg.eigh((R + R.T) / 2.0)
    normal = np.abs(vectors[:, 0])  # the reversed direction
    axis = int(np.argmax(normal))
    pair = ("left and right", "up and down", "near and far")[axis]
    where = (
        "each picture is flipped by itself: check the mirror settings of capture and display"
        if swapped or axis == 1
        else "the pictures are flipped as in a mirror, or the camera's pose is left-handed"
    )
    if axis == 2:
        where = "the sign of the camera's z axis is wrong: z points away from the viewer"
    text = (
        f"the picture is mirrored: {pair} are exchanged ({_summary(seen)}). Likely cause: {where}"
    )
    return Verdict(RegistrationOutcome.FAIL, Cause.MIRRORED, text, seen, _angle(R))


def _turned(seen: tuple[AxisMotion, ...], R: Array, angle: float, each: bool) -> Verdict:
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
        what = f"hand and picture differ by {degrees:.0f} degrees about an axis across the view"
    if each:
        why = "each picture is turned by itself: check the rotation settings of capture and display"
    elif about_view:
        why = (
            "the camera head is turned in its holder, or the camera's frame is wrong in the "
            "endoscope's URDF or in calibration/camera_<arm>.yaml"
        )
    else:
        why = (
            "a wrong base of one of the two arms in cell.yaml (arms.….base), or a wrong tool "
            "calibration of the endoscope"
        )
    return Verdict(
        RegistrationOutcome.FAIL,
        cause,
        f"{what} ({_summary(seen)}). Likely cause: {why}",
        seen,
        angle,
    )


def _wrong_size(seen: tuple[AxisMotion, ...], sizes: Array, angle: float) -> Verdict:
    text = (
        f"directions agree, but the observed motion is {sizes.min():.1f} to {sizes.max():.1f} "
        "times the commanded one. Likely cause: focal length or baseline of the camera, or an "
        "obstacle at the tip"
    )
    return Verdict(RegistrationOutcome.FAIL, Cause.SIZE, text, seen, angle)


def _summary(seen: tuple[AxisMotion, ...]) -> str:
    return ", ".join(f"commanded {s.commanded}, seen {direction(s.metres)}" for s in seen)


def direction(v: Array) -> str:
    """Words for a direction in V, such as "right", or "left and up".

    Args:
        v: (3,); z may be NaN, then only the direction across the view is named.
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
    """Axis of a rotation by about 180 degrees."""
    _, vectors = np.linalg.eigh((R + R.T) / 2.0)
    return np.asarray(vectors[:, -1])
