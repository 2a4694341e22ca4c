"""The networks of the field: BC, ACT, MoE-ACT; PyTorch.

All three look through the same encoder, which is trained from random numbers, and answer with the
same chunks. They differ in what lies between:

- ``bc``: a multilayer perceptron.
- ``act``: a transformer over the places of the picture that decodes the chunk, trained as the
  decoder of a conditional variational autoencoder (Zhao et al. 2023).
- ``moe_act``: the same, and each phase of the task has an expert that says the actions. A gate
  mixes them, and learns the phases from labels (supervised mixture of experts, arXiv 2601.21971).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from surg_learn.cloning.arm_columns import MOTION

METHODS = ("moe_act", "act", "bc")
ACTION_SIZE = len(MOTION)
"""Tip, roll, jaw."""
CELLS = 8
"""Side of the encoder's coarse map, whose cells are the transformers' tokens."""


@dataclass(frozen=True)
class Sizes:
    """Of a network; stored with its weights."""

    method: str
    chunk: int
    """Actions predicted at once."""
    inputs: int
    """Numbers beside the pictures."""
    eyes: int = 1
    phases: int = 0
    """Experts of ``moe_act``."""
    width: int = 24
    """Channels of the encoder's first layer."""
    places: int = 32
    """Heat maps of the encoder's spatial softmax."""
    model: int = 128
    """Of the transformers' tokens."""
    heads: int = 8
    feed: int = 512
    layers: int = 2
    """Of each of the transformers."""
    latent: int = 32
    hidden: int = 256
    """Of the perceptrons."""


@dataclass
class Answer:
    """Of a network for B observations.

    Attributes:
        chunk: (B, chunk * 5), normalised.
        gate: (B, phases) logits; None: the network has no gate.
        spread: Divergence of the latent from a standard normal distribution, a mean over B; None:
            no action was given, or the network has no latent.
    """

    chunk: Any
    gate: Any = None
    spread: Any = None


