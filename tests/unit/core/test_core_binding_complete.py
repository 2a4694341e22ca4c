"""The binding is whole: every public name of the core is reachable or its absence has a reason.

Headers, module and stub are read and compared, so a name that is added to one of them only fails
here.
"""

from __future__ import annotations

import ast
import inspect
import re
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, _core

CORE = paths.ROOT / "src" / "surg_core"
STUB = CORE / "python" / "surg_core" / "_core.pyi"

ABSENT = {
    # parts of Controller, reachable through step() and run(), whose types own no meaning alone
    "ArmState Sight Pilot Whereabouts Setpoint Space Dofs Trocar TrackSample Jaw": "part",
    "ForceGuard": "part",
    "OperatingState Conditions Authority": "part",
    "velocity_wish axial_wish paper_wish TwistWish Gains to_spherical to_cartesian": "part",
    "Wish PathView Barrier SingularityMeasures": "part",
    "is_servo is_jaw Inputs newton_step wrapped aside_near_trocar"
    " braked_together slowed_flange": "part",
    # plain bytes for the black box, which has a program of its own (rcm_replay)
    "IsPlain ImageWriter ImageReader BlackBox BlackBoxEvent BlackBoxStep BlackBoxLabel": "bytes",
    "BlackBoxRecording BlackBoxError BlackBoxDifference ControllerSetup": "bytes",
    "encode decode replay": "bytes",
    # value types that Python has as arrays, tuples or arguments
    "Tool Line UrBranch UrSolutions Value Interval": "arguments",
}
"""Names of the headers that the module does not have, and why."""
RENAMED = {
    "name": ("reason_name", "state_name"),
    "home_of": ("Home",),
    "Options": ("Controller",),
}


def declared() -> dict[str, str]:
    """Public name -> header, of everything at namespace level."""
    found: dict[str, str] = {}
    for header in sorted((CORE / "include" / "surg_core").glob("*.hpp")):
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


def test_every_public_name_of_the_core_is_reachable_or_has_a_reason() -> None:
    absent = {name for names in ABSENT for name in names.split()}
    names = declared()
    missing = {
        name: header
        for name, header in names.items()
        if not hasattr(_core, name)
        and name not in absent
        and not all(hasattr(_core, other) for other in RENAMED.get(name, ("",)))
    }
    print(f"{len(names)} public names, {len(absent & set(names))} absent for a reason")
    assert len(names) > 60, "the reader of the headers finds next to nothing"
    assert not missing, f"bind them, or say in ABSENT why not: {missing}"
    assert not {n for n in absent if hasattr(_core, n)}, "bound after all: take it out of ABSENT"


def test_every_name_of_the_module_is_exported() -> None:
    names = {name for name in vars(_core) if not name.startswith("_")}
    assert names <= set(surg_core.__all__), names - set(surg_core.__all__)
    assert all(hasattr(surg_core, name) for name in surg_core.__all__)
    assert surg_core.__all__ == sorted(
        set(surg_core.__all__), key=lambda n: (0 if n.isupper() else 1 if n[0].isupper() else 2, n)
    )


def stub_of() -> tuple[dict[str, ast.ClassDef], dict[str, ast.FunctionDef], set[str]]:
    """Classes, functions and constants of the stub."""
    tree = ast.parse(STUB.read_text())
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    constants = {
        node.target.id
        for node in tree.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    return classes, functions, constants


def parameters(function: ast.FunctionDef) -> list[str]:
    """Names of the parameters without ``self``."""
    names = [argument.arg for argument in [*function.args.args, *function.args.kwonlyargs]]
    return [name for name in names if name != "self"]


def bound_parameters(function: object) -> list[str]:
    """The same from the first line that pybind11 writes into a docstring."""
    signature = (inspect.getdoc(function) or "").split("\n")[0]
    inside = signature[signature.index("(") + 1 : signature.rindex(") ->")]
    names, depth, word = [], 0, ""
    for letter in inside + ",":
        depth += letter in "([{<"
        depth -= letter in ")]}>"
        if letter == "," and depth == 0:
            names.append(word.split(":")[0].strip())
            word = ""
        else:
            word += letter
    return [name for name in names if name not in ("", "self", "*")]


def test_the_stub_says_what_the_module_has() -> None:
    classes, functions, constants = stub_of()
    public = {name: value for name, value in vars(_core).items() if not name.startswith("_")}
    assert set(classes) == {n for n, v in public.items() if inspect.isclass(v)}
    assert set(functions) == {n for n, v in public.items() if inspect.isroutine(v)}
    assert constants - {"_Array", "_Bytes"} == {
        n for n, v in public.items() if not inspect.isclass(v) and not inspect.isroutine(v)
    }
    checked = 0
    for name, stub in functions.items():
        assert parameters(stub) == bound_parameters(public[name]), name
        checked += 1
    for name, stub_class in classes.items():
        for where, member in members(stub_class):
            checked += 1
            actual = inspect.getattr_static(public[name], where, None)
            assert actual is not None, f"{name}.{where} is in the stub only"
            if isinstance(member, ast.FunctionDef) and not member.decorator_list:
                if where in ("__int__", "__len__"):
                    continue
                assert parameters(member) == bound_parameters(getattr(public[name], where)), (
                    f"{name}.{where}"
                )
        stated = {where for where, _ in members(stub_class)}
        actual_names = {
            n
            for n in vars(public[name])
            if not n.startswith("_") or (n == "__init__" and constructible(public[name]))
        }
        if issubclass(public[name], Exception) or hasattr(public[name], "__members__"):
            actual_names = set(getattr(public[name], "__members__", {}))
            stated -= {"__int__"}
        assert actual_names <= stated, f"{name}: not in the stub: {actual_names - stated}"
    print(f"{checked} functions and members compared")
    assert checked > 300


def constructible(kind: type) -> bool:
    """Whether pybind11 gave the class a constructor."""
    return "__init__" in vars(kind) and "__init__(self" in (kind.__init__.__doc__ or "")


def members(stub: ast.ClassDef) -> Iterator[tuple[str, ast.stmt]]:
    """Name and node of everything in a class of the stub."""
    for node in stub.body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, node
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            yield node.targets[0].id, node


def test_enumerations_have_the_numbers_of_the_stub() -> None:
    classes, _, _ = stub_of()
    compared = 0
    for name, stub in classes.items():
        kind = getattr(_core, name)
        for where, node in members(stub):
            if isinstance(node, ast.Assign):
                assert isinstance(node.value, ast.Constant)
                assert int(getattr(kind, where)) == node.value.value, f"{name}.{where}"
                compared += 1
    assert compared > 60


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
    moved = np.add(arm.trocar.p_BRcm, [0.001, 0.0, 0.0])
    readings = surg_core.Readings(p_BTrack=moved, v_BTrack=[0.0, 0.0, 0.0])
    assert readings.track_valid
    out = tracking.step(home, rest, readings=readings)
    np.testing.assert_allclose(out.p_BRcm, moved, atol=1e-12)
