"""The same task in Python: pink (Pinocchio) and mink (MuJoCo). Runs in `.venv-bench`, prints JSON.

Each cycle is a quadratic programme that the library builds: a frame task takes the tip to the next
pose on the pivot (position cost 1, orientation cost 0.1), and a task of our own, two rows, holds
the shaft on the trocar as a strict equality. Limits are the library's own for position and
velocity.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


def minimal_rotation(a: Any, b: Any) -> Any:
    """Rotation matrix of least angle that takes unit a to unit b."""
    w = np.cross(a, b)
    W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return np.eye(3) + W + W @ W / (1 + a @ b)


def lateral(p: Any, s: Any, trocar: Any) -> Any:
    """Lateral vector from the shaft through p along s to the trocar."""
    d = trocar - p
    return d - s * (s @ d)


def across(s: Any) -> Any:
    """Two unit vectors across s, as rows."""
    u = np.cross(s, np.eye(3)[np.argmin(np.abs(s))])
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(s, u)])


def rcm_rows(p: Any, s: Any, J: Any, trocar: Any) -> tuple[Any, Any]:
    """Lateral vector (2,) and Jacobian (2, n) of the shaft point at the trocar.

    Args:
        p: Tip in the base.
        s: Unit shaft axis in the base.
        J: Jacobian of the tip in base axes, v then omega.
        trocar: Trocar point in the base.
    """
    arm = (trocar - p) @ s * s  # tip to the shaft point at the trocar
    rows = across(s)
    moment = np.cross(J[3:].T, arm).T
    return rows @ lateral(p, s, trocar), rows @ (J[:3] + moment)


@dataclass
class Law:
    """One library with the task set up in it.

    Attributes:
        library: The module, with its ``solve_ik``.
        configuration: Its arm with the present joints.
        read: Present pose of the tip ``(4, 4)`` and its Jacobian ``(6, n)`` in its own axes.
        tip: Its frame task for the tip.
        target: From a pose ``(4, 4)`` to what the frame task takes.
        rcm: The two rows of the pivot.
        limits: Its limits.
        period: Control period [s].
    """

    library: Any
    configuration: Any
    read: Callable[[Any], tuple[Any, Any]]
    tip: Any
    target: Callable[[Any], Any]
    rcm: Any
    limits: list[Any]
    period: float

    def step(self, X: Any) -> None:
        """Take the tip to a pose within one period."""
        self.tip.set_target(self.target(X))
        v = self.library.solve_ik(
            self.configuration,
            [self.tip],
            self.period,
            solver="daqp",
            damping=1e-9,
            limits=self.limits,
            constraints=[self.rcm],
        )
        self.configuration.integrate_inplace(v, self.period)

    def pose(self) -> Any:
        """Pose of the tip in the base."""
        return self.read(self.configuration)[0]


def pivot_task(base: type, read: Callable[[Any], tuple[Any, Any]], trocar: Any, cost: Any) -> Any:
    """The two rows of the pivot as a task of a library.

    Args:
        base: The library's class of tasks.
        read: As in `Law`.
        trocar: Trocar point in the base.
        cost: What `base` takes; without effect on an equality.
    """

    class Pivot(base):  # type: ignore[misc]
        def rows(self, configuration: Any) -> tuple[Any, Any]:
            X, J_local = read(configuration)
            J = np.vstack([X[:3, :3] @ J_local[:3], X[:3, :3] @ J_local[3:]])
            return rcm_rows(X[:3, 3], X[:3, 2], J, trocar)

        def compute_error(self, configuration: Any) -> Any:
            return -self.rows(configuration)[0]

        def compute_jacobian(self, configuration: Any) -> Any:
            return self.rows(configuration)[1]

        def __repr__(self) -> str:
            return "Pivot()"

    return Pivot(cost=cost)


def with_pink(scene: dict[str, Any]) -> Law:
    """The task in pink, on Pinocchio."""
    import pink
    import pinocchio as pin

    model = pin.buildModelFromUrdf(scene["urdf"])
    flange = model.getFrameId(scene["flange"])
    X_FTip = pin.SE3(minimal_rotation(np.array([0, 0, 1.0]), scene["s_F"]), scene["p_FTip"])
    parent = model.frames[flange]
    model.addFrame(
        pin.Frame("tip", parent.parentJoint, flange, parent.placement * X_FTip, pin.OP_FRAME)
    )
    model.velocityLimit = np.asarray(scene["velocity"])

    def read(now: Any) -> tuple[Any, Any]:
        X = now.get_transform_frame_to_world("tip").homogeneous
        return X, now.get_frame_jacobian("tip")

    return Law(
        library=pink,
        configuration=pink.Configuration(model, model.createData(), scene["home"]),
        read=read,
        tip=pink.tasks.FrameTask("tip", position_cost=1.0, orientation_cost=0.1),
        target=pin.SE3,
        rcm=pivot_task(pink.tasks.Task, read, scene["trocar"], 1.0),
        limits=[pink.limits.ConfigurationLimit(model), pink.limits.VelocityLimit(model)],
        period=scene["period"],
    )


def with_mink(scene: dict[str, Any]) -> Law:
    """The task in mink, on MuJoCo."""
    import mink
    import mujoco

    spec = mujoco.MjSpec.from_file(scene["urdf"])
    R = minimal_rotation(np.array([0, 0, 1.0]), scene["s_F"])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, R.ravel())
    spec.body(scene["flange"]).add_site(name="tip", pos=scene["p_FTip"], quat=quaternion)
    model = spec.compile()
    configuration = mink.Configuration(model)
    configuration.update(np.asarray(scene["home"]))
    names = [model.joint(i).name for i in range(model.njnt)]

    def read(now: Any) -> tuple[Any, Any]:
        X = now.get_transform_frame_to_world("tip", "site").as_matrix()
        return X, now.get_frame_jacobian("tip", "site")

    return Law(
        library=mink,
        configuration=configuration,
        read=read,
        tip=mink.FrameTask("tip", "site", position_cost=1.0, orientation_cost=0.1),
        target=mink.SE3.from_matrix,
        rcm=pivot_task(mink.Task, read, scene["trocar"], np.ones(2)),
        limits=[
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict(zip(names, scene["velocity"], strict=True))),
        ],
        period=scene["period"],
    )


def main() -> None:
    """Read the scene, run both libraries in turn, print their figures."""
    folder = Path(sys.argv[1])
    cycles = int(sys.argv[2])
    scene = json.loads((folder / "scene.json").read_text("utf-8"))
    scene = {
        key: np.asarray(value) if isinstance(value, list) else value for key, value in scene.items()
    }
    path = np.fromfile(folder / "tip.path").reshape(-1, 3)[: cycles + 1]
    libraries: dict[str, Law] = {}
    for name, start in (("py_pink", with_pink), ("py_mink", with_mink)):
        try:
            libraries[name] = start(scene)
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
    times: dict[str, list[float]] = {name: [] for name in libraries}
    rcm: dict[str, list[float]] = {name: [] for name in libraries}
    tips: dict[str, list[float]] = {name: [] for name in libraries}
    failed: dict[str, int] = dict.fromkeys(libraries, 0)
    homes = {name: law.pose().copy() for name, law in libraries.items()}
    rounds = 100  # cycles that one has its turn
    for begin in range(0, len(path) - 1, rounds):
        for name, law in libraries.items():
            for p in path[begin + 1 : begin + 1 + rounds]:
                s = p - scene["trocar"]
                s = s / np.linalg.norm(s)
                X = np.eye(4)
                X[:3, :3] = minimal_rotation(homes[name][:3, 2], s) @ homes[name][:3, :3]
                X[:3, 3] = p
                t = time.perf_counter()
                try:
                    law.step(X)
                except Exception as error:
                    failed[name] += 1
                    if failed[name] == 1:
                        print(f"{name}: {error!r}", file=sys.stderr)
                times[name].append(time.perf_counter() - t)
                now = law.pose()
                rcm[name].append(
                    float(np.linalg.norm(lateral(now[:3, 3], now[:3, 2], scene["trocar"])))
                )
                tips[name].append(float(np.linalg.norm(now[:3, 3] - p)))
    result = {}
    for name in libraries:
        us = np.asarray(times[name]) * 1e6
        result[name] = {
            "what": {
                "py_pink": "Python QP, pink (Pinocchio, DAQP)",
                "py_mink": "Python QP, mink (MuJoCo, DAQP)",
            }[name],
            "median": float(np.median(us)),
            "p99": float(np.percentile(us, 99)),
            "rcm_mean_um": float(np.mean(rcm[name]) * 1e6),
            "rcm_max_at_samples_um": float(np.max(rcm[name]) * 1e6),
            "tip_mean_um": float(np.mean(tips[name]) * 1e6),
            "tip_max_um": float(np.max(tips[name]) * 1e6),
            "cycles": len(us),
            "failures": failed[name],
        }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
