"""How fast an episode is simulated through the graph."""

from pathlib import Path

from surg_cli.graph import episode_plans, episode_process
from surg_cli.host import cells
from surg_cli.host.terminal import CliError, Progress


def real_time_factor(task: str, robot: str, seed: int, out: Path, cameras: str = "left") -> float:
    """Simulated by wall time of one recorded episode through the graph.

    Args:
        task: Its name.
        robot: As for `--robot`.
        seed: Of the episode.
        out: Empty folder for it.
        cameras: Which views of 640 x 480 at 20 fps are rendered and recorded.

    Raises:
        CliError: The episode was not played to its end.
    """
    condition = episode_plans.Condition("phantom", "ours")
    cell = episode_plans.find_cell(robot)
    views = episode_plans.VIEWS[cameras]
    plan = episode_plans.make_plan(task, cell, cells.load(cell), [condition], seed, views, out)
    plan = episode_plans.for_episode(plan, condition, seed, out)
    with Progress("episode") as progress:
        ended = episode_process.run_episode(
            plan, lambda seconds, note: progress.update(None, f"{seconds:.1f} s")
        )
    entry = episode_process.describe(plan, ended)
    if not entry["played"] or ended.real_time_factor is None:
        raise CliError(f"no rate: {entry['failure_reason'] or 'the episode is too short'}")
    return ended.real_time_factor
