"""What pmc prints becomes what is known of a clock, and is judged."""

from __future__ import annotations

import math
import random
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from surg_recording.clock import clock_sync, pmc
from surg_recording.clock.clock_sync import ClockStatus, parse
from surg_recording.episode import table_columns, table_rows

# As linuxptp 3.1.1 of Debian 12 prints it, from a daemon with free_running in a network namespace.
SLAVE = """sending: GET TIME_STATUS_NP
sending: GET CURRENT_DATA_SET
\t067668.fffe.7a2f46-0 seq 0 RESPONSE MANAGEMENT TIME_STATUS_NP 
\t\tmaster_offset              -7
\t\tingress_time               1795262510929308334
\t\tcumulativeScaledRateOffset +0.000000000
\t\tscaledLastGmPhaseChange    0
\t\tgmTimeBaseIndicator        0
\t\tlastGmPhaseChange          0x0000'0000000000000000.0000
\t\tgmPresent                  true
\t\tgmIdentity                 8a2901.fffe.745a1a
sending: GET PARENT_DATA_SET
sending: GET PORT_DATA_SET
\t067668.fffe.7a2f46-0 seq 1 RESPONSE MANAGEMENT CURRENT_DATA_SET 
\t\tstepsRemoved     1
\t\toffsetFromMaster -7.0
\t\tmeanPathDelay    2521.0
\t067668.fffe.7a2f46-0 seq 2 RESPONSE MANAGEMENT PARENT_DATA_SET 
\t\tparentPortIdentity                    8a2901.fffe.745a1a-1
\t\tgrandmasterPriority1                  100
\t\tgm.ClockClass                         248
\t\tgrandmasterIdentity                   8a2901.fffe.745a1a
\t067668.fffe.7a2f46-1 seq 3 RESPONSE MANAGEMENT PORT_DATA_SET 
\t\tportIdentity            067668.fffe.7a2f46-1
\t\tportState               UNCALIBRATED
\t\tlogMinDelayReqInterval  -2
"""  # noqa: W291
LISTENING = (
    SLAVE.replace("UNCALIBRATED", "LISTENING")
    .replace("8a2901.fffe.745a1a", "067668.fffe.7a2f46")
    .replace("gmPresent                  true", "gmPresent                  false")
    .replace("1795262510929308334", "0")
    .replace("-7", "0")
    .replace("2521.0", "0.0")
)


def answer(state: str = "SLAVE", offset_ns: float = 0.0, delay_ns: float = 2521.0) -> str:
    text = SLAVE.replace("UNCALIBRATED", state).replace("meanPathDelay    2521.0", "meanPathDelay ")
    text = text.replace("meanPathDelay ", f"meanPathDelay    {delay_ns}")
    return text.replace("offsetFromMaster -7.0", f"offsetFromMaster {offset_ns}")


def test_a_slaves_answer() -> None:
    status = parse(SLAVE)
    assert status == ClockStatus(
        "UNCALIBRATED",
        pytest.approx(-7e-9),
        pytest.approx(2521e-9),
        "8a2901.fffe.745a1a",
        "067668.fffe.7a2f46",
    )
    assert status.fault() == ""


def test_a_masters_answer_needs_no_offset() -> None:
    status = parse(answer("MASTER").replace("8a2901.fffe.745a1a", "067668.fffe.7a2f46"))
    assert (status.port_state, status.offset, status.grandmaster) == (
        "MASTER",
        0.0,
        "067668.fffe.7a2f46",
    )
    assert math.isnan(status.path_delay)
    assert status.fault() == ""


def test_zeros_before_the_first_exchange_are_no_measurement() -> None:
    """A daemon that hears nobody says offset 0: believed, that would be perfect sync."""
    status = parse(LISTENING)
    assert math.isnan(status.offset)
    assert math.isnan(status.path_delay)
    assert status.grandmaster == ""
    assert "no PTP master is heard" in status.fault()
    young = parse(LISTENING.replace("LISTENING", "SLAVE").replace("false", "true"))
    assert math.isnan(young.offset)
    assert "not measured yet" in young.fault()


@pytest.mark.parametrize("offset_ns", [5e6, -5e6, 1_000_001.0, -1_000_001.0])
def test_an_injected_offset_is_found(offset_ns: float) -> None:
    status = parse(answer(offset_ns=offset_ns))
    assert status.offset == pytest.approx(offset_ns * 1e-9, rel=1e-12)
    assert f"{offset_ns * 1e-6:+.3f} ms off its master" in status.fault()


@pytest.mark.parametrize("offset_ns", [999_999.0, -1_000_000.0, 0.0])
def test_an_offset_within_the_bound_is_in_step(offset_ns: float) -> None:
    assert parse(answer(offset_ns=offset_ns)).fault() == ""


