"""The socket of /monitor: status out, Stop in; never a page of the session."""

from __future__ import annotations

import json

import aiohttp

from helpers.async_tests import within
from helpers.teleop.console import console
from helpers.teleop.console_page import socket_of, when
from surg_console.session.console_orders import EnableTeleop, SetOperatorPresent, StateCommand

TOKEN = "0123456789abcdef0123"


@within(30.0)
async def test_a_monitor_watches_and_stops_and_can_do_nothing_else() -> None:
    async with console(token=TOKEN) as made, aiohttp.ClientSession() as http:
        refused = await socket_of(http, made.port, "status", "x" * 20)
        assert (await refused.receive()).data == 4401
        socket = await socket_of(http, made.port, "status", TOKEN)
        assert (await socket.receive_json())["say"] == "welcome"
        assert (await socket.receive_json())["say"] in ("status", "episodes")
        assert made.session.pages == 0 and made.session.holder == ""
        press = {"say": "press", "button": "stop", "at": 1.0}
        await socket.send_str(json.dumps(press))
        await when(lambda: made.system.given(StateCommand), "the stop")
        assert made.system.given(EnableTeleop) == [EnableTeleop(False)]
        before = list(made.system.orders)
        steps = {"say": "input", "seq": 1, "at": 1.0, "hand": "rate", "v": [0.1, 0, 0]}
        others = [{**press, "button": b} for b in ("enable", "take", "record", "policy")]
        for message in (*others, steps):
            await socket.send_str(json.dumps(message))
        words = [m.data async for m in socket if m.type is aiohttp.WSMsgType.TEXT]
        assert sum("a monitor watches" in each for each in words) >= len(others)
        assert socket.close_code == 1008, "five of these end the page"
        assert made.system.orders == before
        assert SetOperatorPresent(True) not in made.system.given(SetOperatorPresent)
