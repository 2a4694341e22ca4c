"""Endoscope guidance: the second arm keeps the tip of a moving instrument in the picture's centre.

A script moves the instrument on a smooth random path. The error is the distance of its tip to the
centre of the view in pixels of a picture 480 high. The tip's place in the view is the mean of its
places in both pictures of a stereo endoscope, whose axis runs between the cameras. Success: over
the whole path the error stays small on average and never becomes so large that the tip leaves the
middle of the picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

import surg_core
from surg_core.contract import GRID, TICK
from surg_sim.arrays import Array
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.endoscope_rig import cameras
from surg_sim.tasks.endoscope_guidance.endoscope_guidance_expert import (
    GuidanceExpert,
    InstrumentScript,
)
from surg_sim.tasks.task import State, Task, Verdict

if TYPE_CHECKING:
    from surg_sim.physics.patient_settings import PatientSetting
    from surg_sim.physics.world import World
    from surg_sim.tasks.scripted_sender import Expert

INSTRUMENT, SCOPE = "PSM1", "ECM"
HEIGHT = 480
"""Of the picture in which errors are measured [px]."""

READY = 2.0
"""The instrument waits so long, and nothing is judged [s]."""
DURATION = 20.0
"""Of the instrument's path [s]."""
REACH = np.array([0.025, 0.018, 0.012])
"""Half size of the box in which the instrument moves, patient axes about the work point [m]."""
WAVES = 3
"""Sinusoids per axis of the path."""
SLOW, FAST = 0.05, 0.20
"""Range of their frequencies [1/s]."""

MEAN_ERROR = 25.0
"""Success needs a mean error of at most this [px]."""
MAX_ERROR = 120.0
"""An error above this ends the episode: the tip has left the middle of the picture [px]."""


class InstrumentPath:
    """A smooth random path of the instrument's tip: sums of slow sinusoids that start at zero."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._frequency = rng.uniform(SLOW, FAST, (WAVES, 3))
        weight = rng.uniform(0.5, 1.0, (WAVES, 3))
        self._amplitude = REACH * weight / weight.sum(axis=0)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (WAVES, 3))

    def at(self, t: float) -> Array:
        """Offset from where the instrument began, patient axes, at t [s], (3,) [m]."""
        t = min(max(t, 0.0), DURATION)
        waves = np.sin(2.0 * np.pi * self._frequency * t + self._phase) - np.sin(self._phase)
        fade = min(t / 2.0, 1.0)
        return np.asarray(fade * fade * (3.0 - 2.0 * fade) * (self._amplitude * waves).sum(axis=0))


class EndoscopeGuidance(Task):
    """See the module."""

    name = "endoscope_guidance"
    title = "Endoscope guidance"
    instruction = "Keep the tip of the moving instrument in the centre of the picture."
    stages: ClassVar[Mapping[str, str]] = {
        "ready": "Hold the endoscope still until the instrument moves.",
        "follow": "Follow the tip of the instrument so that it stays in the centre.",
    }
    time_limit = READY + DURATION
    fitting_cells = ("sim_two_arms", "sim_two_arms_panda")
    commanded = (SCOPE,)
    plotted: ClassVar[Mapping[str, str]] = {"error": "px"}

    def prepare(self, cell: surg_core.Cell, setting: PatientSetting) -> None:
        """Two arms are needed, and the second must hold a camera."""
        arms = cell.arms
        if INSTRUMENT not in arms or SCOPE not in arms or arms[SCOPE].instrument.camera is None:
            needs = f"needs {INSTRUMENT} with an instrument and {SCOPE} with an endoscope"
            raise self.misfit(cell, needs)
        super().prepare(cell, setting)
        self._tip = cell.arms[INSTRUMENT].instrument.tip_link

    def bind(self, world: World) -> None:
        """Find the instrument's tip and the cameras."""
        from surg_sim.physics.scene import site_of

        self._data = world.data
        self._body = int(world.model.body(f"{INSTRUMENT}_{self._tip}").id)
        self._R = site_of([world.cell.arms[name] for name in world.arms]).R
        scope = world.cell.arms[SCOPE]
        self.views = [EndoscopeView(world.model, world.data, eye) for eye in cameras(scope)]

    def reset(self, rng: np.random.Generator) -> None:
        """A new path."""
        super().reset(rng)
        self.path = InstrumentPath(rng)
        self._errors: list[float] = []
        self.error = 0.0
        self._lost = False

    def experts(self, cell: surg_core.Cell, seed: int) -> Mapping[str, Expert]:
        """Two: the one who guides, and the script of the instrument."""
        return {
            "expert": GuidanceExpert(cell, seed, SCOPE),
            "instrument": InstrumentScript(cell, seed, INSTRUMENT),
        }

    @property
    def tip(self) -> Array:
        """The instrument's tip in the world [m], (3,)."""
        return np.array(self._data.xpos[self._body])

    def pixels(self) -> Array:
        """Where the tip is in the view, from its centre, x right, y down, (2,) [px].

        The mean over the pictures: in each alone a tip on the endoscope's axis is beside the centre
        by half the disparity.
        """
        places = [view.project(self.tip)[0] for view in self.views]
        return np.asarray(HEIGHT * np.mean(places, axis=0))

    def advance(self) -> None:
        """20 times a second: the error."""
        super().advance()
        if self.on_grid:
            error = float(np.hypot(*self.pixels()))
            self.error = error if np.isfinite(error) else 10.0 * MAX_ERROR
            if self.time > READY:
                self._errors.append(self.error)
                self._lost |= self.error > MAX_ERROR

    @property
    def mean_error(self) -> float:
        """Over what has been judged so far [px]."""
        return float(np.mean(self._errors)) if self._errors else 0.0

    def state(self) -> State:
        """Points in the world [m], axes of the cameras as columns, pixels of a picture 480 high.

        ``lens`` lies between the lenses.
        """
        eyes = [view.pose for view in self.views]
        offset = self.path.at(self.time - READY)
        return {
            "tip": self.tip,
            "lens": np.mean([eye[:3, 3] for eye in eyes], axis=0),
            "R_WLens": eyes[0][:3, :3].copy(),
            "wanted_offset": np.asarray(self._R @ offset),
            "pixels": self.pixels(),
            "error": self.error,
            "mean_error": self.mean_error,
        }

    def verdict(self) -> Verdict:
        """Reward on the grid: 1 for a centred tip, 0 at ``MAX_ERROR``, divided by the looks."""
        phase = "ready" if self.time <= READY else "follow"
        if self._lost:
            reason = f"the tip was {self.error:.0f} px off the centre; allowed are {MAX_ERROR:.0f}"
            return Verdict(done=True, reason=reason, phase=phase)
        reward = 0.0
        if self.on_grid and self._errors:
            reward = (1.0 - self.error / MAX_ERROR) * GRID * TICK / DURATION
        if self.time >= self.time_limit:
            if self.mean_error <= MEAN_ERROR:
                return Verdict(done=True, success=True, reward=reward, phase="done")
            reason = f"mean error {self.mean_error:.0f} px; allowed are {MEAN_ERROR:.0f}"
            return Verdict(done=True, reason=reason, reward=reward, phase=phase)
        return Verdict(reward=reward, phase=phase)
