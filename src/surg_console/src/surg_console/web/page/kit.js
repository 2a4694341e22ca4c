// What all pages share: the elements, a toast, and the pictures that were drawn.

import { socketUrl, token } from "./link.js";

const TOAST_MS = 5000;
const KEPT_PICTURES = 16384; // a quarter of an hour, for measurements

export const element = (id) => document.getElementById(id);

// Unchanged values are not written again: the browser would draw a whole frame, and delay the picture.

export function set(node, name, value) {
  if (node[name] !== value) node[name] = value;
}

export function write(node, text) {
  set(node, "textContent", text);
}

export function mark(node, name, value) {
  set(node.dataset, name, value);
}

/** Show a button as pressed or not. */
export function sink(button, on) {
  if (button.getAttribute("aria-pressed") !== String(on)) button.setAttribute("aria-pressed", String(on));
}

export function toast(text) {
  const node = element("toast");
  write(node, text);
  node.hidden = false;
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => { node.hidden = true; }, TOAST_MS);
}

/** What the worker of pictures needs; `?codec=jpeg` in the address is for browsers without H.264. */
export function streamOf(layout) {
  const codec = new URLSearchParams(location.search).get("codec") === "jpeg" ? "jpeg" : "h264";
  return { url: socketUrl("/pictures"), token: token(), layout, codec };
}

/** Keep a picture that was drawn, with its age on the console's clock. */
export function remember(picture, head, offsetUs) {
  head.ageMs = (head.drawnUs + offsetUs - head.exposedUs) / 1000;
  picture.exposedUs = head.exposedUs;
  picture.drawn.push(head);
  if (picture.drawn.length > KEPT_PICTURES) picture.drawn.splice(0, KEPT_PICTURES / 4);
}
