"""Which programs learn a task, and what a run of `./surg learn` was asked for."""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_learn.source_digest import source_digest

if TYPE_CHECKING:
    from surg_sim.appearance.domain_randomization import DomainRandomization

EXPERT_NOISE = 5.0
"""Factor of the hand's error in every fourth demonstration of a policy that looks: some miss."""
PUSH_M = 0.003
"""Spread of the pushes in every second demonstration [m], see surg_sim.tasks.perturbed_sender."""


@dataclass(frozen=True)
class Recipe:
    """The programs that train and run a policy; modules of surg_learn."""

    train: str
    serve: str  # the policy's client
    cameras: tuple[str, ...] = ()  # views of the endoscope that are recorded and served
    still_camera: bool = False  # its labels are of the stated camera
    method: str = ""  # of a trainer for any task
    packages: tuple[str, ...] = ()  # sets of the package list that the trainer needs
    devices: str = ""  # program that says where a `--device` trains; empty: on the processor only
    episodes: int = 80  # default number of demonstrations
    expert_noise: float = 1.0  # of every fourth demonstration, see surg_sim.envs.demonstrations
    target: float = 0.0  # share of the roll-outs that must succeed; 0: it is only reported

    @property
    def script(self) -> Path:
        """File of the policy's client."""
        return Path(__file__).parents[1] / f"{self.serve.replace('.', '/')}.py"

    @property
    def digest(self) -> str:
        """Hash of the sources that train and run it."""
        return source_digest(Path(__file__).parent)

    def folder(self, weights: str) -> str:
        """Name of the folder for roll-outs of these weights by these very programs."""
        return hashlib.sha256(f"{weights} {self.digest}".encode()).hexdigest()[:12]

    def least(self, rollouts: int) -> int:
        """How many of so many roll-outs must succeed."""
        return math.ceil(self.target * rollouts - 1e-9)  # a float product can be a hair above


LOOKS = Recipe(
    "",
    "",
    packages=("torch",),
    devices="surg_learn.cloning.training.torch_device",
    cameras=("left",),
    episodes=60,
    expert_noise=EXPERT_NOISE,
)
"""What policies that observe camera images have in common."""
METHODS = {
    method: replace(
        LOOKS,
        train="surg_learn.cloning.train_cloned",
        serve="surg_learn.cloning.cloned_policy",
        method=method,
    )
    for method in ("moe_act", "act", "bc")
}
"""Methods of ``--cameras`` for every task, the default first."""
STATE = ""
"""The method without ``--cameras``, which observes the simulator's truth."""
OF_TASK = {
    "bgr": {
        STATE: Recipe("surg_learn.bgr.train_state", "surg_learn.bgr.state_policy", target=0.85),
        "keypoints": replace(
            LOOKS,
            train="surg_learn.bgr.train_images",
            serve="surg_learn.bgr.image_policy",
            still_camera=True,
        ),
    }
}
"""Methods that were made for one task; 85 % is the paper's 17 of 20."""


def recipe_of(task: str, method: str) -> Recipe:
    """The programs of a method.

    Raises:
        ValueError: There is none of this name for the task.
    """
    known = {**METHODS, **OF_TASK.get(task, {})}
    if method in known:
        return known[method]
    others = ", ".join(name for name in known if name != STATE)
    if method == STATE:
        raise ValueError(f"learn {task}: no policy for it reads the simulator's truth; --cameras")
    raise ValueError(f"--cameras {method}: for {task} there are {others}")


BUILT_IN = "built-in"
"""The ranges of looks that need no file."""


@dataclass(frozen=True)
class Request:
    """What a run of `learn` was asked for; stored beside its results."""

    task: str
    setting: str
    robot: str
    seed: int
    episodes: int
    rollouts: int
    method: str = STATE  # of `recipe_of`
    device: str = "auto"  # where it is trained
    looks: str = ""  # file of the demonstrations' ranges of looks, or BUILT_IN; empty: none

    @property
    def recipe(self) -> Recipe:
        """The programs for it."""
        return recipe_of(self.task, self.method)

    @property
    def cameras(self) -> bool:
        """Whether pictures are recorded."""
        return bool(self.recipe.cameras)

    @property
    def look_ranges(self) -> DomainRandomization | None:
        """From which each demonstration draws how its pictures look; None: as built.

        Raises:
            ConfigError: The file is missing or invalid.
            ValueError: The camera would move, and the labels are of the stated one.
        """
        from surg_sim.appearance.domain_randomization import DomainRandomization

        if not self.looks:
            return None
        still = {"camera_shift_mm": (0.0, 0.0), "camera_turn_deg": (0.0, 0.0)}
        if not self.recipe.still_camera:
            still = {}
        if self.looks == BUILT_IN:
            return replace(DomainRandomization(), **still)
        ranges = DomainRandomization.read(self.looks)
        for name, none in still.items():
            if getattr(ranges, name) != none:
                raise ValueError(
                    f"{self.looks}: {name}: the trainer's labels are of the stated camera; leave "
                    "it out: in training each picture is shifted, turned and scaled with its labels"
                )
        return ranges

    @property
    def demonstrations(self) -> dict[str, Any]:
        """What the demonstrations depend on."""
        recipe = self.recipe
        views = (
            {"cameras": recipe.cameras, "expert_noise": recipe.expert_noise} if self.cameras else {}
        )
        fixed = {"rollouts": 0, "seed": 0, "shake": PUSH_M}
        asked = {k: v for k, v in asdict(self).items() if k not in ("method", "device", "looks")}
        ranges = self.look_ranges
        looks = {} if ranges is None else {"looks": asdict(ranges)}
        return {**asked, **fixed, **views, **looks}
