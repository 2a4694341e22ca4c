"""What a task is: things in the scene, a measure of success, and how an episode begins and ends.

A task is one file with one class. It puts its things into the scene before the scene is compiled
(`add`), finds them in the compiled scene (`bind`), draws an episode (`reset`), goes along tick by
tick (`advance`) and judges from ground truth (`verdict`). An episode changes the state of the model
only, never the model's structure, so that one compiled scene serves all of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from surg_core.contract import GRID, TICK

if TYPE_CHECKING:
    import mujoco

    import surg_core
    from surg_sim.physics.patient_settings import PatientSetting
    from surg_sim.physics.scene import Site
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

Array = NDArray[np.float64]
State = dict[str, "float | Array"]
"""Ground truth of a task at one tick: fixed names, fixed shapes, SI."""


class TaskError(ValueError):
    """A task that cannot be had, or that does not fit a cell: what is wrong and what would do."""


@dataclass(frozen=True)
class Verdict:
    """How an episode stands.

    Attributes:
        done: The episode ends here.
        success: It was one; never without ``done``.
        reason: Why it was none; empty before the end and after a success.
        timeout: It ended because its time is over, not by what was done.
        reward: For what was done up to this tick.
        phase: Where in the task the episode is.
    """

    done: bool = False
    success: bool = False
    reason: str = ""
    timeout: bool = False
    reward: float = 0.0
    phase: str = ""


class Task(ABC):
    """One task; see the module.

    Attributes:
        name: What a person types.
        title: What a person reads.
        time_limit: Longest episode [s].
        home_cell: The bundled cell that is taken when none is named.
        fitting_cells: Bundled cells that fit, for who brought another one.
        commanded: Arms that the task's policy commands, by CRTK name; the others stand still under
            their controllers.
        plotted: Numbers of the state that a figure of an episode shows, with their units.
        tick: Ticks since the episode began.
        assistant: The assistant's instrument in the scene, where there is one.
        skins: What the renderer draws by itself (``render.Skin``).
    """

    name: ClassVar[str]
    title: ClassVar[str]
    time_limit: ClassVar[float]
    home_cell: ClassVar[str] = "sim_two_arms"
    fitting_cells: ClassVar[tuple[str, ...]] = (
        *("sim_two_arms", "sim_two_arms_panda", "sim_ur5e", "sim_panda"),
    )
    commanded: ClassVar[tuple[str, ...]] = ("PSM1",)
    plotted: ClassVar[Mapping[str, str]] = {}

    def __init__(self) -> None:
        self.tick = 0
        self.assistant: Any = None
        self.skins: Sequence[Any] = ()

    # --- before an episode --------------------------------------------------------------------

    def prepare(self, cell: surg_core.Cell, setting: PatientSetting) -> None:
        """Look at the cell and the setting before the scene is built.

        Raises:
            TaskError: The cell does not fit; says why and which would.
        """
        missing = [name for name in self.commanded if name not in cell.arms]
        if missing:
            raise self.misfit(cell, f"needs the arms {', '.join(self.commanded)}")

    def misfit(self, cell: surg_core.Cell, needs: str) -> TaskError:
        """The refusal of a cell: what the task needs, what the cell has, which cell would do."""
        has = ", ".join(f"{name} with {arm.instrument.name}" for name, arm in cell.arms.items())
        return TaskError(
            f"task '{self.name}' {needs}; the cell '{cell.config.name}' has {has}. Take a cell "
            f"such as {', '.join(f'cells/{name}' for name in self.fitting_cells)}"
        )

    def need_jaws(self, cell: surg_core.Cell, arm: str) -> None:
        """Refuse a cell in which this arm is not there or has no jaws.

        Raises:
            TaskError: It is not, or has none.
        """
        held = cell.arms[arm].instrument if arm in cell.arms else None
        if held is None or held.jaw_max <= held.jaw_min:
            raise self.misfit(cell, f"needs {arm} with an instrument that has jaws")

    def add(self, spec: mujoco.MjSpec, site: Site, looks: bool) -> None:
        """Put the task's things into the scene; ``looks``: also what only pictures need."""
        del spec, site, looks

    @abstractmethod
    def bind(self, world: World) -> None:
        """Find the task's things in the compiled scene."""

    @abstractmethod
    def reset(self, rng: np.random.Generator) -> None:
        """Draw an episode and put the state there; the arms are at home, nothing has moved."""
        self.tick = 0

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """The scripted senders that can do this task, by node name; none by default.

        Args:
            cell: The cell.
            seed: Of their imperfections.
        """
        del cell, seed
        return {}

    # --- in an episode ------------------------------------------------------------------------

    def advance(self) -> None:
        """One tick on, called with state k right before the physics that leads to state k + 1."""
        self.tick += 1

    @property
    def time(self) -> float:
        """Since the episode began [s]."""
        return self.tick * TICK

    @property
    def on_grid(self) -> bool:
        """Whether this tick is one of the task's 20 looks per second."""
        return self.tick % GRID == 0

    @abstractmethod
    def state(self) -> State:
        """Ground truth now; the same names and shapes at every call."""

    def jaw_force(self, arm: str) -> Array | None:
        """Force of the task's things on the jaws of an arm now, world [N], (3,); None: no sensor.

        Whether there is one must not change. Robots with a force limit at the tip stop by it.
        """
        del arm
        return None

    @abstractmethod
    def verdict(self) -> Verdict:
        """How the episode stands now."""

    def late(self, phase: str, reward: float = 0.0) -> Verdict | None:
        """The verdict of an episode whose time is over; None while it is not."""
        if self.time < self.time_limit:
            return None
        reason = f"time limit of {self.time_limit:g} s in phase '{phase}'"
        return Verdict(done=True, reason=reason, timeout=True, reward=reward, phase=phase)
