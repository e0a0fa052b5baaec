// The splat pass: the formulas of docs/spec/rasteriser.md sections 3 to 8, front to back into a half-float target.
import * as THREE from "three";

const BUCKETS = 65536;
const NEAR = 0.001;

const VERTEX = `
precision highp float;
precision highp int;
precision highp sampler2D;
in vec3 position;
in uint order;
uniform sampler2D centres, rotations, scales, colours, harmonics;
uniform mat3 turn;
uniform vec3 shift;
uniform vec4 lens;
uniform vec2 size;
uniform float eps, least, degree;
uniform int mode;
uniform vec3 links[64];
out vec2 offset;
out vec3 conic;
out vec4 value;

void main() {
  ivec2 at = ivec2(int(order) & 1023, int(order) >> 10);
  vec4 centre = texelFetch(centres, at, 0);
  vec4 q = texelFetch(rotations, at, 0);
  vec4 scale = texelFetch(scales, at, 0);
  vec4 colour = texelFetch(colours, at, 0);
  vec3 p = turn * centre.xyz + shift;
  float opacity = centre.w;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z < ${NEAR} || opacity < max(least, 1.0 / 255.0)) return;
  q /= length(q);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  mat3 m = mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
  m = turn * m * mat3(scale.x, 0.0, 0.0, 0.0, scale.y, 0.0, 0.0, 0.0, scale.z);
  vec2 low = -lens.zw / lens.xy - 0.15 * size / lens.xy;
  vec2 high = (size - lens.zw) / lens.xy + 0.15 * size / lens.xy;
  vec2 u = clamp(p.xy / p.z, low, high);
  vec3 first = lens.x / p.z * (vec3(m[0].x, m[1].x, m[2].x) - u.x * vec3(m[0].z, m[1].z, m[2].z));
  vec3 second = lens.y / p.z * (vec3(m[0].y, m[1].y, m[2].y) - u.y * vec3(m[0].z, m[1].z, m[2].z));
  float a = dot(first, first), c = dot(second, second), b = dot(first, second);
  vec3 across = cross(first, second);
  float det = dot(across, across) + eps * (a + c) + eps * eps;
  a += eps;
  c += eps;
  conic = vec3(c, -b, a) / det;
  float reach = 2.0 * log(255.0 * opacity);
  offset = position.xy * (sqrt(reach * vec2(a, c)) + 0.5);
  vec2 pixel = lens.xy * p.xy / p.z + lens.zw + offset;
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  if (mode == 1) {
    value = vec4(p.z, 0.0, 0.0, opacity);
  } else if (mode == 2) {
    value = vec4(colour.w, 0.0, 0.0, opacity);
  } else if (mode == 3) {
    int link = int(scale.w + 0.5);
    value = vec4(link < 64 ? links[link] : vec3(dot(colour.rgb, vec3(0.1, 0.2, 0.1))), opacity);
  } else {
    vec3 rgb = colour.rgb;
    if (degree > 0.5) {
      vec3 way = normalize(centre.xyz + transpose(turn) * shift);
      ivec2 h = ivec2((int(order) * 3) % 3072, at.y);
      vec3 sum = -way.y * texelFetch(harmonics, h, 0).rgb + way.z * texelFetch(harmonics, h + ivec2(1, 0), 0).rgb
        - way.x * texelFetch(harmonics, h + ivec2(2, 0), 0).rgb;
      rgb = max(vec3(0.0), rgb + 0.48860251 * sum);
    }
    value = vec4(rgb, opacity);
  }
}`;

const FRAGMENT = `
precision highp float;
in vec2 offset;
in vec3 conic;
in vec4 value;
out vec4 colour;
void main() {
  float sigma = 0.5 * (conic.x * offset.x * offset.x + conic.z * offset.y * offset.y) + conic.y * offset.x * offset.y;
  float alpha = min(0.999, value.a * exp(-sigma));
  if (sigma < 0.0 || alpha < 1.0 / 255.0) discard;
  colour = vec4(value.rgb * alpha, alpha);
}`;

