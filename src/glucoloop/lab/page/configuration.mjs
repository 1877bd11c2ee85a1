// @ts-check
/** Files that `glucoloop` writes, read into a situation of the page and runs beside it. */

import { fromHash, VERSION } from "./keys.mjs";
import { checked, familyOf, tuningOf, usual } from "./situation.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./lab.mjs").Trace} Trace */
/** @typedef {Record<string, any>} Keys */

/** Keys that say nothing about what happens to the person whom the page simulates. */
const OF_NO_EFFECT = new Set(["metrics", "allow_unusual", "label", "people", "first_person", "precision", "arithmetic"]);
const OF_A_TRIAL = new Set(["settled", "shard_people", "traces", "population", "days", "design"]);
/** Usual values of keys that a run does not have. @type {Keys} */
const USUAL_OF_A_TRIAL = { meal_size_spread_pct: 0, meal_time_spread_min: 0 };
/** Keys that the page takes as a link tells them. */
const TAKEN = ["patient", "operating_point", "controller", "guard", "noise_variance", "dead_time_min", "duration_min", "seed"];
const MIN_PER_DAY = 1440;

/**
 * The tables of a configuration file as `glucoloop` writes it: keys with numbers, texts, truths and lists of them.
 * @param {string} text
 * @returns {Keys} what was used, where the file tells it beside what was given; with `case`, a list of tables, for a
 * file with several controllers
 * @throws {RangeError} with the line that is none of these
 */
