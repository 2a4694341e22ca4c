"""Base class of tasks: objects in the scene, episodes, and their success.

A task adds its objects to the scene before compilation (``add``), looks them up in the compiled
scene (``bind``), draws an episode (``reset``), is advanced in every tick (``advance``) and judges
from ground truth (``verdict``). An episode changes the state of the model, never its structure, so
that all episodes share one compiled scene.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

import surg_core
from surg_core.contract import GRID, TICK
from surg_sim.arrays import Array

if TYPE_CHECKING:
    import mujoco

    from surg_sim.physics.patient_settings import PatientSetting
    from surg_sim.physics.scene import Site
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

State = dict[str, "float | Array"]
"""Ground truth of a task at one tick: fixed names and shapes, SI units."""


class TaskError(ValueError):
    """A task does not exist or does not fit the cell; the message states what would fit."""


@dataclass(frozen=True)
class Verdict:
    """State of an episode.

    Attributes:
        done: The episode has ended.
        success: It ended with success; never without ``done``.
        reason: Why it failed; empty before the end and after a success.
        timeout: It ended at its time limit.
        reward: Reward of this tick.
        phase: Phase of the task.

    Raises:
        TaskError: A member has a wrong type or value; names it.
    """

    done: bool = False
    success: bool = False
    reason: str = ""
    timeout: bool = False
    reward: float = 0.0
    phase: str = ""

    def __post_init__(self) -> None:
        """Check the members here: the nodes would fail far from the task."""
        for name in ("done", "success", "timeout"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise TaskError(f"Verdict.{name} is {getattr(self, name)!r}; allowed: True, False")
        for name in ("reason", "phase"):
            if not isinstance(getattr(self, name), str):
                raise TaskError(f"Verdict.{name} is {getattr(self, name)!r}; allowed: a string")
        number = isinstance(self.reward, (int, float, np.integer, np.floating))
        if not (number and np.isfinite(self.reward)):
            raise TaskError(f"Verdict.reward is {self.reward!r}; allowed: a finite number")
        if self.success and not self.done:
            raise TaskError("Verdict.success is True without done; a success ends the episode")


class Task(ABC):
    """One task; see the module.

    Attributes:
        name: Name on the command line.
        title: Name for people.
        instruction: What shall be done, as one sentence to whoever does it; empty: the title.
        stages: Phase of ``Verdict.phase`` -> its instruction, in their usual order.
        time_limit: Longest episode [s].
        home_cell: Bundled cell used if none is given.
        fitting_cells: Bundled cells that fit, for error messages.
        jaws: Arm whose instrument must have jaws; empty: none. Its tip is ``tip``.
        commanded: Arms that the task's policy commands, by CRTK name; all others hold still.
        plotted: State values shown in the figure of an episode, with their units.
        tick: Ticks since the episode began.
        assistant: The assistant's instrument, if there is one.
        skins: Deformable surfaces for the renderer (``render.Skin``).
    """

    name: ClassVar[str]
    title: ClassVar[str]
    instruction: ClassVar[str] = ""
    stages: ClassVar[Mapping[str, str]] = {}
    time_limit: ClassVar[float]
    home_cell: ClassVar[str] = "sim_two_arms"
    fitting_cells: ClassVar[tuple[str, ...]] = (
        *("sim_two_arms", "sim_two_arms_panda", "sim_ur5e", "sim_panda"),
    )
    jaws: ClassVar[str] = ""
    commanded: ClassVar[tuple[str, ...]] = ("PSM1",)
    plotted: ClassVar[Mapping[str, str]] = {}

    def __init__(self) -> None:
        self.tick = 0
        self.assistant: Any = None
        self.skins: Sequence[Any] = ()

    def language(self) -> dict[str, Any]:
        """The instructions as a recording's manifest and a dataset state them."""
        return {
            "title": self.title,
            "instruction": self.instruction or self.title,
            "stages": dict(self.stages),
        }

    # --- before an episode --------------------------------------------------------------------

    def prepare(self, cell: surg_core.Cell, setting: PatientSetting) -> None:
        """Check the cell and the setting before the scene is built.

        Raises:
            TaskError: The cell does not fit.
        """
        missing = [name for name in self.commanded if name not in cell.arms]
        if missing:
            raise self.misfit(cell, f"needs the arms {', '.join(self.commanded)}")
        if self.jaws:
            self.need_jaws(cell, self.jaws)
            self.tip_link: str = cell.arms[self.jaws].instrument.tip_link

    def misfit(self, cell: surg_core.Cell, needs: str) -> TaskError:
        """Error about a cell: what the task needs, what the cell has, which cells fit."""
        has = ", ".join(f"{name} with {arm.instrument.name}" for name, arm in cell.arms.items())
        return TaskError(
            f"task '{self.name}' {needs}; the cell '{cell.config.name}' has {has}. Take a cell "
            f"such as {', '.join(f'cells/{name}' for name in self.fitting_cells)}"
        )

    def need_jaws(self, cell: surg_core.Cell, arm: str) -> None:
        """Check that an arm exists and holds an instrument with jaws.

        Raises:
            TaskError: It does not.
        """
        held = cell.arms[arm].instrument if arm in cell.arms else None
        if held is None or held.jaw_max <= held.jaw_min:
            raise self.misfit(cell, f"needs {arm} with an instrument that has jaws")

    def add(self, spec: mujoco.MjSpec, site: Site, visuals: bool) -> None:
        """Add the task's objects to the scene; with ``visuals`` also visual ones."""
        del spec, site, visuals

    @abstractmethod
    def bind(self, world: World) -> None:
        """Look the task's objects up in the compiled scene."""

    def find_tip(self, world: World) -> None:
        """Look up the tip of the arm ``jaws``, for ``tip``."""
        self._p_WTip = world.data.xpos[world.model.body(f"{self.jaws}_{self.tip_link}").id]

    @property
    def tip(self) -> Array:
        """Tip of the arm ``jaws`` in the world [m], (3,)."""
        return np.array(self._p_WTip)

    @abstractmethod
    def reset(self, rng: np.random.Generator) -> None:
        """Draw an episode and set its initial state; the arms are at home."""
        self.tick = 0

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """Scripted experts by node name; the seed draws their imperfections. None by default."""
        del cell, seed
        return {}

    # --- in an episode ------------------------------------------------------------------------

    def advance(self) -> None:
        """Advance by one tick; called with state k before the physics that leads to state k + 1."""
        self.tick += 1

    @property
    def time(self) -> float:
        """Since the episode began [s]."""
        return self.tick * TICK

    @property
    def on_grid(self) -> bool:
        """Whether the task is evaluated in this tick (20 Hz)."""
        return self.tick % GRID == 0

    @abstractmethod
    def state(self) -> State:
        """Ground truth now; the same names and shapes at every call."""

    def jaw_force(self, arm: str) -> Array | None:
        """Force of the task's objects on an arm's jaws, world frame [N], (3,); None: no sensor.

        Whether there is a sensor must not change. Controllers with a tip force limit use it.
        """
        del arm
        return None

    @abstractmethod
    def verdict(self) -> Verdict:
        """State of the episode."""

    def late(self, phase: str, reward: float = 0.0) -> Verdict | None:
        """Verdict at the time limit; None before it."""
        if self.time < self.time_limit:
            return None
        reason = f"time limit of {self.time_limit:g} s in phase '{phase}'"
        return Verdict(done=True, reason=reason, timeout=True, reward=reward, phase=phase)
