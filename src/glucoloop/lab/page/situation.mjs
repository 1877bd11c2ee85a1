// @ts-check
/** A situation: what the page simulates, within the bounds of what is possible. */

/** @typedef {{t_min: number, carbs_g: number}} Meal */

/**
 * @typedef {object} Fault a fault of sensor or pump, around the earlier ones
 * @property {string} name in `Data.faults`
 * @property {number} start_min
 * @property {number | null} duration_min null for a fault that lasts to the end
 * @property {Record<string, number | boolean>} settings that are not the usual ones
 */

/** @typedef {{name: string, settings: Record<string, number | boolean>}} Monitor with the settings that are not the usual ones */

/**
 * @typedef {object} Situation
 * @property {string} patient family and operating point, as `Data.patients` names them
 * @property {string} controller
 * @property {Record<string, number>} tuning settings that are not the usual ones
 * @property {boolean} guard
 * @property {Record<string, number>} guard_limits limits of the guard that are not the usual ones
 * @property {Record<string, number>} pump_limits limits of the pump that are not the patient's
 * @property {Fault[]} faults
 * @property {Meal[]} meals
 * @property {number} noise_variance
 * @property {Monitor | null} monitor a continuous glucose monitor in place of noise
 * @property {number} dead_time_min
 * @property {number} seed
 * @property {number} duration_min
 * @property {boolean} announce whether the controller is told of each meal
 * @property {number} announce_before_min time before eating at which meals are announced, which an announcement tells
 * @property {number} announced_late_min time by which announcements come later than that, which they do not tell
 */

/**
 * @typedef {object} Setting
 * @property {string} summary
 * @property {boolean} whole
 * @property {number} least
 * @property {number} most
 * @property {number} step
 */

/**
 * @typedef {object} FaultEntry
 * @property {"sensor" | "pump"} part
 * @property {string} summary
 * @property {boolean} timed whether the fault has times; otherwise it is always present
 * @property {Record<string, Setting & {usual: number | boolean}>} settings
 */

/**
 * @typedef {object} Patient
 * @property {string} family name in the catalogue of patients
 * @property {string} operating_point
 * @property {number[]} numbers of the patient that differ between people
 * @property {number[]} matrices of the integrator, without their zeros
 * @property {number[]} gut numbers in which the guts of people differ
 * @property {number[]} x state at rest
 * @property {number} basal_insulin_mU_min
 * @property {number} setpoint_mg_dl
 * @property {number} glucose_mg_dl
 * @property {{carb_ratio_g_U: number, correction_mg_dl_U: number}} profile of the person, as far as basal-bolus therapy needs it
 * @property {Record<string, import("./design.mjs").Numbers>} of_profile numbers of the model of predictive control by a profile,
 *   by controller, where it knows no equations of the patient
 * @property {{pid: import("./design.mjs").FirstOrder, imc: import("./design.mjs").FirstOrder}} first_order
 * @property {import("./design.mjs").Numbers & {step_response: number[]}} response as linear MPC keeps it: coefficients, and a
 *   realisation of what comes after them
 * @property {import("./design.mjs").Numbers & {step_response: number[]}} response_behind_lag the same behind the lag of a monitor
 * @property {import("./design.mjs").Linear} linear
 */

/**
 * @typedef {object} MonitorEntry
 * @property {string} summary
 * @property {import("./design.mjs").Numbers} numbers of its errors
 * @property {number} processes of its noise
 * @property {Record<string, Setting & {usual: number | boolean | null}>} settings
 */

/**
 * @typedef {object} Family what all patients of a model have
 * @property {string} summary
 * @property {Record<string, string>} points summaries of the operating points, the usual one first
 * @property {string} route of insulin
 * @property {string} population that is usual for them, as a command takes it for any number of people
 * @property {number} step_min of the integrator
 * @property {[number, number][]} inside for each moment inside a sample, the integrator's step and the place among its
 *   readings
 * @property {Record<string, {program: string, guard_program?: string, gives_boluses: boolean, summary: string,
 *   settings: Record<string, Setting>, least_behind_lag?: number,
 *   horizon_suits_model: boolean,
 *   usual: Record<string, Record<"noise_free" | "noisy" | "behind_lag", Record<string, any>>>}>} controllers with the usual
 *   values by operating point, and whether the usual horizon is the one that suits the model; the guard has a program of
 *   its own around a controller whose program keeps its loops
 * @property {Record<string, Setting & {usual: number}>} guard_limits
 * @property {Record<string, Setting & {usual: number}>} pump_limits
 * @property {Record<string, any>} configuration what a run without options uses, with a guard
 */

