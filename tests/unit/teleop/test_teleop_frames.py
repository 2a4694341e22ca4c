"""`check_frames` decides by the picture: which registrations it passes, how it names the others.

The judge is tried on ideal places of the tip, made here by projection, and together with the eyes
that find the tip, on pictures that the simulator renders.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import surg_core
from helpers.teleop.stage import Stage, stage_of, turn
from surg_cli.host import paths
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_sim.appearance.render import Picture
from surg_teleop.frames.probe_moves import REST, SPEED, STEPS, ProbeMove, between
from surg_teleop.frames.registration_verdict import (
    MATCHED,
    Cause,
    Lens,
    RegistrationOutcome,
    Verdict,
    direction,
    judge,
    not_seen,
)
from surg_teleop.frames.tip_tracker import NotSeen, Place, find_places

Array = NDArray[np.float64]
Pictures = dict[ProbeMove, tuple[Picture, Picture]]

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
LENS = Lens(f=451.3, centre=np.array([319.5, 239.5]), baseline=0.004)
MIRROR = {axis: np.diag([-1.0 if i == axis else 1.0 for i in range(3)]) for axis in range(3)}


def about_view(degrees: float) -> Array:
    return turn(np.array([0.0, 0.0, 1.0]), np.radians(degrees))


# --- the judge, on ideal places ----------------------------------------------------------------


def ideal(
    M: Array, p: Array, noise: Callable[[], Array], wiring: Callable[[Array, Array], tuple]
) -> dict[ProbeMove, Place]:
    """Places of a tip at p that goes M offset when it is told to go offset, in V."""
    found = {}
    for step in STEPS:
        q = p + M @ step.offset()
        left = LENS.centre + LENS.f * q[:2] / q[2] + noise()
        right = left - [LENS.f * LENS.baseline / q[2], 0.0] + 0.3 * noise()
        left, right = wiring(left, right)
        found[step] = Place(left, left - right)
    return found


def straight(left: Array, right: Array) -> tuple[Array, Array]:
    return left, right


def swapped(left: Array, right: Array) -> tuple[Array, Array]:
    return right, left


def flipped(left: Array, right: Array) -> tuple[Array, Array]:
    """Each picture mirrored by itself."""
    return tuple(np.array([2 * LENS.centre[0] - p[0], p[1]]) for p in (left, right))


def each_turned(left: Array, right: Array) -> tuple[Array, Array]:
    """Each picture turned upside down by itself."""
    return tuple(2 * LENS.centre - p for p in (left, right))


def quarter(left: Array, right: Array) -> tuple[Array, Array]:
    """Each picture turned by a quarter by itself."""
    return tuple(LENS.centre + about_view(90.0)[:2, :2] @ (p - LENS.centre) for p in (left, right))


WRONG = {
    "right registration": (np.eye(3), straight, Cause.NONE, "agree"),
    "mirrored left and right": (MIRROR[0], straight, Cause.MIRRORED, "left and right are"),
    "mirrored up and down": (MIRROR[1], straight, Cause.MIRRORED, "up and down are"),
    "mirrored near and far": (MIRROR[2], straight, Cause.MIRRORED, "near and far are"),
    "each picture mirrored": (np.eye(3), flipped, Cause.MIRRORED, "flipped by itself"),
    "turned clockwise": (about_view(90.0), straight, Cause.TURNED, "degrees clockwise"),
    "turned anticlockwise": (about_view(-60.0), straight, Cause.TURNED, "anticlockwise"),
    "turned a little": (about_view(33.0), straight, Cause.TURNED, "degrees clockwise"),
    "each picture turned": (np.eye(3), quarter, Cause.TURNED, "turned by itself"),
    "upside down": (about_view(180.0), straight, Cause.UPSIDE_DOWN, "camera head"),
    "each upside down": (np.eye(3), each_turned, Cause.UPSIDE_DOWN, "turned by itself"),
    "eyes swapped": (np.eye(3), swapped, Cause.EYES_SWAPPED, "Swap the cables"),
    "base turned": (turn(np.array([0.0, 1.0, 0.0]), 0.8), straight, Cause.TILTED, "base"),
}


@pytest.mark.parametrize("what", WRONG)
def test_the_judge_names_what_is_wrong(what: str) -> None:
    M, wiring, cause, words = WRONG[what]
    rng = np.random.default_rng(sorted(WRONG).index(what))
    for _ in range(1000 if FULL else 100):
        p = np.array([*rng.uniform(-0.015, 0.015, 2), rng.uniform(0.06, 0.12)])
        axis = rng.normal(size=3)
        small = turn(axis / np.linalg.norm(axis), rng.uniform(0.0, np.radians(6.0)))
        places = ideal(M @ small, p, lambda: rng.normal(0.0, 0.15, 2), wiring)
        verdict = judge(places, LENS)
        assert verdict.cause is cause, f"{verdict.text}\n{p}\n{small}"
        assert words in verdict.text
        passed = cause is Cause.NONE
        assert verdict.outcome is (RegistrationOutcome.PASS if passed else RegistrationOutcome.FAIL)


def test_the_limit_between_right_and_wrong_is_an_angle() -> None:
    rng = np.random.default_rng(7)
    for _ in range(2000 if FULL else 200):
        axis = rng.normal(size=3)
        degrees = rng.choice([rng.uniform(0.0, 19.5), rng.uniform(20.5, 150.0)])
        M = turn(axis / np.linalg.norm(axis), np.radians(degrees))
        p = np.array([*rng.uniform(-0.01, 0.01, 2), 0.08])
        verdict = judge(ideal(M, p, lambda: np.zeros(2), straight), LENS)
        if (
            verdict.outcome is RegistrationOutcome.CANNOT_TELL
        ):  # told to go right it goes away: nothing to see
            assert degrees > 70.0
            continue
        assert (verdict.outcome is RegistrationOutcome.PASS) == (degrees < 20.0), (
            f"{degrees}: {verdict.text}"
        )
        assert np.degrees(verdict.angle) == pytest.approx(degrees, abs=2.0)


def test_one_eye_judges_what_is_across_the_view() -> None:
    rng = np.random.default_rng(8)
    one = Lens(LENS.f, LENS.centre)
    for M, cause in (
        (np.eye(3), Cause.NONE),
        (MIRROR[0], Cause.MIRRORED),
        (MIRROR[1], Cause.MIRRORED),
        (about_view(90.0), Cause.TURNED),
        (about_view(180.0), Cause.UPSIDE_DOWN),
    ):
        both = ideal(M, np.array([0.0, 0.01, 0.09]), lambda: rng.normal(0.0, 0.1, 2), straight)
        places = {step: Place(place.left, None) for step, place in both.items()}
        verdict = judge(places, one)
        assert verdict.cause is cause, verdict.text
    assert "one eye" in judge(places_of_identity(), one).text


def places_of_identity() -> dict[ProbeMove, Place]:
    both = ideal(np.eye(3), np.array([0.0, 0.0, 0.09]), lambda: np.zeros(2), straight)
    return {step: Place(place.left, None) for step, place in both.items()}


@pytest.mark.parametrize(
    ("factor", "passes"), [(0.5, False), (0.8, True), (1.4, True), (2.0, False)]
)
def test_a_wrong_size_is_said(factor: float, passes: bool) -> None:
    places = ideal(factor * np.eye(3), np.array([0.0, 0.0, 0.09]), lambda: np.zeros(2), straight)
    verdict = judge(places, LENS)
    assert (verdict.outcome is RegistrationOutcome.PASS) == passes
    if not passes:
        assert verdict.cause is Cause.SIZE
        assert "baseline" in verdict.text


def test_a_tip_that_does_not_move_is_no_verdict() -> None:
    places = ideal(0.01 * np.eye(3), np.array([0.0, 0.0, 0.09]), lambda: np.zeros(2), straight)
    verdict = judge(places, LENS)
    assert verdict.outcome is RegistrationOutcome.CANNOT_TELL
    assert "right and down" in verdict.text
    assert not_seen("the lens is fogged").outcome is RegistrationOutcome.CANNOT_TELL


def test_directions_in_words() -> None:
    for v, words in (
        ([1, 0, 0], "right"),
        ([-1, -0.9, 0], "left and up"),
        ([0.1, 0.1, 1], "away"),
        ([0.2, 0, -1], "nearer"),
        ([0.5, np.nan, np.nan], "right"),
        ([0, 0, 0], "nothing"),
    ):
        assert direction(np.array(v, dtype=float)) == words


# --- the way ----------------------------------------------------------------------------------


def test_the_way_is_slow_and_ends() -> None:
    start, end = np.array([0.0, 0.0, 0.1]), np.array([0.01, -0.003, 0.1])
    t = np.linspace(0.0, 3.0, 3001)
    way = np.array([between(start, end, float(x))[0] for x in t])
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(t)
    assert speed.max() <= SPEED * (1.0 + 1e-6)
    assert speed[0] < 0.01 * SPEED
    assert np.allclose(way[-1], end)
    assert between(start, end, 3.0)[1]
    assert between(start, start, 0.0) == (pytest.approx(start), True)
    assert [str(step) for step in STEPS] == [
        "rest",
        "right",
        "left",
        "down",
        "up",
        "away",
        "nearer",
    ]


# --- on pictures ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stage() -> Stage:
    return stage_of("sim_two_arms")


def lens(stage: Stage) -> Lens:
    i = stage.renderer.intrinsics
    return Lens(i.f, np.array([i.cx, i.cy]), stage.renderer.baseline)


def shoot(stage: Stage, rest: Array, R_WV: Array) -> Pictures | None:
    """Pictures of all steps by this belief of where the camera looks; None: out of reach."""
    found = {}
    for step in STEPS:
        if not stage.put(stage.tool, rest + R_WV @ step.offset()):
            return None
        found[step] = stage.pictures()
    stage.put(stage.tool, rest)
    return found


def verdict_of(pictures: Pictures, lens_: Lens) -> Verdict:
    try:
        left, right = ({step: pair[i] for step, pair in pictures.items()} for i in (0, 1))
        return judge(find_places(left, right), lens_)
    except NotSeen as error:
        return not_seen(str(error))


def rewired(pictures: Pictures, change: Callable[[Picture, Picture], tuple]) -> Pictures:
    return {step: change(*pair) for step, pair in pictures.items()}


WIRINGS: dict[str, tuple[Callable[[Picture, Picture], tuple], Cause]] = {
    "as it should be": (lambda a, b: (a, b), Cause.NONE),
    "eyes swapped": (lambda a, b: (b, a), Cause.EYES_SWAPPED),
    "each picture mirrored": (lambda a, b: (a[:, ::-1], b[:, ::-1]), Cause.MIRRORED),
    "mirrored with swapped eyes": (lambda a, b: (b[:, ::-1], a[:, ::-1]), Cause.MIRRORED),
    "mirrored up and down": (lambda a, b: (a[::-1], b[::-1]), Cause.MIRRORED),
    "each upside down": (lambda a, b: (a[::-1, ::-1], b[::-1, ::-1]), Cause.UPSIDE_DOWN),
}


def camera_file(cell: Path, degrees: float) -> None:
    """A measured camera that is turned about its view in its holder."""
    arm = surg_core.load_cell(cell).arms["ECM"]
    frame = arm.instrument.camera.frames[0]
    X_FV = surg_core.fixed_transform(arm.instrument_urdf, arm.instrument.mount_link, frame)
    q = Rotation.from_matrix(np.asarray(X_FV)[:3, :3] @ about_view(degrees)).as_quat()
    evidence = 'residual: 0.001\nn: 12\ndate: "2026-11-21"'
    text = f"format: surg_camera/1\nquaternion: {q.tolist()}\n{evidence}\n"
    (cell / "calibration" / "camera_ECM.yaml").write_text(text, "utf-8")


def turned_base(cell: Path, degrees: float) -> None:
    """A base of the endoscope's arm that stands otherwise than the cell says."""
    file = cell / "cell.yaml"
    content = yaml.safe_load(file.read_text("utf-8"))
    content["arms"]["ECM"]["base"]["rpy"][2] += float(np.radians(degrees))
    file.write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")


