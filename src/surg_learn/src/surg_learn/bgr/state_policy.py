"""A learned policy for bowel grasping and retraction: numpy only, no platform, no torch.

    python3 -m surg_learn.bgr.state_policy --weights weights.npz --server tcp://127.0.0.1:5555

`train_state.py` writes the weights. The policy reads `observation.state`, which a robot measures,
and `privileged.task_state`, the simulator's ground truth: **no robot can measure that**, so this
policy works in the phantom only. Trained with `--forces`, it reads `observation.force`, too. It
answers each observation with a chunk of actions for the next steps.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import zipfile
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
FORMAT = "surg_bgr_policy/1"
STATE, TASK, ACTION = "observation.state", "privileged.task_state", "action"
ACTIONS = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
"""Columns of the actions: absolute targets."""
FORCE = "observation.force"
"""Forces at tip and trocar; a policy that was trained with `--forces` reads them, too."""
BESIDE = 8
"""Distance in nodes from the requested one to a resting one, which shows how far it was lifted."""
LAGS = (0, 4, 8, 16)
"""Steps back at which the slow features are sampled; they show when a state changed."""
WEIGHTS = "SURG_BGR_WEIGHTS"
"""Environment variable with the path of the weights, if the command line has none."""
ROBOT = "PSM1"
NODES = 36
"""Nodes of the bowel."""
SET = slice(5, 9)
"""Set-point of tip and roll in `observation.state`."""
PLACES, DISTANCE, HERE = slice(0, 9), 9, slice(-3, None)
"""Columns of the features: vectors from the last command to the requested node, the assistant and a
resting node; the length of the first; the last command."""
TENSION = 24
"""Column of the tissue's tension: an infinite scale hides it from a policy, see `train_state`."""
REACH = 0.02
"""The arm cannot be following a command farther than this from the set-point [m]."""


class Columns:
    """Finds columns by their names; no order is assumed.

    Args:
        state: Names of the numbers of `observation.state`.
        task: Names of the numbers of `privileged.task_state`.

    Raises:
        ValueError: A required name is missing.
    """

    def __init__(self, state: Sequence[str], task: Sequence[str]) -> None:
        self.state = state_columns(state)
        self.task = {
            name: _find(TASK, task, [name])[0]
            for name in ("target", "held", "assistant_held", "assistant_jaw", "tension", "visible")
        }
        for name in ("tip", "assistant_tip"):
            self.task[name] = _find(TASK, task, [f"{name}_{i}" for i in range(3)])
        flat = [f"nodes_{i}_{k}" for i in range(NODES) for k in range(3)]
        self.task["nodes"] = _find(TASK, task, flat)


def state_columns(names: Sequence[str]) -> np.ndarray:
    """Columns of tip, roll, jaw and set-point (`SET`) of the robot, (9,).

    Args:
        names: Of the numbers of `observation.state`.

    Raises:
        ValueError: One is missing.
    """
    wanted = [f"{ROBOT}/{n}" for n in ("tip_x", "tip_y", "tip_z", "roll", "jaw")]
    wanted += [f"{ROBOT}/{n}" for n in ("set_x", "set_y", "set_z", "roll_set")]
    return _find(STATE, names, wanted)


def force_columns(names: Sequence[str]) -> np.ndarray:
    """Columns of the robot's forces at tip and trocar, each with whether it is known, (8,).

    Raises:
        ValueError: One is missing.
    """
    wanted = [f"{ROBOT}/{p}_{n}" for p in ("tip", "trocar") for n in ("x", "y", "z", "known")]
    return _find(FORCE, names, wanted)


def _find(key: str, names: Sequence[str], wanted: Sequence[str]) -> np.ndarray:
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"{key} has no {', '.join(missing)}; it has {', '.join(names)[:200]}")
    return np.array([list(names).index(name) for name in wanted])


