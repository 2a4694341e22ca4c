// The age of the picture.

import { element, mark, write } from "./kit.js";
import { wallUs } from "./link.js";

const OLD_PICTURE_MS = 150; // three of the endoscope's periods

/** Write how old the picture on the screen is, by its exposure, and how many come. */
export function showAge(picture, offsetUs) {
  const age = (wallUs() + offsetUs - picture.exposedUs) / 1000;
  const recent = picture.drawn.slice(-100).filter((each) => each.drawnUs > wallUs() - 2e6);
  const node = element("age");
  if (!picture.exposedUs) return;
  const middle = recent.map((each) => each.ageMs).sort((a, b) => a - b)[recent.length >> 1];
  const old = !recent.length || age > OLD_PICTURE_MS + (middle ?? 0);
  write(node, old ? `picture ${(age / 1000).toFixed(1)} s old` : `picture ${middle.toFixed(0)} ms old`);
  mark(node, "tone", old ? "bad" : "");
  const codec = picture.drawn.at(-1).codec === "h264" ? "H.264" : "JPEG";
  write(element("rate"), `${Math.round(recent.length / 2)} fps, ${codec}`);
}
