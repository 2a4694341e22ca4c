// The path of the tip in three planes.

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
  pen.fillStyle = colour("--line");
  for (const c of columns) pen.fillRect(panel.px(c), 0, 1, height - 16);
  for (const l of lines) pen.fillRect(34, panel.py(l), width - 34, 1);
  pen.fillStyle = colour("--faint");
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