REGISTRATIONS: dict[str, tuple[Callable[[Path], None], Array, Cause]] = {
    "camera turned by 90 degrees": (lambda c: camera_file(c, 90.0), np.eye(3), Cause.TURNED),
    "camera upside down": (lambda c: camera_file(c, 180.0), np.eye(3), Cause.UPSIDE_DOWN),
    "left-handed camera": (lambda c: None, MIRROR[0], Cause.MIRRORED),
    "base turned by 50 degrees": (lambda c: turned_base(c, 50.0), np.eye(3), Cause.TILTED),
}


@pytest.fixture(scope="module")
def beliefs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, HeldEndoscope]:
    """What wrong cells say of the camera, by the name of what is wrong with them."""
    bundled, found = paths.CELLS / "sim_two_arms", {}
    for name, (spoil, _, _) in REGISTRATIONS.items():
        cell = tmp_path_factory.mktemp("cell") / "wrong"
        shutil.copytree(bundled, cell)
        text = (cell / "cell.yaml").read_text("utf-8")
        (cell / "cell.yaml").write_text(text.replace("../../src", str(paths.ROOT / "src")), "utf-8")
        spoil(cell)
        camera = held_endoscope(surg_core.load_cell(cell))
        assert camera is not None
        found[name] = camera
    return found


