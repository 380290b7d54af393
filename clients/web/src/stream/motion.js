/**
 * How fast the picture moves, from camera positions: to draw coarser levels while the eye cannot see the difference and the hand wants
 * response, and the full level when it rests (Turk 1992, section 8: coarse during broad motion, fine during final adjustment).
 *
 * Speed is in window heights per second that the model's surface moves on screen: orbiting at radius d by an angle a moves it about a rad,
 * zooming changes its size by |dd| / d.
 */

const ATTACK_SECONDS = 0.06;
const RELEASE_SECONDS = 0.25;
const REST_SECONDS = 0.15; /* no change for this long is rest */

export class MotionMeter {
  constructor() {
    this.last = null;
    this.speed = 0;
  }

  /**
   * @param {{eye: number[], target: number[]}} pose
   * @param {number} seconds a clock
   * @returns {number} smoothed speed, heights per second
   */
  update(pose, seconds) {
    const last = this.last;
    this.last = { eye: [...pose.eye], target: [...pose.target], seconds };
    if (!last) return this.speed;
    const dt = seconds - last.seconds;
    if (!(dt > 0)) {
      this.last.seconds = last.seconds;
      return this.speed;
    }
    const range = Math.max(distance(pose.eye, pose.target), 1e-30);
    const moved = distance(subtract(pose.eye, pose.target), subtract(last.eye, last.target)) + distance(pose.target, last.target);
    const raw = moved / range / Math.max(dt, 1 / 240);
    if (moved === 0 && dt > REST_SECONDS) {
      this.speed = 0;
    } else {
      const tau = raw > this.speed ? ATTACK_SECONDS : RELEASE_SECONDS;
      this.speed += (raw - this.speed) * (1 - Math.exp(-dt / tau));
      if (this.speed < 1e-3) this.speed = 0;
    }
    return this.speed;
  }
}

/**
 * Factor by which the tolerance in pixels may grow at this speed: 1 at rest, 8 at most. What moves by v heights a second is smeared over v * height / 60
 * pixels in a frame; a tolerance of a part of that cannot be seen. Slow turning (a full turn a minute is 0.1) stays sharp.
 */
export function motionFactor(speed) {
  return Math.min(8, 1 + 6 * Math.max(0, speed - 0.15));
}

function subtract(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}
