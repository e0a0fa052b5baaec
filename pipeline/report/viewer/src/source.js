// Where the bytes of a scene come from: a script beside the page, or a server that answers ranges.

const waiting = new Map();
const given = new Map();

/** Scripts beside the page call this: `rogsScene("name", "base64")`. */
export function give(name, base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  waiting.get(name)?.(bytes);
}

/** Bytes by offset, from a script `{script}` or an address `{url}`. */
export async function open(from) {
  if (from.script) {
    const bytes = await loadScript(from.script);
    return { bytes: async (offset, length) => bytes.subarray(offset, offset + length) };
  }
  return {
    bytes: async (offset, length) => {
      const range = { Range: `bytes=${offset}-${offset + length - 1}` };
      const answer = await fetch(from.url, { headers: range, cache: "no-store" });
      if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
      const bytes = new Uint8Array(await answer.arrayBuffer());
      return answer.status === 206 ? bytes : bytes.subarray(offset, offset + length);
    },
  };
}

function loadScript(name) {
  if (!given.has(name))
    given.set(name, new Promise((resolve, reject) => {
      waiting.set(name, resolve);
      const script = document.createElement("script");
      script.src = name;
      script.onerror = () => reject(new Error(`\`${name}\` is not beside this page`));
      document.head.append(script);
    }));
  return given.get(name);
}

/** Lets the memory of a script's scene go. */
export function forget(from) {
  if (from.script) given.delete(from.script);
}