class Block(nn.Module):
    """Two convolutions beside a shortcut (He et al. 2016), normalised over groups of channels."""

    def __init__(self, before: int, after: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(before, after, 3, stride, 1, bias=False)
        self.second = nn.Conv2d(after, after, 3, 1, 1, bias=False)
        self.norms = nn.ModuleList([nn.GroupNorm(8, after) for _ in range(2)])
        self.short = nn.Conv2d(before, after, 1, stride) if stride > 1 else nn.Identity()

    def forward(self, x: Any) -> Any:
        """(B, C, H, W) to (B, D, H / stride, W / stride)."""
        y = torch.relu(self.norms[0](self.first(x)))
        return torch.relu(self.short(x) + self.norms[1](self.second(y)))


class Encoder(nn.Module):
    """Places and a coarse map of a picture.

    A spatial softmax turns heat maps into places finer than a cell (Levine et al. 2016).
    """

    def __init__(self, width: int, places: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(3, width, 5, 2, 2, bias=False), nn.GroupNorm(8, width), nn.ReLU()
        )
        self.fine = nn.Sequential(Block(width, 2 * width, 2), Block(2 * width, 2 * width, 1))
        self.heat = nn.Conv2d(2 * width, places, 1)
        self.coarse = nn.Sequential(Block(2 * width, 4 * width, 2), Block(4 * width, 4 * width, 2))
        self.features = 2 * places + 4 * width

    def forward(self, x: Any) -> tuple[Any, Any]:
        """Encode pictures.

        Args:
            x: (B, 3, 120, 120), about -2 to 2.

        Returns:
            The map as tokens (B, CELLS**2, 4 * width); places and the map's mean, (B, features).
        """
        # Half the numbers' length, on a GPU in training; places need the whole.
        fast = x.is_cuda and self.training
        with torch.autocast(x.device.type, torch.bfloat16, enabled=fast):
            fine = self.fine(self.stem(x))
            coarse = self.coarse(fine)
        tokens = coarse.float().flatten(2).transpose(1, 2)
        where = middles(self.heat(fine.float()))
        return tokens, torch.cat([where, tokens.mean(dim=1)], dim=1)


def middles(maps: Any) -> Any:
    """Mean place of each map after a softmax over its cells, down then right, -1 to 1.

    Args:
        maps: (B, P, n, n).

    Returns:
        (B, 2 * P)
    """
    share = maps.flatten(2).softmax(dim=2).reshape(maps.shape)
    line = torch.linspace(-1, 1, maps.shape[2], device=maps.device)
    down, right = ((share.sum(dim=axis) * line).sum(dim=2) for axis in (3, 2))
    return torch.cat([down, right], dim=1)


def waves(side: int, size: int) -> Any:
    """Where each cell of a map is, as sines and cosines (Vaswani et al. 2017): (side * side, size).

    Half of them tell the row, the others the column.
    """
    rates = 10000.0 ** (-torch.arange(0, size // 2, 2) / (size // 2))
    line = torch.arange(side)[:, None] * rates
    along = torch.cat([line.sin(), line.cos()], dim=1)
    rows, columns = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    return torch.cat([along[rows.flatten()], along[columns.flatten()]], dim=1)


def perceptron(*sizes: int) -> Any:
    """With ReLU between the layers."""
    layers: list[Any] = []
    for a, b in zip(sizes, sizes[1:]):  # noqa: B905, RUF007  # one shorter; older Pythons
        layers += [nn.Linear(a, b), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Bc(nn.Module):
    """Plain behaviour cloning: what the encoder sees and the numbers, to the chunk."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.eye = Encoder(sizes.width, sizes.places)
        seen = sizes.eyes * self.eye.features + sizes.inputs
        self.hand = perceptron(seen, sizes.hidden, sizes.hidden, ACTION_SIZE * sizes.chunk)

    def forward(self, pictures: Sequence[Any], numbers: Any, told: Any = None) -> Answer:
        """See `Act`."""
        del told
        seen = [self.eye(picture)[1] for picture in pictures]
        return Answer(self.hand(torch.cat([*seen, numbers], dim=1)))


def coder(sizes: Sizes) -> Any:
    """A transformer over tokens.

    Without dropout, which costs a processor a quarter more. The changes of the pictures and the
    noise on the numbers stand against overfitting.
    """
    layer = nn.TransformerEncoderLayer(sizes.model, sizes.heads, sizes.feed, 0.0, batch_first=True)
    return nn.TransformerEncoder(layer, sizes.layers, enable_nested_tensor=False)


class Act(nn.Module):
    """Action chunking with transformers, smaller than the paper's; `moe_act` by its sizes."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.sizes, model = sizes, sizes.model
        self.eye = Encoder(sizes.width, sizes.places)
        self.cells = nn.Linear(4 * sizes.width, model)
        self.seen = nn.Linear(self.eye.features, model)
        self.numbers = nn.Linear(sizes.inputs, model)
        self.latent = nn.Linear(sizes.latent, model)
        self.register_buffer("where", waves(CELLS, model), persistent=False)
        self.kinds = nn.Parameter(0.02 * torch.randn(2 + 2 * sizes.eyes, model))
        self.encoder = coder(sizes)
        layer = nn.TransformerDecoderLayer(model, sizes.heads, sizes.feed, 0.0, batch_first=True)
        self.decoder = nn.TransformerDecoder(layer, sizes.layers)
        self.asked = nn.Parameter(0.02 * torch.randn(sizes.chunk, model))
        # What a person meant, from the whole chunk: in training only.
        self.style = coder(sizes)
        self.told = nn.Linear(ACTION_SIZE, model)
        self.begin = nn.Parameter(0.02 * torch.randn(2 + sizes.chunk, model))
        self.meant = nn.Linear(model, 2 * sizes.latent)
        self.head: Any
        if sizes.method == "moe_act":
            self.head = Experts(sizes)
        else:
            self.head = nn.Linear(model, ACTION_SIZE)

    def forward(self, pictures: Sequence[Any], numbers: Any, told: Any = None) -> Answer:
        """Answer B observations.

        Args:
            pictures: (B, 3, 120, 120) of each eye.
            numbers: (B, inputs), normalised.
            told: (B, chunk * 5), normalised: the chunks to imitate; None: not in training.
        """
        z, spread = self.style_of(numbers, told)
        kinds = self.kinds
        tokens = [self.latent(z)[:, None] + kinds[0], self.numbers(numbers)[:, None] + kinds[1]]
        for n, picture in enumerate(pictures):
            cells, seen = self.eye(picture)
            tokens.append(self.seen(seen)[:, None] + kinds[2 + 2 * n])
            tokens.append(self.cells(cells) + self.where + kinds[3 + 2 * n])
        memory = self.encoder(torch.cat(tokens, dim=1))
        out = self.decoder(self.asked.expand(len(z), -1, -1), memory)
        if self.sizes.method == "moe_act":
            # The tokens of numbers and places, after they have looked at everything.
            chunk, gate = self.head(out, memory[:, 1:3].flatten(1))
            return Answer(chunk.flatten(1), gate, spread)
        return Answer(self.head(out).flatten(1), None, spread)

    def style_of(self, numbers: Any, told: Any) -> tuple[Any, Any]:
        """The latent (B, latent), and its divergence; without chunks zeros, the prior's mean."""
        if told is None:
            return numbers.new_zeros(len(numbers), self.sizes.latent), None
        actions = self.told(told.reshape(len(told), -1, ACTION_SIZE))
        first = torch.zeros_like(actions[:, :1])
        tokens = torch.cat([first, self.numbers(numbers)[:, None], actions], dim=1) + self.begin
        mean, log = self.meant(self.style(tokens)[:, 0]).float().chunk(2, dim=1)
        spread = -0.5 * (1 + log - mean**2 - log.exp()).sum(dim=1).mean()
        return mean + (0.5 * log).exp() * torch.randn_like(mean), spread


class Experts(nn.Module):
    """An expert for each phase, a perceptron from the decoder's tokens to actions, and a gate."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.gate = perceptron(2 * sizes.model, sizes.model, sizes.phases)
        self.experts = nn.ModuleList(
            [perceptron(sizes.model, sizes.model, ACTION_SIZE) for _ in range(sizes.phases)]
        )

    def forward(self, out: Any, seen: Any) -> tuple[Any, Any]:
        """Actions (B, chunk, 5) from tokens (B, chunk, model), and the gate's logits."""
        gate = self.gate(seen).float()
        said = torch.stack([expert(out) for expert in self.experts], dim=1).float()
        return (gate.softmax(dim=1)[:, :, None, None] * said).sum(dim=1), gate


def network_of(sizes: Sizes) -> Any:
    """The network of a method, with random weights.

    Raises:
        ValueError: There is no such method, or it lacks phases.
    """
    if sizes.method not in METHODS:
        raise ValueError(f"method {sizes.method!r}: allowed are {', '.join(METHODS)}")
    if sizes.method == "moe_act" and sizes.phases < 2:
        raise ValueError(f"moe_act needs at least 2 phases, not {sizes.phases}")
    return Bc(sizes) if sizes.method == "bc" else Act(sizes)
