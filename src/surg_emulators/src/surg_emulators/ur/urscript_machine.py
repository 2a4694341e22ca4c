"""Runs the threads of a URScript program, cycle by cycle.

A thread runs until it waits for a motion, `sync` or `sleep`; then the next one runs. Lists and
poses are values: an assignment copies them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from surg_emulators.ur.urscript_syntax import (
    Function,
    Node,
    ScriptError,
    UnknownName,
    called,
    constant,
    parse,
)
from surg_emulators.ur.urscript_threads import Builtin, Leave, Scope, Steps, Thread, Wait
from surg_emulators.ur.urscript_values import MOST_ELEMENTS, Pose, binary, copy, list_place

MOST_NODES = 20_000
"""A thread that executes more in one cycle has a loop without `sync`: the arm stops it too."""
MOST_CALLS, MOST_THREADS = 100, 50
LEAVING = {"break_loop": "break", "continue_loop": "continue"}


class Machine:
    """A running program.

    Args:
        script: URScript.
        builtins: Name -> function of the controller. A function that returns a `Wait` suspends
            its thread; the value of such a call is that of its `answer`, or None.

    Raises:
        ScriptError: The script cannot run on this controller.
    """

    def __init__(self, script: str, builtins: Mapping[str, Builtin]) -> None:
        main = parse(script)
        for name, place in called(main).items():
            if name not in builtins:
                raise UnknownName(name, *place)
        self.name = main.name
        self._builtins = builtins
        self._root = self._scope(main, None, {})
        self.threads = [Thread([self._root])]
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
            if not thread.alive:
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
        self._nodes = 0
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
        found = copy((yield from self._value(scope, value)))
        (scope.holder(name) or scope).values[name] = found

    def _store_local(self, scope: Scope, name: str, value: Node) -> Steps:
        scope.values[name] = copy((yield from self._value(scope, value)))

    def _store_global(self, scope: Scope, name: str, value: Node) -> Steps:
        self._root.values[name] = copy((yield from self._value(scope, value)))

    def _put(self, scope: Scope, name: str, *parts: Node) -> Steps:
        *places, value = yield from self._values(scope, parts)
        element = self._known(scope, name)
        for place in places[:-1]:
            element = element[list_place(place)]
        element[list_place(places[-1])] = copy(value)

    def _leave(self, scope: Scope, *value: Node) -> Steps:
        return Leave("return", (yield from self._value(scope, value[0])) if value else None)

    def _halt(self, scope: Scope) -> Steps:
        self.threads[0].calls.clear()
        yield None

    def _critical(self, scope: Scope) -> Steps:
        """Its beginning or end: no other thread runs before this one waits, in it or not."""
        yield None

    _enter_critical = _exit_critical = _critical

    def _kill(self, scope: Scope, thread: Node) -> Steps:
        victim = yield from self._value(scope, thread)
        if isinstance(victim, Thread):
            victim.calls.clear()
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
            left = binary(sign, left, (yield from self._value(scope, right)))
        return left

    _expression = _both = _comparison = _sum = _product = _operation

    def _negation(self, scope: Scope, value: Node) -> Steps:
        return not (yield from self._value(scope, value))

    def _negative(self, scope: Scope, value: Node) -> Steps:
        return -(yield from self._value(scope, value))

    def _list(self, scope: Scope, *nodes: Node) -> Steps:
        if len(nodes) > MOST_ELEMENTS:
            raise ScriptError(f"a list of more than {MOST_ELEMENTS} elements")
        return [copy(value) for value in (yield from self._values(scope, nodes))]

    def _index(self, scope: Scope, of: Node, *nodes: Node) -> Steps:
        """An element, or a pose: `p[...]` with six numbers."""
        if len(nodes) == 6 and of.data == "variable" and of.children[0] == "p":
            return Pose(float(value) for value in (yield from self._values(scope, nodes)))
        value, *places = yield from self._values(scope, (of, *nodes))
        for place in places:
            value = value[list_place(place)]
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
        return result.answer() if result.answer is not None else None

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
                named[str(name)] = copy((yield from self._value(scope, node)))
            else:
                values.append(copy((yield from self._value(scope, each))))
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
