// The part of the page where a person maps a gamepad; what was mapped is kept by the pad's id.

import { element, write } from "../kit.js";
import { clock } from "../link.js";
import { Lesson, readMapping } from "./lesson.js";
import { STANDARD } from "./pads.js";

const EVERY_MS = 20;
const place = (id) => `surg gamepad ${id}`;

export class PadPage {
  /** @param pads that read the gamepads; @param refuse gives why none may be mapped now, or "" */
  constructor(pads, refuse) {
    this.pads = pads;
    this.known = new Map(); // id -> mapping
    pads.mappingOf = (pad) => this.mappingOf(pad);
    element("pad-map").addEventListener("click", () => refuse() || this.begin());
    element("pad-skip").addEventListener("click", () => this.pads.lesson?.skip());
    element("pad-cancel").addEventListener("click", () => this.end());
    setInterval(() => this.look(), EVERY_MS);
  }

  mappingOf(pad) {
    if (!this.known.has(pad.id)) this.known.set(pad.id, readMapping(localStorage.getItem(place(pad.id))));
    return this.known.get(pad.id) ?? (pad.mapping === "standard" ? STANDARD : null);
  }

  begin() {
    if (this.pads.inUse === null) return;
    this.pads.lesson = new Lesson(this.pads.inUse.id);
    element("pad-lesson").hidden = false;
  }

  end() {
    if (this.pads.lesson === null) return;
    this.pads.lesson = null;
    this.pads.seen.clear(); // each control must be seen at rest first
    element("pad-lesson").hidden = true;
  }

  look() {
    const { lesson } = this.pads;
    if (lesson === null) return;
    const pad = [...navigator.getGamepads()].find((each) => each?.connected && each.id === lesson.id);
    if (!pad) {
      this.end();
      return;
    }
    lesson.feed(pad, clock());
    write(element("pad-sentence"), lesson.sentence);
    if (!lesson.done) return;
    this.known.set(pad.id, lesson.mapping);
    localStorage.setItem(place(pad.id), JSON.stringify(lesson.mapping));
    this.end();
  }
}
