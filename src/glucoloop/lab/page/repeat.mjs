// @ts-check
/** A situation as other parts of glucoloop take it: a command, a configuration file, a program in Python. */

import { keys, VERSION } from "./keys.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */

/** Options whose names are not those of the keys. @type {Record<string, string>} */
const OPTIONS = {
  duration_min: "duration", meals: "meal", faults: "fault", announce_meals: "announce-meals", announce_before_min: "announce-before", habits: "habit",
};
/** Sensors for which there are shorter options. @type {[RegExp, string][]} */
const SHORT = [
  [/^white-noise, variance=/, "noise"],
  [/^dead-time, minutes=/, "dead-time"],
];

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
  const { family } = data.patients[situation.patient];
  if (family in data.people) {
    const { seed, count, given, population } = data.people[family];
    return command("trial", { people: Math.min(people, count), ...keys(situation, data), ...(given === undefined ? {} : { population }), seed });
  }
  return command("trial", { people, ...keys(situation, data), population: data.families[family].population });
}

/** @param {"run" | "trial"} name @param {ReturnType<typeof keys>} given */
function command(name, given) {
  const words = Object.entries(given).flatMap(([key, value]) => {
    const told = Array.isArray(value) && value.length === 0 ? ["none"] : [value].flat();
    if (value === true) return [`--${OPTIONS[key] ?? key}`];
    return told.map((text) => {
      const [start, option] = SHORT.find(([start]) => start.test(`${text}`)) ?? ["", OPTIONS[key] ?? key];
      return `--${option} ${quoted(`${text}`.replace(start, ""))}`;
    });
  });
  return [`glucoloop ${name}`, ...words].join(" ");
}

/** A text as one word of a command. @param {string} text */
function quoted(text) {
  return /^[\w.@:/=+-]+$/.test(text) ? text : `'${text}'`;
}

/** A number, a text or a list of texts as TOML and Python both write it. @param {unknown} value */
function written(value) {
  return JSON.stringify(value).replaceAll('","', '", "');
}

/**
 * The situation as a configuration file of `glucoloop run --config`.
 * @param {Situation} situation
 * @param {Data} data
 * @param {string} version
 */
export function toml(situation, data, version) {
  const told = Object.entries({ [VERSION]: version, ...keys(situation, data) });
  return told.map(([name, value]) => `${name} = ${written(value)}\n`).join("");
}

/**
 * A program in Python that computes the same.
 * @param {Situation} situation
 * @param {Data} data
 */
export function python(situation, data) {
  const lines = Object.entries(keys(situation, data)).map(([name, value]) => `    ${name}=${value === true ? "True" : written(value)},`);
  return `from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop

run = configured(
    Run,
${lines.join("\n")}
)
outcome = close_the_loop(run, run.case)
print(outcome.metrics)
`;
}
