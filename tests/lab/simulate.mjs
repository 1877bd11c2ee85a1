// Simulates situations as the page does: node simulate.mjs PAGE KERNELS REQUEST ANSWER.
// A request is a JSON list of situations, or of texts, which are the parts of links after the #.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [page, kernels, request, answer] = process.argv.slice(2);
const { load } = await import(pathToFileURL(kernels).href);
const { Lab, summary } = await import(pathToFileURL(`${page}/loop.mjs`).href);
const situations = await import(pathToFileURL(`${page}/situation.mjs`).href);

const { texts } = await import(pathToFileURL(`${page}/texts.mjs`).href);

const data = JSON.parse(readFileSync(`${page}/lab.json`, "utf8"));
const lab = new Lab(await load(readFileSync(`${page}/lab.wasm`), "float64"), data);

function answered(asked) {
  try {
    if (asked === "lessons") return texts.lessons.map(({ hash }) => hash);
    const situation = typeof asked === "string" ? situations.fromHash(asked, data).situation : situations.checked(asked, data);
    const trace = lab.simulate(situation);
    const hash = situations.hash(situation, data, "1.2.3");
    return {
      situation,
      numbers: lab.controllerNumbers(situation),
      trace,
      summary: summary(trace),
      hash,
      again: situations.fromHash(hash, data),
      toml: situations.toml(situation, data, "1.2.3"),
      command: situations.commandLine(situation, data),
    };
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    return { refused: error.message };
  }
}

// NaN, which JSON does not have, is written as null.
writeFileSync(answer, JSON.stringify(JSON.parse(readFileSync(request, "utf8")).map(answered)));
