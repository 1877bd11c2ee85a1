// @ts-check
/** Simulates situations: the functions of the module with all that is kept from one situation to the next. */

import { basalBolus, design } from "./design.mjs";
import { ofController } from "./fields.mjs";
import { LoopOfVector, programsOf } from "./loop.mjs";
import { MOMENTS, functionOf, Stage } from "./stage.mjs";
import { lagOf, tuningOf } from "./situation.mjs";

/** @typedef {import("../../native/targets/wasm/kernels.mjs").Kernels} Kernels */
/** @typedef {import("./design.mjs").Numbers} Numbers */
/** @typedef {import("./loop.mjs").Happened} Happened */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./stage.mjs").Body} Body */

/**
 * @typedef {object} Trace
 * @property {number[]} t_min times of the samples
 * @property {number[]} glucose_mg_dl glucose at each sample, free of noise
 * @property {number[]} reading_mg_dl
 * @property {number[]} command_mU_min
 * @property {number[]} insulin_mU_min rate that is delivered from each sample to the next
 * @property {number[]} bolus_mU bolus that is delivered at each sample beside the rate
 * @property {number[]} status
 * @property {number[]} fine_t_min a grid of one minute, both ends included
 * @property {number[]} fine_glucose_mg_dl
 * @property {Float64Array} [memory] (samples + 1, numbers) what the controller keeps before each sample and after the last,
 *   if asked for
 */

const MOST_KEPT = 32;

/**
 * Times of the samples, or of the moments between them, which all traces of a length share: nobody may change them.
 * @type {Map<string, number[]>}
 */
const sharedTimes = new Map();

/** @param {string} of @param {() => number[]} compute */
function timesOf(of, compute) {
  let found = sharedTimes.get(of);
  if (found === undefined) sharedTimes.set(of, (found = compute()));
  return found;
}

/** Simulates situations; the memory of the functions is kept from one to the next. */
export class Lab {
  /**
   * @param {Kernels} kernels
   * @param {Data} data
   */
  constructor(kernels, data) {
    this.kernels = kernels;
    this.data = data;
    /** @type {Map<string, Stage>} */
    this.stages = new Map();
    /** Designs and meals that were computed last, by what they were computed from. @type {Map<string, any>} */
    this.kept = new Map();
  }

  /**
   * @param {string} name
   * @param {number} [place] among those of the same function, each with arrays of its own
   */
  stage(name, place = 0) {
    const key = `${name} ${place}`;
    let found = this.stages.get(key);
    if (found === undefined) {
      found = new Stage(this, name);
      for (const stage of this.stages.values()) stage.refresh();
      this.stages.set(key, found);
    }
    return found;
  }

  /** The plant of a patient. @param {string} patient */
  plant(patient) {
    return this.stage(functionOf(this.data.patients[patient].family, "plant"));
  }

  /**
   * A result that is kept for the next time.
   * @template T
   * @param {unknown} of what it is computed from
   * @param {() => T} compute
   * @returns {T}
   */
  remembered(of, compute) {
    const key = JSON.stringify(of);
    let found = this.kept.get(key);
    if (found === undefined) found = compute();
    else this.kept.delete(key);
    this.kept.set(key, found);
    if (this.kept.size > MOST_KEPT) this.kept.delete(this.kept.keys().next().value ?? "");
    return found;
  }

  /**
   * Numbers of the controller of a situation, and of the guard around it, with the limits of the pump.
   * @param {Situation} situation
   * @returns {Numbers}
   */
  controllerNumbers(situation) {
    const { data } = this;
    const tuning = tuningOf(situation, data);
    const lags = lagOf(situation, data) > 0;
    /** @type {import("./design.mjs").Kept} */
    const kept = (of, compute) => this.remembered([situation.patient, lags, ...of], compute);
    const patient = data.patients[situation.patient];
    const designed = this.remembered([situation.patient, lags, situation.controller, tuning, situation.noise_variance], () => {
      const behind = lags ? { ...patient, response: patient.response_behind_lag } : patient;
      return design(situation.controller, tuning, behind, situation.noise_variance, data.sample_time_min, kept);
    });
    const { guard } = programsOf(situation, data);
    return ofController(designed, guard === null ? situation : { ...situation, guard: false }, data);
  }