@pytest.mark.parametrize("state", ["LISTENING", "FAULTY", "DISABLED", "PASSIVE", "INITIALIZING"])
def test_a_port_without_a_master_is_not_in_step(state: str) -> None:
    """Whatever offset was measured before stands still then."""
    status = parse(answer(state))
    assert math.isnan(status.offset)
    assert state in status.fault()


def test_of_two_ports_the_one_that_follows_counts() -> None:
    port = SLAVE[SLAVE.index("\t067668.fffe.7a2f46-1 seq 3") :]
    first = port.replace("UNCALIBRATED", "MASTER").replace("46-1 seq", "46-2 seq")
    status = parse(SLAVE.replace(port, first + port.replace("UNCALIBRATED", "SLAVE")))
    assert status.port_state == "SLAVE"


@pytest.mark.parametrize("text", ["", "sending: GET TIME_STATUS_NP\n", "pmc: no\n\x00\xff\n" * 9])
def test_no_answer_is_a_problem_with_a_cure(text: str) -> None:
    status = parse(text)
    assert "./surg ptp" in status.problem
    assert status.fault() == status.problem


def test_broken_answers_never_raise_and_never_claim(rng: random.Random) -> None:
    """Lines lost, doubled, cut, swapped: what is said is right or unknown."""
    count = 0
    for _ in range(400):
        lines = SLAVE.splitlines(keepends=True)
        for _ in range(rng.randint(1, 12)):
            place = rng.randrange(len(lines))
            kind = rng.randrange(4)
            if kind == 0:
                del lines[place]
            elif kind == 1:
                lines.insert(place, lines[rng.randrange(len(lines))])
            elif kind == 2:
                lines[place] = lines[place][: rng.randrange(len(lines[place]) + 1)]
            else:
                other = rng.randrange(len(lines))
                lines[place], lines[other] = lines[other], lines[place]
            if not lines:
                break
        status = parse("".join(lines))
        offset, delay = status.offset, status.path_delay
        assert math.isnan(offset) or re.search(r"(?:offset|Master)\s+-?\d*", "".join(lines))
        assert math.isnan(offset) or abs(offset) <= 7.1e-9
        assert math.isnan(delay) or 0 <= delay <= 2.6e-6
        count += not math.isnan(offset)
    print(f"400 broken answers, {count} with an offset left")
    assert 0 < count < 400


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "x", "1e400"])
def test_a_number_that_is_none_is_unknown(word: str) -> None:
    text = SLAVE.replace("offsetFromMaster -7.0", f"offsetFromMaster {word}")
    text = text.replace("master_offset              -7", f"master_offset {word}")
    status = parse(text)
    assert math.isnan(status.offset)
    assert status.fault()


def test_a_row_says_what_is_not_known_by_an_empty_field() -> None:
    message: Any = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(secs=3, nsecs=4)),
        clock="a",
        port_state="LISTENING",
        offset=math.nan,
        path_delay=math.nan,
        grandmaster="",
        in_step=False,
        problem="no master",
    )
    row = table_rows.clock_sync(message, 9)
    assert row == (3_000_000_004, 9, "a", "LISTENING", None, None, "", 0, "no master")
    assert len(row) == len(table_columns.CLOCK_SYNC)


class TestAsking:
    """The part that starts pmc, with a stand-in for it."""

    @pytest.fixture
    def bench(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
        def stand_in(body: str) -> Path:
            program = tmp_path / "pmc"
            program.write_text(f"#!{sys.executable}\nimport sys, time\n{body}\n")
            program.chmod(0o755)
            monkeypatch.setenv("PATH", str(tmp_path))
            socket = tmp_path / "socket"
            socket.touch()
            return socket

        return stand_in

    def test_the_questions_are_asked(self, bench: Any) -> None:
        socket = bench(f"assert sys.argv[-4:] == {[f'GET {q}' for q in clock_sync.QUESTIONS]}\n"
                       f"print({SLAVE!r})")  # fmt: skip
        assert pmc.ask(socket).offset == pytest.approx(-7e-9)

    def test_a_pmc_that_hangs_is_given_up(self, bench: Any) -> None:
        status = pmc.ask(bench("time.sleep(60)"), timeout=0.3)
        assert "did not answer within 0.3 s" in status.problem

    def test_what_pmc_complains_of_is_told(self, bench: Any) -> None:
        status = pmc.ask(bench("print('uds: bind failed', file=sys.stderr); sys.exit(255)"))
        assert "uds: bind failed" in status.problem

    def test_no_daemon(self, bench: Any, tmp_path: Path) -> None:
        bench("")
        assert "sudo ./surg ptp" in pmc.ask(tmp_path / "none").problem

    def test_no_pmc(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setattr(pmc, "program", lambda name: None)
        assert "apt install linuxptp" in pmc.ask(tmp_path).problem
