"""The binding is whole: every public name of the core is reachable or its absence has a reason.

Headers, module and stubs are compared: a name that one of them alone has fails here.
"""

from __future__ import annotations

import importlib.util
import inspect
import re
import sys
import threading
import time
from types import ModuleType

import numpy as np
import pytest

import surg_core
import surg_core.base_file
import surg_core.calibration
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, _core, testing

CORE = paths.ROOT / "src" / "surg_core"

ABSENT = {
    # parts of Controller, reachable through step() and run(), whose types own no meaning alone
    "ArmState InstrumentState CommandHandler TipPose Setpoint Space Dofs": "part",
    "Trocar TrackSample PointKalman NoiseEstimate TrackFilter Jaw LagMeter": "part",
    "Harmonics Overtones RateSearch BreathingFilter": "part",
    "StreamInput StreamEstimate StreamLateness TremorEstimate nearest_inside": "part",
    "HandEstimate SwingEstimate SwingModel oscillation oscillation_noise jerk_noise": "part",
    "ForceGuard ElbowMotion ElbowTurn elbow_turn swivel_angle": "part",
    "StandstillGuard bias_acceleration Pivots padded": "part",
    "Wall Fixtures check_fixture wall_at Constraint Slide nearest_in": "part",
    "OperatingState Conditions Authority CycleClock LagMeter": "part",
    "velocity_twist axial_twist paper_twist TwistParts Gains to_spherical to_cartesian": "part",
    "StepRequest PathView Barrier SingularityMeasures": "part",
    "robot_condition is_servo is_jaw Inputs newton_step wrapped aside_near_trocar"
    " braked_together slowed_flange lateral_fade": "part",
    "Gap gaps distance distance_at_least Clearance ClearanceGuard placed mount": "part",
    # steps of load_arm, each useless without the others
    "parse_link simulator_link link_file unknown_link with_link with_measured_lag": "part",
    "with_home tighten check_base check_hardware check_kinematics check_tool": "part",
    "Model MountedTool urdf_of": "part",
    # plain bytes for the black box, which has a program of its own (rcm_replay)
    "IsPlain SnapshotWriter SnapshotReader": "bytes",
    "BlackBox BlackBoxEvent BlackBoxStep BlackBoxLabel": "bytes",
    "BlackBoxRecording BlackBoxError BlackBoxDifference ControllerSetup": "bytes",
    "encode decode replay": "bytes",
    # value types that Python has as arrays, tuples or arguments
    "Capsule HalfSpace": "arguments",
    "SampleTime Tool Line UrBranch UrSolutions Value Interval": "arguments",
}
"""Names of the headers that the module does not have, and why."""
RENAMED = {
    "name": ("reason_name", "state_name"),
    "home_of": ("Home",),
    "arm_shape": ("ArmShape",),
    "load_model": ("load_chain",),
    "load_tool": ("load_arm",),
    "Options": ("Controller",),
}


def declared() -> dict[str, str]:
    """Public name -> header, of everything at namespace level."""
    found: dict[str, str] = {}
    for header in sorted((CORE / "include" / "surg_core").rglob("*.hpp")):
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", header.read_text(), flags=re.S)
        depth, level = 0, ""
        for part in re.split(r"([{}])", text):  # what stands outside every brace but namespace's
            if part == "{":
                depth += 1
            elif part == "}":
                depth -= 1
                level += ";" if depth == 1 else ""
            elif depth == 1:
                level += part
        level = re.sub(r"template\s*<[^;{]*?>\s*(?=struct|class|inline)", "", level)
        for kind in (
            r"\b(?:struct|class|enum\s+class)\s+(\w+)",
            r"(?:^|[;\n])\s*(?:inline\s+|constexpr\s+|const\s+)*[\w:<>&*, ]+?[\s&*]([a-z]\w*)\s*\(",
        ):
            for name in re.findall(kind, level):
                found[name] = header.name
    return {n: h for n, h in found.items() if n not in ("operator", "sizeof", "if", "return")}


def bound(name: str) -> bool:
    """Whether the binding has a name, for users or for tests."""
    return hasattr(_core, name) or hasattr(_core.testing, name)


