"""Trains the network of `keypoint_network.py` with PyTorch; used by `train_images.py`.

Labels come from the simulator's truth (`privileged.task_state`), and are used here only. Of a real
robot's pictures a person could mark most of them: the requested place, both tips, who holds the
bowel. Points in space would then need two eyes or a depth camera. The tension only a simulator
knows.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Sequence
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
    SIDE,
    TENSION,
    Eye,
    grid,
    square,
)
from surg_learn.bgr.state_policy import NODES
from surg_learn.bgr.training.lerobot_dataset import RATE, Array
from surg_learn.bgr.training.perceptron import half_cosine
from surg_learn.bgr.training.picture_augmentation import Looks, Varied, inside_of

HEAT = 1.0
"""Standard deviation of a heat map's target [cells]."""
DEVICES = ("auto", "cpu", "cuda")
SHARES = (1.0, 5.0, 2.0, 10.0)
"""Weights of the losses of heat maps, tube, who holds, and jaw and tension."""
MOST_TENSION = 1.5
"""Larger tensions are all alike [N]."""


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


POINT_AT, POINT_SPEED, POINT_JAW = 0.025, 0.004, 0.1
"""An assistant points from at most so far [m], so slowly [m/s], with jaws so shut [rad]."""


@dataclass
class Labels:
    """What is to be found in N pictures.

    Attributes:
        points: (N, 3) the requested node in the rcm frame [m].
        marks: (N, 38, 2) the assistant's tip, the robot's tip and the bowel's nodes in the picture,
            down and right, -1 to 1 in the middle square.
        others: (N, 4) whether the robot and the assistant hold the bowel, the assistant's jaw angle
            [rad], the tension [N].
        rest: (N, 36, 3) the nodes in the rcm frame [m].
        free: (N,) whether nobody has touched the bowel.
        pointing: (N,) whether the assistant points.
        target: (N,) number of the requested node.
    """

    points: Array
    marks: Array
    others: Array
    rest: Array
    free: Array
    pointing: Array
    target: Array


def labels(
    task: Array, columns: dict[str, Array], X_RW: Array, X_WV: Array, K: Sequence[float]
) -> Labels:
    """Labels of T steps of an episode.

    Args:
        task: (T, n) `privileged.task_state`.
        columns: Of its parts, see `state_policy.Columns`.
        X_RW: (4, 4) pose of the world in the rcm frame.
        X_WV: (T, 4, 4) pose of the camera (x right, y down, z away).
        K: (4,) focal length, principal point right and down, and height of the picture [px].
    """
    T = len(task)
    nodes = task[:, columns["nodes"]].reshape(T, NODES, 3)
    row = np.arange(T)
    i = np.rint(task[:, columns["target"]]).astype(int).ravel()
    helper = task[:, columns["assistant_tip"]]
    p_W = np.concatenate([helper[:, None], task[:, None, columns["tip"]], nodes], axis=1)
    p_V = np.einsum("tji,tpj->tpi", X_WV[:, :3, :3], p_W - X_WV[:, None, :3, 3])
    # The middle of the picture is the principal point.
    places = K[0] * p_V[..., :2] / np.maximum(p_V[..., 2:], 1e-3) / (K[3] / 2)
    rest = nodes @ X_RW[:3, :3].T + X_RW[:3, 3]
    held = task[:, [*columns["held"].ravel(), *columns["assistant_held"].ravel()]] >= 0
    jaw = task[:, columns["assistant_jaw"]].ravel()
    tension = np.minimum(task[:, columns["tension"]].ravel(), MOST_TENSION)
    speed = np.linalg.norm(np.diff(helper, axis=0, prepend=helper[:1] + 1.0), axis=1) * RATE
    away = np.linalg.norm(helper - nodes[row, i], axis=1)
    return Labels(
        rest[row, i],
        places[..., ::-1],
        np.column_stack([held, jaw, tension]),
        rest,
        ~np.maximum.accumulate(held.any(axis=1)),
        (away < POINT_AT) & (speed < POINT_SPEED) & (jaw < POINT_JAW),
        i,
    )


def heats(marks: Array) -> Array:
    """Targets of the heat maps, (B, CELLS * CELLS, M): a Gaussian about each mark, of sum 1.

    A mark outside the picture has a map of zeros.
    """
    away: Array = grid(CELLS)[None, :, None, :] - marks[:, None, :, :].astype(np.float32)
    step = 2.0 / (CELLS - 1)
    heat = np.exp(-0.5 * (away**2).sum(axis=3) / (HEAT * step) ** 2)
    total = heat.sum(axis=1, keepdims=True)
    return np.where(total > 1.0, heat / np.maximum(total, 1e-9), 0.0).astype(np.float32)


