"""The table of fields against the message definitions: nothing that is said goes unrecorded."""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest

import surg_core
from surg_cli.host import paths
from surg_recording.episode import table_columns, table_rows
from surg_recording.episode.table_columns import Field, Fields

MESSAGES = paths.ROOT / "src" / "surg_msgs" / "msg"
TABLES = {
    # Reason says it in words.
    "Cycle": ((*table_columns.CYCLE, *table_columns.WRIST), {"header", "reason_code"}),
    "ArmTruth": (table_columns.ARM_TRUTH, {"arm"}),
    "TaskState": (table_columns.TASK_STATE, {"header", "seed", "names", "values"}),
    "ClockSync": (table_columns.CLOCK, {"header"}),
}
"""Table of each message, and the members that become file names, heads or stamps."""
KINDS = {"float64": float, "string": str, "bool": int}


def members(message: str) -> dict[str, str]:
    """Type of each member of a message definition."""
    lines = (MESSAGES / f"{message}.msg").read_text().splitlines()
    words = [line.split("#")[0].split() for line in lines]
    return {word[1]: word[0] for word in words if len(word) == 2 and "=" not in word[1]}


@pytest.mark.parametrize("message", TABLES)
def test_every_member_of_the_message_has_its_field(message: str) -> None:
    fields, elsewhere = TABLES[message]
    recorded = {field.source.split(".")[0] for field in fields if field.source}
    assert recorded == set(members(message)) - elsewhere


@pytest.mark.parametrize("message", TABLES)
def test_kinds_and_sizes_are_those_of_the_message(message: str) -> None:
    types = members(message)
    for field in TABLES[message][0]:
        if not field.source:
            continue
        stated = types[field.source]
        size = re.search(r"\[(\d*)\]", stated)
        scalar = stated.split("[")[0]
        assert field.kind is KINDS.get(scalar, int if scalar.startswith("uint") else float)
        assert field.truth_value == (scalar == "bool")
        assert bool(field.members) == ("/" in scalar)
        if size is not None:
            some = field.per_joint or field in table_columns.WRIST  # of an arm without: empty
            assert some == (size[1] == "")
            assert some or len(field.columns) == int(size[1])


@pytest.mark.parametrize("fields", [fields for fields, _ in TABLES.values()])
def test_a_column_stands_once_and_a_row_has_one_value_for_each(fields: Fields) -> None:
    columns = [name for field in fields for name in field.expanded(6)]
    assert len(set(columns)) == len(columns)
    for field in fields:
        if field.source:
            width = len(field.expanded(6))
            assert len(list(table_rows._reader(field)(example(field, width)))) == width


def example(field: Field, width: int) -> SimpleNamespace:
    """A message with this field alone."""
    value: object = 1.0
    if field.members:
        value = SimpleNamespace(**dict.fromkeys(field.members, 1.0))
    elif field.is_array:
        value = [1.0] * width
    return SimpleNamespace(**{field.source: value})


def test_the_same_name_means_the_same_kind_in_every_table() -> None:
    kinds: dict[str, set[type]] = {}
    for fields, _ in TABLES.values():
        for field in fields:
            for name in field.columns:
                kinds.setdefault(name, set()).add(field.kind)
    assert {name: found for name, found in kinds.items() if len(found) > 1} == {}


def test_the_core_reports_what_a_cycle_records() -> None:
    """In-process episodes take from surg_core.Outputs whatever is not said elsewhere."""
    pytest.importorskip("mujoco")
    from surg_sim.envs import episode_messages

    elsewhere = {
        *("tick", "state", "reason", "command", "source", "q", "qd", "q_br"),
        *("compute_us", "period_us", "overruns"),
    }
    names = {field.source for field in table_columns.CYCLE if field.source} - elsewhere
    renamed = {episode_messages.OUTPUTS.get(name, name) for name in names}
    assert renamed <= set(dir(surg_core.Outputs))


def test_the_page_names_every_column() -> None:
    page = (paths.ROOT / "docs/reference/recording.md").read_text()
    for fields, _ in TABLES.values():
        for field in fields:
            name = field.columns[0].split("{")[0]
            stem = re.sub(r"_?(v?x|0)$", "", name) or name
            assert stem in page, f"docs/reference/recording.md does not name {name}"
