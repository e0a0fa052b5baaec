// A player: scenes of one clip, a canvas, and what one can ask of them.
import { Field } from "./field.js";
import { openScene } from "./scene.js";
import { forget, open } from "./source.js";
import { Splats } from "./splats.js";
import { MODES, Stage } from "./stage.js";
import { Things, linkColours } from "./things.js";
import { View } from "./view.js";

/** An element with words in it; words are never markup. */
function make(tag, words, attributes = {}) {
  const made = document.createElement(tag);
  if (words) made.textContent = words;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

export class Player {
  constructor(place) {
    this.place = place;
    this.wanted = JSON.parse(place.dataset.scenes);
    this.time = 0;
    this.playing = false;
    this.mode = 0;
    this.least = 0;
    this.ready = this.start().catch((error) => {
      this.close();
      place.replaceChildren(make("p", `The player cannot start: ${error.message}`, { class: "player-note" }));
      throw error;
    });
  }

  async start() {
    const { place } = this;
    this.note = make("p", "Loading…", { class: "player-note", role: "status" });
    this.canvas = make("canvas", "", { tabindex: "0", "aria-label": "The scene: drag to turn, wheel to come near" });
    this.picture = make("img", "", { alt: "What the camera recorded", hidden: "" });
    const row = make("div", "", { class: "player-row" });
    row.append(this.canvas, this.picture);
    place.replaceChildren(row, this.note);
    this.stage = new Stage(this.canvas, () => this.wake());
    this.scenes = await Promise.all(this.wanted.map(async (from) => openScene(await open(from))));
    const { head } = this.scenes[0];
    this.head = head;
    const colours = linkColours(head.links.length);
    this.fields = this.scenes.map((scene) => new Field(scene));
    this.splats = [];
    this.shown = [0];
    this.view = new View(head, this.canvas, () => this.wake());
    this.view.onleave = () => this.sync();
    if (this.view.followed !== null) this.view.follow(0);
    for (const field of this.fields) {
      await field.loadBase();
      this.splats.push(new Splats(field, colours));
    }
    this.things = new Things(this.scenes[0], colours);
    await this.things.loading;
    this.controls();
    this.note.textContent = "";
    this.setTime(head.times[0]);
    this.resize = new ResizeObserver(() => this.wake());
    this.resize.observe(place);
    this.frame();
    this.loaded = this.loadPlanes();
  }

  /** The other times, in order. */
  async loadPlanes() {
    for (let index = 1; index < this.head.times.length; index++) {
      for (const field of this.fields ?? []) await field.loadPlane(index);
      if (!this.fields) return;
      this.note.textContent = index + 1 < this.head.times.length ? `Loading time ${index + 1} of ${this.head.times.length}…` : "";
      if (this.fields.some((field) => field.at !== this.time)) this.wake();
    }
    this.wanted.forEach(forget);
  }

  setTime(time) {
    this.time = time;
    this.fresh = true;
    this.wake();
  }

  wake() {
    this.dirty = true;
  }

  frame = (now = performance.now()) => {
    if (!this.fields) return;
    this.request = requestAnimationFrame(this.frame);
    const seconds = Math.min(0.1, (now - (this.before ?? now)) / 1000);
    this.before = now;
    if (this.playing) {
      const last = this.head.times.at(-1);
      const next = this.time + seconds / Math.max(0.1, this.head.seconds);
      this.setTime(next > last ? this.head.times[0] : next);
    }
    if (this.view.kind === "fly") this.view.step(this.time, seconds);
    if (this.dirty) this.draw();
  };

  /** Draws what is asked for, as large as the place is, or as large as told. */
  draw(size) {
    this.dirty = false;
    const panes = this.shown.map((index) => this.splats[index]);
    for (const index of this.shown) {
      const field = this.fields[index];
      if (!field.has(this.time)) continue;
      if (this.fresh || field.at !== this.time) this.splats[index].show(this.time);
      field.at = this.time;
    }
    this.fresh = false;
    this.view.step(this.time, 0);
    this.things.place(this.time, this.view.followed);
    const clip = this.head.cameras[0] ?? { width: 640, height: 352 };
    const shares = panes.length + (this.picture.hidden ? 0 : 1);
    const width = size?.width ?? Math.max(16, Math.floor((this.place.clientWidth / shares) * Math.min(2, devicePixelRatio)));
    const height = size?.height ?? Math.max(16, Math.round((width * clip.height) / clip.width));
    this.canvas.style.flex = `${panes.length} 1 0`;
    this.canvas.style.aspectRatio = `${panes.length * clip.width} / ${clip.height}`;
    const asked = { mode: this.mode, least: this.least, width, height };
    this.stage.draw(panes, this.view, this.things, asked);
    this.sync();
  }

  /** What is drawn at a size, as a PNG in a data address; for tests and for keeping a picture. */
  snapshot(width, height) {
    const { shown } = this;
    this.shown = [shown[0]];
    this.draw({ width, height });
    const address = this.canvas.toDataURL("image/png");
    this.shown = shown;
    this.wake();
    return address;
  }

  /** Lets memory and the graphics context go. */
  close() {
    cancelAnimationFrame(this.request);
    this.resize?.disconnect();
    this.view?.dispose();
    this.things?.dispose();
    this.splats?.forEach((splats) => splats.dispose());
    this.stage?.dispose();
    this.fields = null;
  }

  controls() {
    const bar = make("div", "", { class: "player-bar" });
    const tools = make("div", "", { class: "player-bar" });
    const { head, view } = this;
    this.button = make("button", "▶", { type: "button", "aria-label": "Play" });
    this.button.onclick = () => {
      this.playing = !this.playing;
      this.button.textContent = this.playing ? "⏸" : "▶";
      this.wake();
    };
    this.slider = make("input", "", {
      type: "range", min: head.times[0], max: head.times.at(-1), step: "any", value: head.times[0], "aria-label": "Time",
    });
    this.slider.oninput = () => this.setTime(Number(this.slider.value));
    this.clock = make("output", "");
    bar.append(this.button, this.slider, this.clock);
    this.from = select("Camera", [...head.cameras.map((camera) => camera.id + (camera.held_out ? " (held out)" : "")), "free"]);
    this.from.input.onchange = () => {
      const index = Number(this.from.input.value);
      if (index < head.cameras.length) view.follow(index);
      else view.leave();
    };
    const move = select("Move", ["orbit", "fly (WASD, drag)"]);
    move.input.onchange = () => {
      view.use(move.input.value === "1" ? "fly" : "orbit");
      if (move.input.value === "1") view.leave();
    };
    const show = select("Show", MODES);
    show.input.onchange = () => {
      this.mode = Number(show.input.value);
      this.wake();
    };
    const opacity = make("input", "", { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    opacity.oninput = () => {
      this.least = Number(opacity.value);
      this.wake();
    };
    tools.append(this.from.label, move.label, show.label, labelled("Opacity from", opacity));
    if (this.wanted.length > 1)
      this.wanted.forEach((from, index) => tools.append(this.tick(from.name, this.shown.includes(index), (on) => this.showPane(index, on))));
    if (this.scenes[0].has("picture/0/0"))
      tools.append(this.tick("Reference", false, (on) => {
        this.picture.hidden = !on;
      }));
    if (this.things.links.length)
      tools.append(this.tick("Robot mesh", false, (on) => {
        this.things.robot.visible = on;
      }));
    if (head.cameras.length)
      tools.append(this.tick("Cameras", false, (on) => {
        this.things.cameras.visible = on;
      }));
    this.place.append(bar, tools);
  }

  tick(name, on, change) {
    const box = make("input", "", { type: "checkbox" });
    box.checked = on;
    box.onchange = () => {
      if (change(box.checked) === false) box.checked = !box.checked;
      this.wake();
    };
    const label = make("label", "");
    label.append(box, name);
    return label;
  }

  /** One pane at least stays. */
  showPane(index, on) {
    const others = this.shown.filter((other) => other !== index);
    if (!on && !others.length) return false;
    this.shown = on ? [...others, index].sort((a, b) => a - b) : others;
    this.fresh = true;
    return true;
  }

  /** Makes the controls say what is so. */
  sync() {
    const { head, view } = this;
    this.slider.value = this.time;
    this.clock.textContent = `${(this.time * head.seconds).toFixed(2)} s`;
    this.from.input.value = String(view.followed ?? head.cameras.length);
    if (this.picture.hidden || view.followed === null) return;
    let nearest = 0;
    head.times.forEach((time, index) => {
      if (Math.abs(time - this.time) < Math.abs(head.times[nearest] - this.time)) nearest = index;
    });
    const name = `${view.followed}/${nearest}`;
    if (this.pictured === name) return;
    this.pictured = name;
    this.scenes[0].picture(view.followed, nearest).then((address) => {
      if (address && this.pictured === name) this.picture.src = address;
    });
  }
}

function labelled(name, input) {
  const label = make("label", `${name} `);
  label.append(input);
  return label;
}

function select(name, options) {
  const input = make("select", "");
  options.forEach((option, index) => input.append(make("option", option, { value: index })));
  return { input, label: labelled(name, input) };
}