def test_every_public_name_of_the_core_is_reachable_or_has_a_reason() -> None:
    absent = {name for names in ABSENT for name in names.split()}
    names = declared()
    missing = {
        name: header
        for name, header in names.items()
        if not bound(name)
        and name not in absent
        and not all(bound(other) for other in RENAMED.get(name, ("",)))
    }
    print(f"{len(names)} public names, {len(absent & set(names))} absent for a reason")
    assert len(names) > 60, "the reader of the headers finds next to nothing"
    assert not missing, f"bind them, or say in ABSENT why not: {missing}"
    assert not {n for n in absent if bound(n)}, "bound after all: take it out of ABSENT"


def test_every_name_of_the_module_is_exported() -> None:
    """A name of the module is for users, for tests, or for the readers of files in the package."""
    package = [
        surg_core.base_file,
        surg_core.calibration,
        surg_core.config,
        surg_core.transforms,
        surg_core.urdf,
    ]
    read = {name for module in package for name in vars(module)}
    names = {name for name in public(_core) if name != "testing"}
    results = {
        "BaseCalibration",
        "CellArm",
        "CameraConfig",
        "Command",
        "CellEndoscope",
        "Fit",
        "Joint",
        "Tuning",
    }  # parts of what readers return
    assert names <= set(surg_core.__all__) | read | results
    assert public(_core.testing) == set(testing.__all__)
    for module in (surg_core, testing):
        assert all(hasattr(module, name) for name in module.__all__)
    assert not set(surg_core.__all__) & set(testing.__all__)


def public(module: ModuleType) -> set[str]:
    """Names without a leading underscore."""
    return {name for name in vars(module) if not name.startswith("_")}


@pytest.mark.skipif(
    sys.version_info[:2] != (3, 11), reason="the stubs are written on Debian 12, by its pybind11"
)
def test_the_stubs_are_those_of_the_binding() -> None:
    """src/surg_core/tools/write_stub.py has been run since the binding last changed."""
    spec = importlib.util.spec_from_file_location("write_stub", CORE / "tools" / "write_stub.py")
    assert spec is not None and spec.loader is not None
    writer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(writer)
    stubs = writer.stubs()
    assert len(stubs) == 2
    for path, text in stubs.items():
        assert path.read_text() == text, f"{path}: run src/surg_core/tools/write_stub.py"


def test_everything_public_is_documented() -> None:
    silent = [
        name
        for name, value in [*vars(_core).items(), *vars(_core.testing).items()]
        if not name.startswith("_")
        and (inspect.isclass(value) or inspect.isroutine(value))
        # pybind11 writes the signature by itself: there must be more than this line.
        and len((inspect.getdoc(value) or "").strip().split("\n"))
        < (1 if inspect.isclass(value) else 2)
    ]
    assert not silent


class Scene:
    """A controller and recorded inputs."""

    def __init__(self, cycles: int) -> None:
        self.arm = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e").arms["PSM1"]
        self.controller = self.fresh()
        q = np.array(self.arm.robot.home)
        qd = np.zeros(6)
        self.q, self.qd = [], []
        self.commands = []
        self.outputs = []
        for k in range(cycles):
            here = []
            if k % 10 == 0:
                t = 0.002 * k
                p = [0.02 * np.sin(t), 0.02 * (1 - np.cos(t)), 0.12]
                here.append(MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0, 0, 0, 1]))
            out = self.controller.step(q, qd, here)
            self.q.append(q)
            self.qd.append(qd)
            self.commands += [(k, command) for command in here]
            self.outputs.append(out)
            qd = np.array(out.qd_command)
            q = q + 0.002 * qd

    def fresh(self) -> surg_core.Controller:
        arm = self.arm
        made = surg_core.Controller(arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool)
        made.set_rcm(arm.trocar.p_BRcm)
        made.step(arm.robot.home, np.zeros(6))
        for word in (surg_core.StateCommand.ENABLE, surg_core.StateCommand.HOME):
            assert made.request(word) == surg_core.Reason.NONE
        return made


