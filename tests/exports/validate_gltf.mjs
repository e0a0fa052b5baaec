// The validator of Khronos over a glTF file: `npm install gltf-validator`, then `node validate_gltf.mjs FILE`.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const validator = createRequire(process.cwd() + "/")("gltf-validator");
const report = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[2])));
const { numErrors, numWarnings, messages } = report.issues;
for (const { code, message, pointer } of messages.slice(0, 20)) console.log(code, pointer ?? "", message);
console.log(`${numErrors} errors, ${numWarnings} warnings`);
process.exit(numErrors ? 1 : 0);
