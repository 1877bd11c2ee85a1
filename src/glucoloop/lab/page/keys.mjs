// @ts-check
/** A situation in writing: root keys, of which parts are texts, and the part of a link after the #, which is read again. */

import { partOf, partText, valueOf } from "./grammar.mjs";
import { among, checked, checkedFault, patientId, tuningOf, usual } from "./situation.mjs";

/** @typedef {import("./grammar.mjs").Tree} Tree */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Fault} Fault */
/** @typedef {import("./situation.mjs").Meal} Meal */
/** @typedef {import("./situation.mjs").Situation} Situation */

/** Key under which links and files tell the version. */
export const VERSION = "glucoloop";
/** Keys that say nothing about what happens to the person whom the page simulates, those of trials and comparisons among them. */
const OF_NO_EFFECT = [
  VERSION, "metrics", "allow_unusual", "people", "first_person", "population", "design", "traces", "shard_people",
  "precision", "arithmetic", "bound",
];
/** The habit by which announcements are late or early. */
const LATE = "announced-late";
/** Usual values of what a run does not have. */
const USUAL_OF_A_TRIAL = { meal_size_spread_pct: 0, meal_time_spread_min: 0 };
const MIN_PER_DAY = 1440;
const MIN_PER_H = 60;

/**
 * Root keys of the situation, in the grammar of `glucoloop`, with its parts as texts.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {Record<string, string | number | true | string[]>}
 */
export function keys(situation, data) {
  const { family, operating_point } = data.patients[situation.patient];
  const { guard, guard_limits, pump_limits, noise_variance, monitor, dead_time_min, announce, announce_before_min, announced_late_min } = situation;
  const elsewhere = operating_point !== Object.keys(data.families[family].points)[0];
  const sensor = [
    ...(noise_variance > 0 ? [{ name: "white-noise", variance: noise_variance }] : []),
    ...(monitor !== null ? [{ name: monitor.name, ...monitor.settings }] : []),
    ...(dead_time_min > 0 ? [{ name: "dead-time", minutes: dead_time_min }] : []),
  ];
  const limited = Object.keys(guard_limits).length > 0;
  return {
    patient: partText({ name: family, ...(elsewhere ? { operating_point } : {}) }),
    controller: partText({ name: situation.controller, ...situation.tuning }),
    // The model of linear MPC on the page is identified from a record without noise.
    ...(situation.controller === "mpc" ? { model: partText({ noise_variance: 0 }) } : {}),
    ...(guard ? { guard: limited ? partText(guard_limits) : "usual" } : {}),
    meals: situation.meals.map(({ carbs_g, t_min }) => `${carbs_g}g@${t_min}min`),
    ...(announce ? { announce_meals: true } : {}),
    ...(announce && announce_before_min !== 0 ? { announce_before_min } : {}),
    ...(announce && announced_late_min !== 0 ? { habits: [partText({ name: LATE, minutes: announced_late_min })] } : {}),
    duration_min: situation.duration_min,
    ...(sensor.length > 0 ? { sensor: sensor.map(partText) } : {}),
    ...(Object.keys(pump_limits).length > 0 ? { pump: partText(pump_limits) } : {}),
    ...(situation.faults.length > 0 ? { faults: situation.faults.map((fault) => faultText(fault, data)) } : {}),
    seed: situation.seed,
  };
}

/**
 * A fault as `glucoloop` reads it.
 * @param {Fault} fault
 * @param {Data} data
 */
export function faultText({ name, start_min, duration_min, settings }, data) {
  const times = data.faults[name].timed ? { start_min, ...(duration_min === null ? {} : { duration_min }) } : {};
  return partText({ name, ...times, ...settings });
}

/** A meal from its text. @param {string} text @returns {Meal} */
function mealOf(text) {
  const [, carbs, time, unit] = /^([\d.]+)g?@([\d.]+)(min|h)?$/.exec(text) ?? [];
  const [carbs_g, t] = [carbs, time].map(Number);
  if (!Number.isFinite(carbs_g + t)) throw new RangeError(`a meal is '${text}'; write it like 50g@60min`);
  return { carbs_g, t_min: unit === "h" ? t * MIN_PER_H : t };
}

