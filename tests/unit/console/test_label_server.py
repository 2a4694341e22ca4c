"""The label page's mode of the web server: its own page only, and what it saves."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from helpers.async_tests import within
from helpers.recording import datasets_synthetic
from helpers.recording.recording_synthetic import TICK_NS
from surg_console.labelling.label_pages import LabelPages
from surg_console.labelling.label_server import LabelServer
from surg_console.web import connection_cap
from surg_recording.episode import episode_reader, labels

GIVEN = {
    "success": False,
    "note": "slipped",
    "stages": [{"name": "mine", "begin_ns": str(200 * TICK_NS), "end_ns": None}],
    "trim": {"begin_ns": str(130 * TICK_NS), "end_ns": str(330 * TICK_NS)},
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return datasets_synthetic.record(tmp_path_factory.mktemp("labels") / "e", 1, 0.7)


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "e"))


@contextlib.asynccontextmanager
async def serving(*folders: Path) -> AsyncIterator[tuple[LabelServer, aiohttp.ClientSession]]:
    server = LabelServer(LabelPages(folders, "A"))
    task = asyncio.create_task(server.serve())
    async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as http:
        yield server, http
    task.cancel()
    await asyncio.wait([task])


async def ask(
    http: aiohttp.ClientSession, method: str, path: str, body: Any = None, **headers: str
) -> tuple[int, str]:
    data = None if body is None else json.dumps(body).encode()
    own = {"Content-Type": "application/json", "Origin": str(http._base_url).rstrip("/")}
    sent = {**(own if body else {}), **headers}
    async with http.request(method, path, data=data, headers=sent, allow_redirects=False) as answer:
        return answer.status, await answer.text()


@pytest.mark.parametrize(
    ("places", "names"),
    [
        (["a/episodes/000/episode", "a/episodes/001/episode"], ["000", "001"]),
        (
            ["a/episodes/000/episode", "b/episodes/000/episode"],
            ["a/episodes/000", "b/episodes/000"],
        ),
        (["mine/x"], ["x"]),
        (["mine/episode"], ["mine"]),
    ],
)
def test_a_page_names_its_episode_by_what_tells_it_apart(
    tmp_path: Path, places: list[str], names: list[str]
) -> None:
    pages = LabelPages([tmp_path / place for place in places], "A")
    shown = [json.loads(pages._given(number))["place"] for number in range(1, len(places) + 1)]
    count = len(places)
    assert shown == [f"{n} of {count} · {name}" for n, name in enumerate(names, 1)]


@within(60.0)
async def test_the_server_serves_its_own_page_only(folder: Path) -> None:
    async with serving(folder) as (server, http):
        assert server._listening[0].getsockname()[0] == "127.0.0.1"
        async with http.get("/episode/1") as answer:
            policy = answer.headers["Content-Security-Policy"]
            assert answer.status == 200 and "frame-ancestors 'none'" in policy
            assert '"names": ["reach", "follow"]' in await answer.text()
        for file in ("label/label.css", "label/label.js"):
            assert (await ask(http, "GET", f"/page/{file}"))[0] == 200
        assert (await ask(http, "GET", "/episode/1", Host="evil.example"))[0] == 421
        for path in ("/episode/2", "/episode/0", "/../etc/passwd", "/control"):
            assert (await ask(http, "GET", path))[0] == 404
        post = ("POST", "/episode/1", GIVEN)
        assert (await ask(http, *post, Origin="http://evil.example"))[0] == 403
        assert (await ask(http, *post, **{"Content-Type": "text/plain"}))[0] == 415
        large = {**GIVEN, "note": "x" * (300 << 10)}
        assert (await ask(http, "POST", "/episode/1", large))[0] == 413
        status, said = await ask(http, "POST", "/episode/1", {"success": 3})
        assert status == 400 and "success" in said
        assert not (folder / labels.LABELS).exists()
        status, badge = await ask(http, *post)
        assert status == 200 and json.loads(badge)[1].startswith("failure")
    assert episode_reader.read(folder).manifest["labels"]["note"] == "slipped"


@within(60.0)
async def test_half_open_connections_do_not_lock_a_page_out(folder: Path) -> None:
    async with serving(folder) as (server, http):
        open_ones = [
            await asyncio.open_connection("127.0.0.1", server.port)
            for _ in range(connection_cap.MAX_OPEN + 60)
        ]
        for _, writer in open_ones:
            writer.write(b"GET / HT")
        assert (await asyncio.wait_for(ask(http, "GET", "/"), 2.0))[0] == 302
        for _, writer in open_ones:
            writer.close()


def test_a_broken_episode_is_a_page_that_says_so(folder: Path, tmp_path: Path) -> None:
    (folder / "manifest.json").write_text("{")
    pages = LabelPages([folder, folder], "A")
    assert "manifest.json" in pages.page(1) and "/episode/2" in pages.page(1)
