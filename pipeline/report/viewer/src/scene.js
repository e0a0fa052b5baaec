// The scene file: docs/spec/scene.md. Steps are those of version 1.

export const STEP = { position: 0.00025, scale: 0.12, smallest: 1e-5, rotation: 1 / 63, colour: 1 / 255, mesh: 0.0001 };
// "ROGS4D", 26, 10.
const MAGIC = [82, 79, 71, 83, 52, 68, 26, 10];

/** Reads the header; sections are read when they are asked for. */
export async function openScene(source) {
  const start = await source.bytes(0, 16);
  if (start.length < 16 || MAGIC.some((byte, k) => start[k] !== byte)) throw new Error("this is no scene");
  const words = new DataView(start.buffer, start.byteOffset, 16);
  if (words.getUint32(8, true) !== 1) throw new Error("a newer viewer is needed for this scene");
  const length = words.getUint32(12, true);
  const header = JSON.parse(new TextDecoder().decode(await source.bytes(16, length)));
  const table = new Map(header.sections.map((section) => [section.name, section]));
  const raw = (section) => source.bytes(16 + length + section.offset, section.bytes);
  return {
    head: header.head,
    count: header.gaussians,
    degree: header.degree,
    has: (name) => table.has(name),
    /** The integers of a section, row-major. */
    async integers(name) {
      const section = table.get(name);
      if (!section) throw new Error(`the scene has no \`${name}\``);
      return unpack(await inflate(await raw(section)), section.rows, section.widths);
    },
    /** The address of a picture, or null. */
    async picture(camera, time) {
      const section = table.get(`picture/${camera}/${time}`);
      if (!section) return null;
      const bytes = await raw(section);
      let text = "";
      for (let k = 0; k < bytes.length; k += 4096) text += String.fromCharCode(...bytes.subarray(k, k + 4096));
      return `data:image/jpeg;base64,${btoa(text)}`;
    },
  };
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Byte planes of folded differences to integers. */
export function unpack(bytes, rows, widths) {
  const channels = widths.length;
  const values = new Int32Array(rows * channels);
  let plane = 0;
  widths.forEach((width, channel) => {
    let before = 0;
    for (let row = 0; row < rows; row++) {
      let folded = 0;
      for (let k = 0; k < width; k++) folded |= bytes[(plane + k) * rows + row] << (8 * k);
      before = (before + ((folded >>> 1) ^ -(folded & 1))) | 0;
      values[row * channels + channel] = before;
    }
    plane += width;
  });
  return values;
}