/** A list, of which one alone may stand for itself. @param {any} told */
const listed = (told) => [told ?? []].flat();

/**
 * Settings that are not the usual ones, of those that the page offers.
 * @param {string} where the part stands in the tree, for phrases
 * @param {Tree} given
 * @param {Tree} standard usual values
 * @param {string[]} offered
 * @param {string[]} unlike gets a phrase for each other one
 * @returns {Tree}
 */
function taken(where, given, standard, offered, unlike) {
  const other = Object.entries(given).filter(([name, value]) => !Object.hasOwn(standard, name) || JSON.stringify(value) !== JSON.stringify(standard[name]));
  for (const [name, value] of other) if (!offered.includes(name)) unlike.push(`${where}${name} = ${JSON.stringify(value)}`);
  return Object.fromEntries(other.filter(([name]) => offered.includes(name)));
}

/**
 * Noise, monitor and dead time of a chain of sensors.
 * @param {Tree[]} chain from the innermost outwards
 * @param {Data} data
 * @param {string[]} unlike gets a phrase for each sensor that the page has not, or has in another order
 * @returns {{noise_variance: number, monitor: import("./situation.mjs").Monitor | null, dead_time_min: number}}
 */
function ofChain(chain, { sensors, monitors }, unlike) {
  const found = { variance: 0, minutes: 0 };
  /** @type {import("./situation.mjs").Monitor | null} */
  let monitor = null;
  let inner = -1;
  for (const part of chain) {
    const { name, ...given } = part, place = Object.keys(sensors).indexOf(name);
    if (place <= inner || (name in monitors && (monitor !== null || found.variance > 0))) unlike.push(`the sensor ${partText(part)}`);
    else if (name in monitors) {
      inner = place;
      const { settings } = monitors[name];
      const usual = Object.entries(settings).map(([setting, of]) => [setting, of.usual]);
      const standard = { ...sensors[name], ...Object.fromEntries(usual) };
      monitor = { name, settings: taken("sensor.", given, standard, Object.keys(settings), unlike) };
    } else {
      inner = place;
      const told = { ...sensors[name], ...taken("sensor.", given, sensors[name], Object.keys(found), unlike) };
      found.variance = told.variance ?? found.variance;
      found.minutes = told.minutes ?? found.minutes;
    }
  }
  return { noise_variance: found.variance, monitor, dead_time_min: found.minutes };
}

/**
 * Faults that the page has.
 * @param {Tree[]} parts
 * @param {number} duration_min of the run
 * @param {Data} data
 * @param {string[]} unlike gets a phrase for each other one
 * @returns {Fault[]}
 */
function faultsOf(parts, duration_min, data, unlike) {
  return parts.flatMap((part) => {
    const { name, start_min = 0, duration_min: lasts_min = null, ...given } = part;
    /** @type {Tree} */
    const { settings: known = {} } = data.faults[name] ?? {};
    const settings = Object.fromEntries(Object.entries(given).filter(([key, value]) => known[key]?.usual !== value));
    const fault = { name, start_min, duration_min: lasts_min, settings };
    try {
      checkedFault(fault, duration_min, data);
      return [fault];
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      unlike.push(`the fault ${partText(part)}`);
      return [];
    }
  });
}

/** Settings of the habit that the page does not have, with their usual values. */
const OF_LATE = { probability: 1, spread_min: 0, meal: 0 };

/**
 * Time by which announcements are late.
 * @param {Tree[]} habits
 * @param {string[]} unlike gets a phrase for each habit that the page does not have
 */
function announcedLate(habits, unlike) {
  let found = 0;
  for (const habit of habits) {
    const { name, minutes = 20, ...others } = habit;
    if (name !== LATE) unlike.push(`the habit ${partText(habit)}`);
    else found += minutes;
    if (name === LATE) taken("habit.", others, OF_LATE, [], unlike);
  }
  return found;
}

/**
 * The situation that is nearest to what a link or a file tells.
 * @param {Tree} told root keys, with parts as texts or tables
 * @param {Data} data
 * @returns {{situation: Situation, unlike: string[]}} with what the page leaves out, one phrase each
 * @throws {RangeError} with a sentence, for a situation that the page cannot simulate at all
 */
