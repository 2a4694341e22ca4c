// The curves over time, and what all canvases share.

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
  pen.fillStyle = colour("--faint");
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
    pen.fillStyle = colour("--line");
    pen.fillRect(GUTTER, y(mark), places(width), 1);
    pen.fillStyle = colour("--faint");
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
  pen.fillStyle = colour("--faint");
  pen.textAlign = "center";
  for (const mark of marks) {
    pen.fillRect(x(mark * 1e9, width), 0, 1, 5);
    pen.fillText(mark.toFixed(digits) + " s", x(mark * 1e9, width), 17);
  }
}
