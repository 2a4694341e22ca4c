// The force at the tip as a tone and as the gamepad's rumble; off until somebody asks. Every status
// asks for a short piece of both, so that they end by themselves when the console falls silent.

const LEAST = 0.05; // share of the soft limit below which nothing is heard
const PIECE_MS = 100; // two periods of the status
const RISE_S = 0.02;
const LOW_HZ = 220;
const OCTAVES = 2;
const LOUDEST = 0.2;

export class Feel {
  /** @param pad gives the gamepad in use, or null */
  constructor(pad) {
    this.pad = pad;
    this.sound = null; // context, oscillator and gain while it is on
  }

  turn(on) {
    if (on === (this.sound !== null)) return;
    if (!on) {
      this.sound.context.close();
      this.sound = null;
      this.rumble(0);
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

  /**
   * @param force at the tip [N], or null: not known
   * @param soft the arm's soft limit [N]
   * @param following whether the hand moves the tip
   */
  felt(force, soft, following) {
    if (this.sound === null) return;
    const share = following && force !== null ? Math.min(force / soft, 1) : 0;
    const level = share < LEAST ? 0 : share;
    const { context, oscillator, gain } = this.sound;
    const now = context.currentTime;
    oscillator.frequency.setTargetAtTime(LOW_HZ * 2 ** (OCTAVES * level), now, RISE_S);
    gain.gain.cancelScheduledValues(now);
    gain.gain.setTargetAtTime(LOUDEST * level, now, RISE_S / 3);
    gain.gain.setTargetAtTime(0, now + PIECE_MS / 1000 - RISE_S, RISE_S / 3);
    this.rumble(level);
  }

  rumble(level) {
    const motor = this.pad()?.vibrationActuator;
    if (!motor) return;
    if (level === 0) motor.reset?.();
    else {
      const effect = { duration: PIECE_MS, strongMagnitude: level, weakMagnitude: level };
      motor.playEffect("dual-rumble", effect).catch(() => {});
    }
  }
}
