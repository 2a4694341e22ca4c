"""Trains the network of `keypoint_network.py` with PyTorch; used by `train_images.py`."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surg_learn.bgr.image_policy import CERTAIN, TARGET
from surg_learn.bgr.keypoint_network import (
    CELLS,
    CONVOLUTIONS,
    HELD,
    MAPS,
    OTHER_HELD,
    OTHER_JAW,
    PLACE,
    TENSION,
    Eye,
    grid,
)
from surg_learn.bgr.training.keypoint_labels import Labels, heats, pointed_of, tubes
from surg_learn.cloning.arm_columns import Array
from surg_learn.cloning.small_pictures import SIDE
from surg_learn.cloning.training.picture_augmentation import Looks, Varied, inside_of
from surg_learn.cloning.training.torch_device import pytorch
from surg_learn.cloning.training.trainer_options import half_cosine

SHARES = (1.0, 5.0, 2.0, 10.0)
"""Weights of the losses of heat maps, tube, who holds, and jaw and tension."""


@dataclass(frozen=True)
class EyeOptions:
    """Training options of the eye."""

    channels: tuple[int, ...] = (16, 32, 32, 32, 32, 32)
    hidden: int = 64
    steps: int = 1500
    batch: int = 32
    rate: float = 2e-3
    """Initial learning rate; falls to zero along half a cosine."""
    decay: float = 1e-4
    """Weight decay."""
    looks: Looks = field(default_factory=Looks)


class Trained:
    """The network of an `Eye` in PyTorch, while it is trained."""

    def __init__(self, options: EyeOptions, rng: np.random.Generator, device: str) -> None:
        self._torch = torch = pytorch()
        self._device = device
        shapes: list[tuple[int, ...]] = []
        before = 3
        for (size, _, _), channels in zip(CONVOLUTIONS, options.channels, strict=True):
            shapes.append((channels, before, size, size))
            before = channels
        shapes.append((len(MAPS) + 1, before, 1, 1))
        inputs = 2 * len(MAPS) + before * (1 + len(MAPS))
        sizes = [inputs, options.hidden, options.hidden, TENSION + 1]
        shapes += [(b, a) for a, b in itertools.pairwise(sizes)]
        self.weights = []
        for shape in shapes:
            scale = np.sqrt(2.0 / np.prod(shape[1:]))
            array = scale * rng.standard_normal(shape)
            self.weights.append(torch.tensor(array, dtype=torch.float32))
        self.weights[-1] *= 0.1
        # Drawn on the processor, so that a seed means the same on every device.
        self.weights = [weight.to(device) for weight in self.weights]
        self.biases = [torch.zeros(shape[0], device=device) for shape in shapes]
        for parameter in self.parameters:
            parameter.requires_grad_(True)
        self._cells = torch.from_numpy(grid(CELLS)).to(device)

    @property
    def parameters(self) -> list[Any]:
        """Weights and biases of all layers."""
        return [*self.weights, *self.biases]

    def __call__(self, x: Any) -> tuple[Any, Any, Any]:
        """Logarithm of the heat maps, logits of the tube, and what else is said of pictures."""
        torch, weights, biases = self._torch, self.weights, self.biases
        F, k = torch.nn.functional, len(CONVOLUTIONS)
        # Half the numbers' length halves the time of a step; what is trained stays float32.
        with torch.autocast(self._device, dtype=torch.bfloat16):
            for weight, bias, (size, stride, dilation) in zip(
                weights, biases, CONVOLUTIONS, strict=False
            ):
                pad = dilation * (size // 2)
                x = F.relu(F.conv2d(x, weight, bias, stride, pad, dilation))
        x = x.float()
        maps = F.conv2d(x, weights[k], biases[k]).flatten(2)
        points, tube = maps[:, : len(MAPS)], maps[:, len(MAPS)]
        share = F.softmax(points, dim=2)
        flat = x.flatten(2)
        there = share @ flat.transpose(1, 2)
        # Where the instruments are is learned from their marks alone.
        where = (share @ self._cells).detach()
        y = torch.cat([where.flatten(1), flat.mean(dim=2), there.flatten(1)], dim=1)
        y = F.relu(F.linear(y, weights[k + 1], biases[k + 1]))
        y = F.relu(F.linear(y, weights[k + 2], biases[k + 2]))
        return F.log_softmax(points, dim=2), tube, F.linear(y, weights[k + 3], biases[k + 3])

    def losses(self, x: Any, marks: Array, others: Array) -> tuple[Any, Any, Any, Any]:
        """Of heat maps, tube, who holds, and jaw and tension, for pictures (B, 3, ...)."""
        torch = self._torch
        F: Any = torch.nn.functional

        def there(array: Array) -> Any:
            return torch.from_numpy(array).to(self._device)

        maps, tube, raw = self(x)
        heat = there(heats(marks[:, : len(MAPS)])).transpose(1, 2)
        wanted = there(tubes(marks[:, len(MAPS) :]))
        truth = there(others.astype(np.float32))
        return (
            -(heat * maps).sum() / heat.sum().clamp_min(1.0),
            F.binary_cross_entropy_with_logits(tube, wanted),
            F.binary_cross_entropy_with_logits(raw[:, :OTHER_JAW], truth[:, :2]),
            F.smooth_l1_loss(raw[:, OTHER_JAW:], truth[:, 2:]),
        )

    def layers(self) -> list[tuple[Array, Array]]:
        """Weights and biases as an `Eye` has them."""
        found, k = [], len(CONVOLUTIONS)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            array, offset = weight.detach().cpu().numpy(), bias.detach().cpu().numpy()
            if i < k:
                array = array.transpose(2, 3, 1, 0)
            elif i == k:
                array = array[:, :, 0, 0].T
            else:
                array = array.T
            found.append((np.ascontiguousarray(array), offset.copy()))
        return found


def train_eye(
    views: Array,
    labels: Labels,
    options: EyeOptions,
    seed: int,
    progress: Callable[[float, str], None] = lambda part, note: None,
    device: str = "cpu",
) -> Eye:
    """Train on N pictures.

    Args:
        views: (N, SIDE, SIDE, 3), uint8.
        labels: Of them.
        options: See there.
        seed: Of weights, batches and noise.
        progress: Called with the finished share and a note.
        device: Of `device_for`.

    Raises:
        ValueError: PyTorch is not installed, or nobody points in any picture.
    """
    torch = pytorch()
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = Trained(options, rng, device)
    parameters = network.parameters
    adam = torch.optim.AdamW(parameters, lr=options.rate, weight_decay=options.decay)
    vary = Varied(torch, SIDE, options.looks, inside_of(views), seed, device)
    for step in range(options.steps):
        for group in adam.param_groups:
            group["lr"] = options.rate * half_cosine(step / options.steps)
        rows = rng.integers(0, len(views), options.batch)
        x, marks = vary(views[rows], labels.marks[rows])
        parts = network.losses((x - 128.0) / 64.0, marks, labels.others[rows])
        loss = sum(share * part for share, part in zip(SHARES, parts, strict=True))
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(parameters, 10.0)
        adam.step()
        if step % 25 == 0:
            said = ", ".join(f"{float(part.detach()):.3f}" for part in parts)
            progress(step / options.steps, f"eye, step {step} of {options.steps}, losses {said}")
    return Eye(network.layers(), pointed_of(labels))


def errors(seen: Array, labels: Labels) -> dict[str, Any]:
    """How far the eye is off: median and 90th percentile, and shares right.

    Args:
        seen: (N, n) of `image_policy.remembered`.
        labels: Of the same pictures.
    """
    off = np.linalg.norm(seen[:, TARGET] - labels.points, axis=1)
    placed = np.linalg.norm(seen[:, PLACE] - labels.marks[:, 0], axis=1)
    right = (seen[:, [HELD, OTHER_HELD]] > 0.5) == (labels.others[:, :2] > 0.5)
    # Once it was pointed at, and before it is touched.
    known = labels.free & (seen[:, CERTAIN] > 0.9)
    quantiles = [0.5, 0.9]
    return {
        "target": np.quantile(off[known], quantiles).tolist() if known.any() else None,
        "helper": np.quantile(placed, quantiles).tolist(),
        "held": right.mean(axis=0).tolist(),
    }


assert SIDE == 4 * CELLS
