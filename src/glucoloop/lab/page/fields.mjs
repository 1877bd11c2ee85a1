// @ts-check
/** Numbers of the functions of the module, by the names of their fields, from the settings of a situation. */

import { bolusLimitsOf, familyOf, limitsOf, monitorSettings } from "./situation.mjs";

/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Fault} Fault */
/** @typedef {import("./design.mjs").Numbers} Numbers */

const NOISE_BOUND_MG_DL = 5;
/** What stands for a time of wear that is drawn. */
const DRAWN = -1;
const HAIR = 1e-9; // of a sample or a step, as glucoloop rounds up

/**
 * Numbers of a controller, and of the guard around it; of a guard with a program of its own, `designed` is nothing.
 * @param {Numbers} designed
 * @param {Situation} situation
 * @param {Data} data
 * @returns {Numbers}
 */
export function ofController(designed, situation, data) {
  /** @type {Numbers} */
  const numbers = {};
  const own = situation.guard ? "controller.inner." : "controller.";
  const planned = situation.controller.startsWith("mpc") ? "plan." : "";
  for (const name in designed) numbers[own + name] = designed[name];
  for (const [name, value] of Object.entries(limitsOf(situation, data))) {
    numbers[`${own}${planned}limits.${name}`] = value;
    if (situation.guard) numbers[`controller.limits.${name}`] = value;
  }
  for (const [name, value] of Object.entries(bolusLimitsOf(situation, data))) numbers[`${own}bolus.${name}`] = value;
  if (!situation.guard) return numbers;
  numbers["controller.basal_mU_min"] = NaN; // a guard that is told no basal rate takes the one at the start
  numbers["controller.carb_share"] = 1; // by the rules, since no person of the page has a ratio or a factor of the own
  numbers["controller.fall_share"] = 1;
  for (const [name, { usual }] of Object.entries(familyOf(situation, data).guard_limits)) {
    numbers[`guard.${name}`] = situation.guard_limits[name] ?? usual;
  }
  return numbers;
}

/**
 * Times of a fault in samples, as `episodes_of` counts them.
 * @param {Fault} fault
 * @param {number} every
 * @returns {Numbers}
 */
function episodes({ start_min, duration_min }, every) {
  const samples = (/** @type {number} */ minutes) => Math.ceil(minutes / every - HAIR);
  const earliest = samples(start_min);
  const length = duration_min === null ? Infinity : Math.max(1, samples(duration_min));
  return { "episodes.earliest": earliest, "episodes.latest": earliest, "episodes.length": length };
}

/**
 * Name and numbers of the function of a fault.
 * @param {Fault} fault
 * @param {Data} data
 * @returns {{name: string, numbers: Numbers, earlier: number, random: boolean}} and how many of the earlier readings the
 *   fault can give, one of which is drawn if it is random
 */
export function ofFault(fault, data) {
  const every = data.sample_time_min;
  const entry = data.faults[fault.name];
  /** @type {Record<string, any>} */
  const settings = {};
  for (const [name, { usual }] of Object.entries(entry.settings)) settings[name] = fault.settings[name] ?? usual;
  const { noticed, mg_dl_h, tau_min, step_mU_min, least_mU_min, delay_min, among, share, ...others } = settings;
  /** @type {Numbers} */
  const numbers = { ...(entry.timed ? episodes(fault, every) : {}), ...others };
  if (mg_dl_h !== undefined) numbers.mg_dl_sample = (mg_dl_h * every) / 60;
  if (tau_min !== undefined) numbers.left = Math.exp(-every / tau_min);
  if (step_mU_min !== undefined) {
    numbers.step_mU_min = step_mU_min;
    numbers.minimum_mU_min = Math.ceil(least_mU_min / step_mU_min - HAIR) * step_mU_min;
  }
  if (share !== undefined) {
    Object.assign(numbers, { "episodes.earliest": Infinity, "episodes.latest": Infinity, "episodes.length": 1 });
    numbers["episodes.probability"] = share;
  }
  const earlier = delay_min !== undefined ? Math.ceil(delay_min / every - HAIR) : among !== undefined ? among - 1 : 0;
  const program = earlier > 0 ? "late" : fault.name.replaceAll("-", "_");
  return { name: `${entry.part}_${program}${noticed ? "_noticed" : ""}`, numbers, earlier, random: among !== undefined };
}

/**
 * Functions of the sensor, from glucose to the display, with their numbers and what they draw.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {{name: string, numbers: Numbers, drawing?: import("./draws.mjs").Drawing}[]}
 */
export function ofSensor({ noise_variance, monitor }, data) {
  if (noise_variance > 0) {
    const numbers = { variance: noise_variance, bound_mg_dl: NOISE_BOUND_MG_DL };
    return [{ name: "sensor_white_noise", numbers, drawing: { name: "white-noise" } }];
  }
  if (monitor === null) return [];
  const { numbers, processes } = data.monitors[monitor.name];
  const { lag_min, noise, drift, display, worn_min } = monitorSettings(monitor, data);
  const worn = worn_min === null ? DRAWN : Math.min(Math.floor(worn_min / data.sample_time_min + HAIR), Number(numbers.wear) - 1);
  /** @type {Numbers} */
  const errors = { ...numbers, worn };
  if (!noise) errors["constants.sigma"] = [0, 0];
  if (!drift) Object.assign(errors, { "constants.gain": [1, 0, 0], "constants.offset_mg_dl": [0, 0, 0] });
  return [
    ...(lag_min > 0 ? [{ name: "sensor_lag", numbers: { lag_min } }] : []),
    { name: "sensor_monitor", numbers: errors, drawing: { name: "monitor", processes } },
    ...(display ? [{ name: "sensor_display", numbers: data.display }] : []),
  ];
}

/**
 * Name and numbers of the function of the pump, with its fault if it has one.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {{name: string, numbers: Numbers}}
 */
export function ofPump(situation, data) {
  const fault = situation.faults.find(({ name }) => data.faults[name].part === "pump");
  const { name, numbers } = fault === undefined ? { name: "pump", numbers: {} } : ofFault(fault, data);
  /** @type {Numbers} */
  const all = { ...numbers };
  for (const [limit, value] of Object.entries(limitsOf(situation, data))) {
    all[`limits.${limit}`] = value; // those that a resolution keeps, or the pump's own
    all[`inner.limits.${limit}`] = value;
  }
  for (const [limit, value] of Object.entries(bolusLimitsOf(situation, data))) {
    all[`bolus.${limit}`] = value;
    all[`inner.bolus.${limit}`] = value;
  }
  return { name, numbers: all };
}
