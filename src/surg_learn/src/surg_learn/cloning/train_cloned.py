"""Trains a policy of any task from pictures: MoE-ACT, ACT or BC; PyTorch.

    python3 -m surg_learn.cloning.train_cloned datasets/bgr --method act --seed 0 --out act_0.npz

It reads a LeRobot dataset (v2.1), and the same for all methods: pictures, what a robot measures,
and the demonstrator's commands, varied by `picture_augmentation`. MoE-ACT's gate learns the phases
of the recordings, too. No method reads the simulator's truth. Equal data, options, seed and number
of threads give equal weights on a processor.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import torch

from surg_learn.cloning.arm_columns import ACTION, STATE, Array, arm_of
from surg_learn.cloning.cloned_networks import METHODS, Answer, Sizes, network_of
from surg_learn.cloning.cloned_policy import ClonedPolicy, numbers_of, scaled
from surg_learn.cloning.small_pictures import SIDE
from surg_learn.cloning.training.lerobot_dataset import Progress, jaw_range, normalised, scales_of
from surg_learn.cloning.training.picture_augmentation import Looked, Looks, inside_of
from surg_learn.cloning.training.recorded_steps import (
    NO_PHASE,
    PHASE,
    Recorded,
    Steps,
    eyes_of,
    read,
)
from surg_learn.cloning.training.torch_device import DEVICES, device_for
from surg_learn.cloning.training.trainer_options import chosen, half_cosine, parser_of, trained

CHUNKS = {"bc": 16, "act": 40, "moe_act": 40}
"""Actions predicted at once: those of the image policy; 2 s, as in ACT's paper."""

RESERVE = 4
"""Steps of a chunk that are left for a late answer."""


@dataclass(frozen=True)
class Options:
    """Training options; the same for all methods but for the chunk.

    `play` and `looks.moved` were chosen on tuning seeds, with ACT; no other was tuned.
    """

    method: str = METHODS[0]
    chunk: int | None = None
    """None: of `CHUNKS`."""
    eyes: int = 1
    """1: the left one; 2: both."""
    arm: str = "PSM1"
    """That the policy commands."""
    steps: int = 4000
    """Optimiser steps."""
    batch: int = 32
    rate: float = 5e-4
    """Learning rate after `warm`; falls to zero along half a cosine."""
    warm: int = 200
    """Steps in which the learning rate rises."""
    decay: float = 1e-4
    """Weight decay."""
    noise: float = 0.3
    """Standard deviation of the noise on normalised numbers, as for the image policy's hand. With
    little noise a policy that stands still learns from its set-point that it goes on doing so."""
    spread: float = 10.0
    """Weight of the latent's divergence, as in ACT's paper."""
    gate: float = 1.0
    """Weight of the gate's cross-entropy with the phases."""
    play: int | None = None
    """Steps of a chunk that are played before the next one is asked for; None: but for the last
    `RESERVE` all."""
    seed: int = 0
    device: str = "auto"
    looks: Looks = field(default_factory=lambda: Looks(moved=0.0))
    """Pictures are not shifted and turned: that takes more steps than a laptop has."""
    sizes: dict[str, int] = field(default_factory=dict)
    """Further `Sizes` than their defaults."""


