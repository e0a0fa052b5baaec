// A field over time on the processor: base attributes once, and what each time adds.
import { STEP } from "./scene.js";

const ATTRIBUTES = 11;

/** Arrays that the splat pass reads, four numbers a Gaussian, rows of 1024. */
export class Field {
  constructor(scene) {
    this.scene = scene;
    this.count = scene.count;
    this.times = scene.head.times;
    this.rows = Math.max(1, Math.ceil(this.count / 1024));
    const size = 4 * 1024 * this.rows;
    // x y z opacity; w x y z; scales and link; red green blue and metres moved.
    this.centre = new Float32Array(size);
    this.rotation = new Float32Array(size);
    this.scale = new Float32Array(size);
    this.colour = new Float32Array(size);
    this.harmonics = scene.degree > 0 ? new Float32Array(3 * size) : null;
    this.planes = new Array(this.times.length).fill(null);
    this.shown = -1;
  }

  /** What all times have in common, and the first one. */
  async loadBase() {
    this.position = await this.scene.integers("position");
    this.base = await this.scene.integers("attributes");
    for (let n = 0; n < this.count; n++) this.setAttributes(n, this.base, n);
    for (let n = 0; n < this.count; n++) this.scale[4 * n + 3] = 255;
    if (this.scene.has("link")) {
      const links = await this.scene.integers("link");
      for (let n = 0; n < this.count; n++) this.scale[4 * n + 3] = links[n];
    }
    if (this.harmonics) await this.loadHarmonics();
    await this.loadPlane(0);
  }

  /** Degree 1 alone is drawn: three coefficients of red, green, blue, each in a texel. */
  async loadHarmonics() {
    const all = await this.scene.integers("harmonics");
    const per = 3 * ((this.scene.degree + 1) ** 2 - 1);
    for (let n = 0; n < this.count; n++)
      for (let k = 0; k < 9; k++) this.harmonics[12 * n + 4 * Math.floor(k / 3) + (k % 3)] = all[per * n + k] * STEP.colour;
  }

  async loadPlane(index) {
    if (this.planes[index]) return;
    const names = [`moved/${index}`, `rows/${index}`, `attributes/${index}`];
    const [moved, rows, changed] = await Promise.all(names.map((name) => this.scene.integers(name)));
    this.planes[index] = { moved, rows, changed };
  }

  setAttributes(n, from, row) {
    const at = ATTRIBUTES * row;
    for (let k = 0; k < 3; k++) {
      this.scale[4 * n + k] = STEP.smallest * Math.exp(from[at + k] * STEP.scale);
      this.colour[4 * n + k] = from[at + 7 + k] * STEP.colour;
    }
    for (let k = 0; k < 4; k++) this.rotation[4 * n + k] = from[at + 3 + k] * STEP.rotation;
    this.centre[4 * n + 3] = from[at + 10] * STEP.colour;
  }

  /** Whether the planes that a time needs are here. */
  has(time) {
    const [left, right] = this.between(time);
    return Boolean(this.planes[left] && this.planes[right]);
  }

  /** The stored times around a time, and how far it is from the first to the second. */
  between(time) {
    const last = this.times.length - 1;
    let left = 0;
    while (left < last && this.times[left + 1] <= time + 1e-9) left++;
    if (left === last || time <= this.times[left]) return [left, left, 0];
    return [left, left + 1, (time - this.times[left]) / (this.times[left + 1] - this.times[left])];
  }

  /** Fills the arrays for a time: centres lie between those of the stored times, looks are of the nearest. */
  show(time) {
    const [left, right, part] = this.between(time);
    const a = this.planes[left].moved;
    const b = this.planes[right].moved;
    for (let n = 0; n < this.count; n++) {
      let square = 0;
      for (let k = 0; k < 3; k++) {
        const i = 3 * n + k;
        const moved = a[i] + (b[i] - a[i]) * part;
        square += moved * moved;
        this.centre[4 * n + k] = (this.position[i] + moved) * STEP.position;
      }
      this.colour[4 * n + 3] = Math.sqrt(square) * STEP.position;
    }
    const nearest = part < 0.5 ? left : right;
    if (nearest === this.shown) return false;
    if (this.shown >= 0) for (const n of this.planes[this.shown].rows) this.setAttributes(n, this.base, n);
    const plane = this.planes[nearest];
    plane.rows.forEach((n, row) => this.setAttributes(n, plane.changed, row));
    this.shown = nearest;
    return true;
  }
}
