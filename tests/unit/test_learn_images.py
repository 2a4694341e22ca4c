"""The policy that looks at pictures: its convolutions, their gradient, what it sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.bgr_synthetic import STATE, bgr_policy, train_bgr

import bgr_image_policy as seeing  # isort: skip
import train_bgr_images as training  # isort: skip


def network(
    seed: int = 0, hidden: int = 16, out: int = 10
) -> tuple[seeing.ImageNetwork, np.ndarray]:
    """A small network of the policy's shape, and all its numbers in one vector."""
    rng = np.random.default_rng(seed)
    shapes = training.sizes(training.ImageOptions(chunk=out // 5, hidden=(hidden,)), 9)
    flat, layers = train_bgr.flat_layers(shapes)
    flat[:] = 0.05 * rng.standard_normal(flat.size)
    return seeing.ImageNetwork(layers), flat


def inputs(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    shown = rng.integers(0, 256, (count, 96, 96, 3)).astype(np.uint8)
    return shown, rng.standard_normal((count, 9)).astype(np.float32)


def test_a_convolution_is_the_sum_that_its_name_says() -> None:
    """Against four nested loops, and so with no index of ours."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal((2, 9, 9, 3))
    weight = rng.standard_normal((3 * 3 * 3, 5))
    found = seeing.windows(x, 3, 2) @ weight
    assert found.shape == (2, 4, 4, 5)
    for n, i, j in np.ndindex(2, 4, 4):
        seen = [x[n, 2 * i + a, 2 * j + b, c] for a in range(3) for b in range(3) for c in range(3)]
        np.testing.assert_allclose(found[n, i, j], np.array(seen) @ weight)


def test_the_gradient_is_that_of_the_loss() -> None:
    """Central differences along random directions, layer by layer."""
    made, flat = network()
    shown, state = inputs(3)
    target = np.random.default_rng(4).standard_normal((3, 10)).astype(np.float32)
    shapes = training.sizes(training.ImageOptions(chunk=2, hidden=(16,)), 9)
    slope, grads = train_bgr.flat_layers(shapes)
    training.gradient_of(made, grads, shown, state, target)

    def loss() -> float:
        return train_bgr.huber((made(shown, state) - target).astype(np.float64))[0]

    ends = np.cumsum([0, *((a + 1) * b for a, b in shapes)])
    rng = np.random.default_rng(5)
    for layer in range(len(shapes)):
        part = slice(ends[layer], ends[layer + 1])
        way = rng.standard_normal(ends[layer + 1] - ends[layer]).astype(np.float32)
        way /= np.linalg.norm(way)
        kept = flat[part].copy()
        flat[part] = kept + 3e-3 * way
        up = loss()
        flat[part] = kept - 3e-3 * way
        down = loss()
        flat[part] = kept
        measured, stated = (up - down) / 6e-3, float(slope[part] @ way)
        assert stated == pytest.approx(measured, rel=0.05, abs=2e-5), layer


def test_the_picture_is_its_middle_square() -> None:
    picture = np.zeros((480, 640, 3), np.uint8)
    picture[:, :80] = picture[:, 560:] = 255  # what lies outside is not seen
    picture[5:10, 80:85] = 200  # one tile
    seen = seeing.square(picture)
    assert seen.shape == (96, 96, 3)
    assert seen[1, 0].tolist() == [200] * 3 and int((seen > 0).any(axis=2).sum()) == 1
    with pytest.raises(ValueError, match="multiple of 96"):
        seeing.square(np.zeros((100, 100, 3), np.uint8))


def test_it_is_small_and_privileged_of_nothing() -> None:
    shapes = training.sizes(training.ImageOptions(), 9)
    count = sum((a + 1) * b for a, b in shapes)
    print(f"{count} parameters")
    assert count <= 500_000
    assert all(not key.startswith("privileged") for key in seeing.ImagePolicy.wants)


def test_weights_of_one_policy_are_not_taken_by_the_other(tmp_path: Path) -> None:
    made, _ = network()
    scales = {
        "input_mean": np.zeros(9),
        "input_std": np.ones(9),
        "output_mean": np.zeros(10),
        "output_std": np.ones(10),
        "jaw_range": np.array([-10.0, 10.0]),
    }
    policy = seeing.ImagePolicy(made, scales, {bgr_policy.STATE: STATE}, 2, {"privileged": []})
    file = tmp_path / "weights.npz"
    policy.save(file)
    again = seeing.ImagePolicy.load(file)
    assert again.hash == policy.hash
    shown, state = inputs(1)
    picture = np.repeat(np.repeat(shown[0], 5, axis=0), 5, axis=1)
    observation = {bgr_policy.STATE: state[0], seeing.PICTURE: picture}
    chunk = again.act(observation)
    assert chunk is not None and chunk.shape == (2, 5)
    np.testing.assert_allclose(chunk, policy.predict(shown, state)[0])
    with pytest.raises(ValueError, match="format"):
        bgr_policy.Policy.load(file)
