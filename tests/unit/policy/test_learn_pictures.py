"""The policy that looks, and its trainer: scaling, eye, memory, misses, as in training.

On made-up pictures: what it does in the phantom stands in docs/guide/learning.md.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.policy import bgr_pictures as made
from helpers.policy.bgr_pictures import (
    image_policy,
    keypoint_labels,
    keypoint_network,
    keypoint_training,
    picture_augmentation,
    picture_dataset,
    picture_memory,
    train_images,
)
from helpers.policy.bgr_synthetic import STATE, TASK
from helpers.policy.example_program import said_alone
from surg_learn.bgr import observed_features
from surg_learn.cloning import arm_columns, chunk_policy, small_pictures
from surg_learn.cloning.training import recorded_steps, torch_device

FEW_EYE = keypoint_training.EyeOptions(steps=4, batch=4, channels=(4, 4, 4, 4, 4, 4), hidden=8)
FEW = train_images.Options(steps=8, hidden=(16, 16), batch=8, chunk=4, eye=FEW_EYE)


def hand_trained(options: train_images.Options) -> image_policy.ImagePolicy:
    """With an eye of random weights."""
    dataset = made.dataset(2)
    marked = train_images.marks(dataset, observed_features.Columns(STATE, TASK))
    return train_images.train_hand(dataset, options, made.eye(), marked)


def sight(policy: image_policy.ImagePolicy, shown: picture_dataset.Episode) -> np.ndarray:
    """What it makes of an episode."""
    said = train_images.look(policy.network.eye, shown.views)
    scales = policy.scales
    return image_policy.remembered(said, shown.state[:, :3], scales["plane"], scales["lens"])


@pytest.fixture(scope="module")
def policy() -> image_policy.ImagePolicy:
    return hand_trained(FEW)


# --- scaling ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(120, 120), (240, 320), (480, 640)])
def test_a_view_is_the_rounded_mean_of_blocks_of_the_middle_square(shape: tuple[int, int]) -> None:
    height, width = shape
    whole = np.random.default_rng(height).integers(0, 256, (height, width, 3), np.uint8)
    view = small_pictures.small(whole)
    assert view.shape == (120, 120, 3) and view.dtype == np.uint8
    block, left = height // 120, (width - height) // 2
    rng = np.random.default_rng(0)
    for i, k in rng.integers(0, 120, (200, 2)):
        part = whole[i * block : (i + 1) * block, left + k * block : left + (k + 1) * block]
        mean = part.reshape(-1, 3).astype(float).mean(axis=0)
        np.testing.assert_array_equal(view[i, k], np.floor(mean + 0.5))
    np.testing.assert_array_equal(view, small_pictures.small(whole[:, :, ::-1])[:, :, ::-1])


@pytest.mark.parametrize(
    "shape", [(250, 320, 3), (480, 400, 3), (0, 640, 3), (480, 640), (120, 120, 4)]
)
def test_a_picture_that_does_not_divide_is_refused_in_words(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="120, 240, 360") as said:
        small_pictures.small(np.zeros(shape, np.uint8))
    assert str(shape) in str(said.value)


def test_what_the_codec_leaves_of_a_view(tmp_path: Path) -> None:
    """Learned from are decoded videos, acted on are pictures: a grey level apart, scaled."""
    import av

    from surg_recording.datasets import ExportOptions, pictures

    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:480, 0:640]
    shown = []
    for n in range(6):
        waves = [
            120 + 60 * np.sin((x + 9 * n) / (40 + 9 * c)) + 50 * np.cos(y / 31) for c in range(3)
        ]
        shown.append(np.clip(np.stack(waves, -1) + rng.normal(0, 3, (480, 640, 3)), 0, 255))
    shown = [picture.astype(np.uint8) for picture in shown]
    file = tmp_path / "video.mp4"
    frames = (av.VideoFrame.from_ndarray(picture, format="rgb24") for picture in shown)
    pictures.encode(frames, file, ExportOptions())
    seen = small_pictures.views_of(file).astype(int)
    off = np.abs(seen - np.stack([small_pictures.small(picture) for picture in shown]))
    print(f"mean {off.mean():.2f}, 99 % {np.percentile(off, 99):.0f} of 255")
    assert len(seen) == 6 and off.mean() < 2.0


# --- the eye ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", keypoint_network.CONVOLUTIONS)
def test_a_convolution_is_the_sum_that_defines_it(shape: tuple[int, int, int]) -> None:
    size, stride, dilation = shape
    rng = np.random.default_rng(1)
    x, weight = rng.normal(size=(2, 12, 16, 3)), rng.normal(size=(size, size, 3, 4))
    bias = rng.normal(size=4)
    found = keypoint_network.convolve(x, weight, bias, stride, dilation)
    pad = dilation * (size // 2)
    padded = np.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    assert found.shape == (2, 12 // stride, 16 // stride, 4)
    for b, i, k in np.ndindex(*found.shape[:3]):
        row, column = i * stride, k * stride
        reach = dilation * (size - 1) + 1
        part = padded[b, row : row + reach : dilation, column : column + reach : dilation]
        np.testing.assert_allclose(found[b, i, k], bias + np.einsum("ijc,ijco->o", part, weight))


def test_a_heat_map_peaks_at_its_mark_and_is_empty_for_a_mark_outside() -> None:
    marks = np.zeros((1, 2, 2))
    cell = keypoint_network.grid(keypoint_network.CELLS)[7 * keypoint_network.CELLS + 21]
    marks[0, 0], marks[0, 1] = cell, (0.0, 3.0)
    heat = keypoint_labels.heats(marks)[0]
    assert heat[:, 0].argmax() == 7 * keypoint_network.CELLS + 21
    assert heat[:, 0].sum() == pytest.approx(1.0) and heat[:, 1].sum() == 0.0


def test_marks_are_where_a_pinhole_shows_the_points() -> None:
    """Against the picture: the red spot is the target, the green one the robot's tip."""
    shown = made.episode(3)
    columns = observed_features.Columns(STATE, TASK)
    found = keypoint_labels.labels(shown.task, columns.task, np.eye(4), shown.camera, made.K)
    for step in (0, 10):
        for name, colour in (("helper", 0), ("tip", 1)):
            spot = np.argwhere(shown.views[step][:, :, colour] > 200).mean(axis=0) + 0.5
            mark = found.marks[step, keypoint_network.MAPS.index(name)]
            np.testing.assert_allclose(mark, spot / (made.SIDE / 2) - 1, atol=0.02)
    np.testing.assert_allclose(found.points[0, 2], made.DISTANCE)


