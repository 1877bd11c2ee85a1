// Runs one function of a module: node run.mjs KERNELS MODULE REQUEST, with a request as test_module.py writes it.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [kernels, module, request] = process.argv.slice(2);
const { load } = await import(pathToFileURL(kernels).href);
const { name, precision, sizes, samples, people, folder } = JSON.parse(readFileSync(request, "utf8"));
const array = precision === "float64" ? Float64Array : Float32Array;

function numbers(group) {
  const bytes = readFileSync(`${folder}/${group}.bin`);
  return new array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength));
}

const kernel = (await load(readFileSync(module), precision)).prepare(name, sizes, people, samples);
for (const group of ["person", "carry", "own", "shared"]) kernel.set(group, numbers(group));
kernel.run();
for (const group of ["carry", "outputs"]) writeFileSync(`${folder}/${group}.bin`, kernel.get(group));
