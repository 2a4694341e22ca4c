// The console's picture worker: draws the pictures; the page's own thread is free for the hand.

import { PictureStream, wallUs } from "./stream.js";

let canvas = null;
let context = null;

const stream = new PictureStream(draw, (message) => postMessage(message));

onmessage = ({ data }) => {
  if (data.canvas) {
    canvas = data.canvas;
    context = canvas.getContext("2d", { alpha: false, desynchronized: true });
  }
  stream.update(data.settings);
};

function draw(image, head) {
  if (canvas.width !== head.width || canvas.height !== head.height) {
    canvas.width = head.width;
    canvas.height = head.height;
  }
  context.drawImage(image, 0, 0);
  image.close();
  stream.shown(head);
  postMessage({ ...head, drawnUs: wallUs() });
}
