"""Writes the motion of arms that another program recorded as an episode folder.

The recorder itself writes the folder. An import states no control cycles, so the columns that only
a controller of this platform knows are empty, and nothing says how far the shaft was from its
trocar: the shaft axis is taken from the trocar to the tip, and the manifest names the deviation
under ``imported.not_measured``.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import ENABLED
from surg_core.transforms import matrix_to_quaternion_xyzw, rpy_to_matrix
from surg_recording.episode.annotations import Tag
from surg_recording.episode.episode_reader import MANIFEST
from surg_recording.episode.episode_recorder import Recording
from surg_recording.file_io import read_json
from surg_recording.imports.ledger import Ledger
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

DEVIATION = "rcm_deviation"
"""In ``imported.not_measured``: the distance of the shaft from the trocar."""
SERVO_CP = 1
"""surg_msgs/Cycle.command."""
QUALITY = "15"
"""x264's crf of the kept pictures: an export codes them once more, and both losses add up."""


@dataclasses.dataclass(frozen=True)
class ArmSeries:
    """The motion of one arm: N samples with strictly increasing stamps, in its base frame B."""

    name: str
    stamps: Stamps
    p_BTip: Array
    """(N, 3) measured tip [m]."""
    roll: Array
    """(N,) about the shaft, continuous [rad]."""
    jaw: Array
    """(N,) [rad]."""
    q: Array
    """(N, joints) [rad]."""
    qd: Array
    """(N, joints) [rad/s]."""
    p_BGoal: Array
    """(N, 3) commanded tip [m]; the measured one where none is known."""
    roll_goal: Array
    jaw_goal: Array
    p_BRcm: Array
    """(3,) trocar [m]."""
    rpy_BR: Array
    """(3,) orientation of the rcm frame, z into the patient [rad]."""
    robot: str = "unknown"
    instrument: str = "unknown"


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture of a camera: a message like sensor_msgs/Image or CompressedImage."""

    camera: str
    message: Any
    stamp_ns: int


def write(
    folder: Path,
    arms: list[ArmSeries],
    cameras: list[str],
    pictures: Iterable[Picture],
    manifest: Mapping[str, Any],
    ledger: Ledger,
    result: bool | None = None,
    stages: Sequence[tuple[int, str]] = (),
) -> Path:
    """Write an episode.

    Args:
        folder: The new folder.
        arms: At least one.
        cameras: Names of the cameras.
        pictures: All of them, in the order of their time.
        manifest: Facts about the recording; ``imported`` says where it came from.
        ledger: What was kept and dropped; it goes into the manifest.
        result: What the source says of its success; None: nothing.
        stages: Stamp [ns] and text of each stage that begins.

    Returns:
        The folder; its name has a number behind it if it was taken.

    Raises:
        EpisodeError: A series is too short, its stamps go back, the folder cannot be written, or
            more pictures were lost than the ledger allows; nothing stays then.
    """
    facts = _facts(arms, manifest)
    recording = Recording(
        folder,
        mode="lockstep",  # nothing is dropped: the source waits
        arms=[arm.name for arm in arms],
        cameras=cameras,
        manifest=facts,
        video_quality=QUALITY,
    )
    try:
        _fill(recording, arms, pictures)
        end = max(int(arm.stamps[-1]) for arm in arms)
        for stamp, text in stages:
            recording.tag(Tag(stage=text), text, "/import", stamp, stamp)
        if result is not None:
            recording.tag(Tag(success=result, judged=True), "success", "/import", end, end)
        ledger.check()
    except BaseException:
        shutil.rmtree(recording.close({}))
        raise
    told = {"imported": {**facts["imported"], **ledger.stated()}}
    made = recording.close(told, end_stamp_ns=end)
    whole = read_json(made / MANIFEST)
    if whole["outcome"] != "complete":
        shutil.rmtree(made)
        raise EpisodeError(f"the episode would be incomplete: {whole.get('reason')}")
    return made


def _facts(arms: list[ArmSeries], manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest at the start; an EpisodeError if a series cannot be recorded."""
    for arm in arms:
        if len(arm.stamps) < 2 or not np.all(np.diff(arm.stamps) > 0):
            raise EpisodeError(
                f"{arm.name}: {len(arm.stamps)} samples; at least two with increasing stamps are"
                " needed"
            )
    imported: dict[str, Any] = {"not_measured": [DEVIATION], **manifest.get("imported", {})}
    imported["period_s"] = max(float(np.median(np.diff(arm.stamps))) * 1e-9 for arm in arms)
    described = {
        arm.name: {"robot": {"name": arm.robot}, "instrument": {"name": arm.instrument}}
        for arm in arms
    }
    cell = {"name": "imported", "arms": described}
    return {"cell": cell, **manifest, "imported": imported, "mode": "imported"}