def features(
    columns: Columns,
    state: Array,
    task: Array,
    last: Array,
    X_RW: Array,
    force: Array | None = None,
) -> Array:
    """Inputs of the network at each of T successive steps of one episode.

    All are in the rcm frame: vectors from the last command to points, grasps as numbers, the slow
    features at earlier steps (`LAGS`). The origin is the last command: the set-point runs ahead of
    a moving stream, so "stay at the set-point" would make the arm drift.

    Args:
        columns: Of the observations.
        state: (T, 9) `observation.state`.
        task: (T, 148) `privileged.task_state`.
        last: (T, 4) tip and roll of the last command; at the first step, the set-point.
        X_RW: (4, 4) pose of the world in the rcm frame, see `world_in_rcm`.
        force: (T, 8) of `force_columns`; None: a policy without forces.

    Returns:
        (T, F). `PLACES` are vectors from the last command, the first one `DISTANCE` long; `HERE` is
        the last command.
    """
    s = state[:, columns.state]
    z = {name: task[:, index] for name, index in columns.task.items()}
    nodes = z["nodes"].reshape(len(task), NODES, 3)
    row, here = np.arange(len(task)), last[:, :3]
    i = np.clip(np.rint(z["target"]).astype(int), 1, NODES - 2)

    def to(p_W: np.ndarray) -> np.ndarray:
        return p_W @ X_RW[:3, :3].T + X_RW[:3, 3] - here

    along = (nodes[row, i + 1] - nodes[row, i - 1]) @ X_RW[:3, :3].T
    beside = nodes[row, np.minimum(i + BESIDE, NODES - 1)]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    target, helper = to(nodes[row, i]), to(z["assistant_tip"])
    held, assistant_held = (z[name] >= 0 for name in ("held", "assistant_held"))
    pointing = np.linalg.norm(helper - target, axis=1)
    # A held node moves with the jaws: it is no target.
    target[held], along[held], pointing[held] = 0.0, 0.0, 0.0
    now = [
        target,
        helper,
        to(beside),
        np.linalg.norm(target, axis=1),
        along,
        s[:, :3] - here,
        s[:, SET][:, :3] - here,
        s[:, [3, 4, 8]],
        last[:, 3],
        z["assistant_jaw"],
        z["tension"],
        z["visible"],
    ]
    slow = np.column_stack([held, assistant_held, pointing])
    felt = [] if force is None else [force]
    return np.column_stack([*now, *(slow[np.maximum(row - lag, 0)] for lag in LAGS), *felt, here])


def world_in_rcm(p_R: np.ndarray, p_W: np.ndarray) -> np.ndarray:
    """The rigid motion that best maps world points to the rcm frame (Kabsch 1976).

    Args:
        p_R: (N, 3) tip of `observation.state` [m].
        p_W: (N, 3) tip of `privileged.task_state` [m].

    Returns:
        (4, 4) X_RW.
    """
    middle_R, middle_W = p_R.mean(axis=0), p_W.mean(axis=0)
    U, _, Vt = np.linalg.svd((p_R - middle_R).T @ (p_W - middle_W))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, middle_R - R @ middle_W
    return X