def test_the_tube_is_found_beside_where_the_assistant_points() -> None:
    """A tube drawn as a slanted ridge: the place goes onto it, the direction along it."""
    eye = made.eye()
    eye.pointed[0] = (0.05, 0.0)  # the place is below the assistant's tip
    cells = keypoint_network.grid(keypoint_network.CELLS)
    along = np.array([-0.2, 1.0]) / np.hypot(0.2, 1.0)
    across = np.array([along[1], -along[0]])
    foot = np.array([0.1, 0.2])
    tube = np.exp(-0.5 * (((cells - foot) @ across) / 0.07) ** 2).reshape(30, 30)
    helper = foot + 0.06 * across - (0.05, 0.0)
    said, near = eye._find(helper, tube)
    np.testing.assert_allclose(said[:2], foot, atol=0.02)
    np.testing.assert_allclose(said[2:], -along, atol=0.03)
    nothing, seen = eye._find(helper, np.zeros((30, 30)))
    assert np.isfinite(nothing).all() and seen < 0.01 < near


@pytest.mark.parametrize("moved", [(0.0, 0.0), (0.15, -0.2)])
def test_a_camera_that_moved_is_known_from_the_robots_own_tip(moved: tuple[float, float]) -> None:
    """All places are shifted alike; points and directions in space are those of before."""
    view, shift = picture_memory.View(*made.camera()), np.array(moved)
    rng = np.random.default_rng(4)
    for tip in np.repeat(rng.uniform(-0.02, 0.02, (10, 2)), 12, axis=0):
        seen = tip[::-1] / made.REACH + shift + 0.02 * rng.standard_normal(2)
        view.look(seen, 1.0, np.append(tip, made.DISTANCE))
        hidden = np.append(tip, made.DISTANCE)
        view.look(np.zeros(2), 0.0, hidden)  # a tip that is not seen says nothing
    np.testing.assert_allclose(view.shift, shift, atol=0.02)
    goal = np.array([0.010, -0.015])
    place = goal[::-1] / made.REACH + shift
    np.testing.assert_allclose(view.points(place[None])[0], [*goal, made.DISTANCE], atol=8e-4)
    np.testing.assert_allclose(view.along(place, np.array([0.0, 1.0])), [1.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("speed", [0.01, 0.03, 0.06])
def test_an_old_picture_of_a_moving_tip_moves_no_camera(late: int, speed: float) -> None:
    """To and fro at a speed [m/s], seen some steps late: whatever it sees, the goal stays."""
    view = picture_memory.View(*made.camera())
    way = np.abs((0.05 * speed * np.arange(200) + 0.02) % 0.08 - 0.04) - 0.02
    tips = np.column_stack([way, 0.5 * way, np.full(200, made.DISTANCE)])
    worst = 0.0
    for step in range(late, 200):
        view.look(tips[step - late, 1::-1] / made.REACH, 1.0, tips[step])
        worst = max(worst, float(np.linalg.norm(view.shift)))
    assert worst == 0.0


def test_the_lens_is_found_from_tips_and_where_they_are_seen() -> None:
    rng = np.random.default_rng(5)
    X = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    P = np.column_stack([X * np.sign(np.linalg.det(X)), [0.0, 0.0, 0.15]])
    points = rng.uniform(-0.04, 0.04, (200, 3))
    x = np.column_stack([points, np.ones(200)]) @ P.T
    places = 4.0 * x[:, :2] / x[:, 2:]
    lens = keypoint_labels.lens_of(points, places)
    found = np.column_stack([points, np.ones(200)]) @ lens.T
    inside = (np.abs(places) < 1.0).all(axis=1)
    assert 20 < inside.sum() < 200, "some lie outside"
    np.testing.assert_allclose(found[:, :2] / found[:, 2:], places, atol=1e-6)


def test_places_move_with_the_picture_in_training() -> None:
    """A bright square on grey, varied: it is bright where its mark says it is now."""
    torch = pytest.importorskip("torch")
    rng, n, side = np.random.default_rng(6), 200, made.SIDE
    corner = rng.integers(20, side - 30, (n, 2))
    views = np.full((n, side, side, 3), 60, np.uint8)
    for view, (row, column) in zip(views, corner, strict=True):
        view[row : row + 10, column : column + 10] = 200
    marks = ((corner + 5.0) / (side / 2) - 1.0)[:, None].astype(np.float32)
    looks = picture_augmentation.Looks(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, moved=1.0)
    inside = np.ones((side, side), bool)
    vary = picture_augmentation.Varied(torch, side, looks, inside, 0, "cpu")
    shown, found = vary(views, marks)
    checked = 0
    for picture, mark in zip(shown.numpy(), found[:, 0], strict=True):
        if (np.abs(mark) < 0.8).all():
            bright = np.argwhere(picture[0] > 150).mean(axis=0) + 0.5
            np.testing.assert_allclose(mark, bright / (side / 2) - 1, atol=0.01)
            checked += 1
    assert checked > n / 2 and np.abs(found - marks).max() > 0.2


@pytest.mark.skipif(not os.environ.get("SURG_TEST_FULL"), reason="./surg test --full")
def test_it_learns_to_look() -> None:
    """Where the spot is, is said by the picture only."""
    pytest.importorskip("torch")
    columns = observed_features.Columns(STATE, TASK)
    dataset = made.dataset(10, 2)
    marked = train_images.marks(dataset, columns)
    views = {k: np.concatenate([e.views for e in v]) for k, v in dataset.episodes.items()}
    off = []
    for steps in (1, 150):
        options = keypoint_training.EyeOptions(steps=steps, batch=16, channels=(8,) * 6, hidden=32)
        eye = keypoint_training.train_eye(views["train"], marked["train"], options, 0)
        tips = np.concatenate([e.state[:, :3] for e in dataset.episodes["val"]])
        said = train_images.look(eye, views["val"])
        seen = image_policy.remembered(said, tips, *made.camera())
        off.append(keypoint_training.errors(seen, marked["val"])["helper"][0])
    print(f"median error {off[0]:.3f} -> {off[1]:.3f} half heights")
    assert off[1] < 0.5 * off[0]


def test_the_memory_keeps_where_the_assistant_pointed() -> None:
    """Not where its tip passes, nor where it is when its jaws are open."""
    memory = picture_memory.Memory()
    answer = np.zeros(keypoint_network.SAID)
    answer[keypoint_network.NEAR], answer[keypoint_network.AXIS] = 0.5, (1.0, 0.0)

    def show(steps: int, place: float, jaw: float, speed: float, at: float) -> np.ndarray:
        for step in range(steps):
            answer[keypoint_network.AT], answer[keypoint_network.OTHER_JAW] = place, jaw
            answer[keypoint_network.PLACE] = (0.0, at + step * speed)
            said = memory.add(answer)
        return said

    passing = show(20, 0.5, 0.0, 0.02, 0.0)
    assert passing[4] < 0.1 and passing[5] < 0.01
    waiting = picture_memory.Memory()
    answer[keypoint_network.PLACE] = (0.0, 0.0)
    for _ in range(20):  # it has not begun
        assert waiting.add(answer)[5] == 0.0
    pointing = show(12, 0.2, 0.0, 0.0, 0.4)
    np.testing.assert_allclose(pointing[:2], 0.2, atol=0.005)
    assert pointing[4] == 1.0 and pointing[5] > 0.95
    grasping = show(60, 0.7, 0.6, 0.0, 0.4)
    np.testing.assert_allclose(grasping[:2], pointing[:2], atol=5e-3)
    np.testing.assert_allclose(grasping[2:4], (1.0, 0.0))


# --- learning and acting ----------------------------------------------------------------------


def test_one_seed_one_policy(policy: image_policy.ImagePolicy) -> None:
    again, other = hand_trained(FEW), hand_trained(dataclasses.replace(FEW, seed=1))
    assert again.hash == policy.hash != other.hash
    assert again.about["privileged"] == []
    assert again.about["observation"] == ["observation.state", image_policy.PICTURE]


def test_how_to_miss_is_not_learned() -> None:
    """Jaws that soon open again have missed: the steps up to the closing are left out.

    Who carries something for longer and lets it go has not.
    """
    jaw = np.array([0, 0, 0.7, 0.7, 0.7, 0, 0, 0, 0.7, 0.7, 0, 0, 0, 0], float)
    out = np.flatnonzero(recorded_steps.missed(jaw))
    np.testing.assert_array_equal(out, [2, 3, 4, 5])
    assert not recorded_steps.missed(jaw[8:]).any()
    carried = np.concatenate([np.full(10, 0.3), np.zeros(25), np.full(5, 0.3)])
    assert not recorded_steps.missed(carried).any()


def test_a_command_that_is_moved_aside_is_led_back(policy: image_policy.ImagePolicy) -> None:
    columns = observed_features.Columns(STATE, TASK)
    shown = made.dataset(2).episodes["train"]
    seen = [sight(policy, e) for e in shown]
    known = train_images.samples(shown, seen, columns, 4)
    rows = np.random.default_rng(2).permutation(len(known.inputs))
    push = 0.005 * np.random.default_rng(3).standard_normal((len(rows), 3))
    left = np.exp(-np.array([1, 2, 3, 4]) / 5.0)
    x, y = known.pushed(rows, push, left)
    x_0, y_0, free = known.inputs[rows], known.targets[rows], known.free[rows]
    assert 0.2 < free.mean() < 0.9
    here = image_policy.HERE
    np.testing.assert_allclose((x - x_0)[:, here][free], push[free], atol=1e-15)
    for i in range(2):
        moved = (x - x_0)[free, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(moved, -push[free], atol=1e-15)
    aside = (y[:, :, :3] + push[:, None]) - y_0[:, :, :3]
    np.testing.assert_allclose(aside[free], (push[:, None] * left[:, None])[free], atol=1e-15)
    np.testing.assert_array_equal(x[~free], x_0[~free])
    np.testing.assert_array_equal(y[~free], y_0[~free])


def test_acting_step_by_step_is_what_was_trained(policy: image_policy.ImagePolicy) -> None:
    """The memory included: chunks one by one are those of the whole episode."""
    shown = made.episode(99)
    columns = arm_columns.state_columns(STATE, "PSM1")
    for _ in range(2):  # the second time after a reset
        policy.reset("", None)
        said: list[np.ndarray] = []
        last = before = shown.state[0, arm_columns.SET]
        chunks, moved = [], []
        for state, view in zip(shown.state, shown.views, strict=True):
            if np.linalg.norm(last[:3] - state[5:8]) > chunk_policy.REACH:
                last = before = state[arm_columns.SET]  # it begins anew: nothing has moved
            said.append(last)
            moved.append(last - before)
            before = last
            seen = {arm_columns.STATE: state, image_policy.PICTURE: view}
            chunks.append(policy.act(seen))
            assert chunks[-1].shape == (4, 5) and chunks[-1].dtype == np.float64
            last = chunks[-1][0, :4]
        inputs = image_policy.features(
            columns, shown.state, sight(policy, shown), np.array(said), np.array(moved)
        )
        made_at_once = policy.predict(inputs, np.array(said))
        np.testing.assert_allclose(np.array(chunks), made_at_once, atol=1e-5)


@dataclasses.dataclass
class At:
    """An observation at a grid time."""

    step: int
    arrays: dict[str, np.ndarray]
    spec: None = None


def test_it_goes_on_from_what_it_was_last_told_to_do(policy: image_policy.ImagePolicy) -> None:
    """In real time it misses observations; after a refusal the arm has not gone anywhere."""
    shown = made.episode(7)
    arrays = {arm_columns.STATE: shown.state[0], image_policy.PICTURE: shown.views[0]}
    held = shown.state[0, arm_columns.SET]
    policy.reset()
    chunk = policy.act(At(10, arrays))
    for step, row in ((11, 0), (13, 2), (90, 3)):
        found = policy.last_command(held, At(step, arrays))
        np.testing.assert_array_equal(found, chunk[row, :4], f"at {step}")
    policy.acknowledged({"rejected": []})
    np.testing.assert_array_equal(policy.last_command(held, At(12, arrays)), chunk[1, :4])
    policy.acknowledged({"rejected": [], "late": 2})  # the first two rows: others were executed
    for step, row in ((11, held), (12, held), (13, chunk[2, :4])):
        np.testing.assert_array_equal(policy.last_command(held, At(step, arrays)), row)
    policy.acknowledged({"rejected": [{"step": 11, "rule": "start", "text": "too far"}]})
    np.testing.assert_array_equal(policy.last_command(held, At(12, arrays)), held)


def test_how_fast_it_moves_it_knows_from_its_commands(policy: image_policy.ImagePolicy) -> None:
    """Whatever the arm's delay is, and over steps that it missed; nothing where it begins anew."""
    shown = made.episode(7)
    arrays = {arm_columns.STATE: shown.state[0], image_policy.PICTURE: shown.views[0]}
    rows = shown.state[0, arm_columns.SET] + np.arange(1.0, 5.0)[:, None] * [1e-3, 0, 0, 0.01]

    def moved(step: int, behind: float) -> np.ndarray:
        """Of the next observation, of an arm so far behind its set-point [m]."""
        state = shown.state[0].copy()
        state[:3] -= behind
        policy.act(At(step, {**arrays, arm_columns.STATE: state}))
        policy._said = np.column_stack([rows, np.zeros(4)])
        return policy._past[-1][3]

    for behind in (0.0, 0.004):
        policy.reset()
        assert not moved(10, behind).any(), "it has not moved yet"
        assert not moved(11, behind)[1:3].any()
        np.testing.assert_allclose(moved(14, behind), [2e-3 / 3, 0, 0, 0.02 / 3], atol=1e-12)
        policy.acknowledged({"rejected": [], "late": 3})
        assert moved(15, behind).any(), "its answer was late, and the arm moves on"
        policy.acknowledged({"rejected": [{"step": 15, "rule": "start", "text": "too far"}]})
        assert not moved(16, behind).any(), "it was refused"


@pytest.mark.parametrize("counted", [True, False])
def test_a_hand_that_hesitates_keeps_to_a_chunk(
    policy: image_policy.ImagePolicy, monkeypatch: pytest.MonkeyPatch, counted: bool
) -> None:
    """It says at every step that it closes its jaws three steps later, and never gets there."""
    shown = made.episode(7)
    arrays = {arm_columns.STATE: shown.state[0], image_policy.PICTURE: shown.views[0]}
    jaws = np.array([0.6, 0.6, 0.3, 0.0])

    def soon(inputs: np.ndarray, last: np.ndarray) -> np.ndarray:
        return np.column_stack([np.repeat(last, 4, axis=0), jaws])[None]

    def asked(step: int) -> bool:
        return policy.act(At(step, arrays) if counted else arrays) is not None

    def acted(steps: int) -> list[bool]:
        """At which steps of an episode the hand is asked."""
        policy.reset()
        return [asked(step) for step in range(steps)]

    monkeypatch.setattr(policy, "predict", soon)
    wait = image_policy.PATIENCE + 1
    assert acted(2 * (wait + 3)) == 2 * [*wait * [True], *3 * [False]]
    jaws[:] = 0.6  # what stands and means to stand is left alone
    assert all(acted(3 * wait))
    jaws[:] = [0.6, 0.6, 0.3, 0.0]
    assert all(acted(wait))
    policy.acknowledged({"rejected": [{"step": 1, "rule": "start", "text": "too far"}]})
    assert asked(wait), "refused: it asks anew"


def test_numpy_alone_gives_what_the_trainer_had(
    policy: image_policy.ImagePolicy, tmp_path: Path
) -> None:
    """Saved, loaded, and run by a plain interpreter that has numpy and nothing of ours."""
    file = tmp_path / "weights.npz"
    policy.save(file)
    shown = made.episode(5)
    np.savez(tmp_path / "episode.npz", state=shown.state, views=shown.views)
    program = (
        "import sys, pathlib, numpy as np\n"
        "from surg_learn.bgr import image_policy as b\n"
        f"p = b.ImagePolicy.load(pathlib.Path({str(file)!r}))\n"
        f"e = np.load({str(tmp_path / 'episode.npz')!r})\n"
        "out = [p.act({b.STATE: s, b.PICTURE: v}) for s, v in zip(e['state'], e['views'])]\n"
        f"np.save({str(tmp_path / 'out.npy')!r}, out)\n"
        "assert not {'torch', 'surg_core', 'surg_sim', 'pyarrow', 'av'} & set(sys.modules)\n"
        "print(p.hash)"
    )
    assert said_alone(program) == policy.hash
    policy.reset()
    here = [
        policy.act({arm_columns.STATE: state, image_policy.PICTURE: view})
        for state, view in zip(shown.state, shown.views, strict=True)
    ]
    # Another number of threads sums in another order.
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), here, rtol=0, atol=1e-5)


# --- what does not fit ------------------------------------------------------------------------


def test_a_dataset_without_a_share_for_training_is_named() -> None:
    with pytest.raises(ValueError, match="'train'"):
        train_images.train(made.dataset(0, 1), FEW)


def stub_torch(gpu: bool, built: str | None) -> SimpleNamespace:
    """What is asked of PyTorch about its devices."""
    return SimpleNamespace(
        __version__="9.9",
        cuda=SimpleNamespace(is_available=lambda: gpu),
        version=SimpleNamespace(cuda=built),
    )


@pytest.mark.parametrize(
    ("wanted", "gpu", "built", "found"),
    [
        ("auto", True, "12.8", "cuda"),
        ("auto", False, None, "cpu"),
        ("cuda", True, "12.8", "cuda"),
        ("cpu", True, "12.8", "cpu"),
        ("cuda", False, None, "9.9 was built without CUDA; --device cpu"),
        ("cuda", False, "12.8", "9.9 finds no GPU; --device cpu"),
        ("tpu", True, "12.8", "allowed are auto, cpu, cuda"),
    ],
)
def test_where_it_trains_and_a_gpu_that_is_not_there(
    wanted: str, gpu: bool, built: str | None, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch_device, "pytorch", lambda: stub_torch(gpu, built))
    if found in torch_device.DEVICES:
        assert torch_device.device_for(wanted) == found
        return
    with pytest.raises(ValueError, match=found):
        torch_device.device_for(wanted)


def test_a_gpu_that_is_not_there_is_said_before_a_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch_device, "pytorch", lambda: stub_torch(False, None))
    monkeypatch.setattr(train_images, "read", lambda *a: pytest.fail("read"))
    words = [str(tmp_path), "--out", str(tmp_path / "w.npz"), "--device", "cuda"]
    assert train_images.main(words) == 2
    assert "built without CUDA" in capsys.readouterr().err
    assert not (tmp_path / "w.npz").exists()


