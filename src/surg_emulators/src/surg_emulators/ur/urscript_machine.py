"""Runs the threads of a URScript program, cycle by cycle.

A thread runs until it waits for a motion, `sync` or `sleep`; then the next one runs. Lists and
poses are values: an assignment copies them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from surg_emulators.ur.urscript_syntax import Function, Node, ScriptError, called, constant, parse

MOST_NODES = 20_000
"""A thread that executes more in one cycle has a loop without `sync`: the arm stops it too."""
INTEGERS = 2**31
MOST_CALLS, MOST_THREADS, MOST_ELEMENTS = 100, 50, 10_000


class Pose(list[float]):
    """Position [m] and rotation vector [rad]."""


@dataclass
class Wait:
    """What a function returns to let its thread wait.

    Attributes:
        cycles: Cycles to wait.
        until: Ends the wait when it returns True; asked once per cycle after `cycles`.
        motion: Whether the thread controls the motion meanwhile.
    """

    cycles: int = 1
    until: Callable[[], bool] | None = None
    motion: bool = False

    def over(self) -> bool:
        """Count one cycle; whether the thread goes on in it."""
        self.cycles -= 1
        return self.cycles <= 0 and (self.until is None or self.until())


@dataclass
class Scope:
    """Variables of one call, and the call itself."""

    function: Function
    outer: Scope | None
    values: dict[str, Any] = field(default_factory=dict)
    line: int = 0  # of the statement that it is in
    run: Steps | None = None

    def holder(self, name: str) -> Scope | None:
        """The nearest scope that has a variable."""
        here: Scope | None = self
        while here is not None and name not in here.values:
            here = here.outer
        return here


@dataclass
class Thread:
    """One thread of a program: its calls, the innermost last."""

    calls: list[Scope]
    wait: Wait | None = None
    answer: Any = None  # of the call that has ended

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return bool(self.calls)

    @property
    def line(self) -> int:
        """Line of the script that it is in."""
        return self.calls[-1].line if self.calls else 0


@dataclass(frozen=True)
class Leave:
    """Why a block was left before its end: `break`, `continue` or `return` with a value."""

    how: str
    value: Any = None


LEAVING = {"break_loop": "break", "continue_loop": "continue"}

Builtin = Callable[..., Any]
Steps = Generator["Scope | Wait | None", Any, Any]
"""A piece of a program under way. It yields the call or the wait that it needs; None: its thread
may have been killed."""


class Machine:
    """A running program.

    Args:
        script: URScript.
        builtins: Name -> function of the controller. A function that returns a `Wait` suspends
            its thread; the value of such a call is None.

    Raises:
        ScriptError: The script cannot run on this controller.
    """

    def __init__(self, script: str, builtins: Mapping[str, Builtin]) -> None:
        main = parse(script)
        for name, line in called(main).items():
            if name not in builtins:
                raise ScriptError(f"line {line}: function {name!r} is not known")
        self.name = main.name
        self._builtins = builtins
        self._root = self._scope(main, None, {})
        self.threads = [Thread([self._root])]
        self._now = self.threads[0]
        self._critical: Thread | None = None
        self._nodes = 0

    @property
    def running(self) -> bool:
        """Whether the main thread has not ended."""
        return self.threads[0].alive

    def cycle(self) -> None:
        """Run every thread until it waits.

        Raises:
            ScriptError: A thread did what the controller refuses; the program must end.
        """
        for thread in list(self.threads):
            if not thread.alive or (self._critical not in (None, thread)):
                continue
            if thread.wait is not None:
                if not thread.wait.over():
                    continue
                thread.wait = None
            try:
                self._run(thread)
            except (
                ScriptError, TypeError, ValueError, IndexError, ArithmeticError, RecursionError,
            ) as error:  # fmt: skip
                raise ScriptError(f"line {thread.line}: {error}") from error
            if not self.running:
                return
        self.threads = [self.threads[0], *(t for t in self.threads[1:] if t.alive)]

    def _run(self, thread: Thread) -> None:
        self._now, self._nodes = thread, 0
        while thread.calls and thread.wait is None:
            steps = thread.calls[-1].run
            assert steps is not None
            answer, thread.answer = thread.answer, None
            try:
                asked = steps.send(answer)
            except StopIteration as end:
                thread.calls.pop()
                thread.answer = end.value
                continue
            if isinstance(asked, Wait):
                self._suspend(thread, asked)
            elif asked is not None:
                if len(thread.calls) >= MOST_CALLS:
                    raise ScriptError(f"more than {MOST_CALLS} calls inside one another")
                thread.calls.append(asked)

    def _suspend(self, thread: Thread, wait: Wait) -> None:
        if wait.motion:
            for other in self.threads:
                if other is not thread and other.alive and other.wait and other.wait.motion:
                    raise ScriptError("another thread is already controlling the robot")
        thread.wait = wait

    def _scope(self, function: Function, outer: Scope | None, values: dict[str, Any]) -> Scope:
        scope = Scope(function, outer, values)
        scope.run = self._body(scope)
        return scope

    def _body(self, scope: Scope) -> Steps:
        left = yield from self._block(scope, scope.function.body)
        return None if left is None else left.value

    # Statements ------------------------------------------------------------------------------

    def _block(self, scope: Scope, block: Node) -> Steps:
        """Statements up to the end, or to what leaves the block: a `Leave`."""
        for each in block.children:
            if each.data == "definition":
                continue
            if each.data in LEAVING:
                return Leave(LEAVING[each.data])
            scope.line = each.meta.line
            left = yield from getattr(self, f"_{each.data}")(scope, *each.children)
            if isinstance(left, Leave):
                return left
        return None

    def _loop(self, scope: Scope, condition: Node, block: Node) -> Steps:
        line = scope.line
        while (yield from self._value(scope, condition)):
            left = yield from self._block(scope, block)
            if left is not None and left.how != "continue":
                return None if left.how == "break" else left
            scope.line = line
        return None

    def _condition(self, scope: Scope, *parts: Node) -> Steps:
        *branches, last = [parts[n : n + 2] for n in range(0, len(parts), 2)]
        for condition, block in [*branches, last] if len(last) == 2 else branches:
            if (yield from self._value(scope, condition)):
                return (yield from self._block(scope, block))
        return (yield from self._block(scope, last[0])) if len(last) == 1 else None

    def _store(self, scope: Scope, name: str, value: Node) -> Steps:
        found = _copy((yield from self._value(scope, value)))
        (scope.holder(name) or scope).values[name] = found

    def _store_local(self, scope: Scope, name: str, value: Node) -> Steps:
        scope.values[name] = _copy((yield from self._value(scope, value)))

    def _store_global(self, scope: Scope, name: str, value: Node) -> Steps:
        self._root.values[name] = _copy((yield from self._value(scope, value)))

    def _put(self, scope: Scope, name: str, *parts: Node) -> Steps:
        *places, value = yield from self._values(scope, parts)
        element = self._known(scope, name)
        for place in places[:-1]:
            element = element[_place(place)]
        element[_place(places[-1])] = _copy(value)

    def _leave(self, scope: Scope, *value: Node) -> Steps:
        return Leave("return", (yield from self._value(scope, value[0])) if value else None)

    def _halt(self, scope: Scope) -> Steps:
        self.threads[0].calls.clear()
        yield None

    def _enter_critical(self, scope: Scope) -> Steps:
        self._critical = self._now
        yield None

    def _exit_critical(self, scope: Scope) -> Steps:
        self._critical = None
        yield None

    def _kill(self, scope: Scope, thread: Node) -> Steps:
        victim = yield from self._value(scope, thread)
        if isinstance(victim, Thread):
            victim.calls.clear()
            if self._critical is victim:
                self._critical = None
        yield None

    def _join(self, scope: Scope, thread: Node) -> Steps:
        awaited = yield from self._value(scope, thread)
        if isinstance(awaited, Thread):
            yield Wait(1, lambda: not awaited.alive)

    def _alone(self, scope: Scope, value: Node) -> Steps:
        yield from self._value(scope, value)

    # Values ----------------------------------------------------------------------------------

    def _value(self, scope: Scope, node: Node) -> Steps:
        self._nodes += 1
        if self._nodes > MOST_NODES:
            raise ScriptError("an infinite loop without sync()")
        if node.data in ("number", "text", "true", "false"):
            return constant(node)
        if node.data == "variable":
            return self._known(scope, node.children[0])
        return (yield from getattr(self, f"_{node.data}")(scope, *node.children))

    def _values(self, scope: Scope, nodes: Sequence[Node]) -> Steps:
        found = []
        for each in nodes:
            found.append((yield from self._value(scope, each)))
        return found

    def _known(self, scope: Scope, name: str) -> Any:
        holder = scope.holder(name)
        if holder is None:
            raise ScriptError(f"variable '{name}' has no value")
        return holder.values[name]

    def _bracket(self, scope: Scope, value: Node) -> Steps:
        return (yield from self._value(scope, value))

    def _operation(self, scope: Scope, first: Node, *rest: Any) -> Steps:
        left = yield from self._value(scope, first)
        for sign, right in zip(rest[::2], rest[1::2], strict=True):
            if sign in ("and", "or") and bool(left) == (sign == "or"):
                continue  # the left side decides
            left = _binary(sign, left, (yield from self._value(scope, right)))
        return left

    _expression = _both = _comparison = _sum = _product = _operation

    def _negation(self, scope: Scope, value: Node) -> Steps:
        return not (yield from self._value(scope, value))

    def _negative(self, scope: Scope, value: Node) -> Steps:
        return -(yield from self._value(scope, value))

    def _list(self, scope: Scope, *nodes: Node) -> Steps:
        if len(nodes) > MOST_ELEMENTS:
            raise ScriptError(f"a list of more than {MOST_ELEMENTS} elements")
        return [_copy(value) for value in (yield from self._values(scope, nodes))]

    def _index(self, scope: Scope, of: Node, *nodes: Node) -> Steps:
        """An element, or a pose: `p[...]` with six numbers."""
        if len(nodes) == 6 and of.data == "variable" and of.children[0] == "p":
            return Pose(float(value) for value in (yield from self._values(scope, nodes)))
        value, *places = yield from self._values(scope, (of, *nodes))
        for place in places:
            value = value[_place(place)]
        return value

    def _call(self, scope: Scope, name: str, *nodes: Node) -> Steps:
        values, named = yield from self._arguments(scope, nodes)
        frame = self._frame(scope, name, values, named)
        if frame is not None:
            return (yield frame)
        try:
            result = self._builtins[name](*values, **named)
        except TypeError as error:
            raise ScriptError(f"{name}: {str(error).partition('() ')[2] or error}") from error
        if not isinstance(result, Wait):
            return result
        yield result
        return None

    def _start_thread(self, scope: Scope, name: str, *nodes: Node) -> Steps:
        values, named = yield from self._arguments(scope, nodes)
        frame = self._frame(scope, name, values, named)
        if frame is None:
            raise ScriptError(f"'{name}' is no thread of this program")
        if len(self.threads) >= MOST_THREADS:
            raise ScriptError(f"more than {MOST_THREADS} threads")
        started = Thread([frame], Wait(1))
        self.threads.append(started)
        return started

    def _arguments(self, scope: Scope, nodes: Sequence[Node]) -> Steps:
        """Values of a call, and those with a name."""
        values, named = [], {}
        for each in nodes:
            if each.data == "named":
                name, node = each.children
                named[str(name)] = _copy((yield from self._value(scope, node)))
            else:
                values.append(_copy((yield from self._value(scope, each))))
        return values, named

    def _frame(
        self, scope: Scope, name: str, values: list[Any], named: dict[str, Any]
    ) -> Scope | None:
        """A call of a function of the script; None: it is a builtin's name."""
        function = scope.function.find(name)
        if function is None:
            return None
        if len(values) > len(function.parameters):
            raise ScriptError(f"{name} takes {len(function.parameters)} arguments")
        given = function.defaults | dict(zip(function.parameters, values, strict=False)) | named
        if set(given) != set(function.parameters):
            raise ScriptError(f"{name} takes the arguments {', '.join(function.parameters)}")
        outer: Scope | None = scope
        while outer is not None and outer.function is not function.outer:
            outer = outer.outer
        return self._scope(function, outer, given)


