// @ts-check
/** A situation in writing: keys and their values, and the part of a link after the #, which is read again. */

import { among, checked, patientId, usual } from "./situation.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Fault} Fault */
/** @typedef {import("./situation.mjs").Meal} Meal */
/** @typedef {import("./situation.mjs").Situation} Situation */

/** Key under which links and files tell the version. */
export const VERSION = "glucoloop";

/**
 * Keys and values of the situation, by which a link and a configuration file tell it.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {[string, string | number | boolean | string[]][]}
 */
export function keys(situation, data) {
  const { family, operating_point } = data.patients[situation.patient];
  return [
    ["patient", family],
    ["operating_point", operating_point],
    ["controller", situation.controller],
    ...Object.entries(situation.tuning),
    // The model of linear MPC on the page is identified from a record without noise.
    ...(situation.controller === "mpc" ? /** @type {[string, number][]} */ ([["model_noise_variance", 0]]) : []),
    ...(situation.guard ? /** @type {[string, boolean][]} */ ([["guard", true]]) : []),
    ["meals", situation.meals.map(mealText)],
    ["duration_min", situation.duration_min],
    ["noise_variance", situation.noise_variance],
    ["dead_time_min", situation.dead_time_min],
    ...Object.entries(situation.guard ? situation.guard_limits : {}),
    ...Object.entries(situation.pump_limits),
    ...(situation.faults.length ? /** @type {[string, string[]][]} */ ([["faults", situation.faults.map((fault) => faultText(fault, data))]]) : []),
    ["seed", situation.seed],
  ];
}

/**
 * A fault as `glucoloop` reads it.
 * @param {Fault} fault
 * @param {Data} data
 */
export function faultText(fault, data) {
  const times = { start_min: fault.start_min, duration_min: fault.duration_min };
  const told = { ...(data.faults[fault.name].timed ? times : {}), ...fault.settings };
  const given = Object.entries(told).filter(([, value]) => value !== null);
  return [fault.name, ...given.map(([name, value]) => `${name}=${value}`)].join(", ");
}

/** @param {Meal} meal */
function mealText(meal) {
  return `${meal.carbs_g}g@${meal.t_min}min`;
}

/**
 * The situation and the version as the part of a link after the #.
 * @param {Situation} situation
 * @param {Data} data
 * @param {string} version
 */
export function hash(situation, data, version) {
  const told = new URLSearchParams([[VERSION, version]]);
  for (const [name, value] of keys(situation, data)) {
    told.set(name, Array.isArray(value) ? value.join(name === "faults" ? ";" : " ") : `${value}`);
  }
  return `#${told}`;
}

/** @param {string} name @param {string} value */
function numberOf(name, value) {
  if (!/^-?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(value)) throw new RangeError(`${name} is '${value}'; give a number`);
  return Number(value);
}

/**
 * A fault from its text.
 * @param {string} text
 * @param {Data} data
 * @returns {Fault}
 */
function faultOf(text, data) {
  const [name, ...given] = text.split(",").map((part) => part.trim());
  among("a fault", name, Object.keys(data.faults));
  /** @type {Fault} */
  const fault = { name, start_min: 0, duration_min: null, settings: {} };
  const { settings, timed } = data.faults[name];
  for (const part of given) {
    const [key, value] = part.split("=");
    if (timed && (key === "start_min" || key === "duration_min")) {
      fault[key] = numberOf(`${key} of a fault`, value);
      continue;
    }
    among(`a setting of the fault ${name}`, key, Object.keys(settings));
    const told = { true: true, false: false }[value];
    fault.settings[key] = told ?? numberOf(`${key} of a fault`, value);
  }
  return fault;
}

/**
 * The situation of a link.
 * @param {string} text the part of the link from the # on
 * @param {Data} data
 * @returns {{situation: Situation, version: string | null}} which version wrote it, null if the link does not say
 * @throws {RangeError} with a sentence, for a link that tells no situation of this page
 */
export function fromHash(text, data) {
  const told = new URLSearchParams(text.replace(/^#/, ""));
  const begun = usual(data);
  const version = told.get(VERSION);
  const family = told.get("patient") ?? data.patients[begun.patient].family;
  among("the patient", family, Object.keys(data.families));
  const { points, controllers, guard_limits, pump_limits } = data.families[family];
  const point = told.get("operating_point") ?? Object.keys(points)[0];
  among(`the operating point of ${family}`, point, Object.keys(points));
  const controller = told.get("controller") ?? begun.controller;
  among("the controller", controller, Object.keys(controllers));
  /** @type {Situation} */
  const situation = { ...begun, patient: patientId(family, point), controller };
  for (const [name, value] of told) {
    switch (name) {
      case VERSION:
      case "controller":
      case "patient":
      case "operating_point":
        break;
      case "guard":
        among("guard", value, ["true", "false"]);
        situation.guard = value === "true";
        break;
      case "model_noise_variance":
        if (value !== "0") throw new RangeError(`the model's noise is ${value}; this page has models without noise only`);
        break;
      case "meals":
        situation.meals = value
          .split(" ")
          .filter(Boolean)
          .map((meal) => {
            const found = /^([\d.]+)g@([\d.]+)min$/.exec(meal);
            if (found === null) throw new RangeError(`a meal is '${meal}'; write it like 50g@60min`);
            return { carbs_g: numberOf("a meal", found[1]), t_min: numberOf("the time of a meal", found[2]) };
          });
        break;
      case "faults":
        situation.faults = value.split(";").map((fault) => faultOf(fault, data));
        break;
      case "duration_min":
      case "noise_variance":
      case "dead_time_min":
      case "seed":
        situation[name] = numberOf(name, value);
        break;
      default: {
        /** @type {[Record<string, unknown>, "guard_limits" | "pump_limits" | "tuning"][]} */
        const parts = [
          [guard_limits, "guard_limits"],
          [pump_limits, "pump_limits"],
          [controllers[controller].settings, "tuning"],
        ];
        const [, part] = parts.find(([known]) => Object.hasOwn(known, name)) ?? [];
        if (part === undefined) among("a part of the link", name, Object.keys(controllers[controller].settings));
        else situation[part] = { ...situation[part], [name]: numberOf(name, value) };
      }
    }
  }
  return { situation: checked(situation, data), version };
}
