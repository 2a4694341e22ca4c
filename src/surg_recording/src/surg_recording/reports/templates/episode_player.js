// Shows what is at the cursor, and moves it: play, step, zoom.

function show() {
  const row = arm ? at(arm.clocks.cycle, cursor) : -1;
  $("clock").textContent = seconds(cursor) + " / " + seconds(data.duration, 1);
  const width = $("timeline").clientWidth, left = x(cursor, width);
  $("cursor").style.transform = `translateX(${left}px)`;
  $("cursor").style.visibility = left < GUTTER - 1 || left > width - RIGHT + 1 ? "hidden" : "";
  for (const { curve, labels } of rows) {
    if (!curve) continue;
    curve.series.forEach((series, i) => {
      const k = at(arm.clocks[series.clock], cursor), v = k < 0 ? null : series.values[k];
      labels[i].textContent = `${series.name} ${v === null ? "–" : v.toFixed(3)}`;
    });
  }
  drawTip(row);
  for (const video of videos) {
    const frame = at(video.stamps, cursor);
    const label = frame < 0 ? "no picture yet"
      : `frame ${video.frames[frame]}, stamp ${seconds(video.stamps[frame])}`;
    video.caption.textContent = [video.name, label, video.note].filter(Boolean).join(" · ");
    if (playing) follow(video); else seek(video);
    showPlan(video);
  }
  readout(row);
  const now = at(data.events.map((event) => event.t), cursor);
  if (now !== show.now) {
    const items = $("events").children;
    if (items[show.now]) items[show.now].classList.remove("now");
    if (items[now]) {
      items[now].classList.add("now");
      $("events").scrollTop = items[now].offsetTop - $("events").offsetTop - 60;
    }
    show.now = now;
  }
}
function readout(row) {
  const value = (i) => (row < 0 || arm.path[i][row] === null ? "–" : arm.path[i][row].toFixed(2) + " mm");
  const lines = arm ? [
    ["stamp", row < 0 ? "–" : seconds(arm.clocks.cycle[row])],
    ["tick", row < 0 ? "–" : arm.tick[row]],
    ["state", row < 0 ? "–" : data.states[arm.state[row]] || arm.state[row]],
    ["tip x", value(0)], ["tip y", value(1)], ["tip z (depth)", value(2)],
  ] : [["arm", "no cycles recorded"]];
  $("readout").replaceChildren(...lines.map(([name, text]) =>
    element("tr", element("th", name), element("td", text))));
}
function go(t) { cursor = Math.min(Math.max(Math.round(t), 0), data.duration); show(); }

function play(on) {
  playing = on ? { since: performance.now(), start: cursor >= data.duration ? 0 : cursor } : null;
  $("play").textContent = on ? "❚❚" : "▶";
  for (const video of videos) if (!on) video.player.pause();
  if (on) requestAnimationFrame(tick); else show();
}
function tick(now) {
  if (!playing) return;
  const t = playing.start + Math.max(now - playing.since, 0) * 1e6 * Number($("rate").value);
  go(t);
  if (cursor > to || cursor < from) { const size = to - from; look(cursor, cursor + size); }
  if (t >= data.duration) play(false); else requestAnimationFrame(tick);
}
// One frame of the first video; one twentieth of a second without one.
function step(by) {
  play(false);
  const stamps = videos.length ? videos[0].stamps : null;
  if (!stamps) return go(cursor + by * 5e7);
  const frame = at(stamps, cursor) + by;
  if (frame < 0) return go(0);
  return go(frame < stamps.length ? stamps[frame] : data.duration);
}
function look(a, b) {
  const size = Math.min(Math.max(b - a, 5e7), Math.max(data.duration, 1));
  from = Math.min(Math.max(a, 0), Math.max(data.duration, 1) - size);
  to = from + size;
  drawAll();
}
const timeOf = (event) => {
  const box = $("timeline").getBoundingClientRect();
  return from + ((event.clientX - box.left - GUTTER) / places(box.width)) * (to - from);
};
$("timeline").addEventListener("pointerdown", (event) => {
  play(false);
  $("timeline").setPointerCapture(event.pointerId);
  go(timeOf(event));
});
$("timeline").addEventListener("pointermove", (event) => { if (event.buttons & 1) go(timeOf(event)); });
$("timeline").addEventListener("wheel", (event) => {
  event.preventDefault();
  const t = timeOf(event), factor = event.deltaY > 0 ? 1.25 : 0.8;
  look(t - (t - from) * factor, t + (to - t) * factor);
}, { passive: false });
$("timeline").addEventListener("dblclick", () => look(0, data.duration));
$("play").addEventListener("click", () => play(!playing));
$("back").addEventListener("click", () => step(-1));
$("forth").addEventListener("click", () => step(1));
$("rate").addEventListener("change", () => { if (playing) play(true); });
$("plan").addEventListener("change", () => { for (const video of videos) video.plan = undefined; show(); });
$("planchoice").hidden = !videos.some((video) => video.planned);
$("arm").addEventListener("change", () => { arm = data.arms[$("arm").selectedIndex]; build(); });
document.addEventListener("keydown", (event) => {
  const keys = { " ": () => play(!playing), p: () => $("plan").click(), Home: () => go(0), End: () => go(data.duration),
    ArrowLeft: () => (event.shiftKey ? go(cursor - 1e9) : step(-1)),
    ArrowRight: () => (event.shiftKey ? go(cursor + 1e9) : step(1)) };
  if (!keys[event.key] || (["SELECT", "TEXTAREA"].includes(event.target.tagName) || (event.target.tagName === "INPUT" && event.target.type !== "checkbox"))) return;
  event.preventDefault();
  keys[event.key]();
});
window.addEventListener("resize", drawAll);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);

for (const { name } of data.arms) $("arm").append(new Option(name));
$("armchoice").hidden = data.arms.length < 2;
$("events").append(...data.events.map((event) => {
  const time = element("time", (event.exact ? "" : "≈ ") + seconds(event.t));
  const line = element("li", time, element("span", event.text));
  line.style.setProperty("--c", KINDS[event.kind] || KINDS.status);
  line.addEventListener("click", () => { play(false); go(event.t); });
  return line;
}));
$("eventbox").hidden = !data.events.length;
build();
const start = /^#t=([\d.]+)$/.exec(location.hash); // view.html#t=12.5 opens at 12.5 s
if (start) go(Number(start[1]) * 1e9);
window.episodeView = { data, now: () => cursor, go: (t) => { play(false); go(t); }, drawAll,
                       across: (t) => x(t, $("timeline").clientWidth) };