# --- what people are shown --------------------------------------------------------------------


def test_what_it_says_it_sees_lies_where_it_is_in_the_picture(
    policy: image_policy.ImagePolicy,
) -> None:
    """A place of the middle square is a pixel of the whole picture; the wire takes it as it is."""
    from surg_policy_client.attention import to_wire

    policy.reset()
    assert policy.seen() is None
    shown = made.episode(5)
    whole = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)
    arrays = {image_policy.STATE: shown.state[0], image_policy.PICTURE: whole}
    acted = policy.act(arrays)
    seen = policy.seen()
    to_wire(seen)
    tip, assistant, requested = seen.keypoints
    answer = policy.network.eye(small_pictures.small(whole)[None])[0]
    places = (answer[keypoint_network.TIP], answer[keypoint_network.PLACE])
    for point, (down, right) in zip((tip, assistant), places, strict=True):
        # The middle square is 480 pixels wide; its left edge is the 80th.
        expected = (80 + 240 * (1 + right), 240 * (1 + down))
        assert (640 * point.x, 480 * point.y) == pytest.approx(expected, abs=1e-3)
    assert tip.confidence == pytest.approx(answer[keypoint_network.SEEN], abs=1e-6)
    assert requested.name == "requested" and seen.area == (0.125, 0.0, 0.875, 1.0)
    assert seen.heat_map.shape == (30, 30) and np.ptp(seen.heat_map) > 0
    # Asking for it changes nothing.
    policy.reset()
    np.testing.assert_array_equal(policy.act(arrays), acted)