def train(
    found: Recorded, options: Options, progress: Progress = lambda part, note: None
) -> ClonedPolicy:
    """Train on the split ``train``.

    Args:
        found: Demonstrations.
        options: How.
        progress: Is told how far it is.

    Raises:
        ValueError: The split is empty, phases are missing, or the device is not there.
    """
    check(found, options)
    options = replace(options, device=device_for(options.device))
    chunk = chunk_of(options)
    known = Steps.of(found, "train", chunk)
    numbers = numbers_of(known.state, known.last)
    scales = {**scales_of(numbers, known.targets), "jaw_range": jaw_range(known.targets)}
    phases = len(found.phases) if options.method == "moe_act" else 0
    sizes = Sizes(
        options.method, chunk, numbers.shape[1], len(found.views), phases, **options.sizes
    )
    torch.manual_seed(options.seed)  # weights are drawn on the processor: alike on every device
    network = network_of(sizes).to(options.device)
    data = normalised(scales, numbers, known.targets)
    _fit(network, found, known, data, options, progress)
    about: dict[str, Any] = {
        "method": options.method,
        "options": asdict(options),
        "play": max(chunk - RESERVE, 1) if options.play is None else options.play,
        "dataset": found.about,
        "pictures": list(found.views),
        "phases": found.phases if phases else [],
        "episodes": {split: found.split.count(split) for split in dict.fromkeys(found.split)},
        "frames": len(known.rows),
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "observation": [STATE, *found.views],
        "privileged": [],
        "labels": [PHASE] if phases else [],
    }
    policy = ClonedPolicy(network, scales, found.names, sizes, about)
    policy.about |= {
        split: errors(policy, found, Steps.of(found, split, chunk))
        for split in dict.fromkeys(found.split)
    }
    policy.network.cpu()
    return policy


def chunk_of(options: Options) -> int:
    """Actions predicted at once."""
    return CHUNKS[options.method] if options.chunk is None else options.chunk


def check(found: Recorded, options: Options) -> None:
    """Refuse what cannot be trained.

    Raises:
        ValueError: Why.
    """
    if options.method not in METHODS:
        raise ValueError(f"method {options.method!r}: allowed are {', '.join(METHODS)}")
    chunk = chunk_of(options)
    if chunk < 1:
        raise ValueError(f"--chunk {chunk}: allowed are 1 and more")
    if options.play is not None and not 1 <= options.play <= chunk:
        raise ValueError(f"--play {options.play}: allowed are 1 to {chunk}, the steps of a chunk")
    if "train" not in found.split:
        raise ValueError("the dataset has no episode in its split 'train'")
    arm_of(found.names[ACTION])
    if options.method == "moe_act" and len(found.phases) < 2:
        raise ValueError(
            f"moe_act needs the phases of the recordings ({PHASE}), the dataset states "
            f"{len(found.phases)}; ./surg episode label marks them, ./surg episode export writes "
            "them"
        )


def _fit(
    network: Any,
    found: Recorded,
    known: Steps,
    data: tuple[Array, Array],
    options: Options,
    progress: Progress,
) -> None:
    """Train a network; ``data`` are normalised numbers and chunks of all steps."""
    device = options.device
    # The eyes of one observation look alike: the same draws for each.
    vary = [
        Looked(torch, SIDE, options.looks, inside_of(each), options.seed, device)
        for each in found.views.values()
    ]
    numbers, targets = (torch.from_numpy(each).to(device) for each in data)
    phase = torch.from_numpy(known.phase.astype(np.int64)).to(device)
    adam = torch.optim.AdamW(network.parameters(), lr=options.rate, weight_decay=options.decay)
    torch.backends.cuda.matmul.allow_tf32 = True  # a GPU's float32 with 10 bits instead of 23
    network.train()
    for step in range(options.steps):
        rng = np.random.default_rng([options.seed, 0, step])
        torch.manual_seed(int(rng.integers(2**63)))
        for look in vary:
            look.begin(options.seed, step)
        for group in adam.param_groups:
            rise = min((step + 1) / max(options.warm, 1), 1.0)
            group["lr"] = options.rate * rise * half_cosine(step / options.steps)
        picked = rng.integers(0, len(numbers), options.batch)
        rows = torch.from_numpy(picked).to(device)
        shown = (np.asarray(each[known.rows[picked]]) for each in found.views.values())
        seen = [
            scaled(look(torch.from_numpy(each).to(device).permute(0, 3, 1, 2)))
            for look, each in zip(vary, shown, strict=True)
        ]
        told = targets[rows]
        noisy = numbers[rows] + options.noise * torch.randn_like(numbers[rows])
        answer = network(seen, noisy, told)
        parts = losses(answer, told, phase[rows])
        shares = {"spread": options.spread, "gate": options.gate}
        loss = sum(shares.get(name, 1.0) * part for name, part in parts.items())
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        adam.step()
        if step % 50 == 0:
            said = ", ".join(f"{name} {part.item():.3f}" for name, part in parts.items())
            progress(step / options.steps, f"step {step} of {options.steps}: {said}")


