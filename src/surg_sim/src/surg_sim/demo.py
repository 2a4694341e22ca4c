"""One episode of a task with the scripted senders, without ROS: a video and a figure.

As a program: ``python -m surg_sim.demo --task bgr --setting phantom --seed 20000 --out demo``.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from surg_core.contract import GRID, GRID_RATE, TICK
from surg_sim import tasks
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.arrays import Picture
from surg_sim.envs.cell_session import LAWS, CellSession, Tick
from surg_sim.envs.episode_runner import EpisodeReport, run_episode
from surg_sim.physics import cell_files, patient_settings
from surg_sim.tasks import episode_seeds


@dataclass
class Watch:
    """Collects what video and figure show."""

    session: CellSession  # the episode's
    camera: EndoscopeRenderer | None  # draws the endoscope's picture; None: no pictures
    pictures: list[Picture] = field(default_factory=list)  # at 20 fps
    # (time [s], name) of every change.
    phases: list[tuple[float, str]] = field(default_factory=list)
    # Rows of time [s], kinematic and true deviation of the commanded arm [m].
    deviation: list[tuple[float, float, float]] = field(default_factory=list)
    # Rows of time [s] and the task's plotted numbers.
    numbers: list[tuple[float, ...]] = field(default_factory=list)

    def __call__(self, tick: Tick) -> None:
        """After a tick."""
        session, t = self.session, tick.tick * TICK
        if not self.phases or self.phases[-1][1] != tick.verdict.phase:
            self.phases.append((t, tick.verdict.phase))
        if tick.tick % GRID != 0:
            return
        arm = session.task.commanded[0]
        out = tick.outputs[arm]
        if out.homed:
            self.deviation.append((t, out.rcm_error, session.world.truth(arm).deviation))
        self.numbers.append((t, *(float(tick.state[key]) for key in session.task.plotted)))
        if self.camera is not None:
            self.pictures.append(self.camera.render(session.world.data.qpos)["left"])


def write_video(pictures: Sequence[Picture], stem: Path) -> Path:
    """An MP4 where PyAV is installed, else an animated GIF; returns the file.

    Pictures (height, width, 3), rgb8, 20 per second; the stem is a path without an ending.
    """
    if importlib.util.find_spec("av") is not None:
        import av

        file = stem.with_suffix(".mp4")
        with av.open(str(file), "w") as container:
            stream = container.add_stream("libx264", rate=GRID_RATE)
            stream.height, stream.width = pictures[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            for picture in pictures:
                for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                    container.mux(packet)
            for packet in stream.encode():
                container.mux(packet)
        return file
    from PIL import Image

    file = stem.with_suffix(".gif")
    frames = [Image.fromarray(picture).quantize(128) for picture in pictures[::2]]
    frames[0].save(
        file, save_all=True, append_images=frames[1:], duration=2000 // GRID_RATE, loop=0
    )
    return file


def write_figure(watch: Watch, report: EpisodeReport, file: Path) -> None:
    """Deviation and the task's numbers over time, with its phases."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    task = watch.session.task
    rows = 1 + len(task.plotted)
    figure = Figure(figsize=(8.0, 1.2 + 1.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    t, kinematic, true = np.array(watch.deviation).reshape(-1, 3).T
    axes[0].plot(t, 1e3 * true, color="0.6", label="true")
    axes[0].plot(t, 1e3 * kinematic, color="tab:blue", label="kinematic")
    axes[0].set_ylabel("RCM deviation [mm]")
    axes[0].legend(loc="upper right")
    numbers = np.array(watch.numbers).T
    for axis, (name, unit), values in zip(axes[1:], task.plotted.items(), numbers[1:], strict=True):
        axis.plot(numbers[0], values, color="tab:orange")
        axis.set_ylabel(f"{name} [{unit}]")
    for axis in axes:
        for start, _ in watch.phases:
            axis.axvline(start, color="0.85", linewidth=0.8, zorder=0)
    for start, name in watch.phases:
        axes[0].annotate(
            name, (start, 1.0), xycoords=("data", "axes fraction"), fontsize=8, rotation=20
        )
    axes[-1].set_xlabel("time [s]")
    outcome = "success" if report.success else report.reason
    figure.suptitle(f"{task.title}, {watch.session.setting.name}, seed {report.seed}: {outcome}")
    figure.savefig(file, dpi=120)


def main(words: Sequence[str] | None = None) -> int:
    """Entry point: 0 after a success, 1 after a failure, 2 for words that cannot be used."""
    parser = argparse.ArgumentParser(
        prog="surg_sim.demo", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--task", default="bgr", help=", ".join(tasks.names()))
    parser.add_argument("--cell", help="name or path; default: the task's")
    parser.add_argument("--setting", default="phantom", help=", ".join(patient_settings.SETTINGS))
    parser.add_argument("--law", default="ours", help=", ".join(LAWS))
    parser.add_argument("--seed", type=int, default=episode_seeds.TEST.start)
    parser.add_argument("--out", type=Path, default=Path("surg_sim_demo"), help="folder")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"))
    parser.add_argument("--no-video", action="store_true")
    options = parser.parse_args(words)
    try:
        cell = cell_files.find(options.cell or tasks.load(options.task).home_cell)
        visuals = not options.no_video
        session = CellSession(
            cell, options.task, options.setting, options.seed, visuals, options.law
        )
        camera = None
        if visuals:
            camera = EndoscopeRenderer(session.world, ("left",), *options.size)
    except (ValueError, OSError, NoOpenGL) as error:
        hint = "; --no-video needs none" if isinstance(error, NoOpenGL) else ""
        print(f"surg_sim.demo: {error}{hint}", file=sys.stderr)
        return 2
    watch = Watch(session, camera)
    report = run_episode(session, options.seed, watch=watch)
    options.out.mkdir(parents=True, exist_ok=True)
    stem = options.out / f"{options.task}_{options.setting}_{options.seed}"
    if watch.pictures:
        print(write_video(watch.pictures, stem))
    write_figure(watch, report, stem.with_suffix(".png"))
    print(stem.with_suffix(".png"))
    arm = report.arms[session.task.commanded[0]].kinematic
    print(
        f"{'success' if report.success else 'failed: ' + report.reason}; {report.duration:.1f} s; "
        f"kinematic RCM deviation mean {1e3 * arm.mean:.4f}, max {1e3 * arm.max:.4f} mm; "
        f"state hash {report.hash[:16]}"
    )
    return 0 if report.success else 1


if __name__ == "__main__":
    sys.exit(main())
