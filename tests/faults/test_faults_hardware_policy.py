"""One policy, unchanged, on the simulator's arm and on an emulated UR5e in the same tissue.

The task is bowel grasping and retraction; the commands pass the controller's own gate. The policy
is the task's expert, which sees what a policy sees, and the learned one whose weights
SURG_WEIGHTS names.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from helpers.hardware.emulated_world import EmulatedSession
from helpers.results import hardware_results as page
from surg_sim.envs import surg_env
from surg_sim.envs.policy_rollouts import Acts, Rollout, roll_out
from surg_sim.envs.surg_env import SurgEnv

pytestmark = [pytest.mark.untimed, pytest.mark.full]

WEIGHTS = os.environ.get("SURG_WEIGHTS")
SEED = 3
STEP = 0.05
"""[s] Between two actions."""


class Watched(SurgEnv):
    """Keeps the actions that were sent."""

    def reset(self, **given):  # type: ignore[no-untyped-def]
        self.sent: list[np.ndarray] = []
        return super().reset(**given)

    def step(self, action):  # type: ignore[no-untyped-def]
        self.sent.append(np.array(action))
        return super().step(action)


class Scripted:
    """The task's expert as a policy."""

    def __init__(self, env: SurgEnv) -> None:
        self._env = env

    def reset(self, instruction: str, seed: int | None) -> None:
        pass

    def act(self, observation: object) -> np.ndarray:
        return self._env.expert_action()[None]


def learned(env: SurgEnv) -> Acts:
    """The policy of surg_learn with the given weights."""
    assert WEIGHTS is not None
    from surg_learn.bgr import state_policy

    return state_policy.Policy.load(Path(WEIGHTS))


def said(row: str, env: Watched, rollout: Rollout, off: float) -> None:
    """Note an episode."""
    steps = np.linalg.norm(np.diff([action[:3] for action in env.sent], axis=0), axis=1)
    how = "success" if rollout.success else f"failed in {rollout.phase}: {rollout.reason}"
    page.note(
        row,
        1,
        f"{how} after {rollout.duration:.1f} s, {rollout.refused} refused, largest step "
        f"{1e3 * steps.max():.1f} mm; {1e3 * off:.3f} mm",
    )


@pytest.mark.parametrize("which", ["expert", *(["learned"] if WEIGHTS else [])])
def test_one_policy_drives_the_simulated_and_the_emulated_arm(
    which: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for robot in page.ROBOTS:
        if "emulated" in robot:
            monkeypatch.setattr(surg_env, "CellSession", EmulatedSession)
        env = Watched(cell="sim_ur5e")
        rollout = roll_out(env, learned(env) if which == "learned" else Scripted(env), SEED)
        off = rollout.rcm_max
        if isinstance(env.session, EmulatedSession):
            assert env.session.link is not None
            off = max(env.session.link.deviations)
        said(page.policy_row(which, robot), env, rollout, off)
        assert rollout.refused == 0
        assert off < 1.5e-4
        assert rollout.success, rollout.reason
        env.close()
