// The canvas: panes side by side, each a field from the same camera at the same time.
import * as THREE from "three";

export const MODES = ["Colour", "Depth", "Displacement", "Links"];
/** Pixels that are drawn for a pixel of the clip, at most: a field knows no finer detail. One without graphics hardware. */
const DETAIL = 3;

const RAMPS = `
vec3 ramp(float x) {
  return clamp(vec3(1.8 * x, 1.9 * x - 0.75, 0.35 + 0.9 * x - 2.6 * max(x - 0.35, 0.0) + 1.6 * max(x - 0.75, 0.0)), 0.0, 1.0);
}
vec3 heat(float x) { return clamp(vec3(2.0 * x, 2.0 * x - 1.0, 0.0), 0.0, 1.0); }`;

export class Stage {
  constructor(canvas, wake) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    if (!this.renderer.extensions.has("EXT_color_buffer_float") && !this.renderer.extensions.has("EXT_color_buffer_half_float"))
      throw new Error("this browser cannot draw into half-float pictures");
    const gl = this.renderer.getContext();
    const told = gl.getExtension("WEBGL_debug_renderer_info");
    const maker = told ? String(gl.getParameter(told.UNMASKED_RENDERER_WEBGL)) : "";
    this.detail = /swiftshader|llvmpipe|software/i.test(maker) ? 1 : DETAIL;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", wake);
    this.target = new THREE.WebGLRenderTarget(1, 1, {
      type: THREE.HalfFloatType,
      format: THREE.RGBAFormat,
      depthBuffer: false,
      magFilter: THREE.LinearFilter,
      minFilter: THREE.LinearFilter,
    });
    this.last = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      depthTest: false,
      depthWrite: false,
      uniforms: { drawn: { value: this.target.texture }, mode: { value: 0 }, range: { value: new THREE.Vector2(0, 1) } },
      vertexShader: "in vec3 position; out vec2 at; void main() { at = position.xy * 0.5 + 0.5; gl_Position = vec4(position, 1.0); }",
      fragmentShader: `precision highp float;
        uniform sampler2D drawn; uniform int mode; uniform vec2 range; in vec2 at; out vec4 colour;
        ${RAMPS}
        void main() {
          vec4 sum = texture(drawn, at);
          float part = (sum.r / max(sum.a, 1e-6) - range.x) / (range.y - range.x);
          vec3 shown = sum.rgb;
          if (mode == 1) shown = sum.a > 0.01 ? ramp(clamp(part, 0.0, 1.0)) : vec3(0.0);
          if (mode == 2) shown = sum.a > 0.01 ? heat(clamp(part, 0.0, 1.0)) : vec3(0.0);
          colour = vec4(shown, 1.0);
        }`,
    });
    this.quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.last);
    this.quad.frustumCulled = false;
    this.flat = new THREE.Scene();
    this.flat.add(this.quad);
    this.nobody = new THREE.Camera();
  }

  /** Draws the panes from left to right over a picture of this size. */
  draw(panes, view, things, { mode, least, width, height }) {
    const { renderer } = this;
    renderer.setPixelRatio(1);
    if (renderer.domElement.width !== width * panes.length || renderer.domElement.height !== height)
      renderer.setSize(width * panes.length, height, false);
    const clip = view.head.cameras[0] ?? { width: 320, height: 176 };
    const factor = Math.min(1, (this.detail * clip.width) / width, (this.detail * clip.height) / height);
    const size = [Math.max(1, Math.round(width * factor)), Math.max(1, Math.round(height * factor))];
    if (this.target.width !== size[0] || this.target.height !== size[1]) this.target.setSize(...size);
    const own = view.of(...size);
    renderer.setRenderTarget(null);
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, width * panes.length, height);
    renderer.setClearColor(0x000000, 1);
    renderer.clear();
    panes.forEach((splats, index) => {
      splats.sort(own);
      splats.draw(renderer, this.target, own, mode, least);
      renderer.setViewport(index * width, 0, width, height);
      renderer.setScissor(index * width, 0, width, height);
      renderer.setScissorTest(true);
      this.last.uniforms.mode.value = mode;
      this.last.uniforms.range.value.set(...(mode === 1 ? splats.range : [0, 0.1]));
      renderer.render(this.flat, this.nobody);
      if (things?.seen) {
        renderer.clearDepth();
        renderer.render(things.scene, view.camera3(view.of(width, height)));
      }
      renderer.setScissorTest(false);
    });
  }

  dispose() {
    this.target.dispose();
    this.last.dispose();
    this.quad.geometry.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}