def losses(answer: Answer, told: Any, phase: Any) -> dict[str, Any]:
    """Mean absolute error of the chunks; the latent's divergence; the gate's cross-entropy."""
    found = {"chunk": (answer.chunk.float() - told).abs().mean()}
    if answer.spread is not None:
        found["spread"] = answer.spread
    if answer.gate is not None:
        found["gate"] = torch.nn.functional.cross_entropy(
            answer.gate, phase, ignore_index=NO_PHASE, reduction="sum"
        ) / (phase != NO_PHASE).sum().clamp_min(1)
    return found


def errors(policy: ClonedPolicy, found: Recorded, steps: Steps) -> dict[str, float]:
    """Mean absolute error of unvaried steps, in standard deviations, as it is deployed.

    ``first`` is that of the next action; ``gate`` the share of the phases that the gate tells.
    """
    whole, first, right, labelled = 0.0, 0.0, 0, 0
    for rows in np.array_split(np.arange(len(steps.rows)), len(steps.rows) // 256 + 1):
        views = [each[steps.rows[rows]] for each in found.views.values()]
        answer = policy.answer(views, steps.state[rows], steps.last[rows])
        numbers = numbers_of(steps.state[rows], steps.last[rows])
        _, told = normalised(policy.scales, numbers, steps.targets[rows])
        off = np.abs(answer.chunk.float().cpu().numpy() - told)
        whole, first = whole + off.mean(axis=1).sum(), first + off[:, :5].mean(axis=1).sum()
        if answer.gate is not None:
            there = steps.phase[rows] != NO_PHASE
            said = answer.gate.argmax(dim=1).cpu().numpy()
            right += int((said == steps.phase[rows])[there].sum())
            labelled += int(there.sum())
    count = len(steps.rows)
    gate = {"gate": right / labelled} if labelled else {}
    return {"chunk": float(whole / count), "first": float(first / count), **gate}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = parser_of("train_cloned", (__doc__ or "").split("\n")[0])
    made.add_argument("--method", choices=METHODS, default=METHODS[0])
    made.add_argument("--device", choices=DEVICES, default=DEVICES[0], help="where it trains")
    made.add_argument("--eyes", type=int, choices=(1, 2), default=1, help="left, or left + right")
    made.add_argument("--arm", help="that it commands (PSM1)", default=argparse.SUPPRESS)
    for name, kind, about in (
        ("batch", int, "observations of a step"),
        ("play", int, "steps that are played before the next chunk is asked for (all but 4)"),
        ("noise", float, "on normalised numbers, standard deviation (default 0.3)"),
        ("moved", float, "chance of a shifted and turned picture (default 0)"),
    ):
        made.add_argument(f"--{name}", type=kind, help=about, default=argparse.SUPPRESS)
    return made


def brief_of(known: dict[str, Any]) -> str:
    """For `trained`."""
    errors = ", ".join(f"{split} {known[split]['chunk']:.4f}" for split in known["episodes"])
    return (
        f"chunks of {known['chunk']}, {known['method']}, {known['parameters']} parameters, "
        f"{known['frames']} frames, error {errors}"
    )


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for unusable data."""
    given = parser().parse_args(words)

    def make(show: Progress) -> ClonedPolicy:
        looks = {"looks": Looks(moved=given.moved)} if "moved" in given else {}
        options = chosen(Options, given, **looks)
        if options.device != "auto":
            device_for(options.device)  # before minutes of reading
        found = read(given.dataset, eyes_of(options.eyes), options.arm, show)
        return train(found, options, show)

    return trained("train_cloned", given, make, brief_of)


if __name__ == "__main__":
    sys.exit(main())
