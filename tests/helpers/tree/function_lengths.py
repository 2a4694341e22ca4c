"""Functions of Python and C++ sources, and how many lines each has."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

_TEXT = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])'|^[ \t]*\#(?:\\\n|[^\n])*""",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Function:
    """One function.

    Attributes:
        name: As written; a C++ name with its class.
        line: First line of its head.
        lines: From its head to its end.
    """

    name: str
    line: int
    lines: int


def in_python(source: str) -> Iterator[Function]:
    """Functions and methods of a Python module, nested ones too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            assert node.end_lineno is not None
            yield Function(node.name, node.lineno, node.end_lineno - node.lineno + 1)


def in_cpp(source: str) -> Iterator[Function]:
    """Functions of a C++ file, found by counting braces outside namespaces and classes.

    A lambda or a block belongs to the function round it.
    """
    text = _without_text(source)
    depth, scopes, head, head_at = 0, [], "", 0  # scopes: depths of namespaces and classes
    name, start, body = "", 0, 0
    for at, char in enumerate(text):
        outside = depth == len(scopes)
        if char == "{":
            if outside and "(" in head:
                name, start, body = _name(head), head_at, depth + 1
            elif outside and re.search(r"\b(namespace|class|struct|union|enum|extern)\b", head):
                scopes.append(depth)
            depth += 1
            head = ""
        elif char == "}":
            depth -= 1
            if scopes and scopes[-1] == depth:
                scopes.pop()
            if body and depth == body - 1:
                rest = text[at + 1 :].lstrip()
                body = 0
                if rest[:1] in (",", "{"):  # the end of a member's initialiser: the body follows
                    head, head_at = f"{name}(", start
                    continue
                line = text.count("\n", 0, start) + 1
                yield Function(name, line, text.count("\n", 0, at) + 2 - line)
            head = ""
        elif char == ";" and outside:
            head = ""
        elif outside:
            if not head.strip():
                head_at = at
            head += char


def _without_text(source: str) -> str:
    """A source whose comments, literals and preprocessor lines are blank; its lines stay."""
    raw = re.sub(r'R"(\w*)\(.*?\)\1"', _blank, source, flags=re.DOTALL)
    return _TEXT.sub(_blank, raw)


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match.group())


def _name(head: str) -> str:
    """Name of a function from its head."""
    match = re.search(r"([\w:~]+|operator\s*\S+?)\s*\(", head)
    return match.group(1) if match else head.strip()[:40]