def tubes(nodes: Array) -> Array:
    """Targets of the map of the tube, (B, CELLS * CELLS): 1 on its axis, a Gaussian across.

    Args:
        nodes: (B, 36, 2) marks of the nodes.
    """
    between = 0.5 * (nodes[:, 1:] + nodes[:, :-1])
    marks = np.concatenate([nodes, between], axis=1).astype(np.float32)
    cells = grid(CELLS)
    square_away = (
        (cells**2).sum(axis=1)[None, :, None]
        + (marks**2).sum(axis=2)[:, None, :]
        - 2.0 * np.einsum("cd,bmd->bcm", cells, marks)
    )
    step = 2.0 / (CELLS - 1)
    return np.exp(-0.5 * square_away.min(axis=2) / (HEAT * step) ** 2).astype(np.float32)


def plane_of(labels: Labels) -> Array:
    """`plane` of a `View`, by least squares over the nodes of a bowel that nobody has touched."""
    free = labels.free & (np.arange(len(labels.free)) % 5 == 0)
    inside = (np.abs(labels.marks[free, 2:]) < 1.0).all(axis=2)
    terms = square(labels.marks[free, 2:][inside])
    return np.asarray(np.linalg.lstsq(terms, labels.rest[free][inside], rcond=None)[0])


def pointed_of(labels: Labels) -> Array:
    """`pointed` of an `Eye`, by least squares.

    Raises:
        ValueError: Nobody points in any picture.
    """
    shown = np.flatnonzero(labels.pointing & labels.free)
    if len(shown) < 3:
        raise ValueError("the assistant points in no picture of the dataset")
    terms = np.column_stack([np.ones(len(shown)), labels.marks[shown, 0]])
    places = labels.marks[shown, 2 + labels.target[shown]]
    return np.asarray(np.linalg.lstsq(terms, places, rcond=None)[0])


def lens_of(points: Array, places: Array) -> Array:
    """The camera from points and where they are seen: direct linear transformation.

    Args:
        points: (N, 3) [m].
        places: (N, 2) down and right; those outside the picture are left out.

    Returns:
        (3, 4) homogeneous projection.
    """
    seen = (np.abs(places) < 1.0).all(axis=1)
    points, places = points[seen], places[seen]
    middle, spread = points.mean(axis=0), points.std()
    X = np.column_stack([(points - middle) / spread, np.ones(len(points))])
    zero = np.zeros_like(X)
    rows = np.concatenate(
        [
            np.column_stack([X, zero, -places[:, :1] * X]),
            np.column_stack([zero, X, -places[:, 1:] * X]),
        ]
    )
    P = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    to = np.eye(4)
    to[:3] = np.column_stack([np.eye(3), -middle]) / spread
    P = P @ to
    return np.asarray(P / (P @ np.append(middle, 1.0))[2])


class Trained:
    """The network of an `Eye` in PyTorch, while it is trained."""

    def __init__(
        self,
        options: EyeOptions,
        rng: np.random.Generator,
        start: Sequence[tuple[Array, Array]],
        device: str,
    ) -> None:
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
        for i, (array, _) in enumerate(start):
            self.weights[i] = torch.tensor(array.transpose(3, 2, 0, 1).copy())
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


def pytorch() -> Any:
    """The module.

    Raises:
        ValueError: It is not installed.
    """
    try:
        import torch
    except ImportError:
        raise ValueError("PyTorch trains the eye: apt install python3-torch") from None
    return torch


def device_for(wanted: str) -> str:
    """Where PyTorch trains: ``cpu`` or ``cuda``.

    Args:
        wanted: One of `DEVICES`; ``auto``: a GPU where PyTorch finds one.

    Raises:
        ValueError: It is none of them, PyTorch finds no GPU, or PyTorch is not installed.
    """
    if wanted not in DEVICES:
        raise ValueError(f"--device {wanted}: allowed are {', '.join(DEVICES)}")
    if wanted == "cpu":
        return "cpu"
    torch = pytorch()
    if torch.cuda.is_available():
        return "cuda"
    if wanted == "auto":
        return "cpu"
    built = torch.version.cuda
    why = "finds no GPU" if built else "was built without CUDA"
    raise ValueError(
        f"--device {wanted}: PyTorch {torch.__version__} {why}; --device cpu trains on the "
        "processor, --device auto on a GPU where there is one"
    )


def train_eye(
    views: Array,
    labels: Labels,
    options: EyeOptions,
    seed: int,
    progress: Callable[[float, str], None] = lambda part, note: None,
    start: Sequence[tuple[Array, Array]] = (),
    device: str = "cpu",
) -> Eye:
    """Train on N pictures.

    Args:
        views: (N, SIDE, SIDE, 3), uint8.
        labels: Of them.
        options: See there.
        seed: Of weights, batches and noise.
        progress: Called with the finished share and a note.
        start: Weights and biases to begin with, of the first layers.
        device: Of `device_for`.

    Raises:
        ValueError: PyTorch is not installed, or nobody points in any picture.
    """
    torch = pytorch()
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = Trained(options, rng, start, device)
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


def main(words: Sequence[str]) -> int:
    """Say where `--device WORD` trains; returns 0, or 2 where it cannot."""
    try:
        print(device_for(*words))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