  /** Numbers of a guard with a program of its own. @param {Situation} situation @returns {Numbers} */
  guardNumbers(situation) {
    return ofController({}, situation, this.data);
  }

  /**
   * Numbers of a controller that are those of a person, by the names of their places.
   * @param {Situation} situation
   * @param {Body} person
   * @returns {Record<string, number>}
   */
  ofPerson(situation, { basal_insulin_mU_min }) {
    const { controller, guard } = situation;
    const inner = guard ? "controller.inner." : "controller.";
    if (controller === "mpc-se") return { [`${inner}basal_mU_min`]: basal_insulin_mU_min };
    if (controller !== "basal-bolus") return {};
    const { basal_mU_min, carbs_per_U, fall_per_U } = basalBolus(tuningOf(situation, this.data), basal_insulin_mU_min);
    const own = { basal_mU_min, carbs_per_U, fall_per_U };
    return Object.fromEntries(Object.entries(own).map(([name, value]) => [`${inner}${name}`, value]));
  }

  /**
   * Moments of all meals of a situation, as the plant takes them, step by step.
   * @param {Situation} situation
   * @param {number} steps
   * @param {Body[]} people one for each lane
   * @returns {Float64Array} (steps, moments, lanes), or without lanes where all have the same gut
   */
  moments({ patient, meals }, steps, people) {
    const { family } = this.data.patients[patient];
    const name = functionOf(family, "meal");
    const { step_min } = this.data.families[family];
    const guts = people.map(({ gut }) => gut);
    const alike = guts.every((gut) => gut === guts[0] || gut.length === 0);
    const wide = alike ? 1 : guts.length;
    if (functionOf(family, "gut") in this.data.functions) {
      const compute = () => this.digested(family, meals, steps, guts, wide);
      return alike ? this.remembered([family, guts[0], meals, steps], compute) : compute();
    }
    const sum = new Float64Array(steps * MOMENTS * wide);
    for (const { t_min, carbs_g } of meals) {
      const compute = () => this.momentsOfMeal(name, { t_min, carbs_g }, { steps, step_min }, guts, wide);
      const of = alike ? this.remembered([name, guts[0], t_min, carbs_g, steps], compute) : compute();
      for (let i = 0; i < sum.length; i++) sum[i] += of[i];
    }
    return sum;
  }

  /**
   * Moments of meals in a gut that is given by its equations, which is carried from one point of the fine grid to the next.
   * @param {string} family
   * @param {{t_min: number, carbs_g: number}[]} meals
   * @param {number} steps
   * @param {number[][]} guts of the people, one for each lane
   * @param {number} wide lanes that are wanted
   */
  digested(family, meals, steps, guts, wide) {
    const { lanes } = this.kernels;
    const gut = this.stage(functionOf(family, "gut"));
    const each = gut.outputs.length / lanes;
    const points = (steps * MOMENTS) / each;
    const { mg, begins } = this.eatenInPoints(family, meals, points);
    guts.forEach((numbers, lane) => gut.set(numbers, lane));
    gut.prepared.computePerPerson();
    gut.carry.fill(0);
    const found = new Float64Array(points * each * wide);
    for (let point = 0; point < points; point++) {
      gut.own.fill(mg[point], 0, lanes);
      gut.own.fill(begins[point], lanes);
      gut.step();
      for (let i = 0; i < each; i++) for (let lane = 0; lane < wide; lane++) found[(point * each + i) * wide + lane] = gut.outputs[i * lanes + lane];
    }
    return found;
  }

  /**
   * What is eaten in each point of the fine grid, and whether a meal begins there (1) or not (0).
   * @param {string} family
   * @param {{t_min: number, carbs_g: number}[]} meals
   * @param {number} points
   */
  eatenInPoints(family, meals, points) {
    const eaten = this.stage(functionOf(family, "eaten"));
    const [point_min] = this.data.inside_min;
    const [mg, begins] = [new Float64Array(points), new Float64Array(points)];
    for (const { t_min, carbs_g } of meals) {
      eaten.give({ "meal.t_min": t_min, "meal.carbs_g": carbs_g });
      for (let point = Math.floor(t_min / point_min); point < points; point++) {
        eaten.shared[0] = point;
        eaten.step();
        mg[point] += eaten.outputs[0];
        begins[point] = Math.max(begins[point], eaten.outputs[eaten.lanes]);
        if (eaten.outputs[0] === 0 && point * point_min > t_min) break;
      }
    }
    return { mg, begins };
  }

