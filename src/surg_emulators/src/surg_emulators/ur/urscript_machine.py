"""Runs the threads of a URScript program, cycle by cycle.

A thread runs until it waits for a motion, `sync` or `sleep`; then the next one runs. Lists and
poses are values: an assignment copies them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from surg_emulators.ur.urscript_syntax import Function, ScriptError, called, parse

MOST_INSTRUCTIONS = 20_000
"""A thread that executes more in one cycle has a loop without `sync`: the arm stops it too."""
INTEGERS = 2**31
MOST_FRAMES, MOST_THREADS, MOST_ELEMENTS = 100, 50, 10_000


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
    """Variables of one call."""

    function: Function
    outer: Scope | None
    values: dict[str, Any] = field(default_factory=dict)
    place: int = 0  # next instruction
    stack: list[Any] = field(default_factory=list)

    def holder(self, name: str) -> Scope | None:
        """The nearest scope that has a variable."""
        here: Scope | None = self
        while here is not None and name not in here.values:
            here = here.outer
        return here


@dataclass
class Thread:
    """One thread of a program."""

    frames: list[Scope]
    wait: Wait | None = None

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return bool(self.frames)

    @property
    def line(self) -> int:
        """Line of the script that it is in."""
        if not self.frames:
            return 0
        scope = self.frames[-1]
        return scope.function.lines[min(scope.place, len(scope.function.lines)) - 1]


Builtin = Callable[..., Any]


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
        self._root = Scope(main, None)
        self.threads = [Thread([self._root])]
        self._critical: Thread | None = None

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
            self._run(thread)
            if not self.running:
                return
        self.threads = [self.threads[0], *(t for t in self.threads[1:] if t.alive)]

    def _run(self, thread: Thread) -> None:
        for _ in range(MOST_INSTRUCTIONS):
            if thread.wait is not None or not thread.alive:
                return
            scope = thread.frames[-1]
            if scope.place >= len(scope.function.code):  # the main program's end
                thread.frames.clear()
                return
            instruction = scope.function.code[scope.place]
            scope.place += 1
            try:
                _EXECUTE[instruction[0]](self, thread, scope, *instruction[1:])
            except ScriptError as error:
                raise ScriptError(f"line {thread.line}: {error}") from error
            except (TypeError, ValueError, IndexError, ArithmeticError, RecursionError) as error:
                raise ScriptError(f"line {thread.line}: {error}") from error
        raise ScriptError(f"line {thread.line}: an infinite loop without sync()")

    # Instructions ----------------------------------------------------------------------------

    def _push(self, thread: Thread, scope: Scope, value: Any) -> None:
        scope.stack.append(value)

    def _pop(self, thread: Thread, scope: Scope) -> None:
        scope.stack.pop()

    def _load(self, thread: Thread, scope: Scope, name: str) -> None:
        holder = scope.holder(name)
        if holder is None:
            raise ScriptError(f"variable {name!r} has no value")
        scope.stack.append(holder.values[name])

    def _store(self, thread: Thread, scope: Scope, name: str) -> None:
        (scope.holder(name) or scope).values[name] = _copy(scope.stack.pop())

    def _local(self, thread: Thread, scope: Scope, name: str) -> None:
        scope.values[name] = _copy(scope.stack.pop())

    def _global(self, thread: Thread, scope: Scope, name: str) -> None:
        self._root.values[name] = _copy(scope.stack.pop())

    def _put(self, thread: Thread, scope: Scope, name: str, count: int) -> None:
        value = _copy(scope.stack.pop())
        places = [scope.stack.pop() for _ in range(count)][::-1]
        holder = scope.holder(name)
        if holder is None:
            raise ScriptError(f"variable {name!r} has no value")
        element = holder.values[name]
        for place in places[:-1]:
            element = element[_place(place)]
        element[_place(places[-1])] = value

    def _index(self, thread: Thread, scope: Scope, count: int) -> None:
        places = [scope.stack.pop() for _ in range(count)][::-1]
        value = scope.stack.pop()
        for place in places:
            value = value[_place(place)]
        scope.stack.append(value)

    def _list(self, thread: Thread, scope: Scope, count: int) -> None:
        if count > MOST_ELEMENTS:
            raise ScriptError(f"a list of more than {MOST_ELEMENTS} elements")
        start = len(scope.stack) - count
        scope.stack[start:] = [[_copy(value) for value in scope.stack[start:]]]

    def _pose(self, thread: Thread, scope: Scope) -> None:
        scope.stack[-6:] = [Pose(float(value) for value in scope.stack[-6:])]

    def _binary(self, thread: Thread, scope: Scope, sign: str) -> None:
        right, left = scope.stack.pop(), scope.stack.pop()
        if isinstance(left, str) or isinstance(right, str):
            if sign not in ("==", "!="):
                raise ScriptError(f"{sign!r} of a text")
        elif isinstance(left, list) and sign in ("+", "-"):
            scope.stack.append(_elementwise(sign, left, right))
            return
        value = _BINARY[sign](left, right)
        if type(value) is int and not -INTEGERS <= value < INTEGERS:
            raise ScriptError(f"integer {left} {sign} {right} overflows")
        scope.stack.append(value)

    def _negate(self, thread: Thread, scope: Scope) -> None:
        scope.stack.append(-scope.stack.pop())

    def _not(self, thread: Thread, scope: Scope) -> None:
        scope.stack.append(not scope.stack.pop())

    def _jump(self, thread: Thread, scope: Scope, target: int) -> None:
        scope.place = target

    def _unless(self, thread: Thread, scope: Scope, target: int) -> None:
        if not scope.stack.pop():
            scope.place = target

    def _keep(self, thread: Thread, scope: Scope, sign: str, target: int) -> None:
        """`and`, `or`: the left side may decide."""
        if bool(scope.stack[-1]) == (sign == "or"):
            scope.place = target

    def _return(self, thread: Thread, scope: Scope) -> None:
        value = scope.stack.pop()
        thread.frames.pop()
        if thread.frames:
            thread.frames[-1].stack.append(value)

    def _halt(self, thread: Thread, scope: Scope) -> None:
        self.threads[0].frames.clear()

    def _enter(self, thread: Thread, scope: Scope) -> None:
        self._critical = thread

    def _exit(self, thread: Thread, scope: Scope) -> None:
        self._critical = None

    def _arguments(
        self, scope: Scope, count: int, names: tuple[str, ...]
    ) -> tuple[list[Any], dict[str, Any]]:
        start = len(scope.stack) - count - len(names)
        values = [_copy(value) for value in scope.stack[start:]]
        del scope.stack[start:]
        return values[:count], dict(zip(names, values[count:], strict=True))

    def _enclosing(self, scope: Scope, function: Function) -> Scope | None:
        """The scope in which a function's free variables are looked up."""
        here: Scope | None = scope
        while here is not None and here.function is not function.outer:
            here = here.outer
        return here

    def _new_frame(
        self, scope: Scope, name: str, count: int, names: tuple[str, ...]
    ) -> Scope | None:
        """The frame of a call of a function of the script; None: it is a builtin's name."""
        function = scope.function.find(name)
        if function is None:
            return None
        values, named = self._arguments(scope, count, names)
        if len(values) > len(function.parameters):
            raise ScriptError(f"{name} takes {len(function.parameters)} arguments")
        given = function.defaults | dict(zip(function.parameters, values, strict=False)) | named
        if set(given) != set(function.parameters):
            raise ScriptError(f"{name} takes the arguments {', '.join(function.parameters)}")
        return Scope(function, self._enclosing(scope, function), given)

    def _call(
        self, thread: Thread, scope: Scope, name: str, count: int, names: tuple[str, ...]
    ) -> None:
        frame = self._new_frame(scope, name, count, names)
        if frame is not None:
            if len(thread.frames) >= MOST_FRAMES:
                raise ScriptError(f"more than {MOST_FRAMES} calls inside one another")
            thread.frames.append(frame)
            return
        values, named = self._arguments(scope, count, names)
        try:
            result = self._builtins[name](*values, **named)
        except TypeError as error:
            raise ScriptError(f"{name}: {str(error).partition('() ')[2] or error}") from error
        if isinstance(result, Wait):
            self._suspend(thread, result)
            result = None
        scope.stack.append(result)

    def _suspend(self, thread: Thread, wait: Wait) -> None:
        if wait.motion:
            for other in self.threads:
                if other is not thread and other.alive and other.wait and other.wait.motion:
                    raise ScriptError("another thread is already controlling the robot")
        thread.wait = wait

    def _start(
        self, thread: Thread, scope: Scope, name: str, count: int, names: tuple[str, ...]
    ) -> None:
        frame = self._new_frame(scope, name, count, names)
        if frame is None:
            raise ScriptError(f"{name!r} is no thread of this program")
        if len(self.threads) >= MOST_THREADS:
            raise ScriptError(f"more than {MOST_THREADS} threads")
        started = Thread([frame], Wait(1))
        self.threads.append(started)
        scope.stack.append(started)

    def _kill(self, thread: Thread, scope: Scope) -> None:
        victim = scope.stack.pop()
        if isinstance(victim, Thread):
            victim.frames.clear()
            if self._critical is victim:
                self._critical = None

    def _join(self, thread: Thread, scope: Scope) -> None:
        awaited = scope.stack.pop()
        if isinstance(awaited, Thread):
            thread.wait = Wait(1, lambda: not awaited.alive)


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
_EXECUTE: dict[str, Callable[..., None]] = {
    "push": Machine._push,
    "pop": Machine._pop,
    "load": Machine._load,
    "store": Machine._store,
    "local": Machine._local,
    "global": Machine._global,
    "put": Machine._put,
    "index": Machine._index,
    "list": Machine._list,
    "pose": Machine._pose,
    "binary": Machine._binary,
    "negate": Machine._negate,
    "not": Machine._not,
    "jump": Machine._jump,
    "unless": Machine._unless,
    "keep": Machine._keep,
    "return": Machine._return,
    "halt": Machine._halt,
    "enter_critical": Machine._enter,
    "exit_critical": Machine._exit,
    "call": Machine._call,
    "run": Machine._start,
    "kill": Machine._kill,
    "join": Machine._join,
}
