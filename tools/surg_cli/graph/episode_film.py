"""A film of a recorded episode: its endoscope beside a view of the room."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import Progress, warn

FILM = "film.mp4"
SECONDS = 6.0
"""Longest film in a report; a longer episode is played faster."""
_HEIGHT, _ROOM = 360, 540  # [px]

Report = Callable[[float, str], None]


def make(
    recorded: Any,
    cell: Path | None,
    out: Path,
    seconds: float = SECONDS,
    progress: Report = lambda fraction, note: None,
) -> Path:
    """Write the film of an episode and return its path.

    The endoscope's pictures are the recorded ones. The room is drawn: the arms of the cell at the
    recorded joint positions, each frame at its own time. Without a cell there is no room.

    Raises:
        EpisodeError: Nothing to show, or the file cannot be written.
        NoOpenGL: The room cannot be drawn here.
    """
    from surg_cli.host import cells
    from surg_recording.recording_errors import EpisodeError
    from surg_recording.video import film

    if not recorded.arms:
        raise EpisodeError(f"{recorded.folder}: no arm was recorded")
    first = recorded.cycle(recorded.arms[0])["stamp_ns"]
    times = film.times(int(first[0]), int(first[-1]), seconds)
    streams = []
    if recorded.cameras:
        video = recorded.video(recorded.cameras[0])
        streams.append(film.frames_at(video, times, (_width(video.path), _HEIGHT)))
    if cell is not None:
        streams.append(_room(recorded, cells.load(cell), times, progress))
    if not streams:
        raise EpisodeError(
            f"{recorded.folder}: has no camera, and names no cell whose room could be drawn;"
            " give --cell"
        )
    return film.write(film.beside(*streams), len(times), out)


def of_outcomes(played: Iterable[tuple[bool, Path]], cell: Path, out: Path) -> None:
    """Put films of the first failed and the first successful episode into a report's folder.

    ``played`` says of each episode, in order, whether it succeeded, and its folder.
    """
    from surg_recording.reports.learning_report import FILMS

    episodes = list(played)
    for wanted, name in FILMS.items():
        (out / name).unlink(missing_ok=True)
        first = next((folder for success, folder in episodes if success is wanted), None)
        for_report([] if first is None else [first], cell, out, name)


def for_report(folders: Iterable[Path], cell: Path, out: Path, name: str = FILM) -> None:
    """Put the film of the first of some episodes into the folder of a report.

    A reason why none can be made is said and does no harm.
    """
    from surg_recording.episode import episode_reader
    from surg_recording.recording_errors import EpisodeError
    from surg_sim.appearance.opengl import NoOpenGL

    for folder in folders:
        try:
            recorded = episode_reader.read(folder)
            with Progress("film") as progress:
                make(recorded, cell, out / name, progress=progress.update)
        except (EpisodeError, NoOpenGL, ValueError) as problem:
            (out / name).unlink(missing_ok=True)
            warn(f"surg: no film: {problem}")
        return


def _width(video: Path) -> int:
    """Even width of a video's pictures at the height of the film [px]."""
    from surg_recording.datasets.pictures import size_of

    width, height = size_of(video)
    return 2 * round(_HEIGHT * width / height / 2)


def _room(recorded: Any, loaded: Any, times: list[int], progress: Report) -> Iterator[Any]:
    """Pictures of the room at the times [ns]."""
    import numpy as np

    from surg_sim import tasks
    from surg_sim.appearance.room_view import RoomView

    run = recorded.manifest.get("run") or {}
    task = str(run.get("task") or "")
    known = task if task in tasks.names() or task.endswith(".py") else ""
    joints = {}
    for arm in recorded.arms:
        table = recorded.cycle(arm)
        rows = np.maximum(np.searchsorted(table["stamp_ns"], times, side="right") - 1, 0)
        joints[arm] = table.joints("q")[rows]
    assistant = _assistant(recorded, times)
    with RoomView(loaded, known, int(run.get("seed") or 0), _ROOM, _HEIGHT) as view:
        for number in range(len(times)):
            progress(number / len(times), f"frame {number + 1} of {len(times)}")
            posture = {arm: values[number] for arm, values in joints.items()}
            yield view.picture(posture, None if assistant is None else assistant[number])


def _assistant(recorded: Any, times: list[int]) -> Any:
    """Joints of the assistant's instrument at the times, (frames, 4); None without one."""
    import numpy as np

    columns = [f"task.assistant_joints_{i}" for i in range(4)]
    if "task_state" not in recorded.tables:
        return None
    table = recorded.table("task_state")
    if any(column not in table for column in columns):
        return None
    rows = np.maximum(np.searchsorted(table["stamp_ns"], times, side="right") - 1, 0)
    return np.column_stack([table[column][rows] for column in columns])