/**
 * @typedef {object} People whom the page can simulate beside the nominal patient
 * @property {string} population
 * @property {number} seed
 * @property {string} patient around whom they are drawn
 * @property {number} count the most that are simulated at once
 * @property {{word: number, distribution: Record<string, number>}[]} parameters that are drawn
 * @property {number[][]} [given] values of the parameters of each person, where the page carries its people
 * @property {number[]} driven places of the matrices of insulin that are not zero
 * @property {number} doublings
 * @property {number} step_min
 * @property {number[][]} path from moments to the nodes
 */

/**
 * @typedef {object} Data as `glucoloop.lab.build` writes it
 * @property {number} sample_time_min
 * @property {number[]} inside_min
 * @property {number} longest_min
 * @property {Record<string, Record<import("../../native/targets/wasm/kernels.mjs").Group, Record<string, number>> & {per_person: number}>} functions
 * @property {Record<string, Family>} families the usual one first
 * @property {Record<string, Patient>} patients by `patientId`
 * @property {Record<string, Record<string, any>>} sensors of a chain, from the innermost outwards, with their usual settings
 * @property {Record<string, FaultEntry>} faults those that this page has
 * @property {Record<string, MonitorEntry>} monitors
 * @property {import("./design.mjs").Numbers} display of a monitor
 * @property {Record<string, People>} people by family, of those around whose patients there are any
 * @property {number} seeds of the random numbers that can be chosen, from 0 on
 * @property {string} [open] link with which a page that carries its people begins
 * @property {Record<string, string>} statuses
 * @property {Record<string, string>} status_names as tables tell them
 */

const MU_PER_U = 1000;
const MOST_MEALS = 12;
const LARGEST_MEAL_G = 300;
const LARGEST_VARIANCE = 900;
const MOST_FAULTS = 4;
const LONGEST_DEAD_TIME_MIN = 60;
const SHORTEST_MIN = 30;
/** The longest time from an announcement until the meal, and by which it is late or early. */
const LONGEST_ANNOUNCED_MIN = 120;
/** Settings that only have the values of their sliders: for other lags the page has no models. */
const OF_STEPS = ["lag_min"];

/**
 * The situation that the page begins with: that of `glucoloop run`.
 * @param {Data} data
 * @returns {Situation}
 */
export function usual(data) {
  return {
    patient: Object.keys(data.patients)[0],
    controller: "mpc",
    tuning: {},
    guard: false,
    guard_limits: {},
    pump_limits: {},
    faults: [],
    meals: [{ t_min: 50, carbs_g: 50 }],
    noise_variance: 0,
    monitor: null,
    dead_time_min: 0,
    seed: 0,
    duration_min: 600,
    announce: false,
    announce_before_min: 0,
    announced_late_min: 0,
  };
}

/**
 * The people who are drawn around a patient; null if there are none.
 * @param {string} patient
 * @param {Data} data
 * @returns {People | null}
 */
export function peopleAround(patient, data) {
  const people = data.people[data.patients[patient].family];
  return people?.patient === patient ? people : null;
}

/**
 * The people on whom a controller can be tried; null if there are none.
 * @param {{patient: string, controller: string}} situation
 * @param {Data} data
 * @returns {People | null} none under a controller whose model of each person the page cannot make
 */
export function peopleIn(situation, data) {
  const { guard_program } = familyOf(situation, data).controllers[situation.controller];
  return guard_program === undefined ? peopleAround(situation.patient, data) : null;
}

/** Name of a patient in the data. @param {string} family @param {string} operating_point */
export function patientId(family, operating_point) {
  return `${family}/${operating_point}`;
}

/** What the patient's family has. @param {{patient: string}} situation @param {Data} data @returns {Family} */
export function familyOf({ patient }, data) {
  return data.families[data.patients[patient].family];
}

/**
 * The situation with another patient. Tuning and limits that were set for a patient of another family do not stay: those
 * that are usual in the new family take their place.
 * @param {Situation} situation
 * @param {string} family
 * @param {string | undefined} operating_point the usual one, if none is given
 * @param {Data} data
 * @returns {{situation: Situation, reset: ("controller" | "tuning" | "guard_limits" | "pump_limits")[]}} with what did not stay
 */
