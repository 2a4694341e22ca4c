"""Roll-outs of a learned policy through the graph: each in a graph of its own, played once.

A roll-out is an episode of `./surg run TASK --policy SCRIPT`: the same graph, the same recording.
Its result is stored beside it, so that an interrupted run resumes after the last finished one.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.graph import episode_plans, episode_process, policy_program, task_episode
from surg_cli.graph.episode_plans import Condition
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress
from surg_learn.learn_terminal import LearnError

RESULT = "result.json"
WEIGHTS = "SURG_WEIGHTS"
"""Environment variable that tells a policy's script where its weights are."""


@dataclass
class Player:
    """Plays roll-outs of one policy, whose client is ``script``.

    ``privileged``: the simulator's truth is served, ``forces``: the forces at tip and trocar.
    ``cameras``: views that are served and recorded.
    """

    task: str
    cell: Path
    loaded: Any
    setting: str
    script: Path
    weights: Path
    privileged: bool
    cameras: tuple[str, ...] = ()
    forces: bool = False

    def __post_init__(self) -> None:
        policy = policy_program.read(str(self.script), None, self.privileged, self.forces)
        self._condition = Condition(self.setting, "ours")
        self._plan = episode_plans.make_plan(
            self.task,
            self.cell,
            self.loaded,
            [self._condition],
            0,
            self.cameras,
            Path(),
            policy,
        )

    @property
    def title(self) -> str:
        """Of the task."""
        return str(self._plan.run_info["title"])

    @property
    def robot(self) -> str:
        """Of the commanded arm."""
        return str(self._plan.run_info["robot"])

    def play(self, seed: int, folder: Path, show: Callable[[float, str], None]) -> dict[str, Any]:
        """Play one, or return its stored result; remains of an interrupted roll-out are removed.

        ``show`` gets the simulated time [s] and a note on the progress.
        """
        file = folder / RESULT
        if file.is_file():
            return dict(json.loads(file.read_text("utf-8")))
        shutil.rmtree(folder, ignore_errors=True)
        plan = episode_plans.for_episode(self._plan, self._condition, seed, folder)
        os.environ[WEIGHTS] = str(self.weights.absolute())
        ended = episode_process.run_episode(plan, show)
        result = describe(plan, ended)
        # A roll-out that broke off is played again when the run is resumed.
        if result["rollout"]["played"]:
            paths.write_text(file, json.dumps(result, indent=1) + "\n")
        return result


def describe(plan: SystemPlan, ended: task_episode.Ended) -> dict[str, Any]:
    """Both entries of a roll-out: that of the policy, and that of the episode."""
    from surg_recording.reports import learning

    entry, rollout = episode_process.measure(
        plan, ended, lambda entry, recorded: learning.roll_out(entry, ended.policy or {}, recorded)
    )
    return {"rollout": rollout, "episode": entry}


def roll_out(player: Player, count: int, folder: Path) -> list[dict[str, Any]]:
    """Play the policy through the graph on seeds that were not used for training.

    Raises:
        LearnError: The graph cannot be started, in its own words.
    """
    from surg_sim.tasks import episode_seeds

    entries: list[dict[str, Any]] = []
    with Progress("roll-outs") as progress:
        for n, seed in enumerate(episode_seeds.test_seeds(count)):
            good = sum(e["rollout"]["success"] for e in entries)

            def show(seconds: float, note: str, n: int = n, good: int = good) -> None:
                words = f"{n + 1} of {count}, {good} succeeded: {seconds:.1f} s, {note}"
                progress.update(n / count, words)

            try:
                entries.append(player.play(seed, folder / str(seed), show))
            except CliError as problem:
                raise LearnError(str(problem), problem.code) from problem
    return entries
