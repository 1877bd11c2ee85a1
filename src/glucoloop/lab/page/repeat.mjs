// @ts-check
/** A situation as other parts of glucoloop take it: a command, a configuration file, a program in Python. */

import { keys, VERSION } from "./keys.mjs";
import { familyOf } from "./situation.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */

/** Options whose names are not those of the keys. @type {Record<string, string>} */
const OPTIONS = {
  duration_min: "duration",
  noise_variance: "noise",
  dead_time_min: "dead-time",
  model_noise_variance: "model-noise",
  max_change_mU_min: "max-rate-change",
  min_insulin_mU_min: "min-insulin",
  max_insulin_mU_min: "max-insulin",
  meals: "meal",
  faults: "fault",
};

/**
 * The command that computes the same.
 * @param {Situation} situation
 * @param {Data} data
 */
export function commandLine(situation, data) {
  return command("run", keys(situation, data));
}

/**
 * The command that tries the same on people around the patient; with noise, each has noise of his own there.
 * @param {Situation} situation
 * @param {Data} data
 * @param {number} people
 */
export function commandForPeople(situation, data, people) {
  const { seed } = data.people[data.patients[situation.patient].family];
  return command("trial", [["people", people], ...keys(situation, data).filter(([name]) => name !== "seed"), ["seed", seed]]);
}

/** @param {"run" | "trial"} name @param {ReturnType<typeof keys>} given */
function command(name, given) {
  const words = [`glucoloop ${name}`];
  for (const [name, value] of given) {
    const option = OPTIONS[name] ?? name.replaceAll("_", "-");
    if (Array.isArray(value) && value.length === 0) words.push(`--no-${option}`);
    else if (Array.isArray(value)) words.push(...value.map((part) => `--${option} ${quoted(part)}`));
    else words.push(value === true ? `--${option}` : `--${option} ${value}`);
  }
  return words.join(" ");
}

/** A text as one word of a command. @param {string} text */
function quoted(text) {
  return /^[\w.@:/=+-]+$/.test(text) ? text : `'${text}'`;
}

/**
 * The situation as a configuration file of `glucoloop run --config`.
 * @param {Situation} situation
 * @param {Data} data
 * @param {string} version
 */
export function toml(situation, data, version) {
  const lines = values(situation, data).map(([name, text]) => `${name} = ${text}`);
  return `${[`${VERSION} = "${version}"`, ...lines].join("\n")}\n`;
}

/**
 * A program in Python that computes the same.
 * @param {Situation} situation
 * @param {Data} data
 */
export function python(situation, data) {
  const lines = values(situation, data).map(([name, text]) => `    "${name}": ${text === "true" ? "True" : text},`);
  return `from glucoloop.config.run import read_run
from glucoloop.studies.closed_loop import close_the_loop

keys = {
${lines.join("\n")}
}
outcome = close_the_loop(read_run(keys))
print(outcome.metrics)
`;
}

/**
 * Keys and values as TOML and Python both write them: a whole number of a key that takes any number has a point.
 * @param {Situation} situation
 * @param {Data} data
 */
function values(situation, data) {
  const whole = new Set(["seed"]);
  for (const [name, setting] of Object.entries(familyOf(situation, data).controllers[situation.controller].settings)) {
    if (setting.whole) whole.add(name);
  }
  const text = (/** @type {string} */ name, /** @type {unknown} */ value) =>
    typeof value === "number" && !whole.has(name) && Number.isInteger(value) ? `${value}.0` : JSON.stringify(value);
  return keys(situation, data).map(([name, value]) => [name, text(name, value)]);
}
