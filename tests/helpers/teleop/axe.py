"""What axe-core says of a page in Chromium, and what people need to see there."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from helpers.teleop.chromium import Tab

SIZES = {390: 844, 820: 1180, 1366: 768, 1920: 1080}
"""[px] Widths and heights: a phone, a tablet, a laptop, a monitor."""
LOOKS = ("light", "dark")
GRAVE = ("serious", "critical")
SEEN = """(element) => {
  const box = element.getBoundingClientRect();
  const off = box.x < 0 || box.y < 0 || box.right > innerWidth || box.bottom > innerHeight;
  if (!box.width || off) return false;
  return element.contains(document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2));
}"""


def missing() -> str:
    """Why axe-core cannot be used; empty: it can."""
    return "" if find_spec("axe_playwright_python") else "axe-core is missing (./surg dev setup)"


async def resize(tab: Tab, width: int, height: int = 0, look: str = "dark") -> None:
    """Give a page a size of `SIZES`, or any, and the look that the system prefers."""
    await tab.call("Page.bringToFront")  # one behind another draws nothing
    features = [{"name": "prefers-color-scheme", "value": look}]
    await tab.call("Emulation.setEmulatedMedia", features=features)
    size = {"width": width, "height": height or SIZES[width], "deviceScaleFactor": 1}
    await tab.call("Emulation.setDeviceMetricsOverride", mobile=width < 1000, **size)
    await tab.run("new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))")


async def grave(tab: Tab) -> list[str]:
    """The serious and critical violations, the contrast of text among them, with their places."""
    await _inject(tab)
    found: list[dict[str, Any]] = await tab.run(
        "axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations.map((v) =>"
        " ({id: v.id, impact: v.impact, where: v.nodes.map((n) => n.target + ' ' +"
        " n.failureSummary.split('\\n').at(-1))})))"
    )
    return [f"{each['id']}: {each['where'][:3]}" for each in found if each["impact"] in GRAVE]


async def contrast(tab: Tab) -> tuple[int, float]:
    """How many texts of a page axe-core could measure, and the least contrast of one."""
    await _inject(tab)
    found: list[float] = await tab.run(
        "axe.run(document, {runOnly: ['color-contrast']}).then((r) => r.passes.flatMap((p) =>"
        " p.nodes.map((n) => n.any[0].data.contrastRatio)).filter((ratio) => ratio))"
    )
    return len(found), min(found)


async def _inject(tab: Tab) -> None:
    if not await tab.run("'axe' in globalThis"):
        spec = find_spec("axe_playwright_python")
        assert spec is not None and spec.submodule_search_locations
        (folder,) = spec.submodule_search_locations
        script = (Path(folder) / "axe.min.js").read_text()
        await tab.run(f"{script}; 0")


async def visible(tab: Tab, selector: str) -> bool:
    """Whether an element is whole on the screen, and nothing lies over its middle."""
    return bool(await tab.run(f"({SEEN})(document.querySelector('{selector}'))"))


async def scrolls_sideways(tab: Tab) -> bool:
    """Whether the page is wider than the screen."""
    return bool(await tab.run("document.documentElement.scrollWidth > innerWidth"))


async def spoken(tab: Tab, role: str) -> list[str]:
    """What the nodes of a role say, by the browser's accessibility tree."""
    nodes = (await tab.call("Accessibility.getFullAXTree"))["nodes"]
    by_id = {node["nodeId"]: node for node in nodes}

    def words(node: dict[str, Any]) -> str:
        if node.get("role", {}).get("value") == "StaticText":
            return str(node["name"]["value"])
        return " ".join(words(by_id[each]) for each in node.get("childIds", []) if each in by_id)

    return [words(node) for node in nodes if node.get("role", {}).get("value") == role]