export function fromToml(text) {
  /** @type {Keys} */
  const keys = {};
  let into = keys;
  const joined = text.replace(/= \[\n([^\]]*)\]/g, (_, inside) => `= [${inside.replaceAll("\n", " ")}]`);
  for (const line of joined.split("\n")) {
    if (/^\s*(#.*)?$/.test(line)) continue;
    const table = /^(\[\[?)([\w.]+)\]\]?$/.exec(line);
    const pair = /^(\w+) = (.*)$/.exec(line);
    if (table !== null) {
      const path = table[2].split("."), name = path.pop() ?? "";
      const outer = path.reduce((of, part) => { of[part] ??= {}; return Array.isArray(of[part]) ? of[part].at(-1) : of[part]; }, keys);
      into = {};
      outer[name] = table[1] === "[" ? into : [...(outer[name] ?? []), into];
    } else if (pair !== null) {
      into[pair[1]] = valueOf(pair[2], line);
    } else throw new RangeError(`the configuration has the line '${line}', which this page cannot read`);
  }
  return keys.used === undefined ? keys : { [VERSION]: keys[VERSION], ...keys.used };
}

/** @param {string} text @param {string} line */
function valueOf(text, line) {
  try {
    // Short tables are written in one line, as { key = value }, which JSON writes as { "key": value }.
    const json = text.includes("{ ") ? text.replace(/([{,] )(\w+) = /g, '$1"$2": ') : text;
    return JSON.parse(json.replace(/,\s*\]$/, "]"));
  } catch {
    throw new RangeError(`the configuration has the line '${line}', which this page cannot read`);
  }
}

/**
 * The situation that is nearest to a configuration.
 * @param {Keys} keys
 * @param {Data} data
 * @returns {{situation: Situation, unlike: string[]}} with what the page leaves out, one phrase each
 * @throws {RangeError} with a sentence, for one that the page cannot simulate at all
 */
export function situationOf(keys, data) {
  const { case: cases, days, meals = [], faults = [], ...own } = keys;
  const told = { ...own, ...(cases ?? [{}])[0] };
  const hash = new URLSearchParams();
  for (const name of TAKEN) if (told[name] !== undefined) hash.set(name, `${told[name]}`);
  if (days !== undefined) hash.set("duration_min", `${days * MIN_PER_DAY}`);
  hash.set("meals", meals.join(" "));
  /** @type {Situation} */
  const situation = { ...usual(data), ...fromHash(`#${hash}`, data).situation };
  const standard = tuningOf(situation, data);
  const { controllers, guard_limits, pump_limits, configuration } = familyOf(situation, data);
  const { settings } = controllers[situation.controller];
  const unlike = [];
  for (const [name, value] of Object.entries(told)) {
    if (TAKEN.includes(name) || name === VERSION || OF_NO_EFFECT.has(name) || OF_A_TRIAL.has(name)) continue;
    if (Object.hasOwn(settings, name)) {
      if (value !== standard[name]) situation.tuning = { ...situation.tuning, [name]: value };
    } else if (Object.hasOwn(guard_limits, name)) {
      if (value !== guard_limits[name].usual) situation.guard_limits = { ...situation.guard_limits, [name]: value };
    } else if (Object.hasOwn(pump_limits, name)) {
      if (value !== pump_limits[name].usual) situation.pump_limits = { ...situation.pump_limits, [name]: value };
    } else if (name === "model" || name === "model_noise_variance") {
      if (value !== 0) unlike.push(`${name} = ${JSON.stringify(value)}`);
    } else if (JSON.stringify(value) !== JSON.stringify(standard[name] ?? configuration[name] ?? USUAL_OF_A_TRIAL[name])) {
      unlike.push(`${name} = ${JSON.stringify(value)}`);
    }
  }
  for (const fault of faults) {
    try {
      situation.faults = [...situation.faults, ...fromHash(`#${new URLSearchParams({ faults: fault })}`, data).situation.faults];
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      unlike.push(`the fault ${fault}`);
    }
  }
  return { situation: checked(situation, data), unlike };
}

/**
 * The run of a file `trace.csv`; glucose between samples is not in it.
 * @param {string} text
 * @param {Data} data
 * @returns {Trace}
 * @throws {RangeError} for a table without its columns
 */
export function fromTrace(text, data) {
  const [head, ...lines] = text.trim().split("\n").map((line) => line.split(","));
  const column = (/** @type {string} */ name) => {
    const at = head.indexOf(name);
    if (at < 0) throw new RangeError(`the table has no column ${name}; its columns are ${head.join(", ")}`);
    return lines.map((line) => line[at]);
  };
  const numbers = (/** @type {string} */ name) => column(name).map((cell) => (cell === "" ? NaN : Number(cell)));
  const statuses = Object.fromEntries(Object.entries(data.status_names).map(([value, name]) => [name, Number(value)]));
  const [t_min, glucose_mg_dl] = [numbers("t_min"), numbers("glucose_mg_dl")];
  if (t_min.length < 2 || glucose_mg_dl.some((value) => !Number.isFinite(value))) {
    throw new RangeError("the table has fewer than two samples, or a glucose that is no number");
  }
  return {
    t_min,
    glucose_mg_dl,
    reading_mg_dl: numbers("reading_mg_dl"),
    command_mU_min: numbers("command_mU_min"),
    insulin_mU_min: numbers("insulin_mU_min"),
    status: column("status").map((name) => statuses[name] ?? 0),
    fine_t_min: t_min,
    fine_glucose_mg_dl: glucose_mg_dl,
  };
}

/**
 * @typedef {object} Percentiles
 * @property {string} name of the controller
 * @property {number[]} t_min
 * @property {number[][]} levels glucose in mg/dl, or insulin in mU/min, that 5, 25, 50, 75, 95 % of the people are below
 */

/** Tenths of a minute, in which pages tell times. */
const PER_MIN = 10;

/**
 * Percentiles and the configuration that a trial's page tells.
 * @param {Document} page
 * @returns {{glucose: Percentiles[], keys: Keys}}
 * @throws {RangeError} for another page
 */
export function fromPage(page) {
  const configuration = [...page.querySelectorAll("details pre code")].map((code) => code.textContent ?? "").find((text) => text.includes(`${VERSION} = `));
  if (configuration === undefined) throw new RangeError("the page tells no configuration; give a page that glucoloop wrote");
  const glucose = [];
  for (const panel of page.querySelectorAll('.panel[data-unit="mg/dl"]')) {
    const step = Number(panel.getAttribute("data-step"));
    const paths = [...panel.querySelectorAll("path[data-name]")];
    const [wide, half] = paths.filter((path) => path.getAttribute("data-kind") === "band").map((path) => pointsOf(path, step));
    const median = paths.find((path) => path.getAttribute("data-name") === "median");
    if (wide === undefined || half === undefined || median === undefined) continue;
    const middle = pointsOf(median, step);
    const name = panel.closest("figure")?.getAttribute("aria-label") ?? "";
    const t_min = middle.map(({ t }) => t);
    const edge = (/** @type {{t: number, value: number}[]} */ points) => t_min.map((t) => at(points, t));
    const low = (/** @type {typeof wide} */ band) => band.slice(band.length / 2).reverse();
    const high = (/** @type {typeof wide} */ band) => band.slice(0, band.length / 2);
    glucose.push({ name, t_min, levels: [edge(low(wide)), edge(low(half)), middle.map(({ value }) => value), edge(high(half)), edge(high(wide))] });
  }
  return { glucose, keys: fromToml(configuration) };
}

/** Points of a path of a page, each from the one before. @param {Element} path @param {number} step */
function pointsOf(path, step) {
  let [x, y] = [0, 0];
  const numbers = (path.getAttribute("d") ?? "").match(/-?\d+/g) ?? [];
  const points = [];
  for (let i = 0; i + 1 < numbers.length; i += 2) {
    x += Number(numbers[i]);
    y += Number(numbers[i + 1]);
    points.push({ t: x / PER_MIN, value: y * step });
  }
  return points;
}

/** Value at a time, on the line between two points. @param {{t: number, value: number}[]} points @param {number} t */
function at(points, t) {
  const after = points.findIndex((point) => point.t >= t);
  if (after <= 0) return points[after === 0 ? 0 : points.length - 1].value;
  const [a, b] = [points[after - 1], points[after]];
  return a.value + ((b.value - a.value) * (t - a.t)) / (b.t - a.t);
}