class Network:
    """A multilayer perceptron with ReLU; weights (n_in, n_out) and biases, float32."""

    def __init__(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        self.layers = list(layers)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(T, n_in) to (T, n_out), both normalised."""
        for weight, bias in self.layers[:-1]:
            x = np.maximum(x @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        return x @ weight + bias


def weights_of(file: Path, form: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Head and arrays of a file of weights.

    Raises:
        ValueError: The file holds no weights of this format, or of another action space.
    """
    try:
        with np.load(file, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        head = json.loads(arrays.pop("head").tobytes())
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{file}: no weights of this policy ({error})") from None
    if not isinstance(head, dict) or head.get("format") != form:
        raise ValueError(f"{file}: its format is not {form}")
    said = head["names"].get(ACTION, ACTIONS)
    if said != ACTIONS:
        raise ValueError(
            f"{file}: trained on the actions {', '.join(said)}; allowed: {', '.join(ACTIONS)} "
            "(a dataset with absolute actions)"
        )
    return head, arrays


def write_weights(file: Path, head: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write what `weights_of` reads, without pickle; whole or not at all."""
    text = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    whole = file.with_name(f".{file.name}.partial")
    with whole.open("wb") as stream:
        np.savez(stream, head=text, **arrays)
    whole.replace(file)


class Policy:
    """A network with its scales, column names and provenance.

    Attributes:
        wants: Observation keys.
        chunk: Actions per answer, K.
        about: Dataset, options and losses of the training.
    """

    format = FORMAT
    trainer = "train_state.py"
    wants: tuple[str, ...] = (STATE, TASK)

    def __init__(
        self,
        network: Any,
        scales: Mapping[str, np.ndarray],
        names: Mapping[str, Sequence[str]],
        chunk: int,
        about: Mapping[str, Any],
    ) -> None:
        self.network, self.scales, self.chunk = network, dict(scales), chunk
        self.names = {key: list(value) for key, value in names.items()}
        self.about = dict(about)
        self._checked = False
        self._columns = self._find_columns()
        self._forces = force_columns(self.names[FORCE]) if FORCE in self.names else None
        if self._forces is not None:
            self.wants = (*type(self).wants, FORCE)
        self.reset()

    def shape_of(self, key: str) -> tuple[int, ...] | None:
        """Shape of an observation in the training; None: any."""
        del key
        return None

    def _find_columns(self) -> Any:
        """Columns of the observations.

        Raises:
            ValueError: A required column is missing.
        """
        return Columns(self.names[STATE], self.names[TASK])

    # --- weights on disk ----------------------------------------------------------------------

    def save(self, file: Path) -> None:
        """Write an .npz without pickle."""
        head = {
            "format": self.format,
            "names": self.names,
            "chunk": self.chunk,
            "about": self.about,
        }
        arrays = {f"scale_{name}": value for name, value in self.scales.items()}
        for i, (weight, bias) in enumerate(self.network.layers):
            arrays[f"weight_{i}"], arrays[f"bias_{i}"] = weight, bias
        write_weights(file, head, arrays)

    @classmethod
    def load(cls, file: Path) -> Policy:
        """Read weights.

        Raises:
            ValueError: The file holds no weights of this policy.
        """
        head, arrays = weights_of(file, cls.format)
        count = sum(name.startswith("weight_") for name in arrays)
        layers = [(arrays[f"weight_{i}"], arrays[f"bias_{i}"]) for i in range(count)]
        scales = {n[6:]: value for n, value in arrays.items() if n.startswith("scale_")}
        network = cls.network_of(layers, scales)
        return cls(network, scales, head["names"], head["chunk"], head["about"])

    @classmethod
    def network_of(
        cls, layers: Sequence[tuple[np.ndarray, np.ndarray]], scales: Mapping[str, np.ndarray]
    ) -> Any:
        """The network of a file's layers."""
        del scales
        return Network(layers)

    @property
    def hash(self) -> str:
        """SHA-256 over weights and scales; equal trainings give equal hashes."""
        found = hashlib.sha256()
        for array in [a for layer in self.network.layers for a in layer]:
            found.update(np.ascontiguousarray(array).tobytes())
        for name in sorted(self.scales):
            found.update(np.ascontiguousarray(self.scales[name]).tobytes())
        return found.hexdigest()

    # --- acting -------------------------------------------------------------------------------

    def reset(self, instruction: str = "", seed: int | None = None) -> None:
        """Forget the last episode. The policy is deterministic and knows one task."""
        del instruction, seed
        self._said: np.ndarray | None = None
        self._said_at: int | None = None
        self._count = self._asked = self._kept = 0
        self._past: deque[tuple[np.ndarray, ...]] = deque(maxlen=max(LAGS) + 1)

    def predict(self, inputs: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Chunks of actions for features.

        Args:
            inputs: (T, F) of `features`.
            last: (T, 4) tip and roll of the last command; actions are relative to it.

        Returns:
            (T, K, 5) tip [m], roll [rad], jaw [rad]; absolute.
        """
        scales = self.scales
        x = (inputs - scales["input_mean"]) / scales["input_std"]
        return self.actions(self.network(x.astype(np.float32)), last)

    def actions(self, outputs: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Actions from the network's outputs (T, n_out); see `predict`."""
        scales = self.scales
        y = outputs.astype(np.float64) * scales["output_std"] + scales["output_mean"]
        y = y.reshape(len(y), -1, 5)[:, : self.chunk]
        y[:, :, :4] += last[:, None, :]
        y[:, :, 4] = np.clip(y[:, :, 4], *scales["jaw_range"])
        return y

    def last_command(self, held: np.ndarray, observation: Any = None) -> np.ndarray:
        """Tip and roll of the command in force, (4,).

        Args:
            held: The set-point, (4,); used if no command was sent or the last one was refused.
            observation: Its grid time chooses the row of the last chunk: in real time a slow answer
                misses observations. Default: the first row.
        """
        if self._said is None:
            return held
        step, at = getattr(observation, "step", None), self._said_at
        row = 0 if step is None or at is None else min(max(step - at, 0), len(self._said) - 1)
        said: np.ndarray = self._said[row, :4]
        return held if np.linalg.norm(said[:3] - held[:3]) > REACH else said

    def say(self, chunk: np.ndarray, observation: Any) -> np.ndarray:
        """Remember a chunk (K, 5) as what the arm is told, and return it."""
        step = getattr(observation, "step", None)
        self._said, self._said_at = chunk, None if step is None else step + 1
        return chunk

    def goes_on(self, observation: Any) -> bool:
        """Whether the last chunk goes on: `_kept` of its steps are played from where it was asked.

        Otherwise a new one is asked for now; a policy that keeps to it sets `_kept`. Call it once
        for each observation. Without a grid time they are counted.
        """
        step = getattr(observation, "step", None)
        now = self._count if step is None else int(step)
        self._count = now + 1
        if self._said is not None and 0 <= now - self._asked < self._kept:
            if step is None:
                self._said = self._said[1:]  # its first row is the command in force
            return True
        self._asked, self._kept = now, 0
        return False

    def acknowledged(self, head: Mapping[str, Any]) -> None:
        """The server says what became of earlier steps: after a refusal the arm is at rest."""
        if head["rejected"]:
            self._said = None

    def see(self, observation: Any) -> Mapping[str, np.ndarray]:
        """The arrays of an observation, after a check that their columns are those of the training.

        Args:
            observation: A `surg_policy_client.Observation`, or arrays by key.

        Raises:
            ValueError: The columns differ, or their order does.
        """
        spec = getattr(observation, "spec", None)
        if spec is not None and not self._checked:
            for key in self.wants:
                served = list(spec.observation[key].names or ())
                if key in self.names and served != self.names[key]:
                    raise ValueError(
                        f"{key} is served as {', '.join(served)[:200]}; this policy was trained on "
                        f"{', '.join(self.names[key])[:200]}"
                    )
            self._checked = True
        return getattr(observation, "arrays", observation)

    def act(self, observation: Any) -> np.ndarray | None:
        """The next actions, (K, 5), from an observation (`surg_policy_client.Observation`).

        None: those of before go on. The server executes the first action of the chunk and asks
        again at the next step.
        """
        arrays = self.see(observation)
        state, task = (np.asarray(arrays[key], np.float64).ravel() for key in (STATE, TASK))
        last = self.last_command(state[self._columns.state][SET], observation)
        felt = (
            () if self._forces is None else (np.asarray(arrays[FORCE], np.float64)[self._forces],)
        )
        self._past.append((state, task, last, *felt))
        parts = [np.array([step[i] for step in self._past]) for i in range(3 + len(felt))]
        parts.insert(3, self.scales["X_RW"])
        inputs = features(self._columns, *parts)[-1:]
        return self.say(self.predict(inputs, last[None])[0], observation)


def wanted(policy: Policy) -> Any:
    """What the server has to serve, as a `surg_policy_client.Spec`; else it refuses the policy."""
    from surg_policy_client.spec import ActionSpec, Feature, Spec

    features = {
        key: Feature(
            names=tuple(policy.names[key]) if key in policy.names else None,
            shape=policy.shape_of(key),
        )
        for key in policy.wants
    }
    return Spec(observation=features, action=ActionSpec.of_space("absolute", [ROBOT]))


def serve(kind: type[Policy], about: str, words: Sequence[str] | None = None) -> int:
    """Command line of a policy: connect and answer until Ctrl-C.

    Args:
        kind: Class of the policy.
        about: One line of help.
        words: Of the command line.

    Returns:
        Exit status: 0 after Ctrl-C, 1 for a server that does not fit, 2 for wrong input.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--server", default="tcp://127.0.0.1:5555", help="address of the platform")
    parser.add_argument(
        "--weights",
        type=Path,
        default=os.environ.get(WEIGHTS),
        help=f"file of {kind.trainer} (default: environment variable {WEIGHTS})",
    )
    parser.add_argument("--keys", type=Path, help="folder of keys, if the server requires keys")
    options = parser.parse_args(words)
    if options.weights is None:
        parser.error(f"--weights FILE or {WEIGHTS} is required; {kind.trainer} writes the file")
    import surg_policy_client

    try:
        policy = kind.load(Path(options.weights))
    except (OSError, ValueError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    try:
        wants = wanted(policy)
        surg_policy_client.serve(policy, options.server, wants=wants, keys=options.keys)
    except surg_policy_client.PolicyClientError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(serve(Policy, (__doc__ or "").split("\n")[0]))
