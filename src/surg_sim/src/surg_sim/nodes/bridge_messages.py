"""The simulator's own 500 Hz messages as bytes, beside those of a link (`link_messages`)."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from surg_ros.link_messages import doubles, header, text
from surg_sim.arrays import Array
from surg_sim.physics.ground_truth import ArmTruth
from surg_sim.tasks import Verdict


def pack_point_velocity(
    stamp_ns: int, seq: int, frame: bytes, point: Array, velocity: Array
) -> bytes:
    """A surg_msgs/PointVelocityStamped as bytes; ``frame`` as for ``header``."""
    return header(seq, stamp_ns, frame) + struct.pack("<6d", *point, *velocity)


def pack_ground_truth(stamp_ns: int, tick: int, arms: Iterable[tuple[str, ArmTruth]]) -> bytes:
    """A surg_msgs/GroundTruth as bytes."""
    parts = []
    for name, truth in arms:
        *vectors, jaw = truth
        parts.append(text(name) + np.concatenate(vectors).tobytes() + struct.pack("<d", jaw))
    count = struct.pack("<QI", tick, len(parts))
    return b"".join((header(tick, stamp_ns), count, *parts))


class TaskStateLayout:
    """surg_msgs/TaskState of a task, whose entries keep their names, order and shapes.

    They are those of an example of what the task says of itself.
    """

    def __init__(self, state: Mapping[str, float | Array]) -> None:
        self._shapes = {name: np.shape(value) for name, value in state.items()}
        self.names = [_entry(name, shape) for name, shape in self._shapes.items()]
        self._head = struct.pack("<I", len(self.names)) + b"".join(map(text, self.names))

    def pack(
        self,
        stamp_ns: int,
        tick: int,
        seed: int,
        state: Mapping[str, float | Array],
        verdict: Verdict,
    ) -> bytes:
        """The message as bytes, of an episode that ``seed`` has drawn.

        Raises:
            ValueError: An entry has come, gone or changed its shape.
        """
        shapes = {name: np.shape(value) for name, value in state.items()}
        if shapes != self._shapes:
            raise ValueError(f"the task's state was {self._shapes} and is {shapes}")
        flat = [np.ravel(value) for value in state.values()]
        values = np.concatenate(flat) if flat else np.zeros(0)
        return b"".join(
            (
                header(tick, stamp_ns),
                struct.pack("<QI", tick, seed),
                self._head,
                doubles(values),
                text(verdict.phase),
                struct.pack("<2B", verdict.done, verdict.success),
                text(verdict.reason),
                struct.pack("<d", verdict.reward),
            )
        )


def _entry(name: str, shape: tuple[int, ...]) -> str:
    return f"{name}[{','.join(map(str, shape))}]" if shape else name


def task_state(names: Iterable[str], values: Sequence[float]) -> dict[str, float | Array]:
    """The dictionary that ``TaskStateLayout`` has packed.

    Raises:
        ValueError: Names and number of values do not belong together.
    """
    state: dict[str, float | Array] = {}
    start = 0
    for entry in names:
        name, _, rest = entry.partition("[")
        shape = tuple(int(n) for n in rest.rstrip("]").split(",") if n)
        end = start + math.prod(shape)
        part = np.array(values[start:end], dtype=np.float64)
        if len(part) != end - start:
            raise ValueError(f"{len(values)} values end within {entry!r}")
        state[name] = part.reshape(shape) if rest else float(part[0])
        start = end
    if start != len(values):
        raise ValueError(f"{len(values)} values for names of {start}")
    return state


def pack_wrench(
    stamp_ns: int, seq: int, frame: bytes, force: Array, torque: Sequence[float] | Array = (0, 0, 0)
) -> bytes:
    """A geometry_msgs/WrenchStamped; ``frame`` as for ``header``."""
    return header(seq, stamp_ns, frame) + struct.pack("<6d", *force, *torque)
