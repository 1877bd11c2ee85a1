// @ts-check
/** Files that `glucoloop` writes: root keys of a situation, runs, and people of a trial. */

import { csvRows } from "../../pages/csv.mjs";
import { plotsOf } from "../../pages/data.mjs";
import { VERSION } from "./keys.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./lab.mjs").Trace} Trace */
/** @typedef {Record<string, any>} Keys */

/**
 * The root keys of a configuration file as `glucoloop` writes it: numbers, texts, truths, tables and lists of them.
 * @param {string} text
 * @returns {Keys} what was used, where the file tells it beside what was given
 * @throws {RangeError} with the line that is none of these
 */
export function fromToml(text) {
  /** @type {Keys} */
  const keys = {};
  let into = keys;
  const joined = text.replace(/= \[\n([^]*?)\n\]/g, (_, inside) => `= [${inside.replaceAll("\n", " ")}]`);
  for (const line of joined.split("\n")) {
    if (/^\s*(#.*)?$/.test(line)) continue;
    const table = /^(\[\[?)([\w.]+)\]\]?$/.exec(line);
    const pair = /^(\w+) = (.*)$/.exec(line);
    if (table !== null) {
      const path = table[2].split("."), name = path.pop() ?? "";
      const outer = path.reduce((of, part) => tableIn(of, part, line), keys);
      into = {};
      if (table[1] === "[") set(outer, name, into, line);
      else if (outer[name] === undefined) set(outer, name, [into], line);
      else if (Array.isArray(outer[name])) outer[name].push(into);
      else throw unreadable(line);
    } else if (pair !== null) {
      set(into, pair[1], valueOf(pair[2], line), line);
    } else throw unreadable(line);
  }
  return keys.used === undefined ? keys : { [VERSION]: keys[VERSION], ...keys.used };
}

/** @param {string} line */
const unreadable = (line) => new RangeError(`the configuration has the line '${line}', which this page cannot read`);

/** Give a table a key that it does not have yet, nor any object. @param {Keys} table @param {string} name @param {any} value @param {string} line */
function set(table, name, value, line) {
  if (name in table) throw unreadable(line);
  table[name] = value;
}

/** The table of a name, or the last one of a list of tables. @param {Keys} outer @param {string} name @param {string} line @returns {Keys} */
function tableIn(outer, name, line) {
  if (!(name in outer)) set(outer, name, {}, line);
  const own = Object.hasOwn(outer, name) && Array.isArray(outer[name]) ? outer[name].at(-1) : outer[name];
  if (!Object.hasOwn(outer, name) || typeof own !== "object" || own === null) throw unreadable(line);
  return own;
}

/** @param {string} text @param {string} line */
function valueOf(text, line) {
  try {
    // Short tables are written in one line, as { key = value }, which JSON writes as { "key": value }.
    const json = text.replace(/"(?:[^"\\]|\\.)*"|(\w+) = /g, (whole, key) => (key === undefined ? whole : `"${key}": `));
    return JSON.parse(json.replace(/,\s*\]$/, "]"), (_, value) => {
      if (value === null || (typeof value === "number" && !Number.isFinite(value))) throw unreadable(line);
      return value;
    });
  } catch {
    throw unreadable(line);
  }
}

/**
 * The run of a file `trace.csv`; glucose between samples is not in it.
 * @param {string} text
 * @param {Data} data
 * @returns {Trace}
 * @throws {RangeError} for a table without its columns
 */
export function fromTrace(text, data) {
  const [head, ...lines] = csvRows(text);
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
    bolus_mU: head.includes("bolus_mU") ? numbers("bolus_mU") : t_min.map(() => 0),
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
  for (const { name, panels } of plotsOf(page)) {
    const [{ unit, areas, lines }] = panels;
    const [wide, half] = areas;
    if (unit !== "mg/dl" || half === undefined || lines.length !== 1) continue;
    glucose.push({ name, t_min: lines[0].x, levels: [wide.low, half.low, lines[0].y, half.high, wide.high] });
  }
  return { glucose, keys: fromToml(configuration) };
}
