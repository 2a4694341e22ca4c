"""``observation.force``: recorded, exported and observed are the forces that the simulator had."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.recording_synthetic import R_BR, TICK_NS, stamp, xyz
from helpers.sim.felt_nudge_task import ARM, pull
from surg_cli.host import paths
from surg_core.arm_view import ArmState, ArmView
from surg_core.contract import ARM_FORCE, FORCE_KEY, FORCE_TIMEOUT_NS, GRID
from surg_core.force.observed_force import NewestForces, arm_force
from surg_policy_bridge.server.served_forces import ServedForces
from surg_recording import datasets
from surg_recording.episode import episode_reader
from surg_recording.episode.episode_recorder import Recording
from surg_sim.envs import policy_rollouts
from surg_sim.envs.recorded_episode import RecordedSession
from surg_sim.envs.surg_env import SurgEnv
from surg_sim.physics import cell_files
from surg_sim.tasks.scripted_sender import home_frame

TASK = str(paths.ROOT / "tests" / "helpers" / "sim" / "felt_nudge_task.py")
SEED, LATE = 10_004, 5
"""Ticks by which a force is older than the observation that holds it."""
SERIAL = datasets.ExportOptions(executor="serial")


class Truth:
    """What the simulator had at each tick, in the rcm frame that the cell's drawing gives."""

    def __init__(self, session: Any) -> None:
        self.trocar: dict[int, np.ndarray] = {}
        arm = session.cell.arms[ARM]
        self.R_WR = np.asarray(home_frame(arm))[:3, :3]
        self.R_WB = np.asarray(arm.X_WB)[:3, :3]
        inner = session.tick

        def tick(*given: Any) -> Any:
            at = session.world.tick
            self.trocar[at] = self.R_WB @ np.asarray(session.world.truth(ARM).trocar_force)
            return inner(*given)

        session.tick = tick

    def row(self, tick: int) -> np.ndarray:
        """``contract.ARM_FORCE`` of an observation at a tick; the task counts from 0."""
        felt = self.R_WR.T @ np.stack([pull(tick - LATE - 1), self.trocar[tick - LATE]]).T
        return np.concatenate([felt[:, 0], [1.0], felt[:, 1], [1.0]])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    session = RecordedSession(cell_files.find("sim_two_arms"), TASK)
    session.reset(SEED)
    truth = Truth(session)
    folder = tmp_path_factory.mktemp("felt") / "episode"
    session.record(folder, SEED)
    return folder, truth


def exported(recordings: list[Path], out: Path, **options: Any) -> tuple[dict[str, Any], Any]:
    """Description of the feature and its rows, of a LeRobot data set."""
    chosen = datasets.ExportOptions(executor="serial", splits={"train": 1.0}, **options)
    report = datasets.load("lerobot").write(recordings, out, chosen)
    assert report.ok, report
    info = json.loads((out / "meta/info.json").read_text())
    (table,) = sorted((out / "data").rglob("*.parquet"))
    return info["features"], pq.read_table(table)


def test_an_export_holds_the_true_forces_of_five_ticks_before(
    recorded: tuple[Path, Truth], tmp_path: Path
) -> None:
    folder, truth = recorded
    features, table = exported([folder], tmp_path / "out")
    feature = features[FORCE_KEY]
    names = [f"{arm}/{name}" for arm in (ARM, "ECM") for name in ARM_FORCE]
    assert feature["names"] == names and feature["info"]["units"][:4] == ["N", "N", "N", "1"]
    assert "rcm" in feature["info"]["frame"]
    rows = np.array(table.column(FORCE_KEY).to_pylist())
    ticks = np.array(table.column("timing.grid_ns").to_pylist()) // TICK_NS
    expected = np.array([truth.row(int(tick)) for tick in ticks])
    assert len(rows) > 20 and np.ptp(rows[:, 0]) > 1.0 and np.abs(expected[:, 4:7]).max() > 0.01
    # The recorded rcm frame is the one measured at homing, micrometres beside the drawn one.
    np.testing.assert_allclose(rows[:, :8], expected, atol=1e-3)
    assert set(rows[:, 11]) == {0.0} and set(rows[:, 15]) == {1.0}  # the second arm has no jaws
    stats = json.loads((tmp_path / "out/meta/episodes_stats.jsonl").read_text())["stats"]
    np.testing.assert_allclose(stats[FORCE_KEY]["max"], rows.max(axis=0), rtol=1e-6)
    np.testing.assert_allclose(stats[FORCE_KEY]["mean"], rows.mean(axis=0), atol=1e-6)


