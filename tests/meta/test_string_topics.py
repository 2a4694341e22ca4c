"""Text on a topic is for people: no node decides by JSON, or by a sentence, in std_msgs/String."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from helpers.tree.source_tree import tracked
from surg_cli.graph.topic_contract import load
from surg_cli.host import paths

PEOPLE = "a sentence for people"
CRTK = "CRTK's teleoperation interface has it as a text; no node of ours subscribes"
ANNOTATION = "free-form facts for the manifest; the recorder stores them and decides nothing"
PROMISED = {
    "<arm>/error": PEOPLE,
    "<arm>/warning": PEOPLE,
    "<arm>/status": PEOPLE,
    "<arm>/force/status": PEOPLE,
    "/<leader>/error": PEOPLE,
    "/teleop/warning": PEOPLE,
    "/<leader>_<arm>/current_state": CRTK,
    "/<leader>_<arm>/desired_state": CRTK,
    "/console/teleop/select": "a dVRK console's name of a pair; an unknown one is refused",
    "/console/teleop/unselect": "the same",
    "/console/teleop/selected": CRTK,
    "/console/teleop/unselected": CRTK,
    "/system/string_to_speech": "a dVRK topic, ignored",
    "/system/warning": PEOPLE,
    "/record/tag": ANNOTATION,
    "/record/info": ANNOTATION,
    "/sim/undeclared": "one name; it can only take the word 'deterministic' away",
    "/sim/guide_home": "one name, looked up in the cell; an unknown one is refused",
    "/sim/inject": "a test's fault script; opt-in, on this machine only, and checked whole",
}
"""Every std_msgs/String of the contract, and why it is none by which another node decides."""

USED = {
    "status_reporter.cpp": {"warning", "status", "error"},
    "rcm_loop.cpp": {"/sim/undeclared"},
    "console_topics_node.py": {"name"},
    "operator_topics_node.py": {"select", "unselect"},
    "lambda7_node.cpp": {"error"},
    "dvrk_compat_node.py": {"warning"},
    "leader_node.py": {"error"},
    "teleop_status_node.py": {"~warning", "current_state", "desired_state"},
    "order_topics_node.py": {"/sim/guide_home", "orders.Describe.topic"},
    "ros_system_node.py": {"warning"},
    "recorder_topics_node.py": {"name", "/record/tag", "/record/info"},
    "sim_bridge_node.py": {"/sim/undeclared", "/sim/inject", "/sim/guide_home"},
    "watch.py": {"topic", "/record/info"},
    "record.py": {"name"},
    "link_node.py": {"warning"},
    "force_node.py": {"status", "warning"},
    "drive_node.py": {"warning"},
    "robot_request.py": {"warning"},
}
"""File -> last part of the topics that it offers or takes as std_msgs/String."""


def strings_in_python(source: str) -> Iterator[str]:
    """The topic beside every use of the class ``String``, as it is written."""
    for node in ast.walk(ast.parse(source)):
        parts: list[ast.expr | None] = []
        if isinstance(node, ast.Call):
            parts = [*node.args]
        elif isinstance(node, ast.Tuple):
            parts = [*node.elts]
        elif isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(value, ast.Name) and value.id == "String" and key is not None:
                    yield ast.unparse(key)
        names = [part.id if isinstance(part, ast.Name) else "" for part in parts]
        if "String" in names[1:]:
            yield ast.unparse(parts[0])


def topics_of(name: str, text: str) -> set[str]:
    """Last parts of the topics that a source file uses as std_msgs/String."""
    if name.endswith(".py"):
        written = set(strings_in_python(text))
    else:
        pattern = r"(?:advertise|subscribe)<std_msgs::String>\(([^,]*)"
        written = set(re.findall(pattern, text))
    found = set()
    for topic in written:
        quoted = re.findall(r"""["']([^"']*)["']""", topic)
        last = quoted[-1] if quoted else topic
        name_of_variable = re.search(r"\{(\w+)\}$", last)
        last = name_of_variable.group(1) if name_of_variable else last
        ours = last.startswith(("/sim/", "/record/"))
        found.add(last if ours else last.rpartition("/")[2] or last)
    return found


def json_on_topics(source: str) -> list[int]:
    """Lines in which a message's text is read, or published, as JSON."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        function = ast.unparse(node.func)
        inside = ", ".join(ast.unparse(argument) for argument in node.args)
        if function == "json.loads" and re.fullmatch(r"\w+\.data", inside):
            found.append(node.lineno)
        if function.endswith(".publish") and "json.dumps" in inside:
            found.append(node.lineno)
    return found


def product_files() -> Iterator[tuple[str, str]]:
    for file in tracked():
        top, *rest = file.relative_to(paths.ROOT).parts
        ours = top in ("src", "tools") and "tests" not in rest
        if ours and file.suffix in (".py", ".cpp", ".hpp"):
            yield file.name, file.read_text("utf-8")


def test_the_contract_has_no_string_by_which_a_node_decides() -> None:
    found = {entry.name for entry in load().entries if entry.type == "std_msgs/String"}
    assert found == set(PROMISED)


def test_no_file_uses_another_string_topic() -> None:
    found: dict[str, set[str]] = {}
    for name, text in product_files():  # a node and the script that starts it may have one name
        found.setdefault(name, set()).update(topics_of(name, text))
    assert {name: topics for name, topics in found.items() if topics} == USED


def test_no_node_reads_or_writes_json_on_a_topic() -> None:
    python = [(n, json_on_topics(text)) for n, text in product_files() if n.endswith(".py")]
    assert [(name, lines) for name, lines in python if lines] == []


@pytest.mark.parametrize(
    "line",
    [
        "status = json.loads(message.data)",
        "self._status.publish(json.dumps(status))",
        "self._status.publish(String(json.dumps(status)))",
    ],
)
def test_json_on_a_topic_is_noticed(line: str) -> None:
    assert len(json_on_topics(line)) == 1
