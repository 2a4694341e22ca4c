"""URScript to syntax trees.

The subset: `def`, `thread`, `sec`, `while`, `if`/`elif`/`else`, `return`, `break`, `continue`,
`halt`, `global`, `local`, assignments, lists, poses, indices, calls with named arguments, `run`,
`join`, `kill`, `enter_critical`, `exit_critical`. A new line is a space. Not known: `struct`,
`switch`, `for`, text with escapes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from lark import Lark, Token
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

MOST_NESTING = 120
"""Levels of a tree: blocks, brackets and operators inside one another."""
_PARSER = Lark(
    r"""
    start: statement*
    block: statement*
    ?statement: ("def" | "thread" | "sec") NAME "(" _parameters ")" ":" block "end" -> definition
      | "while" expression ":" block "end" -> loop
      | condition
      | "global" NAME "=" expression -> store_global
      | "local" NAME "=" expression -> store_local
      | NAME "=" expression -> store
      | NAME "[" _values "]" "=" expression -> put
      | "kill" expression -> kill
      | "join" expression -> join
      | _RETURN -> leave
      | "return" expression? -> leave
      | "break" -> break_loop
      | "continue" -> continue_loop
      | "halt" -> halt
      | "enter_critical" -> enter_critical
      | "exit_critical" -> exit_critical
      | expression -> alone
    condition: "if" expression ":" block ("elif" expression ":" block)* ("else" ":" block)? "end"
    _parameters: (parameter ("," parameter)* ","?)?
    parameter: NAME ("=" expression)?

    !?expression: both (("or" | "xor") both)*
    !?both: negated ("and" negated)*
    ?negated: "not" negated -> negation
      | comparison
    !?comparison: sum (("==" | "!=" | "<" | ">" | "<=" | ">=") sum)*
    !?sum: product (("+" | "-") product)*
    !?product: signed (("*" | "/" | "%") signed)*
    ?signed: "-" signed -> negative
      | "+" signed
      | indexed
    ?indexed: operand
      | indexed "[" _values "]" -> index
    ?operand: NUMBER -> number
      | TEXT -> text
      | "True" -> true
      | "False" -> false
      | "(" expression ")" -> bracket
      | "[" _values "]" -> list
      | "run" NAME "(" _arguments ")" -> start_thread
      | NAME "(" _arguments ")" -> call
      | NAME -> variable
    _values: (expression ("," expression)* ","?)?
    _arguments: (argument ("," argument)* ","?)?
    ?argument: expression | named
    named: NAME "=" expression

    _RETURN.2: /return(?=[ \t\r]*(#[^\n]*)?(\n|$))/
    NUMBER: /0x[0-9a-fA-F]+|\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?/
    NAME: /[A-Za-z_]\w*/
    TEXT: /"[^"\n]*"|'[^'\n]*'/
    %ignore /[ \t\r\n]+/
    %ignore /#[^\n]*/
    """,
    parser="lalr",
    lexer="basic",
    propagate_positions=True,
)

Node = Any
"""A `Tree`; its children are trees and words."""


class ScriptError(Exception):
    """A script that the controller refuses or stops; states line and reason."""


class UnknownName(ScriptError):
    """A script that calls what nobody defines; `code` is the maker's own word for it."""

    def __init__(self, name: str, line: int, column: int) -> None:
        super().__init__(f"line {line}: function {name!r} is not known")
        self.column, self.code = column, f"compile_error_name_not_found:{name}:"


@dataclass
class Function:
    """A function or thread of a program.

    Attributes:
        name: Its name.
        body: Its statements.
        parameters: Names of its parameters.
        defaults: Parameter -> value, for those that may be left out.
        inner: Functions defined in it, by name.
        outer: Function in which it is defined.
        calls: Names that it calls -> line and column of the first call.
    """

    name: str
    body: Node
    parameters: tuple[str, ...] = ()
    defaults: dict[str, Any] = field(default_factory=dict)
    inner: dict[str, Function] = field(default_factory=dict)
    outer: Function | None = None
    calls: dict[str, tuple[int, int]] = field(default_factory=dict)

    def find(self, name: str) -> Function | None:
        """The function that a name means here."""
        here: Function | None = self
        while here is not None:
            if name in here.inner:
                return here.inner[name]
            here = here.outer
        return None


@lru_cache(maxsize=4)
def parse(script: str) -> Function:
    """The main function of a program; line numbers of the pendant (`$ 3 "..."`) are left out.

    A program that was run lately is not read again: the maker's own takes 0.1 s.

    Raises:
        ScriptError: The script is not in the subset.
    """
    lines = ("" if line.lstrip().startswith("$") else line for line in script.split("\n"))
    try:
        tree = _PARSER.parse("\n".join(lines))
    except UnexpectedCharacters as error:
        raise ScriptError(f"line {error.line}: unexpected {error.char!r}") from None
    except UnexpectedToken as error:
        raise ScriptError(f"line {error.line}: {_unexpected(error)}") from None
    root = Function("", tree)
    _enter(root, tree, False, 0)
    if any(each.data != "definition" for each in root.body.children):
        return root
    if len(root.inner) != 1:
        raise ScriptError(f"{len(root.inner)} programs in one script; one def ... end is allowed")
    return next(iter(root.inner.values()))


def called(function: Function) -> dict[str, tuple[int, int]]:
    """Names that a function and those in it call, and the script does not define -> first place."""
    found = {n: place for n, place in function.calls.items() if function.find(n) is None}
    for each in function.inner.values():
        found = called(each) | found
    return found


def constant(tree: Node) -> Any:
    """The value of a number, a text, True or False.

    Raises:
        ScriptError: The tree is none of them.
    """
    if tree.data == "negative" and tree.children[0].data == "number":
        return -constant(tree.children[0])
    if tree.data == "number":
        word = str(tree.children[0])
        return int(word, 0) if word.isdigit() or word.startswith("0x") else float(word)
    if tree.data == "text":
        return str(tree.children[0])[1:-1]
    if tree.data not in ("true", "false"):
        raise ScriptError(f"line {tree.meta.line}: expected a constant as default value")
    return tree.data == "true"


def _unexpected(error: UnexpectedToken) -> str:
    """What was found in the place of what."""
    found = repr(str(error.token)) if error.token.type != "$END" else "the end of the script"
    if "END" in error.expected:
        return f"expected 'end', not {found}"
    wanted = sorted(error.expected)
    return f"unexpected {found}" + (f"; expected {wanted[0]}" if len(wanted) == 1 else "")


def _enter(function: Function, tree: Node, looped: bool, depth: int) -> None:
    """Take over what a part of a function defines and calls, and refuse what cannot run."""
    if depth > MOST_NESTING:
        raise ScriptError(f"line {tree.meta.line}: too many blocks or brackets inside one another")
    for each in tree.children:
        if isinstance(each, Token):
            continue
        if each.data == "definition":
            _define(function, each, depth)
            continue
        if each.data in ("break_loop", "continue_loop") and not looped:
            raise ScriptError(f"line {each.meta.line}: break and continue need a loop around them")
        if each.data in ("call", "start_thread"):
            place = (each.meta.line, each.meta.column)
            function.calls.setdefault(str(each.children[0]), place)
            named = [part.data == "named" for part in each.children[1:]]
            if named != sorted(named):
                raise ScriptError(f"line {each.meta.line}: expected a named argument")
        _enter(function, each, looped or each.data == "loop", depth + 1)


def _define(outer: Function, tree: Node, depth: int) -> None:
    name, *parameters, body = tree.children
    made = outer.inner[str(name)] = Function(str(name), body, outer=outer)
    made.parameters = tuple(str(each.children[0]) for each in parameters)
    made.defaults = {
        str(each.children[0]): constant(each.children[1])
        for each in parameters
        if len(each.children) > 1
    }
    _enter(made, body, False, depth + 1)
