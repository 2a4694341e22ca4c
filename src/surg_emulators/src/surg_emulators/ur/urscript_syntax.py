"""URScript to instructions of a small stack machine.

The subset: `def`, `thread`, `sec`, `while`, `if`/`elif`/`else`, `return`, `break`, `continue`,
`halt`, `global`, `local`, assignments, lists, poses, indices, calls with named arguments, `run`,
`join`, `kill`, `enter_critical`, `exit_critical`. A new line is a space. Not known: `struct`,
`switch`, `for`, text with escapes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

MOST_NESTING = 60
TOKEN = re.compile(
    r"(?P<number>0x[0-9a-fA-F]+|\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?)"
    r'|(?P<name>[A-Za-z_]\w*)|(?P<text>"[^"\n]*"|\'[^\'\n]*\')'
    r"|(?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:.])|(?P<space>[ \t\r]+)|(?P<wrong>.)"
)
_RESERVED = (
    "def thread sec while if elif else end return break continue halt global local run join kill "
    "and or xor not True False enter_critical exit_critical"
)
KEYWORDS = frozenset(_RESERVED.split())
VALUES = frozenset({"True", "False", "not", "run"})
"""Keywords with which an expression can begin."""
LEVELS = (
    ("or", "xor"),
    ("and",),
    ("not",),
    ("==", "!=", "<", ">", "<=", ">="),
    ("+", "-"),
    ("*", "/", "%"),
)
"""Operators, from those that bind least."""

Instruction = tuple[Any, ...]


class ScriptError(Exception):
    """A script that the controller refuses or stops; states line and reason."""


@dataclass
class Function:
    """A function or thread of a program.

    Attributes:
        name: Its name.
        parameters: Names of its parameters.
        defaults: Parameter -> value, for those that may be left out.
        code: Its instructions; the first word of each names it.
        lines: Line of the script for each instruction.
        inner: Functions defined in it, by name.
        outer: Function in which it is defined.
    """

    name: str
    parameters: tuple[str, ...] = ()
    defaults: dict[str, Any] = field(default_factory=dict)
    code: list[Instruction] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    inner: dict[str, Function] = field(default_factory=dict)
    outer: Function | None = None

    def find(self, name: str) -> Function | None:
        """The function that a name means here."""
        here: Function | None = self
        while here is not None:
            if name in here.inner:
                return here.inner[name]
            here = here.outer
        return None


@dataclass(frozen=True)
class Token:
    """One word of a script."""

    kind: str  # number, name, text, sign, finish
    text: str
    line: int


def tokens(script: str) -> list[Token]:
    """Words of a script; comments and line numbers of the pendant (`$ 3 "..."`) are left out."""
    found: list[Token] = []
    for number, line in enumerate(script.split("\n"), 1):
        if line.lstrip().startswith("$"):
            continue
        place = 0
        while place < len(line) and line[place] != "#":
            match = TOKEN.match(line, place)
            assert match is not None and match.lastgroup is not None  # `wrong` takes the rest
            if match.lastgroup == "wrong":
                raise ScriptError(f"line {number}: unexpected {match.group()!r}")
            if match.lastgroup != "space":
                found.append(Token(match.lastgroup, match.group(), number))
            place = match.end()
    return [*found, Token("finish", "end of script", script.count("\n") + 1)]


def parse(script: str) -> Function:
    """The main function of a program.

    Raises:
        ScriptError: The script is not in the subset.
    """
    parser = _Parser(tokens(script))
    root = Function("")
    parser.block(root, ("finish",))
    if root.code:
        return root
    if len(root.inner) != 1:
        raise ScriptError(f"{len(root.inner)} programs in one script; one def ... end is allowed")
    return next(iter(root.inner.values()))


def called(function: Function) -> dict[str, int]:
    """Names that a function and those in it call -> the first line."""
    found: dict[str, int] = {}
    for instruction, line in zip(function.code, function.lines, strict=True):
        if instruction[0] in ("call", "run") and function.find(instruction[1]) is None:
            found.setdefault(instruction[1], line)
    for each in function.inner.values():
        found = called(each) | found
    return found


class _Parser:
    """Recursive descent; writes instructions into the function that it is in."""

    def __init__(self, words: list[Token]) -> None:
        self.words, self.place, self.depth = words, 0, 0
        self.loops: list[tuple[int, list[int]]] = []

    # Words -----------------------------------------------------------------------------------

    @property
    def now(self) -> Token:
        return self.words[self.place]

    def next(self) -> Token:
        token = self.now
        if token.kind != "finish":
            self.place += 1
        return token

    def accept(self, *texts: str) -> str:
        """Take the next word if it is one of these; what it was, or an empty text."""
        if self.now.text in texts and self.now.kind in ("name", "sign"):
            return self.next().text
        return ""

    def expect(self, text: str) -> None:
        if not self.accept(text):
            raise self.error(f"expected {text!r}")

    def name(self) -> str:
        token = self.next()
        if token.kind != "name" or token.text in KEYWORDS:
            raise ScriptError(f"line {token.line}: expected a name, not {token.text!r}")
        return token.text

    def error(self, why: str) -> ScriptError:
        return ScriptError(f"line {self.now.line}: {why}, not {self.now.text!r}")

    def emit(self, function: Function, *instruction: Any) -> int:
        function.code.append(instruction)
        function.lines.append(self.words[max(self.place - 1, 0)].line)
        return len(function.code) - 1

    # Statements ------------------------------------------------------------------------------

    def block(self, function: Function, ends: tuple[str, ...]) -> str:
        """Statements up to one of the ends; takes the end and returns it."""
        self.depth += 1
        if self.depth > MOST_NESTING:
            raise self.error(f"more than {MOST_NESTING} blocks inside one another")
        while True:
            if self.now.kind == "finish":
                if "finish" not in ends:
                    raise self.error(f"expected {ends[-1]!r}")
                break
            if self.now.kind == "name" and self.now.text in ends:
                break
            self.statement(function)
        self.depth -= 1
        return self.next().text

    def statement(self, function: Function) -> None:
        start = self.now.text
        if start in ("def", "thread", "sec"):
            self.definition(function)
        elif start == "while":
            self.loop(function)
        elif start == "if":
            self.condition(function)
        elif start in ("global", "local"):
            self.next()
            name = self.name()
            self.expect("=")
            self.expression(function)
            self.emit(function, start, name)
        elif start in ("kill", "join"):
            self.next()
            self.expression(function)
            self.emit(function, start)
        else:
            self.simple(function)

    def simple(self, function: Function) -> None:
        start, line = self.now.text, self.now.line
        if self.accept("return"):
            if self.now.line > line or self.now.text in KEYWORDS - VALUES:
                self.emit(function, "push", None)
            else:
                self.expression(function)
            self.emit(function, "return")
        elif self.accept("halt", "enter_critical", "exit_critical"):
            self.emit(function, start)
        elif start in ("break", "continue"):
            if not self.loops:
                raise self.error("a loop around it")
            self.next()
            at = self.emit(function, "jump", self.loops[-1][0])
            if start == "break":
                self.loops[-1][1].append(at)
        else:
            self.assignment_or_call(function)

    def definition(self, function: Function) -> None:
        self.next()
        made = Function(self.name(), outer=function)
        self.expect("(")
        parameters = []
        while not self.accept(")"):
            parameters.append(self.name())
            if self.accept("="):
                made.defaults[parameters[-1]] = self.constant()
            if self.now.text != ")":
                self.expect(",")
        made.parameters = tuple(parameters)
        self.expect(":")
        loops, self.loops = self.loops, []
        function.inner[made.name] = made
        self.block(made, ("end",))
        self.emit(made, "push", None)
        self.emit(made, "return")
        self.loops = loops

    def constant(self) -> Any:
        """A default value: a number, a text, True or False."""
        holder = Function("")
        self.expression(holder)
        code = holder.code
        if len(code) == 2 and code[1] == ("negate",) and code[0][0] == "push":
            return -code[0][1]
        if len(code) != 1 or code[0][0] != "push":
            raise self.error("a constant as default value")
        return code[0][1]

    def loop(self, function: Function) -> None:
        self.next()
        start = len(function.code)
        self.expression(function)
        self.expect(":")
        leave = self.emit(function, "unless", 0)
        self.loops.append((start, [leave]))
        self.block(function, ("end",))
        self.emit(function, "jump", start)
        self.land(function, self.loops.pop()[1])

    def condition(self, function: Function) -> None:
        self.next()
        leaves: list[int] = []
        ending = "elif"
        while ending == "elif":
            self.expression(function)
            self.expect(":")
            skip = self.emit(function, "unless", 0)
            ending = self.block(function, ("elif", "else", "end"))
            leaves.append(self.emit(function, "jump", 0))
            self.land(function, [skip])
        if ending == "else":
            self.expect(":")
            self.block(function, ("end",))
        self.land(function, leaves)

    def land(self, function: Function, jumps: list[int]) -> None:
        """Let jumps go to the next instruction."""
        for at in jumps:
            function.code[at] = (function.code[at][0], len(function.code))

    def assignment_or_call(self, function: Function) -> None:
        start = self.place
        if self.now.kind == "name" and self.now.text not in KEYWORDS:
            name = self.name()
            indices = 0
            if self.accept("["):
                indices = self.arguments(function, "]")
            if self.accept("="):
                self.expression(function)
                self.emit(function, *(("store", name) if not indices else ("put", name, indices)))
                return
            # It was an expression: forget what the index left behind.
            if indices:
                raise self.error("expected '='")
            self.place = start
        self.expression(function)
        self.emit(function, "pop")

    # Expressions -----------------------------------------------------------------------------

    def expression(self, function: Function, level: int = 0) -> None:
        self.depth += level == 0
        if self.depth > MOST_NESTING:
            raise self.error(f"more than {MOST_NESTING} brackets inside one another")
        if level == len(LEVELS):
            self.unary(function)
        elif LEVELS[level] == ("not",):
            if self.accept("not"):
                self.depth += 1
                self.expression(function, level)
                self.depth -= 1
                self.emit(function, "not")
            else:
                self.expression(function, level + 1)
        else:
            self.expression(function, level + 1)
            while sign := self.accept(*LEVELS[level]):
                skip = self.emit(function, "keep", sign, 0) if sign in ("and", "or") else -1
                self.expression(function, level + 1)
                self.emit(function, "binary", sign)
                if skip >= 0:
                    function.code[skip] = ("keep", sign, len(function.code))
        self.depth -= level == 0

    def unary(self, function: Function) -> None:
        signs = ""
        while sign := self.accept("-", "+"):
            signs += sign
        self.operand(function)
        while self.accept("["):
            self.emit(function, "index", self.arguments(function, "]"))
        if signs.count("-") % 2:
            self.emit(function, "negate")

    def operand(self, function: Function) -> None:
        token = self.next()
        if token.kind == "number":
            whole = token.text.isdigit() or token.text.startswith("0x")
            self.emit(function, "push", int(token.text, 0) if whole else float(token.text))
        elif token.kind == "text":
            self.emit(function, "push", token.text[1:-1])
        elif token.text in ("True", "False"):
            self.emit(function, "push", token.text == "True")
        elif token.text == "(":
            self.expression(function)
            self.expect(")")
        elif token.text == "[":
            self.emit(function, "list", self.arguments(function, "]"))
        elif token.text == "run":
            name = self.name()
            self.expect("(")
            self.call(function, "run", name)
        elif token.kind == "name" and token.text not in KEYWORDS:
            self.named(function, token.text)
        else:
            raise ScriptError(f"line {token.line}: expected a value, not {token.text!r}")

    def named(self, function: Function, name: str) -> None:
        """A call, a pose or a variable. `p[...]` with six numbers is a pose."""
        if self.accept("("):
            self.call(function, "call", name)
        elif name == "p" and self.now.text == "[" and self._six_ahead():
            self.next()
            self.arguments(function, "]")
            self.emit(function, "pose")
        else:
            self.emit(function, "load", name)

    def _six_ahead(self) -> bool:
        depth, commas = 0, 0
        for place in range(self.place, len(self.words)):
            token = self.words[place]
            depth += (token.text in ("[", "(")) - (token.text in ("]", ")"))
            commas += depth == 1 and token.text == ","
            if depth == 0:
                break
        return commas == 5

    def arguments(self, function: Function, end: str) -> int:
        """Values up to a bracket; returns how many."""
        count = 0
        while not self.accept(end):
            self.expression(function)
            count += 1
            if self.now.text != end:
                self.expect(",")
        return count

    def call(self, function: Function, kind: str, name: str) -> None:
        positional, names = 0, []
        while not self.accept(")"):
            follows = self.words[self.place + 1] if self.now.kind == "name" else None
            if follows is not None and follows.text == "=" and follows.kind == "sign":
                names.append(self.name())
                self.next()
            elif names:
                raise self.error("expected a named argument")
            else:
                positional += 1
            self.expression(function)
            if self.now.text != ")":
                self.expect(",")
        self.emit(function, kind, name, positional, tuple(names))
