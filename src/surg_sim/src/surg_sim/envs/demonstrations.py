"""Many recorded episodes of a task's scripted senders, several at a time, each in its process.

Work that was cut off is taken up where it ended: a recording that is complete is not played again.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from surg_recording import job_pool
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError
from surg_sim.appearance.domain_randomization import DomainRandomization
from surg_sim.envs.recorded_episode import RecordedSession
from surg_sim.physics.endoscope_rig import FRAMES
from surg_sim.tasks.perturbed_sender import PerturbedExpert
from surg_sim.tasks.scripted_arm import ArmExpert


@dataclass(frozen=True)
class DemonstrationPlan:
    """What all demonstrations have in common."""

    out: Path  # folder of the recordings; each is ``<out>/<seed>``
    cell: Path  # folder of the cell
    task: str  # name
    setting: str = "phantom"  # of ``patient_settings.SETTINGS``
    cameras: tuple[str, ...] = ()  # views to record
    size: tuple[int, int] = (640, 480)  # of the pictures [px]
    shake: float = 0.0  # of every second demonstration, see ``perturbed_sender`` [m]; 0: of none
    # Factor of the hand's error in every fourth demonstration, so that its jaws close on nothing
    # and it tries again; 1: in none.
    expert_noise: float = 1.0
    randomization: DomainRandomization | None = (
        None  # of the pictures; None: as the scene was built
    )

    def folder(self, seed: int) -> Path:
        """Where the recording of a seed lies."""
        return self.out / str(seed)

    def done(self, seed: int) -> bool:
        """Whether the recording of a seed is there, whole, and as planned.

        It may have more views.
        """
        try:
            episode = episode_reader.read(self.folder(seed))
        except EpisodeError:
            return False
        look = None if self.randomization is None else self.randomization.draw(seed).described()
        run = episode.manifest.get("run", {})
        same = (
            run.get("look") == json.loads(json.dumps(look))
            and run.get("shake", 0.0) in (0.0, self.shake)
            and run.get("expert_noise", run.get("clumsiness", 1.0)) in (1.0, self.expert_noise)
            and {FRAMES[view] for view in self.cameras} <= set(episode.cameras)
        )
        return bool(episode.complete and same)


@dataclass(frozen=True)
class Demonstration:
    """One recording."""

    seed: int
    success: bool
    reason: str
    duration: float
    """[s] simulated"""


def play(
    plan: DemonstrationPlan,
    seeds: Sequence[int],
    workers: int = 2,
    progress: Callable[[int, Demonstration], None] = lambda n, made: None,
) -> list[Demonstration]:
    """Play and record what is not there yet, several at a time; returns what was made, by seed.

    ``progress`` is called with the number of episodes that were made so far, and the newest.

    Raises:
        EpisodeError: A recording could not be written.
        ValueError: The task does not fit the cell.
    """
    todo = [seed for seed in seeds if not plan.done(seed)]
    if not todo:
        return []
    plan.out.mkdir(parents=True, exist_ok=True)
    made: list[Demonstration] = []

    def done(_: str, demonstration: Demonstration) -> None:
        made.append(demonstration)
        progress(len(made), demonstration)

    def lost(seed: str, why: str) -> None:
        raise EpisodeError(f"demonstration {seed}: {why}")

    jobs = {str(seed): (plan, seed, seeds.index(seed)) for seed in todo}
    place = job_pool.Executor(workers=workers)
    job_pool.run(_play_one, jobs, place, job_pool.JobCallbacks(done, lost))
    return sorted(made, key=lambda demonstration: demonstration.seed)


_sessions: dict[DemonstrationPlan, RecordedSession] = {}


def _play_one(job: tuple[DemonstrationPlan, int, int]) -> Demonstration:
    """One of a plan with this seed and place among all, in a process that compiles the scene once.

    With pictures, once for each episode: the seed draws the look of the tissue, as in a graph.
    """
    plan, seed, index = job
    if plan.cameras and plan in _sessions:
        _sessions.pop(plan).close()
    if plan not in _sessions:
        _sessions[plan] = RecordedSession(
            plan.cell, plan.task, plan.setting, seed, plan.cameras, plan.size, plan.randomization
        )
    session, folder = _sessions[plan], plan.folder(seed)
    for left in (folder, folder.with_name(folder.name + episode_reader.PARTIAL)):
        shutil.rmtree(left, ignore_errors=True)  # of a run that was cut off
    session.reset(seed)
    experts = dict(session.task.experts(session.cell, seed))
    spread = plan.shake if index % 2 == 1 else 0.0
    expert_noise = plan.expert_noise if index % 4 == 3 else 1.0
    for name, expert in experts.items():
        if isinstance(expert, ArmExpert):
            expert.expert_noise = expert_noise
            if spread > 0.0:
                experts[name] = PerturbedExpert(expert, seed, spread)
    report = session.record(folder, seed, experts, shake=spread, expert_noise=expert_noise)
    return Demonstration(seed, report.success, report.reason, report.duration)
