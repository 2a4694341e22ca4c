// The worker of /monitor: draws the stereo picture, its test picture and what stands over it.

import { Display, regions } from "./eyes.js";
import { PictureStream, wallUs } from "./stream.js";

const TEST = { width: 1920, height: 540 }; // both eyes
const TEXT_SHARE = 0.28; // of the height, for the text

let display = null;
let settings = { format: "left" };
let eyes = 2; // in the picture
let newest = null; // {image, head} on the screen
let text = null;
let layer = null; // the text, drawn once for all pictures

const stream = new PictureStream(arrived, (message) => postMessage(message));

onmessage = ({ data }) => {
  if (data.canvas) display = new Display(data.canvas);
  if (data.size && display) {
    [display.canvas.width, display.canvas.height] = data.size;
    display.cleared = "";
    layer = null;
  }
  if (data.show) settings = data.show;
  if (data.text && JSON.stringify(data.text) !== JSON.stringify(text)) {
    text = data.text;
    layer = null;
    display.cleared = "";
  }
  if (data.stream) {
    eyes = data.stream.layout.startsWith("stereo") ? 2 : 1;
    stream.update(data.stream);
  }
  else paint();
};

function arrived(image, head) {
  newest?.image.close();
  newest = { image, head };
  paint();
  stream.shown(head);
  postMessage({ ...head, drawnUs: wallUs() });
}

function paint() {
  if (!display) return;
  const test = settings.test || !newest;
  const shown = test ? { image: testPicture(settings.test), head: TEST } : newest;
  display.draw(shown.image, shown.head, { ...settings, eyes: test ? 2 : eyes });
  if (!text) return;
  layer ??= textLayer(text, display.canvas);
  const { width, height } = display.canvas;
  // The same place in both eyes: at the depth of the screen.
  for (const [x, y, w, h] of regions(settings.format)) {
    const wide = layer.width * w;
    const tall = layer.height * h;
    display.context.imageSmoothingEnabled = true;
    display.context.drawImage(layer, x * width, y * height, wide, tall);
  }
}

function textLayer({ headline, sentence, small, holds, old }, { width, height }) {
  const canvas = new OffscreenCanvas(width, Math.max(1, Math.round(height * TEXT_SHARE)));
  const context = canvas.getContext("2d");
  const size = Math.max(14, height / 32);
  const line = (words, y, font, colour) => {
    context.font = font;
    context.fillStyle = "rgb(0 0 0 / 65%)";
    const wide = context.measureText(words).width;
    if (words) context.fillRect(size * 0.5, y - size * 0.95, wide + size * 0.8, size * 1.35);
    context.fillStyle = colour;
    context.fillText(words, size * 0.9, y, width - 2 * size);
  };
  line(headline, size * 1.5, `600 ${size}px system-ui, sans-serif`, holds ? "#f0b449" : "#4fd1c5");
  line(sentence, size * 3, `${size * 0.7}px system-ui, sans-serif`, "#e4eaf0");
  line(small, size * 4.4, `${size * 0.6}px system-ui, sans-serif`, old ? "#ff6161" : "#8794a3");
  return canvas;
}

/** Tells the eyes apart: with the left eye closed only the R stays. Black before the first picture. */
function testPicture(wanted) {
  testPicture.made ??= {};
  testPicture.made[wanted] ??= drawnTest(wanted);
  return testPicture.made[wanted];
}

function drawnTest(wanted) {
  const canvas = new OffscreenCanvas(TEST.width, TEST.height);
  const context = canvas.getContext("2d");
  context.fillStyle = "#000";
  context.fillRect(0, 0, TEST.width, TEST.height);
  if (!wanted) return canvas;
  const half = TEST.width / 2;
  context.textAlign = "center";
  ["L", "R"].forEach((letter, i) => {
    context.fillStyle = ["#702020", "#204070"][i];
    context.fillRect(i * half, 0, half, TEST.height);
    context.fillStyle = "#fff";
    context.font = "600 200px system-ui, sans-serif";
    context.fillText(letter, half * (i + [0.3, 0.7][i]), 290);
    context.font = "26px system-ui, sans-serif";
    // The depth slider cuts both eyes at their edges, and its bar covers their lower part.
    context.fillText("Close the right eye: L stays.", half * (i + 0.5), 350);
    context.fillText("Close the left eye: R stays.", half * (i + 0.5), 390);
    context.strokeStyle = "#fff";
    context.lineWidth = 4;
    context.strokeRect(i * half + 20, 20, half - 40, TEST.height - 40);
  });
  return canvas;
}
