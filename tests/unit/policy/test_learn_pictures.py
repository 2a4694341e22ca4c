"""The policy that looks, and its trainer: scaling, layers, gradient, same by seed, as in training.

On made-up pictures: what it does in the phantom stands in docs/guide/learning.md.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from helpers.policy import bgr_pictures as made
from helpers.policy.bgr_pictures import bgr_image_policy, train_bgr_images
from helpers.policy.bgr_synthetic import STATE, bgr_policy
from helpers.policy.example_program import said_alone
from surg_policy_client.spec import Spec

FEW = train_bgr_images.Options(
    steps=8, maps=(6, 6, 6), hidden=(16, 16), batch=8, chunk=4, ahead=(8,)
)


@pytest.fixture(scope="module")
def policy() -> bgr_image_policy.ImagePolicy:
    return train_bgr_images.train(made.dataset(), FEW)


# --- scaling ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(96, 96), (192, 256), (480, 640), (576, 1024)])
def test_a_view_is_the_rounded_mean_of_blocks_of_the_middle_square(shape: tuple[int, int]) -> None:
    height, width = shape
    whole = np.random.default_rng(height).integers(0, 256, (height, width, 3), np.uint8)
    view = bgr_image_policy.small(whole)
    assert view.shape == (96, 96, 3) and view.dtype == np.uint8
    block, left = height // 96, (width - height) // 2
    rng = np.random.default_rng(0)
    for i, k in rng.integers(0, 96, (200, 2)):
        part = whole[i * block : (i + 1) * block, left + k * block : left + (k + 1) * block]
        mean = part.reshape(-1, 3).astype(float).mean(axis=0)
        np.testing.assert_array_equal(view[i, k], np.floor(mean + 0.5))
    np.testing.assert_array_equal(view, bgr_image_policy.small(whole[:, :, ::-1])[:, :, ::-1])


@pytest.mark.parametrize(
    "shape", [(240, 320, 3), (480, 400, 3), (0, 640, 3), (480, 640), (96, 96, 4)]
)
def test_a_picture_that_does_not_divide_is_refused_in_words(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="96, 192, 288") as said:
        bgr_image_policy.small(np.zeros(shape, np.uint8))
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
    seen = train_bgr_images.views_of(file).astype(int)
    off = np.abs(seen - np.stack([bgr_image_policy.small(picture) for picture in shown]))
    print(f"mean {off.mean():.2f}, 99 % {np.percentile(off, 99):.0f} of 255")
    assert len(seen) == 6 and off.mean() < 2.0


# --- layers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", bgr_image_policy.CONVOLUTIONS)
def test_patches_make_a_convolution(shape: tuple[int, int, int]) -> None:
    """Against the sum that defines it."""
    size, stride, pad = shape
    rng = np.random.default_rng(1)
    x, weight = rng.normal(size=(2, 16, 20, 3)), rng.normal(size=(size, size, 3, 4))
    found = bgr_image_policy.patches(x, size, stride, pad) @ weight.reshape(-1, 4)
    padded = np.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    assert found.shape == (2, (16 + 2 * pad - size) // stride + 1,
                           (20 + 2 * pad - size) // stride + 1, 4)  # fmt: skip
    for b, i, k in np.ndindex(*found.shape[:3]):
        part = padded[b, i * stride : i * stride + size, k * stride : k * stride + size]
        np.testing.assert_allclose(found[b, i, k], np.einsum("ijc,ijco->o", part, weight))


def test_a_place_is_where_a_map_is_high() -> None:
    maps = np.zeros((1, 24, 24, 2))
    maps[0, 6, 20, 0], maps[0, 23, 0, 1] = 60.0, 60.0
    down, right, mean = np.split(bgr_image_policy.places(maps, bgr_image_policy.shares(maps))[0], 3)
    np.testing.assert_allclose(down, [2 * 6 / 23 - 1, 1.0], atol=1e-9)
    np.testing.assert_allclose(right, [2 * 20 / 23 - 1, -1.0], atol=1e-9)
    np.testing.assert_allclose(mean, 60.0 / 24**2)


def test_the_gradient_is_that_of_the_loss() -> None:
    """Against central differences in float64, of parameters of every layer."""
    rng = np.random.default_rng(3)
    few = dataclasses.replace(FEW, maps=(4, 5, 3), hidden=(7, 6), chunk=1, ahead=())
    shapes = train_bgr_images.shapes_of(few)
    flat = rng.normal(0.0, 0.4, sum((a + 1) * b for a, b in shapes))
    layers, ends, at = [], [], 0
    for a, b in shapes:
        weight = flat[at : at + a * b].reshape(a, b)
        layers.append((weight, flat[at + a * b : at + (a + 1) * b]))
        at += (a + 1) * b
        ends.append(at)
    network = bgr_image_policy.ImageNetwork(layers)
    grads = [(np.zeros((a, b)), np.zeros(b)) for a, b in shapes]
    pictures = rng.normal(size=(3, 24, 24, bgr_image_policy.CHANNELS))
    numbers = rng.normal(size=(3, bgr_image_policy.NUMBERS))
    target = rng.normal(size=(3, 5))
    train_bgr_images.gradient_of(network, grads, pictures, numbers, target)
    slope = np.concatenate([np.append(w.ravel(), b) for w, b in grads])

    def loss() -> float:
        error = np.abs(network(pictures, numbers) - target)
        return float(np.mean(np.where(error < 0.5, 0.5 * error**2, 0.5 * (error - 0.25))))

    step, checked = 1e-6, 0
    for begin, end in zip([0, *ends[:-1]], ends, strict=True):
        for i in [*rng.integers(begin, end, 40), end - 1]:
            kept = flat[i]
            flat[i] = kept + step
            up = loss()
            flat[i] = kept - step
            down = loss()
            flat[i] = kept
            assert slope[i] == pytest.approx((up - down) / (2 * step), abs=1e-8, rel=1e-4)
            checked += 1
    assert np.count_nonzero(slope) > 0.5 * len(slope)
    print(f"{checked} of {flat.size} parameters in {len(shapes)} layers")


# --- learning and acting ----------------------------------------------------------------------


def test_one_seed_one_policy(policy: bgr_image_policy.ImagePolicy) -> None:
    again = train_bgr_images.train(made.dataset(), FEW)
    other = train_bgr_images.train(made.dataset(), dataclasses.replace(FEW, seed=1))
    assert again.hash == policy.hash != other.hash
    assert again.about["privileged"] == []
    assert again.about["observation"] == ["observation.state", bgr_image_policy.PICTURE]


def test_the_default_network_is_small() -> None:
    shapes = train_bgr_images.shapes_of(train_bgr_images.Options())
    count = sum((a + 1) * b for a, b in shapes)
    print(f"{count} parameters")
    assert count <= 500_000


def test_it_learns_to_look() -> None:
    """Where the spot is, is said by the picture only."""
    options = dataclasses.replace(FEW, maps=(8, 8, 8), hidden=(32, 32), batch=24, rate=3e-3)
    before = train_bgr_images.train(made.dataset(12), dataclasses.replace(options, steps=1))
    after = train_bgr_images.train(made.dataset(12), dataclasses.replace(options, steps=150))
    print(f"loss on val {before.about['loss']['val']:.3f} -> {after.about['loss']['val']:.3f}")
    assert after.about["loss"]["val"] < 0.6 * before.about["loss"]["val"]


def test_a_command_that_is_moved_aside_is_led_back() -> None:
    columns = bgr_image_policy.state_columns(STATE)
    known = train_bgr_images.Samples.of(made.dataset().episodes["train"], columns, FEW)
    rows = np.random.default_rng(2).permutation(len(known.numbers))
    push = 0.005 * np.random.default_rng(3).standard_normal((len(rows), 3))
    left = np.exp(-np.array([1, 2, 3, 4, 9]) / 5.0)
    x, y = known.pushed(rows, push, left)
    x_0, y_0, free = known.numbers[rows], known.targets[rows], known.free[rows]
    assert 0.2 < free.mean() < 0.9
    here = bgr_image_policy.HERE
    np.testing.assert_allclose((x - x_0)[:, here][free, :3], push[free], atol=1e-15)
    np.testing.assert_allclose((x - x_0)[free, :3], -push[free], atol=1e-15)
    aside = (y[:, :, :3] + push[:, None]) - y_0[:, :, :3]
    np.testing.assert_allclose(aside[free], (push[:, None] * left[:, None])[free], atol=1e-15)
    np.testing.assert_array_equal(y[:, :, 3:], y_0[:, :, 3:])
    np.testing.assert_array_equal(x[~free], x_0[~free])
    np.testing.assert_array_equal(y[~free], y_0[~free])


def test_acting_step_by_step_is_what_was_trained(policy: bgr_image_policy.ImagePolicy) -> None:
    """Pictures of before included: chunks one by one are those of the whole episode."""
    shown = made.episode(99)
    columns = bgr_image_policy.state_columns(STATE)
    for _ in range(2):  # the second time after a reset
        policy.reset("", None)
        said: list[np.ndarray] = []
        last = shown.state[0, bgr_policy.SET]
        chunks = []
        for state, view in zip(shown.state, shown.views, strict=True):
            if np.linalg.norm(last[:3] - state[5:8]) > bgr_policy.REACH:
                last = state[bgr_policy.SET]
            said.append(last)
            seen = {bgr_policy.STATE: state, bgr_image_policy.PICTURE: view}
            chunks.append(policy.act(seen))
            assert chunks[-1].shape == (4, 5) and chunks[-1].dtype == np.float64
            last = chunks[-1][0, :4]
        whole = train_bgr_images.Samples.of([shown], columns, FEW)
        numbers = bgr_image_policy.numbers(columns, shown.state, np.array(said))
        rows = np.arange(len(shown.state))
        made_at_once = policy.look(whole.pictures(rows), numbers, np.array(said))
        np.testing.assert_allclose(np.array(chunks), made_at_once, atol=1e-5)


def test_numpy_alone_gives_what_the_trainer_had(
    policy: bgr_image_policy.ImagePolicy, tmp_path: Path
) -> None:
    """Saved, loaded, and run by a plain interpreter that has numpy and nothing of ours."""
    file = tmp_path / "weights.npz"
    policy.save(file)
    shown = made.episode(5)
    np.savez(tmp_path / "episode.npz", state=shown.state, views=shown.views)
    program = (
        "import sys, pathlib, numpy as np, bgr_image_policy as b\n"
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
        policy.act({bgr_policy.STATE: state, bgr_image_policy.PICTURE: view})
        for state, view in zip(shown.state, shown.views, strict=True)
    ]
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), here, rtol=0, atol=1e-6)


def test_weights_of_another_policy_are_refused(
    policy: bgr_image_policy.ImagePolicy, tmp_path: Path
) -> None:
    policy.save(tmp_path / "looking.npz")
    with pytest.raises(ValueError, match="surg_bgr_policy/1"):
        bgr_policy.Policy.load(tmp_path / "looking.npz")


# --- what does not fit ------------------------------------------------------------------------


def test_a_server_without_cameras_is_told_with_what_to_do() -> None:
    wanted = Spec.of_keys(list(bgr_image_policy.ImagePolicy.wants))
    (said,) = wanted.mismatches(Spec.of_keys(["observation.state"]))
    print(said)
    assert bgr_image_policy.PICTURE in said and "--cameras" in said


def test_a_dataset_without_pictures_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text('{"features": {"observation.state": {}}}')
    out = tmp_path / "w.npz"
    assert train_bgr_images.main([str(tmp_path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "action, observation.images.endoscope.left" in said and not out.exists()
    with pytest.raises(ValueError, match="'train'"):
        train_bgr_images.train(made.dataset(0, 1), FEW)