def test_right_passes_and_wrong_is_caught_at_random_views(
    stage: Stage, beliefs: dict[str, HeldEndoscope]
) -> None:
    """Every wrong registration at every view: camera wiring and cell, twenty views in full."""
    rng = np.random.default_rng(20)
    views = 20 if FULL else 2
    counts, worst = {}, 0.0
    for view in range(views):
        stage.aim(rng)
        rest = stage.work + rng.uniform(-0.008, 0.008, 3)
        stage.put(stage.tool, rest)
        stage.pictures()
        R_WV = stage.X_WV()[:3, :3]
        own = held_endoscope(stage.cell)
        assert own is not None
        assert np.abs(own.rotation(stage.joints("ECM")) - R_WV).max() < 1e-9
        right = shoot(stage, rest, R_WV)
        assert right is not None, f"view {view}: out of reach"
        for k, (name, (change, cause)) in enumerate(WIRINGS.items()):
            if k and k % views != view and not FULL:
                continue
            verdict = verdict_of(rewired(right, change), lens(stage))
            assert verdict.cause is cause, f"view {view}, {name}: {verdict.text}"
            counts[name] = counts.get(name, 0) + 1
            if cause is Cause.NONE:
                worst = max(worst, float(np.degrees(verdict.angle)))
        names = list(REGISTRATIONS) if FULL else [list(REGISTRATIONS)[view % len(REGISTRATIONS)]]
        for name in names:
            _, handed, cause = REGISTRATIONS[name]
            believed = beliefs[name].rotation(stage.joints("ECM")) @ handed
            pictures = shoot(stage, rest, believed)
            assert pictures is not None, f"view {view}, {name}: out of reach"
            verdict = verdict_of(pictures, lens(stage))
            assert verdict.cause is cause, f"view {view}, {name}: {verdict.text}"
            counts[name] = counts.get(name, 0) + 1
    print(counts, f"largest angle of a right registration: {worst:.1f} degrees")
    assert worst < 12.0


