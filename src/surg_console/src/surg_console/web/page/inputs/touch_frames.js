// Inputs under a finger: Chromium stops a page's timers for 100 ms when one comes down. Its frames go on.

import { clock } from "../link.js";

const AFTER_TOUCH_S = 0.3;

/** Speak with each frame while a finger is down, and shortly after. */
export function speakWhileTouched(speak) {
  const touching = new Set();
  let framesUntil = 0;
  function frames() {
    speak();
    if (touching.size || clock() < framesUntil) requestAnimationFrame(frames);
  }
  for (const kind of ["pointerdown", "pointerup", "pointercancel"]) {
    addEventListener(kind, (event) => {
      if (event.pointerType !== "touch") return;
      const idle = !touching.size && clock() >= framesUntil;
      if (kind === "pointerdown") touching.add(event.pointerId);
      else touching.delete(event.pointerId);
      framesUntil = clock() + AFTER_TOUCH_S;
      if (idle) frames();
    }, true);
  }
}
