// How far apart the pictures are that a page takes. One that is late with an input takes fewer from then on:
// inputs go first, and the console holds the arm after 100 ms without one.

const LATE_S = 0.06; // between two inputs
const SETTLE_S = 1; // before it takes still fewer
const CALM_S = 20; // of inputs in time, before it takes more again
const SPACINGS_MS = [0, 100, 200]; // 20, 10 and 5 pictures a second

export class Pace {
  constructor() {
    this.step = 0;
    this.calm = 0; // [s] of inputs in time
    this.settled = 0; // when it may take still fewer [s]
  }

  /** Between two pictures, at least [ms]. */
  get spacing() {
    return SPACINGS_MS[this.step];
  }

  /** An input goes out now [s], `gap` [s] after the last one; returns whether `spacing` has changed. */
  input(gap, now) {
    const before = this.step;
    this.calm = gap > LATE_S ? 0 : this.calm + gap;
    if (gap > LATE_S && now > this.settled) this.step = Math.min(before + 1, SPACINGS_MS.length - 1);
    if (this.calm > CALM_S) {
      this.step = Math.max(before - 1, 0);
      this.calm = 0;
    }
    if (this.step === before) return false;
    this.settled = now + SETTLE_S;
    return true;
  }
}
