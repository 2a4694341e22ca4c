// The script of an episode's page. Times are integer nanoseconds since the first stamp.
"use strict";

// What a policy planned and saw, drawn over the left eye's video.
const episodePlan = (() => {
  const OLD = 5e8, WAY = "#ffb020", POINT = "#39d0ff";

  // The plan of a time; null: there is none, or it is too old.
  function now(plans, index, cursor) {
    const plan = plans[index];
    return plan && cursor - plan.t <= OLD ? plan : null;
  }
  function words(plan) {
    if (!plan) return "no plan of a policy";
    const sure = plan.confidence === null ? "" : Math.round(100 * plan.confidence) + " % sure";
    const { rejected, clipped, late, stale } = plan.counts;
    const counts = `refused ${rejected}, clipped ${clipped}, late ${late}, stale ${stale}`;
    const last = plan.rule && `last refused by ${plan.rule}: ${plan.text}`;
    return [plan.phase, sure, counts, last].filter(Boolean).join(" · ");
  }
  function draw(canvas, plan, width, height) {
    canvas.width = width; // clears it
    canvas.height = height;
    if (!plan) return;
    const pen = canvas.getContext("2d"), unit = height / 480;
    if (plan.map) heat(pen, plan.map, width, height);
    pen.lineWidth = 1.5 * unit;
    for (const way of plan.ways) {
      pen.strokeStyle = pen.fillStyle = WAY;
      pen.beginPath();
      way.forEach((p, i) => {
        if (p) pen[i && way[i - 1] ? "lineTo" : "moveTo"](p[0] * width, p[1] * height);
      });
      pen.stroke();
      way.forEach((p, i) => {
        if (p) disc(pen, p[0] * width, p[1] * height, (i === way.length - 1 ? 4 : 2) * unit);
      });
    }
    for (const [name, x, y, certainty] of plan.points) {
      pen.globalAlpha = 0.35 + 0.65 * certainty;
      pen.strokeStyle = pen.fillStyle = POINT;
      pen.beginPath();
      pen.arc(x * width, y * height, 7 * unit, 0, 7);
      pen.stroke();
      pen.font = `${Math.round(12 * unit)}px system-ui, sans-serif`;
      pen.fillText(`${name} ${Math.round(100 * certainty)} %`, x * width + 10 * unit, y * height - 6 * unit);
    }
    pen.globalAlpha = 1;
  }
  function disc(pen, x, y, radius) {
    pen.beginPath();
    pen.arc(x, y, radius, 0, 7);
    pen.fill();
  }
  function heat(pen, { rows, columns, area, data }, width, height) {
    const code = atob(data), small = document.createElement("canvas");
    small.width = columns;
    small.height = rows;
    const map = new ImageData(columns, rows);
    for (let i = 0; i < rows * columns; i++) map.data.set([57, 208, 255, 0.35 * code.charCodeAt(i)], 4 * i);
    small.getContext("2d").putImageData(map, 0, 0);
    const [left, top, right, bottom] = area;
    pen.drawImage(small, left * width, top * height, (right - left) * width, (bottom - top) * height);
  }
  return { now, words, draw };
})();

