// Simulates situations as the page does: node simulate.mjs PAGE KERNELS REQUEST ANSWER [FOLDER OF OTHER DATA].
// A request is a JSON list of situations; of texts, which are the parts of links after the #; or of {link, samples}, for
// what the controller expects at these samples; of {link, person}, for a person of the
// population; or of {toml, csv}, files that glucoloop wrote.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [page, kernels, request, answer, built = page] = process.argv.slice(2);
const { load } = await import(pathToFileURL(kernels).href);
const { Lab } = await import(pathToFileURL(`${page}/lab.mjs`).href);
const { summary } = await import(pathToFileURL(`${page}/summary.mjs`).href);
const { checked } = await import(pathToFileURL(`${page}/situation.mjs`).href);
const { fromHash, hash: hashOf, situationOf } = await import(pathToFileURL(`${page}/keys.mjs`).href);
const links = await import(pathToFileURL(`${page}/links.mjs`).href);
const { usualUnits } = await import(pathToFileURL(`${page}/units.mjs`).href);
const { ofFault, ofSensor } = await import(pathToFileURL(`${page}/fields.mjs`).href);
const { draws } = await import(pathToFileURL(`${page}/draws.mjs`).href);
const repeat = await import(pathToFileURL(`${page}/repeat.mjs`).href);

const { texts } = await import(pathToFileURL(`${page}/texts.mjs`).href);

const { predicted, termsOf } = await import(pathToFileURL(`${page}/prediction.mjs`).href);

const { fromToml, fromTrace } = await import(pathToFileURL(`${page}/configuration.mjs`).href);

const { some } = await import(pathToFileURL(`${page}/many.mjs`).href);
const { personOf } = await import(pathToFileURL(`${page}/people.mjs`).href);

const data = JSON.parse(readFileSync(`${built}/lab.json`, "utf8"));
const lab = new Lab(await load(readFileSync(`${built}/lab.wasm`), "float64"), data);

async function answered(asked) {
  try {
    if (asked === "lessons" || asked === "presets") return texts[asked];
    if (asked.toml !== undefined) {
      const read = situationOf(fromToml(asked.toml), data);
      return { ...read, here: lab.simulate(read.situation), table: asked.csv && fromTrace(asked.csv, data) };
    }
    if (asked.people !== undefined) {
      const { situation } = links.fromLink(asked.link, data);
      const crowd = some(lab, situation, 0, asked.people);
      const command = repeat.commandForPeople(situation, data, asked.people);
      return { command, score: crowd.score(), worst: crowd.worst(3), percentiles: crowd.percentiles("") };
    }
    if (asked.person !== undefined) {
      const { situation } = links.fromLink(asked.link, data);
      const body = personOf(lab, situation.patient, asked.person);
      if (body === null) return { absent: true };
      const { basal_insulin_mU_min, glucose_mg_dl } = body;
      return { basal_insulin_mU_min, glucose_mg_dl, x: [...body.x], trace: lab.simulate(situation, body) };
    }
    const found = typeof asked === "string" ? links.fromLink(asked, data)
      : asked.link !== undefined ? { ...links.fromLink(asked.link, data), samples: asked.samples }
        : { situation: asked, units: usualUnits() };
    const situation = checked(found.situation, data);
    const { memory, ...trace } = lab.simulate(situation, undefined, { memory: true });
    const predictions = (found.samples ?? []).map((sample) => predicted(lab, situation, { ...trace, memory }, sample));
    const terms = (found.samples ?? []).map((sample) => termsOf(lab, situation, { ...trace, memory }, sample));
    const hash = hashOf(situation, data, "1.2.3");
    const link = links.link({ situation, units: found.units, person: found.person ?? null }, data, "1.2.3");
    return {
      situation,
      numbers: lab.controllerNumbers(situation),
      sensors: ofSensor(situation, data).map(({ name, numbers, drawing }) => {
        const drawn = drawing && draws(lab, drawing, situation.seed, trace.t_min.length);
        return { name, numbers, start: [...drawn?.start ?? []], samples: [...drawn?.samples ?? []] };
      }),
      faults: situation.faults.map((fault) => ofFault(fault, data).numbers),
      trace,
      summary: summary(trace),
      predictions,
      terms,
      unlike: found.unlike,
      hash,
      link,
      units: found.units,
      again: fromHash(hash, data),
      toml: repeat.toml(situation, data, "1.2.3"),
      command: repeat.commandLine(situation, data),
      python: repeat.python(situation, data),
    };
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    return { refused: error.message };
  }
}

// NaN, which JSON does not have, is written as null.
const answers = [];
for (const asked of JSON.parse(readFileSync(request, "utf8"))) answers.push(await answered(asked));
writeFileSync(answer, JSON.stringify(answers));
