// Labels of an episode by keyboard. Times are integer nanoseconds since the first stamp.
"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const view = window.episodeView, given = JSON.parse($("given").textContent);
  const COLOURS = ["#1d6fb8", "#2f8f5b", "#d9972b", "#8a5bb5", "#3aa6a6", "#b8553a", "#6b7f2a",
                   "#c25b8f", "#5f6c7b"];
  const origin = BigInt(view.data.origin_ns), last = view.data.duration;
  const state = {
    success: given.success, note: given.note, edited: given.stages_edited,
    stages: given.stages.map((stage) => ({
      name: stage.name, begin: since(stage.begin_ns), end: stage.end_ns === null ? null : since(stage.end_ns) })),
    begin: given.trim[0] === null ? null : since(given.trim[0]),
    end: given.trim[1] === null ? null : since(given.trim[1]),
  };
  const names = [...new Set([...given.names, ...state.stages.map((stage) => stage.name)])].slice(0, 9);
  function since(stamp) { return Number(BigInt(stamp) - origin); }
  function stamp(t) { return t === null ? null : String(origin + BigInt(Math.round(t))); }
  const colour = (name) => COLOURS[Math.max(names.indexOf(name), 0) % COLOURS.length];

  // --- saving: one request at a time, the newest state last ---

  let sending = false, again = false;
  async function save() {
    if (sending) { again = true; return; }
    sending = true;
    $("saved").textContent = "saving …";
    do {
      again = false;
      const body = JSON.stringify({
        success: state.success, note: state.note,
        stages: state.edited ? state.stages.map((stage) => ({
          name: stage.name, begin_ns: stamp(stage.begin), end_ns: stamp(stage.end) })) : null,
        trim: { begin_ns: stamp(state.begin), end_ns: stamp(state.end) },
      });
      try {
        const answer = await fetch(location.pathname, {
          method: "POST", headers: { "Content-Type": "application/json" }, body });
        const said = answer.ok ? "saved" : await answer.text();
        if (answer.ok) judge(await answer.json());
        $("saved").textContent = said;
        $("saved").className = answer.ok ? "faint" : "bad";
      } catch {
        $("saved").textContent = "not saved: ./surg episode label has ended";
        $("saved").className = "bad";
      }
    } while (again);
    sending = false;
  }
  function judge([kind, label, why]) { // the verdict that counts, by the program's own rule
    for (const [id, style] of [["judged", "badge "], ["verdict", ""]]) {
      $(id).className = style + kind;
      $(id).textContent = label;
      $(id).title = why;
    }
  }
  function change(edit) { edit(); save(); show(); }

  // --- marks ---

  function endCurrent(t) {
    const open = state.stages.filter((s) => s.begin < t && (s.end === null || s.end > t));
    for (const stage of open) stage.end = t;
  }
  function begin(name) {
    const t = view.now();
    change(() => {
      state.edited = true;
      state.stages = state.stages.filter((stage) => stage.begin !== t);
      const following = state.stages.find((stage) => stage.begin > t);
      endCurrent(t);
      if (!names.includes(name) && names.length < 9) names.push(name);
      state.stages.push({ name, begin: t, end: following ? following.begin : null });
      state.stages.sort((a, b) => a.begin - b.begin);
    });
  }
  const keys = {
    s: () => change(() => { state.success = true; }),
    f: () => change(() => { state.success = false; }),
    u: () => change(() => { state.success = null; }),
    "0": () => change(() => { state.edited = true; endCurrent(view.now()); }),
    Backspace: () => change(() => { state.edited = true; state.stages.pop(); }),
    "[": () => change(() => { state.begin = view.now(); if (state.end !== null && state.end <= state.begin) state.end = null; }),
    "]": () => change(() => { state.end = view.now(); if (state.begin !== null && state.begin >= state.end) state.begin = null; }),
    "\\": () => change(() => { state.begin = state.end = null; }),
    n: () => $("note").focus(),
    m: () => { $("otherbox").hidden = false; $("other").focus(); },
  };
  document.addEventListener("keydown", async (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const field = event.target.tagName === "INPUT" ? event.target : null;
    if (event.key === "Enter" || (field && event.key === "Escape")) {
      event.preventDefault();
      if (field) { field.blur(); return; }
      while (sending) await new Promise((done) => setTimeout(done, 20));
      if ($("saved").className === "bad") return;
      const next = event.shiftKey ? given.back : given.next;
      if (next) location.assign(next);
      return;
    }
    if (field || event.target.tagName === "SELECT") return;
    const digit = /^[1-9]$/.test(event.key) ? names[Number(event.key) - 1] : undefined;
    const act = digit ? () => begin(digit) : keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  $("note").addEventListener("change", () => change(() => { state.note = $("note").value; }));
  $("other").addEventListener("change", () => {
    const name = $("other").value.trim();
    $("other").value = "";
    $("otherbox").hidden = true;
    if (name) begin(name);
  });
  $("other").addEventListener("blur", () => { $("otherbox").hidden = true; });

  // --- the panel ---

  function show() {
    $("place").textContent = given.place;
    const cut = (t, other) => (t === null ? other : (t / 1e9).toFixed(3) + " s");
    $("trim").textContent = state.begin === null && state.end === null ? "not trimmed"
      : `used: ${cut(state.begin, "begin")} to ${cut(state.end, "end")}`;
    if (document.activeElement !== $("note")) $("note").value = state.note;
    const t = view.now(), current = state.stages.find((s) => s.begin <= t && (s.end === null || t < s.end));
    $("names").replaceChildren(...names.map((name, i) => {
      const item = document.createElement("li");
      item.textContent = `${i + 1} ${name}`;
      item.style.setProperty("--c", colour(name));
      item.className = current && current.name === name ? "now" : "";
      return item;
    }));
    draw(t);
  }
  function draw(t) {
    const canvas = $("marks"), scale = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * scale);
    canvas.height = Math.round(canvas.clientHeight * scale);
    const pen = canvas.getContext("2d"), width = canvas.clientWidth, height = canvas.clientHeight;
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.font = '12px "DejaVu Sans", system-ui, sans-serif';
    for (const stage of state.stages) {
      const left = view.across(stage.begin), right = view.across(stage.end === null ? last : stage.end);
      pen.fillStyle = colour(stage.name);
      pen.fillRect(left, 3, Math.max(right - left - 1, 2), height - 6);
      pen.save();
      pen.beginPath();
      pen.rect(left, 0, right - left, height);
      pen.clip();
      pen.fillStyle = "#fff";
      pen.fillText(stage.name, left + 6, height / 2 + 4);
      pen.restore();
    }
    pen.fillStyle = "#1f293399";
    if (state.begin !== null) pen.fillRect(0, 0, view.across(state.begin), height);
    if (state.end !== null) pen.fillRect(view.across(state.end), 0, width, height);
    pen.fillStyle = "#1f2933";
    pen.fillRect(view.across(t), 0, 1.5, height);
  }
  let shown = null;
  (function watch() { // the cursor moves by the page's own script
    if (view.now() !== shown) { shown = view.now(); show(); }
    requestAnimationFrame(watch);
  })();
  window.addEventListener("resize", show);
  judge(given.badge);
  show();
  $("labels").focus();
})();
