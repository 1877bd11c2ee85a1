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
/** Keys that say nothing about what happens to the person whom the page simulates, those of a trial among them. */
const OF_NO_EFFECT = [
  VERSION, "metrics", "allow_unusual", "people", "first_person", "population", "design", "traces", "shard_people",
  "precision", "arithmetic",
];
/** Usual values of what a run does not have. */
const USUAL_OF_A_TRIAL = { meal_size_spread_pct: 0, meal_time_spread_min: 0 };
/** Settings of sensors that the page has. */
const OF_SENSORS = ["variance", "minutes"];
const MIN_PER_DAY = 1440;
const MIN_PER_H = 60;

/**
 * Root keys of the situation, in the grammar of `glucoloop`, with its parts as texts.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {Record<string, string | number | string[]>}
 */
export function keys(situation, data) {
  const { family, operating_point } = data.patients[situation.patient];
  const { guard, guard_limits, pump_limits, noise_variance, dead_time_min } = situation;
  const elsewhere = operating_point !== Object.keys(data.families[family].points)[0];
  const sensor = [
    ...(noise_variance > 0 ? [{ name: "white-noise", variance: noise_variance }] : []),
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
 * The situation that is nearest to what a link or a file tells.
 * @param {Tree} told root keys, with parts as texts or tables
 * @param {Data} data
 * @returns {{situation: Situation, unlike: string[]}} with what the page leaves out, one phrase each
 * @throws {RangeError} with a sentence, for a situation that the page cannot simulate at all
 */
export function situationOf(told, data) {
  const begun = usual(data);
  const { patient: of_patient, controller: cases, meals, days, duration_min, seed, sensor, pump, faults, ...root } = told;
  const { name: family = data.patients[begun.patient].family, operating_point, ...unknown } = partOf(of_patient ?? {});
  among("the patient", family, Object.keys(data.families));
  const { points, controllers, guard_limits, pump_limits, configuration } = data.families[family];
  const point = operating_point ?? Object.keys(points)[0];
  among(`the operating point of ${family}`, point, Object.keys(points));
  const {
    name: controller = begun.controller, label, settled, guard = root.guard, model = root.model, faults: own_faults, ...settings
  } = partOf(listed(cases)[0] ?? {});
  among("the controller", controller, Object.keys(controllers));

  /** @type {string[]} */
  const unlike = [];
  /**
   * Settings that are not the usual ones, of those that the page offers; the others are left out.
   * @param {string} where
   * @param {Tree} given
   * @param {Tree} standard
   * @param {string[]} offered
   */
  const taken = (where, given, standard, offered) => {
    const other = Object.entries(given).filter(([name, value]) => !Object.hasOwn(standard, name) || JSON.stringify(value) !== JSON.stringify(standard[name]));
    for (const [name, value] of other) if (!offered.includes(name)) unlike.push(`${where}${name} = ${JSON.stringify(value)}`);
    return Object.fromEntries(other.filter(([name]) => offered.includes(name)));
  };

  /** @type {Situation} */
  const situation = {
    ...begun,
    patient: patientId(family, point),
    controller,
    meals: meals === undefined ? begun.meals : listed(meals).filter(Boolean).map(mealOf),
    duration_min: days !== undefined ? days * MIN_PER_DAY : duration_min ?? begun.duration_min,
    seed: seed ?? begun.seed,
  };
  taken("patient.", unknown, {}, []);
  const chain = Object.keys(data.sensors);
  let inner = -1;
  for (const part of listed(sensor).map(partOf)) {
    const { name, ...given } = part, place = chain.indexOf(name);
    if (place <= inner) unlike.push(`the sensor ${partText(part)}`);
    else {
      inner = place;
      const { variance, minutes } = { ...data.sensors[name], ...taken("sensor.", given, data.sensors[name], OF_SENSORS) };
      situation.noise_variance = variance ?? situation.noise_variance;
      situation.dead_time_min = minutes ?? situation.dead_time_min;
    }
  }
  const { settings: offered } = controllers[controller];
  situation.tuning = taken("controller.", settings, { known_dead_time: false, ...tuningOf(situation, data) }, Object.keys(offered));
  if (guard !== undefined && partOf(guard).name !== "none") {
    situation.guard = true;
    situation.guard_limits = taken("guard.", partOf(guard), configuration.guard, Object.keys(guard_limits));
  }
  const identified = controller === "mpc" ? { noise_variance: situation.noise_variance } : {};
  taken("model.", partOf(model ?? identified), configuration.model, []);
  situation.pump_limits = taken("pump.", partOf(pump ?? {}), configuration.pump, Object.keys(pump_limits));
  for (const part of [...listed(faults), ...listed(own_faults)].map(partOf)) {
    const { name, start_min = 0, duration_min = null, ...given } = part;
    /** @type {Tree} */
    const entry = data.faults[name] ?? {};
    const settings = Object.fromEntries(Object.entries(given).filter(([key, value]) => entry.settings?.[key]?.usual !== value));
    const fault = { name, start_min, duration_min, settings };
    try {
      checkedFault(fault, situation.duration_min, data);
      situation.faults = [...situation.faults, fault];
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      unlike.push(`the fault ${partText(part)}`);
    }
  }
  const others = Object.entries(root).filter(([name]) => !["guard", "model", ...OF_NO_EFFECT].includes(name));
  taken("", Object.fromEntries(others), { ...configuration, ...USUAL_OF_A_TRIAL }, []);
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
  const several = ["controller", "meals", "sensor", "faults"];
  const root = Object.fromEntries([...told.keys()].map((name) => [name, several.includes(name) ? told.getAll(name) : valueOf(told.get(name) ?? "")]));
  const { situation, unlike } = situationOf({ model: { noise_variance: 0 }, ...root }, data);
  if (unlike.length > 0) throw new RangeError(`it has ${unlike.join(" and ")}, which this page cannot simulate`);
  return { situation, version: told.get(VERSION) };
}
