// What is drawn over the Gaussians: the robot's mesh and the frusta of the cameras.
import * as THREE from "three";
import { STEP } from "./scene.js";
import { matrixAt } from "./view.js";

/** Colours of links, far apart in hue. */
export function linkColours(count) {
  return Array.from({ length: Math.max(64, count) }, (_, k) => {
    const colour = new THREE.Color().setHSL((k * 0.618034) % 1, 0.75, 0.55, THREE.LinearSRGBColorSpace);
    return new THREE.Vector3(colour.r, colour.g, colour.b);
  });
}

export class Things {
  constructor(scene, colours) {
    this.head = scene.head;
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x555566, 3));
    this.robot = new THREE.Group();
    this.cameras = new THREE.Group();
    this.robot.visible = this.cameras.visible = false;
    this.scene.add(this.robot, this.cameras);
    this.links = [];
    this.loading = this.load(scene, colours);
    this.frusta = this.head.cameras.map((camera) => {
      const lines = new THREE.LineSegments(frustum(camera), line(camera.held_out ? 0x55ccff : 0xffcc33));
      lines.matrixAutoUpdate = false;
      this.cameras.add(lines);
      return lines;
    });
  }

  get hasRobot() {
    return this.head.links.some((_, link) => this.robotSections.has(`mesh/${link}/positions`));
  }

  async load(scene, colours) {
    this.robotSections = scene;
    for (let link = 0; link < this.head.links.length; link++) {
      if (!scene.has(`mesh/${link}/positions`)) continue;
      const positions = Float32Array.from(await scene.integers(`mesh/${link}/positions`), (steps) => steps * STEP.mesh);
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
      geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(await scene.integers(`mesh/${link}/triangles`)), 1));
      const colour = new THREE.Color().setRGB(colours[link].x, colours[link].y, colours[link].z, THREE.LinearSRGBColorSpace);
      const look = { color: colour, flatShading: true, transparent: true, opacity: 0.75, side: THREE.DoubleSide };
      const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial(look));
      mesh.matrixAutoUpdate = false;
      this.links.push([link, mesh]);
      this.robot.add(mesh);
    }
  }

  /** Puts everything where it is at a time; the camera that one looks through is not drawn. */
  place(time, followed) {
    const { times, recon_from_link: links } = this.head;
    if (links.length)
      for (const [link, mesh] of this.links) {
        mesh.matrix.copy(matrixAt(links.map((all) => all[link]), times, time));
        mesh.matrixWorldNeedsUpdate = true;
      }
    this.frusta.forEach((lines, index) => {
      lines.matrix.copy(matrixAt(this.head.cameras[index].recon_from_camera, times, time));
      lines.matrixWorldNeedsUpdate = true;
      lines.visible = index !== followed && !this.hides(index, followed, time);
    });
  }

  /** Whether a camera stands so near to the one that one looks through that it would fill the picture. */
  hides(index, followed, time) {
    if (followed === null) return false;
    const at = (camera) => {
      const pose = matrixAt(this.head.cameras[camera].recon_from_camera, this.head.times, time);
      return new THREE.Vector3().setFromMatrixPosition(pose);
    };
    return at(index).distanceTo(at(followed)) < 0.15;
  }

  get seen() {
    return this.robot.visible || this.cameras.visible;
  }

  dispose() {
    this.scene.traverse((thing) => {
      thing.geometry?.dispose();
      thing.material?.dispose();
    });
  }
}

const line = (color) => new THREE.LineBasicMaterial({ color, depthTest: true });

/** The pyramid of a camera, 10 cm deep. */
function frustum({ width, height, fx, fy, cx, cy }) {
  const depth = 0.1;
  const corner = (x, y) => [((x - cx) / fx) * depth, ((y - cy) / fy) * depth, depth];
  const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
  const points = corners.flatMap((at, k) => [[0, 0, 0], at, at, corners[(k + 1) % 4]]);
  return new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(points.flat()), 3));
}
