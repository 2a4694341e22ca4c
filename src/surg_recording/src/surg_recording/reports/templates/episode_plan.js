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