def test_run_is_step_after_step_bit_for_bit() -> None:
    scene = Scene(600)
    controller = scene.fresh()
    found = controller.run(scene.q, scene.qd, scene.commands)
    assert len(found) == 600
    for name in ("qd_command", "twist_command", "p_BTip", "s_B", "p_set", "v_set", "virtual_q"):
        wanted = np.array([getattr(out, name) for out in scene.outputs])
        assert np.array_equal(getattr(found, name), wanted), name
    for name in ("scale", "rcm_error", "depth", "roll"):
        wanted = np.array([getattr(out, name) for out in scene.outputs])
        assert np.array_equal(getattr(found, name), wanted), name
    for name in ("state", "reason", "motion"):
        wanted = np.array([int(getattr(out, name)) for out in scene.outputs])
        assert np.array_equal(getattr(found, name), wanted), name
    assert found.limited_by == tuple(out.limited_by for out in scene.outputs)
    assert [k for k, _ in found.verdicts] == list(range(0, 600, 10))
    assert all(verdict.reason == surg_core.Reason.NONE for _, verdict in found.verdicts)
    assert np.abs(found.p_set[-1] - found.p_set[0]).max() > 0.01, "it has moved"


def test_run_checks_what_it_is_given() -> None:
    scene = Scene(20)
    controller = scene.fresh()
    hold = MotionCommand(Motion.HOLD, 1)
    with pytest.raises(ValueError, match="qd: shape"):
        controller.run(scene.q, scene.qd[:-1])
    with pytest.raises(ValueError, match="q: shape"):
        controller.run(scene.q[0], scene.qd[0])
    with pytest.raises(ValueError, match="cycles must rise, from 0 to 19"):
        controller.run(scene.q, scene.qd, [(5, hold), (4, hold)])
    with pytest.raises(ValueError, match="cycle 20"):
        controller.run(scene.q, scene.qd, [(20, hold)])
    with pytest.raises(ValueError, match="more than 64 in cycle 3"):
        controller.run(scene.q, scene.qd, [(3, hold)] * 65)
    with pytest.raises(ValueError, match="jaw: shape"):
        controller.run(scene.q, scene.qd, jaw=np.zeros(3))


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
    scene = Scene(3)
    found = scene.fresh().run(scene.q, scene.qd)
    chain = scene.arm.chain
    tool = (scene.arm.tool.s_F, scene.arm.tool.p_FTip, scene.arm.trocar.p_BRcm)
    X_BF = chain.forward_batch(scene.q)
    arrays = [found.qd_command, found.state, found.busy, found.scale, X_BF]
    arrays += [surg_core.shaft_states(X_BF, *tool).deviation, chain.jacobian_batch(scene.q)]
    arrays += [surg_core.shaft_state(X_BF[0], *tool).e]
    arrays += [scene.outputs[0].qd_command, scene.outputs[0].X_BF, scene.controller.X_BR]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_the_gil_is_released() -> None:
    """Another thread goes on while a batch runs; with the GIL held it would stand still."""
    scene = Scene(2)
    controller = scene.fresh()
    q = np.tile(scene.arm.robot.home, (40_000, 1))
    qd = np.zeros_like(q)
    poses = np.tile(np.eye(4), (300_000, 1, 1))
    tool = (scene.arm.tool.s_F, scene.arm.tool.p_FTip, scene.arm.trocar.p_BRcm)
    for call in (
        lambda: controller.run(q, qd),
        lambda: scene.arm.chain.jacobian_batch(np.tile(q, (10, 1))),
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
    scene = Scene(1)
    controller = scene.fresh()
    home, rest = scene.arm.robot.home, np.zeros(6)
    hard = surg_core.Readings(tip_force=surg_core.ForceSample([0, 0, 100.0]))
    out = controller.step(home, rest, readings=hard)
    assert (out.state, out.reason) == (surg_core.State.FAULT, surg_core.Reason.FORCE)
    arm = scene.arm
    tracking = surg_core.Controller(
        arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, track_rcm=True
    )
    tracking.set_rcm(arm.trocar.p_BRcm)
    moved = np.add(arm.trocar.p_BRcm, [0.003, 0.0, 0.0])  # nearer than 2 mm it would fade in
    readings = surg_core.Readings(p_BTrack=moved, v_BTrack=[0.0, 0.0, 0.0])
    assert readings.track_valid
    out = tracking.step(home, rest, readings=readings)
    np.testing.assert_allclose(out.p_BRcm, moved, atol=1e-12)