  /**
   * @param {string} name of the function
   * @param {{t_min: number, carbs_g: number}} meal
   * @param {{steps: number, step_min: number}} grid
   * @param {number[][]} guts of the people, one for each lane
   * @param {number} wide lanes that are wanted
   */
  momentsOfMeal(name, { t_min, carbs_g }, { steps, step_min }, guts, wide) {
    const { lanes } = this.kernels;
    const stage = this.stage(name);
    stage.give({ "meal.t_min": t_min, "meal.carbs_g": carbs_g });
    if (guts[0].length > 0) {
      guts.forEach((gut, lane) => stage.set(gut, lane, stage.place("gut.0")));
      stage.prepared.computePerPerson();
    }
    const found = new Float64Array(steps * MOMENTS * wide);
    // Nothing appears before the meal.
    for (let i = Math.floor(t_min / step_min); i < steps; i++) {
      stage.shared[0] = i * step_min;
      stage.step();
      for (let j = 0; j < MOMENTS; j++) for (let lane = 0; lane < wide; lane++) found[(i * MOMENTS + j) * wide + lane] = stage.outputs[j * lanes + lane];
    }
    return found;
  }

  /**
   * @param {Situation} situation that `checked` returned
   * @param {Body} [body] another person than the nominal patient
   * @param {{memory?: boolean, seed?: number}} [asked] whether the trace tells what the controller keeps, and another seed
   *   of the random numbers than that of the situation
   * @returns {Trace}
   */
  simulate(situation, body = this.data.patients[situation.patient], asked = {}) {
    const { data } = this;
    const every = data.sample_time_min;
    const samples = Math.round(situation.duration_min / every);
    const inside = data.inside_min.length;
    const { lanes } = this.kernels;
    const t_min = timesOf(`${samples} x ${every}`, () => Array.from({ length: samples }, (_, k) => k * every));
    const fine_t_min = timesOf(`${samples} x ${every}: ${data.inside_min}`, () => [
      0,
      ...t_min.flatMap((t) => data.inside_min.map((after) => t + after)),
    ]);
    // Copies, because an array that is filled one number after another is made several times.
    const array = (/** @type {number[]} */ like) => like.slice();
    /** @type {Trace} */
    const trace = {
      t_min,
      glucose_mg_dl: array(t_min),
      reading_mg_dl: array(t_min),
      command_mU_min: array(t_min),
      insulin_mU_min: array(t_min),
      bolus_mU: array(t_min),
      status: array(t_min),
      fine_t_min,
      fine_glucose_mg_dl: array(fine_t_min),
    };
    trace.fine_glucose_mg_dl[0] = body.glucose_mg_dl;
    const loop = new LoopOfVector(this, situation);
    const kept = asked.memory ? loop.kept : 0;
    const memory = new Float64Array((samples + 1) * kept);
    const tell = (/** @type {number} */ k, /** @type {Happened} */ happened) => {
      trace.glucose_mg_dl[k] = happened.glucose_mg_dl[0];
      trace.reading_mg_dl[k] = happened.reading_mg_dl[0];
      trace.command_mU_min[k] = happened.command_mU_min[0];
      trace.insulin_mU_min[k] = happened.insulin_mU_min[0];
      trace.bolus_mU[k] = happened.bolus_mU[0];
      trace.status[k] = happened.status[0];
      for (let i = 0; i < inside; i++) {
        trace.fine_glucose_mg_dl[k * inside + i + 1] = happened.inside_mg_dl[i * lanes];
      }
      if (kept > 0) loop.remember(memory, (k + 1) * kept);
    };
    loop.begin(new Array(lanes).fill(body), new Array(lanes).fill(asked.seed ?? situation.seed));
    if (kept > 0) loop.remember(memory, 0);
    loop.run(tell);
    if (asked.memory) trace.memory = memory;
    return trace;
  }
}
