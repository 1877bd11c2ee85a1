// Measure the laboratory's page, in node and in Chromium, and compare with what it should take:
//
//     glucoloop lab --out lab.html
//     node benchmarks/lab.mjs [lab.html]
//
// Without the page only node is measured. A browser needs the packages of tests/browser (npm ci --prefix tests/browser),
// and Chromium, at /usr/bin/chromium or where CHROMIUM says. Times are by the clock: measure on a machine that does
// nothing else.
import { existsSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { cpus, loadavg } from "node:os";
import { pathToFileURL } from "node:url";
import { load } from "../src/glucoloop/native/targets/wasm/kernels.mjs";
import { Lab } from "../src/glucoloop/lab/page/lab.mjs";
import { summary } from "../src/glucoloop/lab/page/summary.mjs";
import { some } from "../src/glucoloop/lab/page/many.mjs";
import { checked, usual } from "../src/glucoloop/lab/page/situation.mjs";

const MOVES = 200;
const PEOPLE = 400;
const SETTLED_MS = 4000;
const DAY = { duration_min: 1440, noise_variance: 1.45, meals: [{ t_min: 420, carbs_g: 45 }, { t_min: 720, carbs_g: 70 }] };
const page = new URL("../src/glucoloop/lab/page/", import.meta.url);
const data = JSON.parse(readFileSync(new URL("lab.json", page), "utf8"));

/** Times of a part of the benchmark, in ms. */
const quantile = (times, part) => [...times].sort((a, b) => a - b)[Math.floor(part * (times.length - 1))];

console.log(`${cpus().length} x ${cpus()[0].model}, load ${loadavg()[0].toFixed(1)}\n`);
console.log(`${"".padEnd(58)}${["best", "median", "95 %", "target", "95 %/target"].map((name) => name.padStart(11)).join("")}`);
function tell(name, times, target) {
  const [median, most] = [quantile(times, 0.5), quantile(times, 0.95)];
  const numbers = [Math.min(...times).toFixed(2), median.toFixed(2), most.toFixed(2), target ?? "", target ? (most / target).toFixed(2) : ""];
  console.log(name.padEnd(58) + numbers.map((value) => `${value}`.padStart(11)).join(""));
}

async function inNode() {
  const lab = new Lab(await load(readFileSync(new URL("lab.wasm", page)), "float64"), data);
  const MOVED = { pid: "closed_loop_min", imc: "filter_min", mpc: "move_weight", "mpc-se": "measurement_variance" };
  for (const [controller, setting] of Object.entries(MOVED))
    for (const guard of [false, true]) {
      const times = [];
      for (let i = 0; i < MOVES; i++) {
        const tuning = { [setting]: 5 + i / 1e3 };
        const situation = checked({ ...usual(data), controller, guard, noise_variance: 1.45, tuning }, data);
        const start = performance.now();
        summary(lab.simulate(situation));
        times.push(performance.now() - start);
      }
      tell(`node: ${controller}${guard ? ", guarded" : ""}: ${setting}, 10 h, ms`, times.slice(20));
    }
  for (const family of Object.keys(data.people)) {
    const day = (controller) => checked({ ...usual(data), ...DAY, controller, patient: data.people[family].patient }, data);
    some(lab, day("mpc"), 0, 40);
    for (const [controller, drawn] of [["mpc", ", drawn too"], ["mpc", ""], ["pid", ""], ["mpc-se", ""]]) {
      const start = process.cpuUsage().user;
      some(lab, day(controller), 40, PEOPLE);
      tell(`node: ${family} under ${controller}, one person for a day${drawn}, ms of a core`, [(process.cpuUsage().user - start) / 1000 / PEOPLE]);
    }
  }
}

/** Open the page some times, with a processor that is slower by a factor; times until the first picture. */
async function opened(browser, address, slower) {
  const times = [];
  for (let i = 0; i < 7; i++) {
    const tab = await browser.newPage({ viewport: { width: 1280, height: 900 } });
    const session = await tab.context().newCDPSession(tab);
    await session.send("Emulation.setCPUThrottlingRate", { rate: slower });
    await tab.goto(address);
    await tab.waitForFunction(() => performance.getEntriesByName("first picture").length);
    times.push(await tab.evaluate(() => performance.getEntriesByName("first picture")[0].startTime));
    await tab.close();
  }
  return times.slice(1);
}

/** Move a slider, each time by a step; times of its listener and of what is drawn at the next frame. */
async function moved(browser, address, slider) {
  const tab = await browser.newPage({ viewport: { width: 1280, height: 900 } });
  await tab.addInitScript(() => {
    const own = requestAnimationFrame;
    globalThis.spent = 0;
    globalThis.requestAnimationFrame = (listener) => own((now) => {
      const start = performance.now();
      listener(now);
      globalThis.spent += performance.now() - start;
    });
  });
  await tab.goto(address);
  await tab.waitForFunction(() => document.documentElement.dataset.ready);
  const times = await tab.evaluate(async ({ slider, moves }) => {
    const input = document.getElementById(slider);
    const [least, most] = [Number(input.min), Number(input.max)];
    const found = [];
    for (let i = 0; i < moves; i++) {
      await new Promise((resolve) => setTimeout(resolve, 24));
      input.value = `${least + ((most - least) * (i + 1)) / (moves + 1)}`;
      const start = performance.now();
      input.dispatchEvent(new Event("input"));
      globalThis.spent = performance.now() - start;
      await new Promise((resolve) => setTimeout(resolve, 40));
      found.push(globalThis.spent);
    }
    return found;
  }, { slider, moves: MOVES });
  await tab.close();
  return times.slice(20);
}

/** Try a tuning on people, some seconds after the page was opened, when its workers are there; the first time makes the people. */
async function tried(browser, address, count) {
  const tab = await browser.newPage();
  await tab.goto(address);
  await tab.waitForFunction(() => document.documentElement.dataset.ready);
  await tab.waitForTimeout(SETTLED_MS);
  const times = [];
  for (let i = 0; i < 4; i++) {
    times.push(await tab.evaluate(async (count) => {
      document.getElementById("people-count").value = `${count}`;
      const said = document.getElementById("said");
      said.textContent = "";
      const told = new Promise((resolve) => new MutationObserver(() => said.textContent && resolve()).observe(said, { childList: true }));
      const start = performance.now();
      document.getElementById("people-try").click();
      await told;
      return performance.now() - start;
    }, count));
  }
  await tab.close();
  return times;
}

async function inBrowser(file) {
  const require = createRequire(new URL("../tests/browser/", import.meta.url));
  const { chromium } = require("playwright-core");
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
  const address = pathToFileURL(file).href;
  tell("Chromium: first picture, ms", await opened(browser, address, 1), 400);
  tell("Chromium: first picture, six times slower, ms", await opened(browser, address, 6), 2000);
  for (const [hash, slider] of [["controller=pid", "tuning-closed_loop_min"], ["controller=mpc&sensor=white-noise,+variance=1.45&guard=usual", "tuning-move_weight"], ["controller=mpc-se&sensor=white-noise,+variance=1.45", "tuning-measurement_variance"]]) {
    tell(`Chromium: ${slider.slice(7)} moved and drawn, ms`, await moved(browser, `${address}#${hash}`, slider), 2);
  }
  const day = "#controller=mpc&sensor=white-noise,+variance=1.45&duration_min=1440&meals=45g@420min&meals=70g@720min";
  for (const [count, target] of [[1000, 500], [10_000, 4000]]) {
    const [first, ...others] = await tried(browser, address + day, count);
    tell(`Chromium: ${count} people for a day, at first, ms`, [first], target);
    tell(`Chromium: ${count} people for a day, later, ms`, others, target);
  }
  await browser.close();
}

await inNode();
const [, , file] = process.argv;
if (file !== undefined && existsSync(file)) await inBrowser(file);
