// What all parts of the page share, and its videos. Times are integer nanoseconds since the first
// stamp.

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
// A colour of the style sheet: of light or dark, as the system prefers.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
const seconds = (t, digits = 3) => (t / 1e9).toFixed(digits) + " s";

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
