"""Selects episodes by an expression: ``success and setting == "ex_vivo"``.

The expression is parsed, never executed: names of facts, texts, numbers, lists, comparisons,
``and``, ``or``, ``not``. A fact that an episode does not state is ``None``.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.labels import KEY
from surg_recording.episode.verdicts import verdict

MAX_LENGTH, MAX_PARTS = 1000, 200
"""Characters and parts of an expression."""

FACTS = {
    "success": "the verdict: True, False, or None (nobody judged)",
    "judged_by": '"person", "task" or None',
    "labelled": "True: labelled by ./surg episode label",
    "complete": "True: nothing was lost",
    **dict.fromkeys(("task", "setting", "robot", "law", "operator", "mode"), "a text"),
    "seed": "a number",
    "simulated": "True: by the simulator",
    "duration": "of the recording [s]",
    "tags": 'texts: "slip" in tags',
    "stages": 'names: "grasp" in stages',
    "cameras": "names",
    "arms": "names",
    "note": "text of the label",
    "folder": "name of the episode's folder",
    "created": 'UTC: created >= "2026-11-01"',
}
"""Names in an expression, with their meaning."""

_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: lambda a, b: a is b or a == b,
    ast.IsNot: lambda a, b: not (a is b or a == b),
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_ORDERED = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


class SelectionError(ValueError):
    """An expression that is not allowed; the message names its part and what is allowed."""


class Selection:
    """A parsed expression.

    Raises:
        SelectionError: It is none, too long, or holds what is not allowed.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > MAX_LENGTH:
            raise SelectionError(f"{len(text)} characters; at most {MAX_LENGTH} are allowed")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
            said = problem.msg if isinstance(problem, SyntaxError) else problem
            raise SelectionError(f"{text!r}: {said}; e.g. {EXAMPLE}") from None
        if sum(1 for _ in ast.walk(self._tree)) > MAX_PARTS:
            raise SelectionError(f"more than {MAX_PARTS} parts")
        self._check(self._tree)

    def matches(self, recorded: Episode) -> bool:
        """Whether an episode fits; a SelectionError if the comparison makes no sense."""
        return bool(self._value(self._tree, facts(recorded)))

    def _check(self, node: ast.AST) -> None:
        """Refuse everything but the parts that ``_value`` knows."""
        if isinstance(node, ast.Name):
            if node.id not in FACTS:
                raise SelectionError(f"no fact {node.id!r}; there are {', '.join(FACTS)}")
            return
        if isinstance(node, ast.Constant):
            if not isinstance(node.value, str | int | float | bool | None):
                raise SelectionError(f"{node.value!r} is not allowed")
            return
        if isinstance(node, ast.BoolOp):
            inner: list[ast.AST] = list(node.values)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
            inner = [node.operand]
        elif isinstance(node, ast.Compare):
            inner = [node.left, *node.comparators]
        elif isinstance(node, ast.List | ast.Tuple):
            inner = list(node.elts)
        else:
            said = ast.unparse(node)[:60]
            raise SelectionError(
                f"{said!r} is not allowed; allowed are facts, texts, numbers, lists, comparisons,"
                " in, and, or, not"
            )
        for each in inner:
            self._check(each)

    def _value(self, node: ast.AST, known: Mapping[str, Any]) -> Any:
        if isinstance(node, ast.Name):
            return known[node.id]
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.BoolOp):
            both = isinstance(node.op, ast.And)
            values = (bool(self._value(each, known)) for each in node.values)
            return all(values) if both else any(values)
        if isinstance(node, ast.UnaryOp):
            value = self._value(node.operand, known)
            return not value if isinstance(node.op, ast.Not) else self._negative(node, value)
        if isinstance(node, ast.List | ast.Tuple):
            return [self._value(each, known) for each in node.elts]
        assert isinstance(node, ast.Compare)
        left = self._value(node.left, known)
        for sign, right_node in zip(node.ops, node.comparators, strict=True):
            right = self._value(right_node, known)
            if not self._compare(node, sign, left, right):
                return False
            left = right
        return True

    def _compare(self, node: ast.Compare, sign: ast.cmpop, left: Any, right: Any) -> bool:
        if isinstance(sign, _ORDERED) and (left is None or right is None):
            return False  # a fact that is not stated is neither less nor more
        if isinstance(sign, ast.In | ast.NotIn) and right is None:
            right = ""
        try:
            return bool(_COMPARE[type(sign)](left, right))
        except TypeError as problem:
            raise SelectionError(f"{ast.unparse(node)}: {problem}") from None

    def _negative(self, node: ast.UnaryOp, value: Any) -> Any:
        if not isinstance(value, int | float):
            raise SelectionError(f"{ast.unparse(node)}: {value!r} has no negative")
        return -value


EXAMPLE = 'success and setting == "ex_vivo"'


def facts(recorded: Episode) -> dict[str, Any]:
    """The facts of an episode that an expression may name."""
    manifest = recorded.manifest
    run, labels = manifest.get("run") or {}, manifest.get(KEY) or {}
    judged = verdict(manifest)
    robot = run.get("robot") or next(iter(_robots(manifest)), None)
    return {
        "success": judged.success,
        "judged_by": judged.by,
        "labelled": bool(labels),
        "complete": recorded.complete,
        "task": manifest.get("task") or run.get("task") or run.get("motion"),
        "robot": robot,
        **{key: run.get(key) or manifest.get(key) for key in ("setting", "operator")},
        "law": run.get("law"),
        "mode": manifest.get("mode"),
        "seed": manifest.get("seed", run.get("seed")),
        "simulated": bool(manifest.get("sim")),
        "duration": _duration_s(manifest),
        "tags": [t.get("text") if isinstance(t, dict) else t for t in recorded.tags],
        "stages": [stage.get("name") for stage in recorded.stages],
        "cameras": recorded.cameras,
        "arms": recorded.arms,
        "note": labels.get("note", ""),
        "folder": recorded.folder.name,
        "created": manifest.get("created"),
    }


def _robots(manifest: Mapping[str, Any]) -> list[str]:
    arms = ((manifest.get("cell") or {}).get("arms") or {}).values()
    names = [(arm.get("robot") or {}).get("name") for arm in arms]
    return [name for name in names if name]


def _duration_s(manifest: Mapping[str, Any]) -> float | None:
    """Of the longest table of control cycles [s]."""
    spans = [
        (entry["last_stamp_ns"] - entry["first_stamp_ns"]) * 1e-9
        for name, entry in manifest["tables"].items()
        if name.startswith("cycle_") and entry.get("first_stamp_ns") is not None
    ]
    return max(spans, default=None)