export function withPatient(situation, family, operating_point, data) {
  const patient = patientId(family, operating_point ?? Object.keys(data.families[family].points)[0]);
  if (family === data.patients[situation.patient].family) return { situation: { ...situation, patient }, reset: [] };
  const parts = /** @type {const} */ (["tuning", "guard_limits", "pump_limits"]);
  /** @type {("controller" | "tuning" | "guard_limits" | "pump_limits")[]} */
  const reset = parts.filter((part) => Object.keys(situation[part]).length > 0);
  const there = situation.controller in data.families[family].controllers;
  if (!there) reset.unshift("controller");
  const { controller, announce, announce_before_min, announced_late_min } = there ? situation : usual(data);
  const announced = { announce, announce_before_min, announced_late_min };
  return { situation: { ...situation, patient, controller, ...announced, tuning: {}, guard_limits: {}, pump_limits: {} }, reset };
}

/**
 * All settings of the controller: the given ones, and the usual ones for the readings.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {Record<string, any>}
 */
export function tuningOf(situation, data) {
  const { operating_point } = data.patients[situation.patient];
  const usual = familyOf(situation, data).controllers[situation.controller].usual[operating_point];
  const kind = situation.noise_variance > 0 ? "noisy" : lagOf(situation, data) > 0 ? "behind_lag" : "noise_free";
  return { ...usual[kind], ...situation.tuning };
}

/** Whether the controller decides on boluses. @param {Situation} situation @param {Data} data */
export function givesBoluses(situation, data) {
  return familyOf(situation, data).controllers[situation.controller].gives_boluses;
}

/**
 * Carbohydrate that the controller is told of at each sample; what it would be told before the start, it is told there.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {Float64Array}
 */
export function announced({ announce, announce_before_min, announced_late_min, meals, duration_min }, { sample_time_min }) {
  const told = new Float64Array(Math.round(duration_min / sample_time_min));
  for (const { t_min, carbs_g } of announce ? meals : []) {
    const sample = Math.max(0, Math.floor((t_min - announce_before_min + announced_late_min) / sample_time_min));
    if (sample < told.length) told[sample] += carbs_g;
  }
  return told;
}

/** All settings of a monitor. @param {Monitor} monitor @param {Data} data @returns {Record<string, any>} */
export function monitorSettings({ name, settings }, data) {
  const usual = Object.entries(data.monitors[name].settings).map(([setting, { usual }]) => [setting, usual]);
  return { ...Object.fromEntries(usual), ...settings };
}

/** Lag of the sensor, min. @param {Situation} situation @param {Data} data @returns {number} */
export function lagOf({ monitor }, data) {
  return monitor === null ? 0 : monitorSettings(monitor, data).lag_min;
}

/**
 * Limits of the pump.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {import("./design.mjs").Limits}
 */
export function limitsOf(situation, data) {
  const { pump } = familyOf(situation, data).configuration;
  const { max_change_mU_min, min_insulin_mU_min, max_insulin_mU_min } = { ...pump, ...situation.pump_limits };
  return { max_change_mU_min, min_mU_min: min_insulin_mU_min, max_mU_min: max_insulin_mU_min };
}

/** Limits of boluses, those of the patient's usual pump. @param {Situation} situation @param {Data} data */
export function bolusLimitsOf(situation, data) {
  const { max_bolus_U, min_bolus_U, bolus_step_U } = familyOf(situation, data).configuration.pump;
  return { max_mU: MU_PER_U * max_bolus_U, min_mU: MU_PER_U * min_bolus_U, step_mU: MU_PER_U * bolus_step_U };
}

/**
 * @param {string} what
 * @param {unknown} value
 * @param {number} least
 * @param {number} most
 * @param {string} unit
 * @param {number} [step]
 */
function within(what, value, least, most, unit, step) {
  const every = step === undefined ? "" : step === 1 ? "a whole number " : `a multiple of ${step}${unit} `;
  if (typeof value !== "number" || !(value >= least && value <= most) || (step && value % step !== 0)) {
    throw new RangeError(`${what} is ${value}${unit}; give ${every}from ${least} to ${most}${unit}`);
  }
}

/**
 * @param {string} what
 * @param {string} value
 * @param {string[]} known
 */
export function among(what, value, known) {
  if (!known.includes(value)) throw new RangeError(`${what} is '${value}'; the known ones are: ${known.join(", ")}`);
}

/**
 * Refuse settings that are unknown or out of their bounds.
 * @param {Record<string, number | boolean>} given
 * @param {Record<string, Setting>} settings
 * @param {string} what
 */
function allowed(given, settings, what) {
  for (const [name, value] of Object.entries(given)) {
    among(what, name, Object.keys(settings));
    const { least, most, step, whole } = settings[name];
    if (typeof value === "boolean" && least === 0 && most === 1 && whole) continue;
    within(name.replaceAll("_", " "), value, least, most, "", whole ? 1 : OF_STEPS.includes(name) ? step : undefined);
  }
}