def test_the_tip_is_found_to_a_pixel(stage: Stage) -> None:
    """What is seen to move against where the simulator has the tip, which the eyes do not know."""
    rng = np.random.default_rng(21)
    errors, depths = [], []
    for _ in range(20 if FULL else 1):
        stage.aim(rng)
        rest = stage.work + rng.uniform(-0.008, 0.008, 3)
        stage.put(stage.tool, rest)
        stage.pictures()
        X_WV = stage.X_WV()
        pictures = shoot(stage, rest, X_WV[:3, :3])
        assert pictures is not None
        left, right = ({step: pair[i] for step, pair in pictures.items()} for i in (0, 1))
        places = find_places(left, right)
        offsets: list[float] = []
        for step in STEPS:
            true = stage.pixel(rest + X_WV[:3, :3] @ step.offset()) - stage.pixel(rest)
            errors.append(float(np.hypot(*(places[step].left - places[REST].left - true))))
            z = (X_WV[:3, :3].T @ (rest - X_WV[:3, 3]))[2] + step.offset()[2]
            disparity = places[step].disparity
            assert disparity is not None
            d = lens(stage).f * stage.renderer.baseline / z
            offsets.append(disparity[0] - d)
            assert abs(disparity[1]) < MATCHED
        # What is followed reaches from the tip towards the lens: a constant, and no motion.
        assert abs(np.mean(offsets)) < 2.0
        depths += [abs(offset - np.mean(offsets)) for offset in offsets]
    print(f"motion within {max(errors):.2f} px, change of disparity within {max(depths):.2f} px")
    assert max(errors) < 2.5
    assert max(depths) < 0.5


@pytest.fixture(scope="module")
def one_view(stage: Stage) -> Pictures:
    rng = np.random.default_rng(22)
    stage.aim(rng)
    stage.put(stage.tool, stage.work)
    stage.pictures()
    found = shoot(stage, stage.work, stage.X_WV()[:3, :3])
    assert found is not None
    return found


def test_noise_and_flicker_do_not_matter(stage: Stage, one_view: Pictures) -> None:
    rng = np.random.default_rng(23)

    def bad(picture: Picture) -> Picture:
        flicker = rng.uniform(0.97, 1.03)
        noisy = flicker * picture + rng.normal(0.0, 4.0, picture.shape)
        return np.clip(noisy, 0, 255).astype(np.uint8)

    for change, cause in list(WIRINGS.values())[: None if FULL else 2]:
        worse = rewired(rewired(one_view, change), lambda a, b: (bad(a), bad(b)))
        verdict = verdict_of(worse, lens(stage))
        assert verdict.cause is cause, verdict.text


def frozen(pictures: Pictures) -> Pictures:
    return dict.fromkeys(pictures, pictures[REST])


def dark(pictures: Pictures) -> Pictures:
    return rewired(pictures, lambda a, b: (0 * a, 0 * b))


def one_eye_frozen(pictures: Pictures) -> Pictures:
    return {step: (pair[0], pictures[REST][1]) for step, pair in pictures.items()}


def covered(pictures: Pictures) -> Pictures:
    grey = np.full_like(pictures[REST][1], 90)
    return rewired(pictures, lambda a, b: (a, grey))


@pytest.mark.parametrize("what", [frozen, dark, one_eye_frozen, covered])
def test_a_picture_that_shows_nothing_is_never_a_pass(
    what: Callable[[Pictures], Pictures], stage: Stage, one_view: Pictures
) -> None:
    verdict = verdict_of(what(one_view), lens(stage))
    assert verdict.outcome is RegistrationOutcome.CANNOT_TELL, verdict.text
    assert verdict.text.startswith("cannot tell: ")