def _fill(recording: Recording, arms: list[ArmSeries], pictures: Iterable[Picture]) -> None:
    for arm in arms:
        for tick, message in enumerate(_cycles(arm), start=1):
            stamp = int(arm.stamps[tick - 1])
            recording.cycle(arm.name, message, stamp)
            recording.command(arm.name, "servo_cp", _command(message), "/import", stamp)
    for picture in pictures:
        recording.image(picture.camera, picture.message, picture.stamp_ns)


def _cycles(arm: ArmSeries) -> Iterator[SimpleNamespace]:
    """A message like surg_msgs/Cycle for each sample."""
    q_BR = matrix_to_quaternion_xyzw(rpy_to_matrix(arm.rpy_BR)).tolist()
    depth = np.linalg.norm(arm.p_BTip - arm.p_BRcm, axis=1)
    if not depth.min() > 1e-6:
        raise EpisodeError(f"{arm.name}: the tip is at the trocar; is 'rcm' right?")
    axis = (arm.p_BTip - arm.p_BRcm) / depth[:, None]
    nan = float("nan")
    for row in range(len(arm.stamps)):
        yield SimpleNamespace(
            header=header(int(arm.stamps[row])),
            tick=row + 1,
            state=ENABLED,
            homed=True,
            busy=False,
            reason="",
            command=SERVO_CP,
            source="/import",
            p_goal=arm.p_BGoal[row].tolist(),
            roll_goal=float(arm.roll_goal[row]),
            accepted=row + 1,
            refused=0,
            q=arm.q[row].tolist(),
            qd=arm.qd[row].tolist(),
            p_tip=arm.p_BTip[row].tolist(),
            s=axis[row].tolist(),
            p_rcm=arm.p_BRcm.tolist(),
            q_br=q_BR,
            roll=float(arm.roll[row]),
            depth=float(depth[row]),
            rcm_error=nan,
            stop_bound_tip=nan,
            stop_bound_pivot=nan,
            p_set=arm.p_BGoal[row].tolist(),
            v_set=[nan] * 3,
            roll_set=float(arm.roll_goal[row]),
            jaw_set=float(arm.jaw_goal[row]),
            jaw=float(arm.jaw[row]),
            wrist=(),
            scale=1.0,
            limited_by="",
            tier=0,
            qd_command=[nan] * arm.q.shape[1],
            twist_command=[nan] * 6,
            compute_us=0.0,
            period_us=0.0,
            overruns=0,
        )


def _command(cycle: SimpleNamespace) -> SimpleNamespace:
    """A message like the PoseStamped that commanded a cycle's goal."""
    position = SimpleNamespace(**dict(zip("xyz", cycle.p_goal, strict=True)))
    orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    pose = SimpleNamespace(position=position, orientation=orientation)
    return SimpleNamespace(header=cycle.header, pose=pose)


def header(stamp_ns: int) -> SimpleNamespace:
    """A message-like header."""
    secs, nsecs = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(stamp=SimpleNamespace(secs=secs, nsecs=nsecs))