(() => {
  const $ = (id) => document.getElementById(id);
  const data = JSON.parse($("data").textContent);
  const GUTTER = 64, RIGHT = 14, TRAIL = 2e9;
  const KINDS = { error: "#c62f3b", warning: "#d9972b", phase: "#2f8f5b", state: "#1d6fb8",
                  status: "#7b8794" };
  const STATES = ["#cbd2d9", "#9fd3b6", "#f0cf8e", "#e58a92"];
  let cursor = 0, playing = null, from = 0, to = Math.max(data.duration, 1), arm = data.arms[0];

  // Index of the last stamp not later than t; -1 before the first.
  function at(stamps, t) {
    let low = 0, high = stamps.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (stamps[middle] <= t) low = middle + 1; else high = middle;
    }
    return low - 1;
  }
  // A new element with children (elements or texts).
  function element(tag, ...children) {
    const made = document.createElement(tag);
    made.append(...children);
    return made;
  }
  const seconds = (t, digits = 3) => (t / 1e9).toFixed(digits) + " s";

  // --- videos ---

  const videos = data.videos.map((video, i) => {
    const caption = element("figcaption"), player = element("video");
    const code = atob($("video" + i).textContent.trim()), bytes = new Uint8Array(code.length);
    for (let k = 0; k < code.length; k++) bytes[k] = code.charCodeAt(k);
    player.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
    player.muted = true;
    player.playsInline = true;
    player.preload = "auto";
    player.addEventListener("loadeddata", () => { seek(shown); showPlan(shown); });
    player.addEventListener("seeked", () => { if (shown.wanted !== null) seek(shown); });
    const layer = element("canvas"), picture = element("div", player, layer), words = element("p");
    picture.className = "picture";
    words.className = "plan";
    const figure = element("figure", picture, caption);
    const planned = data.plans.length > 0 && video.name === "endoscope_left";
    if (planned) figure.append(words);
    $("videos").append(figure);
    const shown = { ...video, player, caption, layer, words, planned, plan: undefined, wanted: null };
    return shown;
  });
  if (!videos.length) { $("videos").remove(); document.querySelector(".top").classList.add("blind"); }

  // What a policy planned and saw, over the left eye's pictures; drawn again only when it changes.
  const planTimes = data.plans.map((plan) => plan.t);
  function showPlan(video) {
    const found = $("plan").checked ? episodePlan.now(data.plans, at(planTimes, cursor), cursor) : null;
    const width = video.player.videoWidth, height = video.player.videoHeight;
    if (!video.planned || !width || (found === video.plan && video.layer.width === width)) return;
    video.plan = found;
    episodePlan.draw(video.layer, found, width, height);
    video.words.textContent = $("plan").checked ? episodePlan.words(found) : "";
  }

  // Middle of the interval in which a frame is shown, so that rounding cannot select another.
  function middle(video, frame) {
    const last = video.pts.length - 1, start = video.pts[frame];
    const end = frame < last ? video.pts[frame + 1] : start + 20000;
    return (start + end) / 2e6;
  }
  function seek(video) {
    const player = video.player, frame = at(video.stamps, cursor);
    player.style.opacity = frame < 0 ? 0.15 : 1;
    if (playing || player.readyState < 1) return;
    const time = middle(video, Math.max(frame, 0));
    if (player.seeking) { video.wanted = frame; return; }
    video.wanted = null;
    if (Math.abs(player.currentTime - time) > 1e-4) player.currentTime = time;
  }
  function follow(video) { // while playing: the player runs freely; a drift is corrected
    const player = video.player, frame = at(video.stamps, cursor);
    const rate = Number($("rate").value);
    player.style.opacity = frame < 0 ? 0.15 : 1;
    if (frame < 0 || frame >= video.stamps.length - 1) { player.pause(); return; }
    const time = (video.pts[frame] + (cursor - video.stamps[frame]) / 1e3) / 1e6;
    if (Math.abs(player.currentTime - time) > 0.12 * Math.max(rate, 1) && !player.seeking) {
      player.currentTime = time;
    }
    player.playbackRate = rate;
    if (player.paused) player.play().catch(() => {});
  }

  // --- canvases ---

  function prepare(canvas, height) {
    const scale = window.devicePixelRatio || 1, width = canvas.clientWidth;
    if (height) canvas.style.height = height + "px";
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(canvas.clientHeight * scale);
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.font = '11px "DejaVu Sans", system-ui, sans-serif';
    pen.lineJoin = "round";
    return [pen, width, canvas.clientHeight];
  }
  const places = (width) => width - GUTTER - RIGHT;
  const x = (t, width) => GUTTER + ((t - from) / (to - from)) * places(width);
  function steps(low, high, count) {
    const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
    const size = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
    const marks = [];
    for (let k = Math.ceil(low / size); k * size <= high + 1e-12; k++) marks.push(k * size);
    return [marks, Math.max(0, -Math.floor(Math.log10(size) + 1e-9))];
  }
  function clip(pen, width, height) {
    pen.save();
    pen.beginPath();
    pen.rect(GUTTER, 0, places(width), height);
    pen.clip();
  }

  // --- the time line ---

  let rows = [];
  function build() {
    $("curves").replaceChildren();
    rows = [];
    const lane = element("canvas");
    $("curves").append(lane);
    rows.push({ canvas: lane, draw: drawLane, height: 40 });
    for (const curve of arm ? arm.curves : []) {
      const labels = curve.series.map((series) => {
        const label = element("span");
        label.style.setProperty("--c", series.colour);
        return label;
      });
      const legend = element("div", element("b", `${curve.title} [${curve.unit}]`), ...labels);
      legend.className = "legend";
      const canvas = element("canvas");
      $("curves").append(legend, canvas);
      rows.push({ canvas, draw: drawCurve, height: 92, curve, labels });
    }
    const axis = element("canvas");
    $("curves").append(axis);
    rows.push({ canvas: axis, draw: drawAxis, height: 24 });
    drawAll();
  }
  function drawAll() {
    for (const row of rows) row.draw(row, ...prepare(row.canvas, row.height));
    drawSpace();
    show();
  }
  function drawLane(row, pen, width, height) {
    pen.fillStyle = "#5f6c7b";
    pen.textAlign = "right";
    pen.fillText("state", GUTTER - 8, height - 6);
    pen.fillText("events", GUTTER - 8, 16);
    clip(pen, width, height);
    if (arm) {
      const stamps = arm.clocks.cycle;
      for (let i = 0, k; i < stamps.length; i = k) {
        for (k = i + 1; k < stamps.length && arm.state[k] === arm.state[i];) k++;
        const left = x(stamps[i], width), right = x(stamps[Math.min(k, stamps.length - 1)], width);
        pen.fillStyle = STATES[arm.state[i]] || STATES[0];
        pen.fillRect(left, height - 14, Math.max(right - left, 1), 10);
      }
    }
    for (const event of data.events) {
      pen.fillStyle = KINDS[event.kind] || KINDS.status;
      const tall = event.kind === "status" || event.kind === "state" ? 12 : 20;
      pen.fillRect(x(event.t, width) - 1, 22 - tall, 2.5, tall);
    }
    pen.restore();
  }
  function drawCurve(row, pen, width, height) {
    let low = row.curve.unit === "N" || row.curve.series.length > 1 ? 0 : Infinity, high = -Infinity;
    for (const series of row.curve.series) {
      for (const v of series.values) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
    }
    if (!(high > low)) { low = Number.isFinite(low) ? low - 0.5 : 0; high = low + 1; }
    const pad = 0.06 * (high - low), bottom = low === 0 ? 0 : low - pad, top = high + pad;
    const y = (v) => height - 4 - ((v - bottom) / (top - bottom)) * (height - 10);
    const [marks, digits] = steps(bottom, top, 3);
    pen.textAlign = "right";
    for (const mark of marks) {
      pen.fillStyle = "#e4e7eb";
      pen.fillRect(GUTTER, y(mark), places(width), 1);
      pen.fillStyle = "#5f6c7b";
      pen.fillText(mark.toFixed(digits), GUTTER - 8, y(mark) + 4);
    }
    clip(pen, width, height);
    for (const series of row.curve.series) {
      const stamps = arm.clocks[series.clock];
      const first = Math.max(at(stamps, from), 0), last = Math.min(at(stamps, to) + 1, stamps.length - 1);
      pen.strokeStyle = series.colour;
      pen.lineWidth = 1.2;
      pen.beginPath();
      let down = false;
      for (let i = first; i <= last; i++) {
        const v = series.values[i];
        if (v === null) { down = false; continue; }
        if (down) pen.lineTo(x(stamps[i], width), y(v)); else pen.moveTo(x(stamps[i], width), y(v));
        down = true;
      }
      pen.stroke();
    }
    pen.restore();
  }
  function drawAxis(row, pen, width) {
    const [marks, digits] = steps(from / 1e9, to / 1e9, Math.max(2, Math.floor(width / 110)));
    pen.fillStyle = "#5f6c7b";
    pen.textAlign = "center";
    for (const mark of marks) {
      pen.fillRect(x(mark * 1e9, width), 0, 1, 5);
      pen.fillText(mark.toFixed(digits) + " s", x(mark * 1e9, width), 17);
    }
  }

  // --- the tip in space ---

  const panels = [...document.querySelectorAll("#space canvas")].map((canvas) => ({
    canvas, axes: canvas.dataset.axes.split(",").map(Number), still: element("canvas"),
  }));
  let place = null; // centre and extent of the path per axis [mm]
  function drawSpace() {
    place = null;
    if (!arm) return;
    const known = arm.path.map((values) => values.filter((v) => v !== null));
    if (!known[0].length) return;
    const least = known.map((v) => v.reduce((a, b) => Math.min(a, b), Infinity));
    const most = known.map((v) => v.reduce((a, b) => Math.max(a, b), -Infinity));
    place = { middle: least.map((v, i) => (v + most[i]) / 2), spans: most.map((v, i) => v - least[i]) };
    for (const panel of panels) {
      const [pen, width, height] = prepare(panel.canvas);
      const [i, j] = panel.axes;
      panel.scale = Math.min((width - 60) / Math.max(place.spans[i], 5),
                             (height - 34) / Math.max(place.spans[j], 5));
      panel.px = (v) => width / 2 + 14 + (v - place.middle[i]) * panel.scale;
      panel.py = (v) => height / 2 - 8 + (v - place.middle[j]) * panel.scale * (j === 2 ? 1 : -1);
      panel.size = [width, height];
      axes(panel, pen, width, height);
      trace(panel, pen, 0, arm.path[0].length - 1, "#93a5b8", 1.3);
      panel.still.width = panel.canvas.width;
      panel.still.height = panel.canvas.height;
      panel.still.getContext("2d").drawImage(panel.canvas, 0, 0);
    }
  }
  function axes(panel, pen, width, height) {
    const across = (pixel) => place.middle[panel.axes[0]] + (pixel - width / 2 - 14) / panel.scale;
    const half = (height - 16) / 2 / panel.scale, centre = place.middle[panel.axes[1]];
    const [columns, d1] = steps(across(30), across(width), 4), [lines, d2] = steps(centre - half, centre + half, 4);
    pen.fillStyle = "#e9ecef";
    for (const c of columns) pen.fillRect(panel.px(c), 0, 1, height - 16);
    for (const l of lines) pen.fillRect(34, panel.py(l), width - 34, 1);
    pen.fillStyle = "#5f6c7b";
    pen.textAlign = "center";
    for (const c of columns) pen.fillText(c.toFixed(d1), panel.px(c), height - 4);
    pen.textAlign = "right";
    for (const l of lines) if (panel.py(l) > 8 && panel.py(l) < height - 18) pen.fillText(l.toFixed(d2), 30, panel.py(l) + 4);
  }
  function trace(panel, pen, first, last, colour, thick) {
    const [a, b] = panel.axes.map((axis) => arm.path[axis]);
    pen.strokeStyle = colour;
    pen.lineWidth = thick;
    pen.beginPath();
    let down = false;
    for (let i = Math.max(first, 0); i <= last; i++) {
      if (a[i] === null || b[i] === null) { down = false; continue; }
      if (down) pen.lineTo(panel.px(a[i]), panel.py(b[i])); else pen.moveTo(panel.px(a[i]), panel.py(b[i]));
      down = true;
    }
    pen.stroke();
  }
  function drawTip(row) {
    for (const panel of panels) {
      if (!place) continue;
      const pen = panel.canvas.getContext("2d"), [width, height] = panel.size;
      pen.clearRect(0, 0, width, height);
      pen.drawImage(panel.still, 0, 0, width, height);
      if (row < 0) continue;
      const [a, b] = panel.axes.map((axis) => arm.path[axis][row]);
      if (a === null || b === null) continue;
      pen.strokeStyle = "#d9762b88"; // the shaft, from the trocar at the origin
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.moveTo(panel.px(0), panel.py(0));
      pen.lineTo(panel.px(a), panel.py(b));
      pen.stroke();
      trace(panel, pen, at(arm.clocks.cycle, cursor - TRAIL), row, "#1d6fb8", 2);
      pen.fillStyle = "#c62f3b";
      pen.beginPath();
      pen.arc(panel.px(a), panel.py(b), 4.5, 0, 7);
      pen.fill();
    }
  }

  // --- the samples at the cursor ---

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

  // --- play, step, zoom ---

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
})();
