"""One cell of a card: a policy, a task and a condition, on all seeds, each in a fresh process."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from policy import shut_in
from policy.card_conditions import BY_NAME, CardCondition, Eye
from policy.card_measures import Measures
from policy.wire_policy import (
    ANSWER_S,
    PICTURE,
    LineBroken,
    PolicyLost,
    Wire,
    WirePolicy,
)
from scipy.spatial.transform import Rotation

from surg_cli.graph.policy_program import WORDLESS
from surg_core.contract import GRID, image_key
from surg_policy_bridge.server.model_server import ServerState
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.endoscope_rig import FRAMES
from surg_sim.tasks import load
from surg_sim.tasks.bgr import bgr_definition

EXPERT = "expert"
"""Name of the scripted sender: the one that a policy replaces, and the entrant."""
OTHER = 500
"""The pictures of another episode are those of the seed from so much further on."""
_TARGETS = bgr_definition.TARGETS


@dataclass(frozen=True)
class CellJob:
    """What is played.

    Attributes:
        policy: `EXPERT`, a program, or an address at which somebody's policy connects.
        task: Its name.
        condition: Of `BY_NAME`.
        seeds: Of the episodes.
        answer_s: Longest wait for an answer [s].
    """

    policy: str | shut_in.Program
    task: str
    condition: str
    seeds: tuple[int, ...]
    answer_s: float = ANSWER_S


def play(job: CellJob) -> dict[str, Any]:
    """Play a cell: what was ``served``, ``episodes``, and ``latency_s`` of this machine.

    A policy that is lost is not asked again: the seeds that are left fail for the same reason.
    """
    condition = BY_NAME[job.condition]
    bgr_definition.TARGETS = condition.targets or _TARGETS
    scene = Scene(job, condition)
    lost = ""
    episodes: list[dict[str, Any]] = []
    try:
        for seed in job.seeds:
            entry = not_played(seed, lost) if lost else scene.episode(seed)
            lost = entry["reason"] if entry.pop("lost") else ""
            episodes.append(entry)
    finally:
        scene.close()
    latency = np.percentile(scene.round_trips, (50, 99)).tolist() if scene.round_trips else None
    return {"served": scene.served, "episodes": episodes, "latency_s": latency}


def not_played(seed: int, reason: str) -> dict[str, Any]:
    """The entry of an episode that a policy has lost before it began."""
    nothing = dict.fromkeys((*Measures.NAMES, "state_hash"))
    counts: dict[str, Any] = dict.fromkeys(COUNTS, 0)
    known = {"seed": seed, "success": False, "reason": reason, "phase": "", "rejected": {}}
    return {**known, **nothing, **counts, "refused": 0, "lost": True}


COUNTS = ("accepted", "clipped", "late", "stale", "empty")
"""Of the model server."""


ATTEMPTS = 5
"""Times that an episode is played when its connection breaks off; each time it is the same one."""


class SeenSession(CellSession):
    """A session that keeps the joint positions of the state that is observed, for pictures."""

    seen: np.ndarray

    def tick(self, *words: Any, **named: Any) -> Tick:
        """See `CellSession.tick`."""
        if self.world.tick % GRID == 0:
            self.seen = self.world.data.qpos.copy()
        return super().tick(*words, **named)


class Scene:
    """The scene of a cell, compiled once.

    Attributes:
        served: Observations that the policy got: ``key``, ``dtype``, ``shape``, ``privileged``.
        round_trips: Wall-clock times from an observation to its answer [s].
    """

    def __init__(self, job: CellJob, condition: CardCondition) -> None:
        self._job, self._condition = job, condition
        self._drawn = job.policy != EXPERT
        cell = cell_files.find(load(job.task).home_cell)
        self._session = SeenSession(
            cell, job.task, condition.setting, job.seeds[0], visuals=self._drawn
        )
        model = self._session.world.model
        there = {model.camera(i).name for i in range(model.ncam)}
        self._views = tuple(v for v, frame in FRAMES.items() if frame in there and self._drawn)
        move_camera(model, condition, self._views)
        self._renderers: dict[tuple[str, ...], Any] = {}
        self.served: list[dict[str, Any]] = []
        self.round_trips: list[float] = []

    def episode(self, seed: int) -> dict[str, Any]:
        """Play one; ``lost``: the policy did not take part to the end."""
        if self._job.policy == EXPERT:
            measures = Measures(self._session)
            experts = self._session.task.experts(self._session.cell, seed)
            self.served = [{"key": "everything", "privileged": True}]
            report = run_episode(self._session, seed, experts, measures)
            entry = {**not_played(seed, ""), **measures.values, "lost": False}
            return {**entry, **self._ended(measures, report.reason), "success": report.success}
        for _ in range(ATTEMPTS):
            with tempfile.TemporaryDirectory(prefix="surg-card-") as folder:
                try:
                    return self._by_wire(seed, Path(folder))
                except LineBroken:
                    continue
        return not_played(seed, f"the connection broke off {ATTEMPTS} times")

    def _by_wire(self, seed: int, folder: Path) -> dict[str, Any]:
        measures = Measures(self._session)
        experts = dict(self._session.task.experts(self._session.cell, seed))
        wire, program, given = Wire(str(self._job.policy)), None, self._job.policy
        if isinstance(given, shut_in.Program):
            wire = Wire(f"ipc://{folder / 'socket'}")
        wire = replace(wire, answer_s=self._job.answer_s, ended=lambda: _end_of(program, folder))
        eye = Eye(self._condition, seed, self._others(seed + OTHER))
        policy = WirePolicy(
            self._session, wire, self._views, self._pictures(seed), eye, self._condition.delay
        )
        success, reason, lost = False, "", False
        try:
            if isinstance(given, shut_in.Program):
                program = shut_in.start(given, folder)
            policy.greet()
            experts[EXPERT] = policy
            report = run_episode(self._session, seed, experts, measures)
            success, reason = report.success, report.reason
        except PolicyLost as why:
            # A policy that the gate has paused may do better with the next seed.
            reason, lost = str(why), policy.server.state is not ServerState.PAUSED
        finally:
            policy.end(success, reason)
            if program is not None:
                program.kill()
                program.wait()
        self.served = self.served or _served(policy)
        counters = policy.server.counters
        self.round_trips += [1e-9 * ns for ns in counters.round_trip.values]
        counts = {name: getattr(counters, name) for name in COUNTS}
        told = {
            "seed": seed,
            "success": success,
            "rejected": dict(sorted(counters.rejected.items())),
        }
        return {**told, **measures.values, **counts, **self._ended(measures, reason), "lost": lost}

    def _others(self, seed: int) -> dict[str, list[np.ndarray]]:
        """Pictures of the expert's episode by key, where they are shown in place of one's own."""
        if self._condition.eye is not None:
            return {}
        draw, shown = self._pictures(seed), dict[str, list[np.ndarray]]()

        def keep(tick: Tick) -> None:
            if tick.tick % GRID == 0:
                for view, picture in draw(self._views).items():
                    shown.setdefault(image_key(f"endoscope_{view}"), []).append(picture.copy())

        run_episode(self._session, seed, watch=keep)
        return shown

    def _ended(self, measures: Measures, reason: str) -> dict[str, Any]:
        """How an episode ended that has begun; with nothing of it, it never did."""
        tick = measures.last
        arms = self._session.task.commanded
        return {
            "reason": reason,
            "phase": tick.verdict.phase if tick else "",
            "refused": sum(int(tick.outputs[arm].refused) for arm in arms) if tick else 0,
            "state_hash": self._session.hash if tick else None,
        }

    def _pictures(self, seed: int) -> Callable[[Sequence[str]], Mapping[str, np.ndarray]]:
        """Pictures of the observed state by view; the seed draws their look where one is drawn."""

        def draw(views: Sequence[str]) -> Mapping[str, np.ndarray]:
            from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer

            chosen = tuple(views)
            if chosen not in self._renderers:
                world, (height, width) = self._session.world, PICTURE
                self._renderers[chosen] = EndoscopeRenderer(world, chosen, width, height)
            renderer = self._renderers[chosen]
            if (ranges := self._condition.randomization) is not None and seed not in dressed:
                renderer.set_appearance(ranges.draw(seed))
                dressed.append(seed)
            return renderer.render(self._session.seen)

        dressed: list[int] = []
        return draw

    def close(self) -> None:
        """Release the OpenGL contexts."""
        for renderer in self._renderers.values():
            renderer.close()


def move_camera(model: Any, condition: CardCondition, views: Sequence[str]) -> None:
    """Put the cameras of these views where a condition has them."""
    for view in views:
        camera = model.camera(FRAMES[view])
        stated = Rotation.from_quat(np.roll(camera.quat, -1))  # MuJoCo has w first
        turn = Rotation.from_euler("x", condition.turn, degrees=True)
        camera.pos[:] += stated.apply([condition.aside, 0.0, 0.0])
        camera.quat[:] = np.roll((stated * turn).as_quat(), 1)


def _end_of(program: subprocess.Popen[bytes] | None, folder: Path) -> str:
    """How a program has ended; empty: it has not."""
    code = None if program is None else program.poll()
    if code is None:
        return ""
    how = f"was killed by signal {-code}" if code < 0 else f"ended ({code})"
    return f"its program {how}: {shut_in.last_words(folder) or WORDLESS}"


def _served(policy: WirePolicy) -> list[dict[str, Any]]:
    observation = {} if policy.served is None else policy.served.observation
    return [
        {"key": key, "dtype": f.dtype, "shape": list(f.shape or ()), "privileged": f.privileged}
        for key, f in observation.items()
    ]
