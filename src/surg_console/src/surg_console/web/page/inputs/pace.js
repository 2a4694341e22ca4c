// How many of the pictures a page takes. One that is late with an input takes fewer from then on: inputs go
// first, and the console holds the arm after 100 ms without one.

const LATE_S = 0.06; // between two inputs
const SETTLE_S = 1; // before it takes still fewer
const CALM_S = 20; // of inputs in time, before it takes more again
const FEWEST = 4;

export class Pace {
  constructor() {
    this.every = 1; // of so many pictures it takes one
    this.calm = 0; // [s] of inputs in time
    this.settled = 0; // when it may take still fewer [s]
  }

  /** An input goes out now [s], `gap` [s] after the last one; returns whether `every` has changed. */
  input(gap, now) {
    const before = this.every;
    this.calm = gap > LATE_S ? 0 : this.calm + gap;
    if (gap > LATE_S && now > this.settled) this.every = Math.min(FEWEST, 2 * before);
    if (this.calm > CALM_S) {
      this.every = Math.max(1, before / 2);
      this.calm = 0;
    }
    if (this.every === before) return false;
    this.settled = now + SETTLE_S;
    return true;
  }
}