def _binary(sign: str, left: Any, right: Any) -> Any:
    if isinstance(left, str) or isinstance(right, str):
        if sign not in ("==", "!="):
            raise ScriptError(f"{sign!r} of a text")
    elif isinstance(left, list) and sign in ("+", "-"):
        return _elementwise(sign, left, right)
    value = _BINARY[sign](left, right)
    if type(value) is int and not -INTEGERS <= value < INTEGERS:
        raise ScriptError(f"integer {left} {sign} {right} overflows")
    return value


def _copy(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    if _size(value) > MOST_ELEMENTS:
        raise ScriptError(f"a list of more than {MOST_ELEMENTS} elements")
    return type(value)(_copy(each) for each in value)


def _size(value: Any) -> int:
    """Elements of a list and of those in it; stops counting when there are too many."""
    count, left = 0, [value]
    while left and count <= MOST_ELEMENTS:
        here = left.pop()
        count += len(here)
        left += [each for each in here if isinstance(each, list)]
    return count


def _place(value: Any) -> int:
    if isinstance(value, bool) or int(value) != value or value < 0:
        raise ScriptError(f"index {value!r}: not a number from 0")
    return int(value)


def _elementwise(sign: str, left: list[Any], right: list[Any]) -> list[Any]:
    if not isinstance(right, list) or len(left) != len(right):
        raise ScriptError(f"{sign!r} of lists of different lengths")
    return type(left)(_BINARY[sign](a, b) for a, b in zip(left, right, strict=True))


_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
    "and": lambda a, b: bool(a) and bool(b),
    "or": lambda a, b: bool(a) or bool(b),
    "xor": lambda a, b: bool(a) != bool(b),
}
