"""Gymnasium environments: a task, its scene and its controllers in this process, without ROS.

One step is 25 ticks (20 Hz) in lock-step order: the same seed and commands give the same state hash
here and in a ROS graph. Import this module, then ::

    env = gymnasium.make("surg_sim/bgr-v0", setting="phantom")

docs/reference/tasks.md defines the observation and action spaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from surg_sim.arrays import Array

try:
    import gymnasium
except ImportError as error:  # pragma: no cover - of an installation without the extra
    raise ImportError(
        "the environments need gymnasium: pip install 'surg_sim[gym]' or pip install gymnasium"
    ) from error

from surg_core.action_space import ABSOLUTE
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.bring_up import BringUp
from surg_core.contract import GRID, GRID_RATE, TICK_NS
from surg_sim.appearance.domain_randomization import Appearance, DomainRandomization
from surg_sim.envs.cell_session import CellSession, Tick, merge
from surg_sim.envs.env_spaces import EnvSpaces
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds, load, names
from surg_sim.tasks.scripted_sender import Action

if TYPE_CHECKING:
    from surg_sim.tasks.scripted_sender import Expert, Observation

POLICY = "expert"
"""Name of the expert that the policy replaces; the others stay scripted."""
CAMERAS = ("left", "right")

_READY = 10  # grid steps that homing and enabling may take


class SurgEnv(gymnasium.Env[dict[str, Any], Array]):
    """One task as an environment.

    Observation, a dict: ``state`` (what a robot could measure; ``state_names``), ``images`` (only
    with ``images``; left and right, (height, width, 3), rgb8), ``force`` (only with ``forces``; at
    tip and trocar of every commanded arm, ``contract.ARM_FORCE``, rcm frame), ``privileged`` (the
    task's ground truth, which no policy for a robot may read). Action: where set-point and jaw
    shall be at the next grid time, one of ``surg_core.action_space`` for every commanded arm. A
    step that is too large is refused by the controller, as on a robot, and counted in
    ``info["refused"]``. Reward: the task's. Terminated: success or failure; truncated: time
    limit. ``info``: ``success``, ``reason``, ``phase``, ``seed``, ``refused``, ``rcm_error``
    (largest kinematic deviation of the step, by arm [m]).

    Args:
        task: Of ``tasks.names()``, or the path of a task's file.
        cell: A bundled cell's name or the path of one; default: the task's own.
        setting: Of ``patient_settings.SETTINGS``.
        images: Cameras to observe, of ``CAMERAS``.
        width: Of the pictures [px].
        height: [px].
        render_mode: None or ``rgb_array`` (left camera).
        law: Of ``cell_session.LAWS``.
        seed_look: Draws the look of the tissue, once for the environment.
        forces: Observe the forces at tip and trocar.
        space: Of the actions, of ``contract.ACTION_SPACES``.
        randomization: Ranges, or their file, from which each episode's seed draws its appearance;
            ``info["look"]`` of ``reset`` tells the drawn one. None: all look as built. Physics and
            ground truth are the same with and without.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": GRID_RATE}

    def __init__(
        self,
        task: str = "bgr",
        cell: str | Path | None = None,
        setting: str = "phantom",
        images: Sequence[str] = (),
        width: int = 320,
        height: int = 240,
        render_mode: str | None = None,
        law: str = "ours",
        seed_look: int = 0,
        forces: bool = False,
        space: str = ABSOLUTE,
        randomization: DomainRandomization | Path | str | None = None,
    ) -> None:
        strange = [name for name in images if name not in CAMERAS]
        if strange or render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"images {list(images)}, render_mode {render_mode!r}: allowed are images of "
                f"{', '.join(CAMERAS)} and render_mode None or 'rgb_array'"
            )
        drawn = bool(images) or render_mode is not None
        if randomization is not None and not drawn:
            raise ValueError(
                "randomization needs pictures: images=('left',) or render_mode='rgb_array'"
            )
        self._randomization = (
            DomainRandomization.read(randomization)
            if isinstance(randomization, (str, Path))
            else randomization
        )
        self._appearance: Appearance | None = None
        path = cell_files.find(cell or load(task).home_cell)
        self.session = CellSession(path, task, setting, seed_look, drawn, law)
        self.render_mode, self._images = render_mode, tuple(v for v in CAMERAS if v in images)
        self._size = (width, height)
        self._renderers: dict[tuple[str, ...], Any] = {}
        self._qpos = self.session.world.data.qpos.copy()
        """Joint positions of the observed state, for pictures."""
        self._spaces = EnvSpaces(self.session, self._images, self._size, forces, space)
        self.arms, self.state_names = self._spaces.arms, self._spaces.state_names
        self.action_names = self._spaces.action_names
        self._expert: Expert | None = None
        self._tick: Tick | None = None
        self.action_space = self._spaces.action()
        self.observation_space = self._spaces.observation()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; the arms are homed and enabled, nothing has moved.

        The seed draws the episode; None: one of ``episode_seeds.TRAINING``. No options are used.

        Raises:
            RuntimeError: An arm does not become ready; states why.
        """
        super().reset(seed=seed)
        self.seed = self.seed_of(seed, self.np_random)
        session = self.session
        session.reset(self.seed)
        if self._randomization is not None:
            self._appearance = self._randomization.draw(self.seed)
            for renderer in self._renderers.values():
                renderer.set_appearance(self._appearance)
        senders = dict(session.task.experts(session.cell, self.seed))
        senders.pop(POLICY, None)
        self._partners: list[Expert] = [senders[name] for name in sorted(senders)]
        self._partner_actions: list[Action] = []
        self._expert = None
        self._advance(Action())
        bring_ups = {arm: BringUp() for arm in self.arms}
        for bring_up in bring_ups.values():
            bring_up.start(0)
        for _ in range(_READY):
            asked = {arm: self._bring_up(bring_up, arm) for arm, bring_up in bring_ups.items()}
            if not any(bring_up.active for bring_up in bring_ups.values()):
                break
            self._advance(Action(arms=asked))
        failed = {arm: each.reason for arm, each in bring_ups.items() if each.active or each.reason}
        if failed:
            why = "; ".join(f"{arm}: {reason or 'too late'}" for arm, reason in failed.items())
            raise RuntimeError(f"not ready: {why} {self._info()['reason'] or ''}".rstrip())
        told = {} if self._appearance is None else {"look": self._appearance.described()}
        return self._observation(), {**self._info(), **told}

    @staticmethod
    def seed_of(seed: int | None, rng: np.random.Generator) -> int:
        """The episode of a seed; None: a drawn one of ``episode_seeds.TRAINING``."""
        drawn = rng.integers(episode_seeds.TRAINING.start, episode_seeds.TRAINING.stop)
        return int(drawn) if seed is None else seed

    def _bring_up(self, bring_up: BringUp, arm: str) -> ArmCommands:
        assert self._tick is not None
        view = ArmView.of(self._tick.outputs[arm])
        return bring_up.tick(view, self._tick.tick * TICK_NS)

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Send one action and let 25 ticks pass.

        Raises:
            ValueError: The action has the wrong length or is not finite.
            RuntimeError: The episode is over or has not begun.
        """
        if self._tick is None or self._tick.verdict.done:
            raise RuntimeError("no episode: call reset() first")
        reward = self._advance(Action(arms=self._spaces.commands(action, self._tick)))
        verdict = self._tick.verdict
        ended = verdict.done and not verdict.timeout
        return self._observation(), reward, ended, verdict.timeout, self._info()

    def _advance(self, action: Action) -> float:
        """Tick to the next grid time or to the end; returns the reward of these ticks."""
        commands, assistant = merge([action, *self._partner_actions], self.session.world.tick)
        reward, self._worst = 0.0, dict.fromkeys(self.session.world.arms, 0.0)
        for i in range(GRID):
            self._qpos = self.session.world.data.qpos.copy()  # a tick ends in the next one's state
            tick = self.session.tick(commands if i == 0 else None, assistant if i == 0 else None)
            self._tick = tick
            reward += tick.verdict.reward
            for arm, out in tick.outputs.items():
                self._worst[arm] = max(self._worst[arm], out.rcm_error)
            if tick.verdict.done:
                break
        self._partner_actions = []
        if not tick.verdict.done:
            self._observed: Observation = tick.observation()
            self._partner_actions = [partner.tick(self._observed) for partner in self._partners]
        return reward

    def _observation(self) -> dict[str, Any]:
        assert self._tick is not None
        observation = self._spaces.observe(self._tick)
        if self._images:
            observation["images"] = self._render(self._images)
        return observation

    def _info(self) -> dict[str, Any]:
        assert self._tick is not None
        verdict, outputs = self._tick.verdict, self._tick.outputs
        return {
            "success": verdict.success,
            "reason": verdict.reason,
            "phase": verdict.phase,
            "seed": self.seed,
            "refused": sum(int(outputs[arm].refused) for arm in self.arms),
            "rcm_error": dict(self._worst),
        }

    def _render(self, views: tuple[str, ...]) -> dict[str, NDArray[np.uint8]]:
        from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer

        if views not in self._renderers:
            self._renderers[views] = EndoscopeRenderer(self.session.world, views, *self._size)
            if self._appearance is not None:
                self._renderers[views].set_appearance(self._appearance)
        return self._renderers[views].render(self._qpos)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """The left camera's picture in mode ``rgb_array``."""
        return self._render(("left",))["left"] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Release the OpenGL contexts."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}

    def expert_action(self) -> Array:
        """What the task's expert would do now; call it in every step of an episode, or in none."""
        if self._expert is None:
            self._expert = self.session.task.experts(self.session.cell, self.seed)[POLICY]
        scripted = self._expert.tick(self._observed)
        if self._expert.reason or self._tick is None:
            raise RuntimeError(f"the expert has no motion: {self._expert.reason}")
        return self._spaces.action_of(scripted.arms, self._tick)


def register() -> None:
    """Make ``gymnasium.make("surg_sim/<task>-v0")`` work for all tasks that have a name."""
    for name in names():
        key = f"surg_sim/{name}-v0"
        if key not in gymnasium.registry:
            gymnasium.register(
                key, entry_point="surg_sim.envs.surg_env:SurgEnv", kwargs={"task": name}
            )


register()
