"""Records episodes that run in this process, in the format of the recorder node.

The episode folder has the same tables and rows as one from a ROS graph
(docs/reference/recording.md), so the same readers work. Wall-clock values are left out: the compute
time of a control cycle is empty, and the stamps of reception are those of the ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import surg_core
from surg_core.contract import FORCE_TICKS, GRID, SECOND_NS, TICK_NS
from surg_core.transforms import matrix_to_quaternion_xyzw
from surg_sim.envs.cell_session import CellSession, Command, Tick
from surg_sim.envs.episode_runner import EpisodeReport, run_episode
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.endoscope_rig import FRAMES

try:
    from surg_recording.episode import provenance
    from surg_recording.episode.episode_recorder import Recording
    from surg_sim.envs import episode_messages as messages
except ImportError as error:  # pragma: no cover - of an installation of surg_sim alone
    raise ImportError(
        "recording in process needs surg_recording: pip install ./src/surg_recording"
    ) from error

if TYPE_CHECKING:
    from surg_sim.appearance.domain_randomization import DomainRandomization
    from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
    from surg_sim.tasks import Task
    from surg_sim.tasks.scripted_sender import Expert


class RecordedSession(CellSession):
    """A session that records every tick, for a cell given by its path.

    The recording describes the cell's files. Cameras are views to render and record, of ``left``
    and ``right``; size is width and height of the pictures [px]. Looks are ranges from which each
    episode's seed draws how its pictures look; the manifest's ``run.look`` tells the drawn one.
    """

    def __init__(
        self,
        cell: Path,
        task: Task | str,
        setting: str = "phantom",
        seed: int = 0,
        cameras: Sequence[str] = (),
        size: tuple[int, int] = (640, 480),
        randomization: DomainRandomization | None = None,
    ) -> None:
        super().__init__(cell, task, setting, seed, visuals=bool(cameras))
        self._randomization = randomization
        self._described = provenance.describe_cell(cell)
        self._versions = provenance.versions()
        self._views = tuple(cameras)
        self._renderer: EndoscopeRenderer | None = None
        if cameras:
            from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer

            self._renderer = EndoscopeRenderer(self.world, cameras, *size)
        self._recording: Recording | None = None
        self._orientations: dict[str, tuple[bytes, list[float]]] = {}

    def record(
        self,
        folder: Path,
        seed: int,
        experts: Mapping[str, Expert] | None = None,
        **run: Any,
    ) -> EpisodeReport:
        """Play an episode to its end and record it.

        Args:
            folder: The episode folder; when its name is taken, a number is appended.
            seed: Of the episode.
            experts: Senders by node name; None: those of the task.
            **run: What else the recording shall say of its run.

        Raises:
            EpisodeError: The folder cannot be written.
        """
        if self._randomization is not None and self._renderer is not None:
            look = self._randomization.draw(seed)
            self._renderer.set_appearance(look)
            run["look"] = look.described()
        self._recording = self._open(folder, self._describe_run(seed, run))
        try:
            report = run_episode(self, seed, experts)
        except BaseException:
            self._recording.note("the program that played the episode was ended")
            self._recording.close({})
            raise
        finally:
            recording, self._recording = self._recording, None
        ticks = round(report.duration * SECOND_NS) // TICK_NS
        recording.close({"sim": self._outcome(report, ticks)}, end_stamp_ns=ticks * TICK_NS)
        return report

    def _describe_run(self, seed: int, run: Mapping[str, Any]) -> dict[str, Any]:
        """The key ``run`` of the manifest."""
        return {
            "task": self.task.name,
            **self.task.language(),
            "operator": "scripted expert",
            "robot": self.cell.arms[self.world.arms[0]].robot.name,
            "mode": "cartesian",
            "timing": "lockstep",
            "seed": seed,
            "setting": self.setting.name,
            "law": self.law,
            **run,
        }

    def _open(self, folder: Path, run: Mapping[str, Any]) -> Recording:
        return Recording(
            folder,
            mode="lockstep",
            arms=list(self.world.arms),
            cameras=[FRAMES[view] for view in self._views],
            manifest={
                "run": run,
                **{key: run[key] for key in ("task", "operator", "seed")},
                "clock": "simulator ticks",
                "cell": self._described,
                "camera_info": self._camera_models(),
                "versions": self._versions,
                "host": provenance.host(),
            },
        )

    def _camera_models(self) -> dict[str, Any]:
        """The key ``camera_info`` of the manifest, as in a graph."""
        if self._renderer is None:
            return {}
        lenses = map(self._renderer.lens, self._views)
        return {
            lens.camera_name: {**lens.camera_info, "frame_id": lens.camera_name} for lens in lenses
        }

    def _outcome(self, report: EpisodeReport, ticks: int) -> dict[str, Any]:
        """The key ``sim`` of the manifest."""
        return {
            "tick": ticks,
            "sim_time_s": report.duration,
            "deterministic": True,
            "state_hash": report.hash,
            "done": True,
            "aborted": None,
            "task": {
                "name": self.task.name,
                "setting": self.setting.name,
                "phase": self.task.verdict().phase,
                "done": True,
                "success": report.success,
                "reason": report.reason,
            },
        }

    def tick(
        self,
        commands: Mapping[str, Sequence[Command]] | None = None,
        assistant: AssistantCommand | None = None,
    ) -> Tick:
        """See ``CellSession.tick``; writes what it was given, what was there and what came out."""
        recording, world = self._recording, self.world
        if recording is None:
            return super().tick(commands, assistant)
        stamp = world.tick * TICK_NS
        before = {name: (world.state(name), world.truth(name)) for name in world.arms}
        on_grid = world.tick % GRID == 0
        felt = self._felt() if world.tick % FORCE_TICKS == 0 else {}
        state = self.task.state() if on_grid or self.task.verdict().done else None
        if self._renderer is not None and on_grid:
            self._record_pictures(recording, stamp)
        for arm, given in (commands or {}).items():
            for command in given:
                if isinstance(command, surg_core.MotionCommand):
                    topic, message = messages.command_of(command, stamp)
                    recording.command(arm, topic, message, messages.SENDER, stamp)
        if assistant is not None:
            for topic, values in (
                ("servo_jp", assistant.joints),
                (messages.JAW, assistant.jaw),
            ):
                if values is not None:
                    message = messages.message_of(stamp, position=np.atleast_1d(values).tolist())
                    recording.command("assistant", topic, message, "/assistant", stamp)
        tick = super().tick(commands, assistant)
        for name, out in tick.outputs.items():
            row = messages.cycle_of(out, tick.tick, before[name][0], self._orientation(name))
            recording.cycle(name, row, stamp)
        arms = [messages.truth_of(name, truth) for name, (_, truth) in before.items()]
        recording.ground_truth(messages.message_of(stamp, tick=tick.tick, arms=arms), stamp)
        for (name, place), force in felt.items():
            recording.force(
                name,
                place,
                messages.message_of(stamp, wrench=messages.wrench(force)),
                stamp,
            )
        if state is not None:
            recording.task_state(messages.task_state_of(tick, state), stamp)
        return tick

    def _felt(self) -> dict[tuple[str, str], Any]:
        """What force sensors measure now, by arm and place [N], base frame."""
        found = {}
        for name in self.world.arms:
            found[name, "trocar"] = self.world.truth(name).trocar_force
            if (tip := self.world.tip_force(name)) is not None:
                found[name, "tip"] = tip
        return found

    def _orientation(self, arm: str) -> list[float]:
        """Of the rcm frame in the base, x, y, z, w; it changes when the arm is homed."""
        R_BR = np.asarray(self.controllers[arm].X_BR)[:3, :3]
        known = self._orientations.get(arm)
        if known is None or known[0] != R_BR.tobytes():
            q = np.array(matrix_to_quaternion_xyzw(R_BR))
            # The sign that Eigen gives it, and so the controller node.
            if np.trace(R_BR) <= 0.0 and q[int(np.argmax(np.diag(R_BR)))] < 0.0:
                q = -q
            known = (R_BR.tobytes(), list(q.tolist()))
            self._orientations[arm] = known
        return known[1]

    def close(self) -> None:
        """Release the OpenGL context."""
        if self._renderer is not None:
            self._renderer.close()

    def _record_pictures(self, recording: Recording, stamp: int) -> None:
        """Render and record the state that is there."""
        assert self._renderer is not None
        for view, picture in self._renderer.render(self.world.data.qpos).items():
            height, width, _ = picture.shape
            shape = {"width": width, "height": height, "step": 3 * width, "encoding": "rgb8"}
            message = messages.message_of(stamp, data=picture.tobytes(), **shape)
            recording.image(FRAMES[view], message, stamp)
