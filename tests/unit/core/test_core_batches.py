"""The binding: batches, read-only results, the GIL, and readings of sensors."""

from __future__ import annotations

import inspect
import threading
import time

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_core import _core


def test_everything_public_is_documented() -> None:
    silent = [
        name
        for name, value in vars(_core).items()
        if not name.startswith("_")
        and (inspect.isclass(value) or inspect.isroutine(value))
        # pybind11 writes the signature by itself: there must be more than this line.
        and len((inspect.getdoc(value) or "").strip().split("\n"))
        < (1 if inspect.isclass(value) else 2)
    ]
    assert not silent


def cell_arm() -> surg_core.Arm:
    return surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e").arms["PSM1"]


def at_work(arm: surg_core.Arm) -> surg_core.Controller:
    """A controller that is homed and enabled."""
    made = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
    made.set_rcm(arm.trocar.p_BRcm)
    made.step(arm.robot.home, np.zeros(6))
    for word in (surg_core.StateCommand.ENABLE, surg_core.StateCommand.HOME):
        assert made.request(word) == surg_core.Reason.NONE
    return made


def test_batches_are_the_single_calls() -> None:
    arm = surg_core.load_cell(paths.ROOT / "cells" / "sim_panda").arms["PSM1"]
    rng = np.random.default_rng(2)
    q = np.array(arm.robot.home) + rng.uniform(-0.3, 0.3, size=(50, 7))
    poses = arm.chain.forward_batch(q)
    assert np.array_equal(poses, [arm.chain.forward(row) for row in q])
    assert np.array_equal(arm.chain.jacobian_batch(q), [arm.chain.jacobian(row) for row in q])
    sevens = [[*X[:3, 3], *surg_core.matrix_to_quaternion_xyzw(X[:3, :3])] for X in poses]
    tool = (arm.tool.s_F, arm.tool.p_FTip, arm.trocar.p_BRcm)
    single = [surg_core.shaft_state(X, *tool) for X in poses]
    for given in (poses, sevens):
        batch = surg_core.shaft_states(given, *tool)
        for name in ("p_BTip", "s", "e", "p_BNear", "depth"):
            wanted = [getattr(one, name) for one in single]
            np.testing.assert_allclose(getattr(batch, name), wanted, atol=1e-12)
        np.testing.assert_allclose(batch.deviation, np.linalg.norm(batch.e, axis=1), atol=1e-15)
    with pytest.raises(ValueError, match=r"X_BF: shape \(n, 4, 4\) or \(n, 7\)"):
        surg_core.shaft_states(np.zeros((3, 6)), *tool)
    with pytest.raises(ValueError, match=r"X_BF\[1\]: a finite position and a unit quaternion"):
        surg_core.shaft_states([sevens[0], [0] * 7], *tool)


def test_results_are_read_only() -> None:
    arm = cell_arm()
    controller = at_work(arm)
    out = controller.step(arm.robot.home, np.zeros(6))
    tool = (arm.tool.s_F, arm.tool.p_FTip, arm.trocar.p_BRcm)
    X_BF = arm.chain.forward_batch([arm.robot.home])
    arrays = [X_BF, surg_core.shaft_states(X_BF, *tool).deviation]
    arrays += [arm.chain.jacobian_batch([arm.robot.home]), surg_core.shaft_state(X_BF[0], *tool).e]
    arrays += [out.qd_command, out.X_BF, controller.X_BR]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_the_gil_is_released() -> None:
    """Another thread goes on while a batch runs; with the GIL held it would stand still."""
    arm = cell_arm()
    q = np.tile(arm.robot.home, (400_000, 1))
    poses = np.tile(np.eye(4), (300_000, 1, 1))
    tool = (arm.tool.s_F, arm.tool.p_FTip, arm.trocar.p_BRcm)
    for call in (
        lambda: arm.chain.forward_batch(q),
        lambda: arm.chain.jacobian_batch(q),
        lambda: surg_core.shaft_states(poses, *tool),
    ):
        ticks, stop = [0], threading.Event()

        def count(ticks: list[int] = ticks, stop: threading.Event = stop) -> None:
            while not stop.is_set():
                ticks[0] += 1
                time.sleep(1e-4)

        thread = threading.Thread(target=count)
        thread.start()
        before = ticks[0]
        call()
        during = ticks[0] - before
        stop.set()
        thread.join()
        print(f"{during} ticks of the other thread")
        assert during >= 5


def test_readings_reach_the_controller() -> None:
    arm = cell_arm()
    controller = at_work(arm)
    home, rest = arm.robot.home, np.zeros(6)
    hard = surg_core.Readings(tip_force=surg_core.ForceSample([0, 0, 100.0]))
    out = controller.step(home, rest, readings=hard)
    assert (out.state, out.reason) == (surg_core.State.FAULT, surg_core.Reason.FORCE)
    tracking = surg_core.Controller(
        arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, track_rcm=True
    )
    tracking.set_rcm(arm.trocar.p_BRcm)
    moved = np.add(arm.trocar.p_BRcm, [0.003, 0.0, 0.0])  # nearer than 2 mm it would fade in
    readings = surg_core.Readings(p_BTrack=moved, v_BTrack=[0.0, 0.0, 0.0])
    out = tracking.step(home, rest, readings=readings)
    np.testing.assert_allclose(out.p_BRcm, moved, atol=1e-12)
