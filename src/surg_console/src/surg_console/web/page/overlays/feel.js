// The force at the tip as a tone and as the gamepad's rumble; off until somebody asks. Every word of
// the console asks for a short piece of both, which ends by itself: the tone on the sound card's own
// clock, so that it ends although this page stands still.

import { Feed } from "./feed.js";

const LEAST = 0.05; // share of the soft limit below which nothing is heard
// What is heard ends so long after its force was measured. The console looks every 10 ms, so that
// this is 50 ms after a sensor's last word.
const LONGEST_S = 0.04;
const RISE_S = 0.02;
const FALL_S = 0.01;
const LOW_HZ = 220;
const OCTAVES = 2;
const LOUDEST = 0.2;

export class Feel {
  /**
   * @param pad gives the gamepad in use, or null
   * @param mine whether this page's hand moves the tip
   * @param soft gives the arm's soft limit [N]
   */
  constructor(pad, mine, soft) {
    this.pad = pad;
    this.mine = mine;
    this.soft = soft;
    this.sound = null; // context, oscillator and gain while it is on
    this.feed = new Feed("/feel", (message) => this.arrived(message));
  }

  turn(on) {
    if (on === (this.sound !== null)) return;
    this.feed.turn(on);
    if (!on) {
      this.sound.context.close();
      this.sound = null;
      this.rumble(0, 0);
      return;
    }
    const context = new AudioContext(); // a click or a key has asked for it
    const oscillator = context.createOscillator();
    const gain = context.createGain();
    gain.gain.value = 0;
    oscillator.connect(gain).connect(context.destination);
    oscillator.start();
    this.sound = { context, oscillator, gain };
  }

  /** @param message with the force at the tip [N], null: not to be felt, and its age [s] */
  arrived({ tip, age }) {
    if (this.sound === null) return;
    const left = age === null ? 0 : LONGEST_S - age;
    const share = tip !== null && left > FALL_S && this.mine() ? Math.min(tip / this.soft(), 1) : 0;
    const level = share < LEAST ? 0 : share;
    const { context, oscillator, gain } = this.sound;
    const now = context.currentTime;
    gain.gain.cancelScheduledValues(now);
    if (level === 0) gain.gain.setTargetAtTime(0, now, FALL_S / 6);
    else {
      oscillator.frequency.setTargetAtTime(LOW_HZ * 2 ** (OCTAVES * level), now, RISE_S);
      gain.gain.setTargetAtTime(LOUDEST * level, now, RISE_S / 3);
      gain.gain.setTargetAtTime(0, now + left - FALL_S, FALL_S / 6);
    }
    gain.gain.setValueAtTime(0, now + (level === 0 ? FALL_S : left));
    this.rumble(level, 1000 * left);
  }

  rumble(level, duration) {
    const motor = this.pad()?.vibrationActuator;
    if (!motor) return;
    if (level === 0) motor.reset?.();
    else {
      const effect = { duration, strongMagnitude: level, weakMagnitude: level };
      motor.playEffect("dual-rumble", effect).catch(() => {});
    }
  }
}