def test_an_environment_observes_the_same(recorded: tuple[Path, Truth]) -> None:
    env = SurgEnv(TASK, forces=True)
    truth = Truth(env.session)
    seen, _ = env.reset(seed=SEED)
    assert len(policy_rollouts.names(env)[FORCE_KEY]) == 16
    for _ in range(8):
        assert env.observation_space.contains(seen)
        tick = env.session.world.tick - 1
        assert tick % GRID == 0
        force = policy_rollouts.observe(env, seen)[FORCE_KEY]
        np.testing.assert_allclose(force[:8], truth.row(tick), atol=1e-3)
        seen, *_ = env.step(env.expert_action())
    assert "force" not in SurgEnv(TASK).reset(seed=SEED)[0]
    env.close()


def test_forces_change_no_state_and_can_be_dropped(
    recorded: tuple[Path, Truth], tmp_path: Path
) -> None:
    folder, _ = recorded
    assert FORCE_KEY not in exported([folder], tmp_path / "out", drop=(FORCE_KEY,))[0]
    table = episode_reader.read(folder).table("tip_force_PSM1")
    ticks = table["stamp_ns"] // TICK_NS
    assert set(np.diff(ticks)) == {LATE} and set(table["known"]) == {1}


def test_recordings_without_a_sensor_have_no_such_feature_and_do_not_mix(
    recorded: tuple[Path, Truth], tmp_path: Path
) -> None:
    plain = datasets_synthetic.record(tmp_path / "plain", 1, 0.7, cameras=())
    assert FORCE_KEY not in exported([plain], tmp_path / "out")[0]
    felt = record(tmp_path / "felt", {tick: tick for tick in range(1, 451, 5)})
    report = datasets.load("lerobot").write([felt, plain], tmp_path / "both", SERIAL)
    assert report.refused and "forces at tip and trocar" in str(report.refused)


# --- a sensor that is silent, does not know, or says no number ------------------------------------


def wrench(tick: int, force: Any) -> SimpleNamespace:
    header = SimpleNamespace(stamp=stamp(tick * TICK_NS))
    return SimpleNamespace(header=header, wrench=SimpleNamespace(force=xyz(force)))


def record(folder: Path, said: dict[int, int], bad: Any = None) -> Path:
    """A made-up recording in which the tip's sensor says (tick, 0, 2) N with a stamp at ticks."""
    inner = Recording.cycle

    def cycle(self: Recording, arm: str, message: Any, receive_ns: int) -> None:
        if message.tick in said:
            stamped = said[message.tick]
            force = [message.tick, 0.0, 2.0] if stamped >= 0 else [np.nan, 0.0, 2.0]
            self.force(arm, "tip", wrench(max(stamped, 0), force), receive_ns)
        inner(self, arm, message, receive_ns)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recording, "cycle", cycle)
        return datasets_synthetic.record(folder, 3, 0.7, cameras=())


def test_what_is_not_known_is_zero_and_says_so(tmp_path: Path) -> None:
    """Until tick 100 it knows, then it does not, from 200 on again, and from 260 on it is silent.

    That it does not know is recorded with the stamp of the last force, which counts no more.
    """
    said = {tick: tick if not 100 < tick < 200 else 0 for tick in range(3, 260, 4)}
    folder = record(tmp_path / "felt", said)
    table = episode_reader.read(folder).table("tip_force_PSM1")
    assert table["known"].tolist().count(0) == 1, "said once"
    _, rows = exported([folder], tmp_path / "out")
    force = np.array(rows.column(FORCE_KEY).to_pylist())
    ticks = np.array(rows.column("timing.grid_ns").to_pylist()) // TICK_NS
    for tick, row in zip(ticks, force, strict=True):
        before = [s for s in said if s < tick]
        last = before[-1]
        known = (
            said[last] > 0
            and said.get(last + 4, 1) > 0
            and (tick - last) * TICK_NS <= FORCE_TIMEOUT_NS
        )
        expected = R_BR.T @ [last, 0.0, 2.0] if known else np.zeros(3)
        assert row[:4].tolist() == [*expected, float(known)], tick
    assert set(force[:, 3]) == {0.0, 1.0} and not force[:, 4:].any()


