// Measure how long the page's simulator takes for one run, in node:
//
//     node benchmarks/lab.mjs [RUNS]
//
// 10 h with one meal, 5-min samples, noise; the design of the controller is made anew in every run, as when a slider of
// its tuning moves. Times are by the clock, so measure on a machine that does nothing else.
import { readFileSync } from "node:fs";
import { load } from "../src/glucoloop/native/targets/wasm/kernels.mjs";
import { Lab } from "../src/glucoloop/lab/page/loop.mjs";
import { checked, usual } from "../src/glucoloop/lab/page/situation.mjs";

const runs = Number(process.argv[2] ?? 200);
const page = new URL("../src/glucoloop/lab/page/", import.meta.url);
const data = JSON.parse(readFileSync(new URL("lab.json", page), "utf8"));
const begun = performance.now();
const lab = new Lab(await load(readFileSync(new URL("lab.wasm", page)), "float64"), data);
console.log(`module ready after ${(performance.now() - begun).toFixed(1)} ms`);
console.log("controller          best  median    95 %, ms");
for (const controller of Object.keys(data.controllers)) {
  for (const guard of [false, true]) {
    const situation = checked({ ...usual(data), controller, guard, noise_variance: 1.45 }, data);
    const times = [];
    for (let run = 0; run < runs; run++) {
      lab.last.of = "";
      const start = performance.now();
      lab.simulate(situation);
      times.push(performance.now() - start);
    }
    times.sort((a, b) => a - b);
    const at = (part) => times[Math.floor(part * (runs - 1))].toFixed(2).padStart(8);
    console.log(`${(controller + (guard ? ", guarded" : "")).padEnd(16)}${at(0)}${at(0.5)}${at(0.95)}`);
  }
}
