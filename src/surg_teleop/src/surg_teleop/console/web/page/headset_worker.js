// The headset's picture worker: decodes, and hands the pictures over to the page as they are.

import { PictureStream } from "./stream.js";

const stream = new PictureStream(
  (image, head) => postMessage({ image, head }, [image]),
  (message) => postMessage(message),
);

onmessage = ({ data }) => {
  if (data.shown) stream.shown(data.shown);
  else stream.update(data.stream);
};
