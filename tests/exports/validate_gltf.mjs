// The validator of Khronos over a glTF file: `npm install gltf-validator`, then `node validate_gltf.mjs FILE`. It does not
// know KHR_gaussian_splatting yet, whose attributes it calls invalid names: these are counted apart.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const validator = createRequire(process.cwd() + "/")("gltf-validator");
const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[2])), { maxIssues: 0 });
const unknown = ({ code, pointer = "" }) =>
  code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE" && pointer.includes("/KHR_gaussian_splatting:");
const others = issues.messages.filter((message) => !unknown(message));
for (const { code, severity, pointer, message } of others.slice(0, 20)) console.log(severity, code, pointer ?? "", message);
const errors = others.filter(({ severity }) => severity === 0).length;
const apart = issues.messages.length - others.length;
console.log(`validator ${validator.version()}: ${errors} errors, ${issues.numWarnings} warnings, ${apart} attributes of an unknown extension`);
process.exit(errors ? 1 : 0);