export function situationOf(told, data) {
  const begun = usual(data);
  const { patient, controller, guard, model, meals, days, duration_min, seed, sensor, pump, faults, announce_meals, announce_before_min, habits, ...root } = told;
  const { name: family = data.patients[begun.patient].family, operating_point, ...of_patient } = partOf(patient ?? {});
  among("the patient", family, Object.keys(data.families));
  const { points, controllers, guard_limits, pump_limits, configuration } = data.families[family];
  const point = operating_point ?? Object.keys(points)[0];
  among(`the operating point of ${family}`, point, Object.keys(points));
  // Among the settings of a controller are its own guard, model and faults, a label, and what was settled at its design.
  const of_case = partOf(listed(controller)[0] ?? {});
  const { name = begun.controller, label, settled, guard: own_guard, model: own_model, faults: own_faults, ...settings } = of_case;
  among("the controller", name, Object.keys(controllers));
  /** @type {string[]} */
  const unlike = [];
  taken("patient.", of_patient, {}, [], unlike);
  const length_min = days !== undefined ? days * MIN_PER_DAY : duration_min ?? begun.duration_min;
  /** @type {Situation} */
  const situation = {
    ...begun,
    patient: patientId(family, point),
    controller: name,
    meals: meals === undefined ? begun.meals : listed(meals).filter(Boolean).map(mealOf),
    duration_min: length_min,
    seed: seed ?? begun.seed,
    announce: announce_meals ?? begun.announce,
    announce_before_min: announce_before_min ?? begun.announce_before_min,
    announced_late_min: announcedLate(listed(habits).map(partOf), unlike),
    ...ofChain(listed(sensor).map(partOf), data, unlike),
    faults: faultsOf([...listed(faults), ...listed(own_faults)].map(partOf), length_min, data, unlike),
    pump_limits: taken("pump.", partOf(pump ?? {}), configuration.pump, Object.keys(pump_limits), unlike),
  };
  const standard = { known_dead_time: false, ...tuningOf(situation, data) };
  // A horizon of 0 is the one that suits the model; where it is usual, the page knows it.
  if (controllers[name].horizon_suits_model && settings.prediction_horizon === 0) delete settings.prediction_horizon;
  situation.tuning = taken("controller.", settings, standard, Object.keys(controllers[name].settings), unlike);
  const guarding = partOf(own_guard ?? guard ?? "none");
  if (guarding.name !== "none") {
    situation.guard = true;
    situation.guard_limits = taken("guard.", guarding, configuration.guard, Object.keys(guard_limits), unlike);
  }
  // Linear MPC has a model that is as noisy as the readings, unless another one is told.
  const identified = name === "mpc" ? { noise_variance: situation.noise_variance } : {};
  taken("model.", partOf(own_model ?? model ?? identified), configuration.model, [], unlike);
  const others = Object.entries(root).filter(([key]) => !OF_NO_EFFECT.includes(key));
  taken("", Object.fromEntries(others), { ...configuration, ...USUAL_OF_A_TRIAL }, [], unlike);
  return { situation: checked(situation, data), unlike };
}

/**
 * The situation and the version as the part of a link after the #.
 * @param {Situation} situation
 * @param {Data} data
 * @param {string} version
 */
export function hash(situation, data, version) {
  const told = new URLSearchParams([[VERSION, version]]);
  for (const [name, value] of Object.entries(keys(situation, data))) {
    for (const text of Array.isArray(value) && value.length === 0 ? [""] : listed(value)) told.append(name, `${text}`);
  }
  return `#${told}`;
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
  const several = ["controller", "meals", "sensor", "faults", "habits"];
  const root = Object.fromEntries([...told.keys()].map((name) => [name, several.includes(name) ? told.getAll(name) : valueOf(told.get(name) ?? "")]));
  const { situation, unlike } = situationOf({ model: { noise_variance: 0 }, ...root }, data);
  if (unlike.length > 0) throw new RangeError(`it has ${unlike.join(" and ")}, which this page cannot simulate`);
  return { situation, version: told.get(VERSION) };
}
