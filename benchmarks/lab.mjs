// Measure how long the page's simulator takes for one move of a slider, in node:
//
//     node benchmarks/lab.mjs [MOVES]
//
// 10 h with one meal, 5-min samples, noise. At each move the controller is designed anew, with other variances of the
// Kalman filter; or the meal is another one. Times are by the clock, so measure on a machine that does nothing else.
import { readFileSync } from "node:fs";
import { load } from "../src/glucoloop/native/targets/wasm/kernels.mjs";
import { Lab, summary } from "../src/glucoloop/lab/page/loop.mjs";
import { checked, usual } from "../src/glucoloop/lab/page/situation.mjs";

const moves = Number(process.argv[2] ?? 200);
const page = new URL("../src/glucoloop/lab/page/", import.meta.url);
const data = JSON.parse(readFileSync(new URL("lab.json", page), "utf8"));
const begun = performance.now();
const lab = new Lab(await load(readFileSync(new URL("lab.wasm", page)), "float64"), data);
console.log(`module ready after ${(performance.now() - begun).toFixed(1)} ms`);

function report(name, move) {
  const times = [];
  for (let i = 0; i < moves; i++) {
    const situation = checked(move(i), data);
    const start = performance.now();
    summary(lab.simulate(situation));
    times.push(performance.now() - start);
  }
  const first = times[0].toFixed(2).padStart(8);
  times.sort((a, b) => a - b);
  const at = (part) => times[Math.floor(part * (moves - 1))].toFixed(2).padStart(8);
  console.log(`${name.padEnd(28)}${first}${at(0)}${at(0.5)}${at(0.95)}`);
}

const MOVED = { pid: "closed_loop_min", imc: "filter_min", mpc: "move_weight", "mpc-se": "measurement_variance" };
console.log("move                           first    best  median    95 %, ms");
for (const [controller, setting] of Object.entries(MOVED)) {
  for (const guard of [false, true]) {
    const now = { ...usual(data), controller, guard, noise_variance: 1.45 };
    report(`${controller}${guard ? ", guarded" : ""}: ${setting}`, (i) => ({ ...now, tuning: { [setting]: 5 + i / 1e3 } }));
  }
}
report("mpc: a meal", (i) => ({ ...usual(data), meals: [{ t_min: 50 + i / 1e3, carbs_g: 50 }] }));
