// From where a scene is seen: cameras of the clip, and a free one that is orbited or flown.
import * as THREE from "three";
import { FlyControls } from "three/addons/controls/FlyControls.js";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Variance of the low-pass filter of the rasteriser, square pixels of the clip's images. */
const EPS = 0.3;
// Axes of cameras: ours are x right, y down, z forward; those of three.js y up, z backward.
const FLIP = new THREE.Matrix4().makeScale(1, -1, -1);

export class View {
  /** `wake` is called when something has moved. */
  constructor(head, element, wake) {
    this.head = head;
    this.element = element;
    this.wake = wake;
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.001, 100);
    this.camera.matrixAutoUpdate = true;
    const up = head.recon_from_base;
    this.camera.up.set(up[2], up[6], up[10]).normalize();
    this.followed = head.cameras.length ? 0 : null;
    this.distance = 0.8;
    this.use("orbit");
    if (this.followed === null) {
      this.camera.position.set(0, 0, -1);
      this.controls.target.set(0, 0, 1);
      this.controls.update();
    }
  }

  /** `orbit` or `fly`. */
  use(kind) {
    this.controls?.dispose();
    this.kind = kind;
    if (kind === "fly") {
      this.controls = new FlyControls(this.camera, this.element);
      this.controls.dragToLook = true;
      this.controls.movementSpeed = 0.3;
      this.controls.rollSpeed = 0.4;
    } else {
      this.controls = new OrbitControls(this.camera, this.element);
      this.controls.target.copy(this.ahead());
    }
    this.controls.addEventListener("start", () => this.leave());
    this.controls.addEventListener("change", () => this.wake());
  }

  /** The point ahead that is turned about. */
  ahead() {
    return this.camera.getWorldDirection(new THREE.Vector3()).multiplyScalar(this.distance).add(this.camera.position);
  }

  /** From the camera of the clip that is followed to a free one at its place. */
  leave() {
    if (this.followed === null) return;
    this.followed = null;
    if (this.kind === "orbit") this.controls.target.copy(this.ahead());
    this.onleave?.();
  }

  follow(index) {
    this.followed = index;
    this.lens = this.head.cameras[index];
    this.wake();
  }

  /** Moves the camera: with a clip camera at a time, or by what the hands do. */
  step(time, seconds) {
    if (this.followed !== null) {
      const pose = this.head.cameras[this.followed].recon_from_camera;
      matrixAt(pose, this.head.times, time).multiply(FLIP).decompose(this.camera.position, this.camera.quaternion, SCALE);
      this.camera.updateMatrixWorld(true);
    } else if (this.kind === "fly") {
      this.controls.update(seconds);
    }
  }

  /** The view of a picture of this size: world to camera, lens in pixels, filter. */
  of(width, height) {
    this.camera.updateMatrixWorld(true);
    const clip = this.lens ?? this.head.cameras[0] ?? { width: 640, height: 352, fx: 500, fy: 500, cx: 320, cy: 176 };
    const factor = Math.min(width / clip.width, height / clip.height);
    const lens = [
      clip.fx * factor,
      clip.fy * factor,
      (clip.cx - clip.width / 2) * factor + width / 2,
      (clip.cy - clip.height / 2) * factor + height / 2,
    ];
    const recon = this.camera.matrixWorld.clone().multiply(FLIP).invert().elements;
    const turn = [0, 1, 2].flatMap((row) => [0, 1, 2].map((column) => recon[4 * column + row]));
    return { width, height, lens, turn, shift: [recon[12], recon[13], recon[14]], eps: EPS * factor * factor };
  }

  /** The camera of three.js with the lens of a view. */
  camera3(view) {
    const [fx, fy, cx, cy] = view.lens;
    const { near, far } = this.camera;
    this.camera.projectionMatrix.set(
      (2 * fx) / view.width, 0, 1 - (2 * cx) / view.width, 0,
      0, (2 * fy) / view.height, (2 * cy) / view.height - 1, 0,
      0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near),
      0, 0, -1, 0,
    );
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
    return this.camera;
  }

  dispose() {
    this.controls.dispose();
  }
}

const SCALE = new THREE.Vector3();

/** A row-major pose between those of stored times. */
export function matrixAt(poses, times, time) {
  const of = (index) => new THREE.Matrix4().set(...poses[index]);
  let left = 0;
  while (left < times.length - 1 && times[left + 1] <= time + 1e-9) left++;
  if (left === times.length - 1 || time <= times[left]) return of(left);
  const part = (time - times[left]) / (times[left + 1] - times[left]);
  const [a, b] = [of(left), of(left + 1)].map((matrix) => {
    const parts = [new THREE.Vector3(), new THREE.Quaternion(), new THREE.Vector3()];
    matrix.decompose(...parts);
    return parts;
  });
  return new THREE.Matrix4().compose(a[0].lerp(b[0], part), a[1].slerp(b[1], part), a[2]);
}