def test_a_recorded_force_that_is_no_number_is_not_known(tmp_path: Path) -> None:
    folder = record(tmp_path / "felt", {10: 10, 20: -1, 30: 30})
    assert episode_reader.read(folder).table("tip_force_PSM1")["known"].tolist() == [1, 0, 1]


def test_a_sensor_that_never_knew_leaves_no_table(tmp_path: Path) -> None:
    folder = record(tmp_path / "felt", dict.fromkeys(range(1, 400, 5), 0))
    assert "tip_force_PSM1" not in episode_reader.read(folder).manifest["tables"]


def test_an_edited_force_is_refused(tmp_path: Path) -> None:
    folder = record(tmp_path / "felt", {tick: tick for tick in range(1, 451, 5)})
    file = folder / "tip_force_PSM1.csv"
    file.write_text(file.read_text().replace("101.0", "1e9", 1))
    with pytest.raises(datasets.ExportError, match=r"tip_force_PSM1\.csv"):
        datasets.load("lerobot").write([folder], tmp_path / "out", SERIAL)


# --- on the wire ----------------------------------------------------------------------------------


def view(at_ns: int) -> dict[str, ArmView]:
    R = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    none = np.zeros(3)
    return {ARM: ArmView(at_ns, ArmState.ENABLED, True, False, "", 0, none, none, R_BR=R)}


def test_the_server_serves_the_newest_in_the_rcm_frame() -> None:
    served, ns = ServedForces([ARM]), 10**9
    assert served.silent == [ARM]
    served.take(ARM, "trocar", ns, np.array([1.0, 2.0, 3.0]))
    assert served.silent == []
    row = served.row(view(ns), ns + FORCE_TIMEOUT_NS)
    assert row.tolist() == [0, 0, 0, 0, 2, 1, -3, 1] and row.dtype == np.float32
    assert not served.row(view(ns), ns + FORCE_TIMEOUT_NS + 1).any(), "silent: forgotten"
    later = ns + 5 * TICK_NS
    served.take(ARM, "trocar", later, np.array([7.0, 8.0, 9.0]))
    assert served.row(view(later), later).tolist()[4:] == [2, 1, -3, 1], "of this very tick"
    assert served.row(view(later), later + 1).tolist()[4:] == [8, 7, -9, 1]
    served.take(ARM, "tip", ns, np.array([4.0, 5.0, np.inf]))
    assert served.row(view(later), later + 1).tolist()[:4] == [0, 0, 0, 0], "no number"
    served.take(ARM, "trocar", 0, np.zeros(3))
    assert not served.row(view(later), later + 1).any(), "it says that it does not know"


def test_lock_step_waits_for_the_forces_of_five_ticks_before() -> None:
    served, places = ServedForces([ARM]), {ARM: ["tip", "trocar"]}
    at = 100 * TICK_NS
    served.take(ARM, "tip", 95 * TICK_NS, np.ones(3))
    assert served.behind(at, places)
    served.take(ARM, "trocar", 90 * TICK_NS, np.ones(3))
    assert served.behind(at, places)
    served.take(ARM, "trocar", 95 * TICK_NS, np.ones(3))
    assert not served.behind(at, places)
    assert not served.behind(at, {}), "nothing is measured"


def test_a_force_that_is_not_known_has_no_numbers() -> None:
    assert arm_force(None, np.array([np.nan, 0, 0]), np.eye(3)) == [0.0] * 8
    assert NewestForces().row(0, np.eye(3)) == [0.0] * 8