/**
 * Refuse a horizon at whose end insulin has hardly begun to act, as `glucoloop.control.horizon` does.
 * @param {number | undefined} ahead samples
 * @param {number | undefined} least
 */
function seesInsulin(ahead = 0, least = 0) {
  if (Number.isInteger(ahead) && ahead > 0 && ahead < least) {
    throw new RangeError(
      `a prediction horizon of ${ahead} samples sees less than 5 % of the gain of insulin; a controller that sees so ` +
        `little gives far too much or too little, so give a prediction horizon of ${least} or more`,
    );
  }
}

/** Refuse a fault that is not possible. @param {Fault} fault @param {number} duration_min of the run @param {Data} data */
export function checkedFault(fault, duration_min, data) {
  among("a fault", fault.name, Object.keys(data.faults));
  const { settings, timed } = data.faults[fault.name];
  for (const name of ["start_min", "duration_min"]) {
    if (!timed && fault[/** @type {"start_min"} */ (name)]) throw new RangeError(`the fault ${fault.name} is always there; give no ${name}`);
  }
  if (timed) within("the start of a fault", fault.start_min, 0, duration_min - 1, " min");
  if (timed && fault.duration_min !== null) within("the duration of a fault", fault.duration_min, 1, duration_min, " min");
  allowed(fault.settings, settings, `a setting of the fault ${fault.name}`);
}

/**
 * A situation that can be simulated.
 * @param {Situation} given
 * @param {Data} data
 * @returns {Situation} the same, meals in the order of their times
 * @throws {RangeError} with a sentence, for a value that is not possible
 */
export function checked(given, data) {
  among("the patient", given.patient, Object.keys(data.patients));
  const { controllers, guard_limits, pump_limits } = familyOf(given, data);
  among("the controller", given.controller, Object.keys(controllers));
  within("the length", given.duration_min, SHORTEST_MIN, data.longest_min, " min", data.sample_time_min);
  within("the variance of the noise", given.noise_variance, 0, LARGEST_VARIANCE, " (mg/dl)²");
  within("the dead time", given.dead_time_min, 0, LONGEST_DEAD_TIME_MIN, " min", data.sample_time_min);
  within("the time before eating at which meals are announced", given.announce_before_min, 0, LONGEST_ANNOUNCED_MIN, " min", 1);
  within("the time by which announcements are late", given.announced_late_min, -LONGEST_ANNOUNCED_MIN, LONGEST_ANNOUNCED_MIN, " min", 1);
  within("the seed", given.seed, 0, data.seeds - 1, "", 1);
  for (const [what, value] of [["announcing meals", given.announce], ["the guard", given.guard]]) {
    if (typeof value !== "boolean") throw new RangeError(`${what} is ${JSON.stringify(value)}; give true or false`);
  }
  if (given.monitor !== null) {
    among("the monitor", given.monitor.name, Object.keys(data.monitors));
    allowed(given.monitor.settings, data.monitors[given.monitor.name].settings, "a setting of the monitor");
    if (given.noise_variance > 0) throw new RangeError("white noise inside a monitor is not possible on this page; give one of them");
  }
  if (given.meals.length > MOST_MEALS) {
    throw new RangeError(`${given.meals.length} meals are too many; give at most ${MOST_MEALS}`);
  }
  for (const meal of given.meals) {
    within("a meal", meal.carbs_g, 1, LARGEST_MEAL_G, " g");
    within("the time of a meal", meal.t_min, 0, given.duration_min - 1, " min");
  }
  const { settings, least_behind_lag } = controllers[given.controller];
  const behind = least_behind_lag !== undefined && lagOf(given, data) > 0;
  if (behind) seesInsulin(tuningOf(given, data).prediction_horizon, least_behind_lag);
  else seesInsulin(given.tuning.prediction_horizon, settings.prediction_horizon?.least);
  allowed(given.tuning, settings, "a setting");
  allowed(given.guard_limits, guard_limits, "a limit of the guard");
  allowed(given.pump_limits, pump_limits, "a limit of the pump");
  if (given.faults.length > MOST_FAULTS) {
    throw new RangeError(`${given.faults.length} faults are too many; give at most ${MOST_FAULTS}`);
  }
  for (const fault of given.faults) checkedFault(fault, given.duration_min, data);
  const of_pump = given.faults.filter(({ name }) => data.faults[name].part === "pump");
  if (of_pump.length > 1) {
    throw new RangeError(`${of_pump.length} faults of the pump are too many for this page; give at most one`);
  }
  return { ...given, meals: [...given.meals].sort((a, b) => a.t_min - b.t_min) };
}
