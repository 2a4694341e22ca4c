// The headset's picture worker: decodes, and hands the pictures over to the page. What a decoder has
// put into memory goes as its planes, which load in a fraction of a millisecond; the browser's own way
// from there to a texture takes 5 to 20. What is on the graphics card stays there.

import { PictureStream } from "./stream.js";

const stream = new PictureStream(handOver, (message) => postMessage(message));

async function handOver(image, head) {
  if (image.format !== "I420") {
    postMessage({ image, head }, [image]);
    return;
  }
  const data = new Uint8Array(image.allocationSize());
  const layout = await image.copyTo(data);
  image.close();
  postMessage({ planes: { data, layout }, head }, [data.buffer]);
}

onmessage = ({ data }) => {
  if (data.shown) stream.shown(data.shown);
  else stream.update(data.stream);
};