/** The Gaussians of a field as they look from a camera. */
export class Splats {
  constructor(field, linkColours) {
    this.field = field;
    const texture = (array, width) => {
      const made = new THREE.DataTexture(array, width, field.rows, THREE.RGBAFormat, THREE.FloatType);
      made.needsUpdate = true;
      return made;
    };
    this.textures = {
      centres: texture(field.centre, 1024),
      rotations: texture(field.rotation, 1024),
      scales: texture(field.scale, 1024),
      colours: texture(field.colour, 1024),
      harmonics: field.harmonics ? texture(field.harmonics, 3072) : texture(new Float32Array(4 * field.rows), 1),
    };
    const geometry = new THREE.InstancedBufferGeometry();
    const corners = new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]);
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    this.order = new THREE.InstancedBufferAttribute(new Uint32Array(field.count), 1);
    this.order.setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("order", this.order);
    this.uniforms = {
      ...Object.fromEntries(Object.entries(this.textures).map(([name, value]) => [name, { value }])),
      turn: { value: new THREE.Matrix3() },
      shift: { value: new THREE.Vector3() },
      lens: { value: new THREE.Vector4() },
      size: { value: new THREE.Vector2() },
      eps: { value: 0.3 },
      least: { value: 0 },
      degree: { value: field.harmonics ? 1 : 0 },
      mode: { value: 0 },
      links: { value: linkColours },
    };
    const material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: this.uniforms,
      depthTest: false,
      depthWrite: false,
      side: THREE.DoubleSide,
      blending: THREE.CustomBlending,
      // Front to back: what comes later is behind what is there.
      blendSrc: THREE.OneMinusDstAlphaFactor,
      blendDst: THREE.OneFactor,
      blendSrcAlpha: THREE.OneMinusDstAlphaFactor,
      blendDstAlpha: THREE.OneFactor,
      premultipliedAlpha: true,
    });
    this.geometry = geometry;
    this.material = material;
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.scene = new THREE.Scene();
    this.scene.add(this.mesh);
    this.keys = new Uint16Array(field.count);
    this.histogram = new Uint32Array(BUCKETS);
    this.range = [0.1, 2];
  }

  /** Takes the arrays of the field for a time. */
  show(time) {
    const looks = this.field.show(time);
    this.textures.centres.needsUpdate = true;
    this.textures.colours.needsUpdate = true;
    if (looks) this.textures.rotations.needsUpdate = this.textures.scales.needsUpdate = true;
  }

  /** Order by depth along the axis of a view, nearest first, by counting; those behind it are left out. */
  sort(view) {
    const { centre, count } = this.field;
    const [, , , , , , a, b, c] = view.turn;
    const d = view.shift[2];
    let near = Infinity;
    let far = 0;
    for (let n = 0; n < count; n++) {
      const z = a * centre[4 * n] + b * centre[4 * n + 1] + c * centre[4 * n + 2] + d;
      if (z < NEAR) continue;
      if (z < near) near = z;
      if (z > far) far = z;
    }
    // Equal steps of the logarithm: near things need the finer order.
    const start = Math.log(near);
    const steps = (BUCKETS - 1) / Math.max(1e-6, Math.log(far) - start);
    this.histogram.fill(0);
    for (let n = 0; n < count; n++) {
      const z = a * centre[4 * n] + b * centre[4 * n + 1] + c * centre[4 * n + 2] + d;
      if (z < NEAR) continue;
      const key = ((Math.log(z) - start) * steps) | 0;
      this.keys[n] = key;
      this.histogram[key]++;
    }
    let total = 0;
    for (let key = 0; key < BUCKETS; key++) {
      const own = this.histogram[key];
      this.histogram[key] = total;
      total += own;
    }
    this.range = this.quantiles(total, (key) => Math.exp(start + key / steps));
    const order = this.order.array;
    for (let n = 0; n < count; n++) {
      const z = a * centre[4 * n] + b * centre[4 * n + 1] + c * centre[4 * n + 2] + d;
      if (z >= NEAR) order[this.histogram[this.keys[n]]++] = n;
    }
    this.geometry.instanceCount = total;
    this.order.needsUpdate = true;
  }

  /** Depths with 2 % nearer and 2 % farther; the histogram holds sums. */
  quantiles(total, depth) {
    const at = (part) => {
      let low = 0;
      let high = BUCKETS - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (this.histogram[middle] <= part * total) low = middle;
        else high = middle - 1;
      }
      return depth(low);
    };
    return [at(0.02), at(0.98)];
  }

  /** Draws into a target of the size of the view. */
  draw(renderer, target, view, mode, least) {
    const u = this.uniforms;
    u.turn.value.set(...view.turn);
    u.shift.value.set(...view.shift);
    u.lens.value.set(...view.lens);
    u.size.value.set(view.width, view.height);
    u.eps.value = view.eps;
    u.mode.value = mode;
    u.least.value = least;
    renderer.setRenderTarget(target);
    renderer.setClearColor(0x000000, 0);
    renderer.clear();
    renderer.render(this.scene, NOBODY);
    renderer.setRenderTarget(null);
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
    Object.values(this.textures).forEach((texture) => texture.dispose());
  }
}

const NOBODY = new THREE.Camera();
