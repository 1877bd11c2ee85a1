// @ts-check
/** The closed loop, sample by sample, with the functions of the module: as `glucoloop.simulation.loop` defines it. */

import * as design from "./design.mjs";
import { limitsOf, tuningOf } from "./situation.mjs";

/** @typedef {import("../../native/targets/wasm/kernels.mjs").Kernels} Kernels */
/** @typedef {import("../../native/targets/wasm/kernels.mjs").Prepared} Prepared */
/** @typedef {import("../../native/targets/wasm/kernels.mjs").Sizes} Sizes */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./situation.mjs").Data} Data */

/**
 * @typedef {object} Trace
 * @property {number[]} t_min times of the samples
 * @property {number[]} glucose_mg_dl glucose at each sample, free of noise
 * @property {number[]} reading_mg_dl
 * @property {number[]} command_mU_min
 * @property {number[]} insulin_mU_min rate that is delivered from each sample to the next
 * @property {number[]} status
 * @property {number[]} fine_t_min a grid of one minute, both ends included
 * @property {number[]} fine_glucose_mg_dl
 * @property {{before: ArrayLike<number>, after: ArrayLike<number>}} [watched] what the controller keeps, about one sample
 */

/**
 * Numbers of a controller in the order in which its function takes them. What the design does not give, no step uses.
 * @param {Record<string, number>} fields name -> how many
 * @param {design.Numbers} given
 */
export function inOrder(fields, given) {
  const numbers = [];
  for (const [name, count] of Object.entries(fields)) {
    const own = given[name] ?? 0;
    const own_numbers = typeof own === "number" ? [own] : own;
    for (let i = 0; i < count; i++) numbers.push(own_numbers[i] ?? 0);
  }
  return numbers;
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
    /** @type {Map<string, Prepared>} */
    this.ready = new Map();
    /** The last design, which meals and noise leave as it is. @type {{of: string, numbers: design.Numbers}} */
    this.last = { of: "", numbers: {} };
  }

  /**
   * @param {string} name
   * @param {number} people
   * @param {number} samples
   */
  prepared(name, people = 1, samples = 1) {
    const key = `${name} ${people} ${samples}`;
    let found = this.ready.get(key);
    if (found === undefined) {
      const count = (/** @type {Record<string, number>} */ names) => Object.values(names).reduce((a, b) => a + b, 0);
      const { person, carry, own, shared, outputs } = this.data.functions[name];
      /** @type {Sizes} */
      const sizes = {
        person: count(person),
        carry: count(carry),
        own: count(own),
        shared: count(shared),
        outputs: count(outputs),
      };
      found = this.kernels.prepare(name, sizes, people, samples);
      this.ready.set(key, found);
    }
    return found;
  }

  /**
   * Numbers of the controller of a situation.
   * @param {Situation} situation
   * @returns {design.Numbers}
   */
  designed(situation) {
    const tuning = tuningOf(situation, this.data);
    const of = JSON.stringify([situation.patient, situation.controller, tuning]);
    if (this.last.of !== of) this.last = { of, numbers: this.design(situation, tuning) };
    return this.last.numbers;
  }

  /**
   * @param {Situation} situation
   * @param {design.Tuning} tuning
   * @returns {design.Numbers}
   */
  design(situation, tuning) {
    const patient = this.data.patients[situation.patient];
    const every = this.data.sample_time_min;
    switch (situation.controller) {
      case "pid":
        return design.pid(tuning, patient.first_order.pid, every);
      case "imc":
        return design.imc(tuning, patient.first_order.imc, every);
      case "mpc":
        return design.mpc(tuning, patient.step_response);
      default:
        return design.mpcSe(tuning, patient.linear);
    }
  }

  /**
   * Numbers of the controller and of the guard around it, with the limits of the pump.
   * @param {Situation} situation
   * @returns {design.Numbers}
   */
  controllerNumbers(situation) {
    const inner = { ...this.designed(situation) };
    const planned = situation.controller.startsWith("mpc") ? "plan." : "";
    for (const [name, value] of Object.entries(limitsOf(situation, this.data))) inner[`${planned}limits.${name}`] = value;
    if (!situation.guard) return inner;
    /** @type {design.Numbers} */
    const numbers = { basal_mU_min: NaN }; // a guard that is told no basal rate takes the one at the start
    for (const [name, value] of Object.entries(limitsOf(situation, this.data))) numbers[`limits.${name}`] = value;
    for (const [name, value] of Object.entries(inner)) numbers[`inner.${name}`] = value;
    return numbers;
  }

  /**
   * Moments of all meals of a situation, as the plant takes them, sample by sample.
   * @param {Situation} situation
   * @param {number} samples
   */
  moments(situation, samples) {
    const { meals } = situation;
    const count = Object.values(this.data.functions.meal.outputs).reduce((a, b) => a + b, 0);
    const total = new Float64Array(samples * count);
    if (meals.length === 0) return total;
    const meal = this.prepared("meal", meals.length, samples);
    const names = Object.keys(this.data.functions.meal.person);
    /** @type {Record<string, (meal: import("./situation.mjs").Meal) => number>} */
    const of = { t_min: (m) => m.t_min, carbs_g: (m) => m.carbs_g, eating_min: () => 0 };
    meal.set("person", names.flatMap((name) => meals.map(of[name])));
    meal.set("shared", Array.from({ length: samples }, (_, i) => i * this.data.sample_time_min));
    meal.run();
    const found = meal.get("outputs");
    for (let i = 0; i < total.length; i++) {
      for (let m = 0; m < meals.length; m++) total[i] += found[i * meals.length + m];
    }
    return total;
  }

  /**
   * @param {Situation} situation that `checked` returned
   * @param {number} [watch] sample about which the memory of the controller is told
   * @returns {Trace}
   */
  simulate(situation, watch) {
    const { data } = this;
    const patient = data.patients[situation.patient];
    const every = data.sample_time_min;
    const samples = Math.round(situation.duration_min / every);
    const name = situation.controller.replace("-", "_") + (situation.guard ? "_guarded" : "");
    const moments = this.moments(situation, samples);
    const numbers = this.controllerNumbers(situation);
    const start = this.prepared(`${name}_start`);
    const controller = this.prepared(`${name}_step`);
    const plant = this.prepared("plant");
    const noise = this.prepared("noise");

    start.set("person", inOrder(data.functions[`${name}_start`].person, numbers));
    controller.set("person", inOrder(data.functions[`${name}_step`].person, numbers));
    const of_pump = limitsOf(situation, data);
    const limits = Object.fromEntries(Object.entries(of_pump).map(([key, value]) => [`limits.${key}`, value]));
    const own = Object.fromEntries(patient.numbers.map((value, i) => [`patient.${i}`, value]));
    plant.set("person", inOrder(data.functions.plant.person, { ...limits, ...own, matrices: patient.matrices }));
    noise.set("person", inOrder(data.functions.noise.person, { variance: situation.noise_variance, bound_mg_dl: 5 }));

    const noisy = situation.noise_variance > 0;
    const late = Math.round(situation.dead_time_min / every);
    /** @type {number[]} */
    const line = new Array(late).fill(patient.glucose_mg_dl);
    const read = (/** @type {number} */ glucose, /** @type {number} */ k) => {
      if (!noisy) return glucose;
      noise.set("own", [glucose, data.normals[situation.seed][k]]);
      noise.run();
      return noise.get("outputs")[0];
    };
    // As `Observation`: glucose, valid, setpoint, delivered rate, announced carbohydrate.
    const observed = (/** @type {number} */ reading, /** @type {number} */ delivered) => [
      reading,
      Number.isFinite(reading) ? 1 : 0,
      patient.setpoint_mg_dl,
      delivered,
      0,
    ];

    let glucose = patient.glucose_mg_dl;
    let delivered = patient.basal_insulin_mU_min;
    const first = late > 0 ? line[0] : read(glucose, 0);
    start.set("own", observed(first, delivered));
    start.run();
    controller.set("carry", start.get("outputs"));
    const { min_mU_min, max_mU_min } = of_pump;
    const state = { x: patient.x, delivered_mU_min: Math.min(Math.max(delivered, min_mU_min), max_mU_min) };
    plant.set("carry", inOrder(data.functions.plant.carry, state));
    const places = offsets(data.functions.plant.outputs);

    /** @type {Trace} */
    const trace = {
      t_min: [],
      glucose_mg_dl: [],
      reading_mg_dl: [],
      command_mU_min: [],
      insulin_mU_min: [],
      status: [],
      fine_t_min: [0],
      fine_glucose_mg_dl: [glucose],
    };
    const per_sample = moments.length / samples;
    for (let k = 0; k < samples; k++) {
      line.push(read(glucose, k));
      const reading = /** @type {number} */ (line.shift());
      controller.set("own", observed(reading, delivered));
      const before = k === watch ? controller.get("carry") : undefined;
      controller.run();
      if (before !== undefined) trace.watched = { before, after: controller.get("carry") };
      const [command, status] = controller.get("outputs");
      plant.set("own", [command, ...moments.subarray(k * per_sample, (k + 1) * per_sample)]);
      plant.run();
      const after = plant.get("outputs");
      trace.t_min.push(k * every);
      trace.glucose_mg_dl.push(glucose);
      trace.reading_mg_dl.push(reading);
      trace.command_mU_min.push(command);
      trace.insulin_mU_min.push(after[places.delivered_mU_min]);
      trace.status.push(status);
      data.inside_min.forEach((t, i) => {
        trace.fine_t_min.push(k * every + t);
        trace.fine_glucose_mg_dl.push(after[places.inside_mg_dl + i]);
      });
      glucose = after[places.glucose_mg_dl];
      delivered = after[places.reported_mU_min];
    }
    return trace;
  }
}

/**
 * Where each output begins.
 * @param {Record<string, number>} names
 * @returns {Record<string, number>}
 */
function offsets(names) {
  let at = 0;
  return Object.fromEntries(
    Object.entries(names).map(([name, count]) => {
      const here = at;
      at += count;
      return [name, here];
    }),
  );
}

/**
 * The numbers below the picture, as `glucoloop run` gives them.
 * @param {Trace} trace
 */
export function summary(trace) {
  const glucose = trace.fine_glucose_mg_dl;
  const part = (/** @type {(value: number) => boolean} */ test) => (100 * glucose.filter(test).length) / glucose.length;
  const every = trace.t_min.length > 1 ? trace.t_min[1] - trace.t_min[0] : 0;
  return {
    mean_mg_dl: glucose.reduce((a, b) => a + b, 0) / glucose.length,
    minimum_mg_dl: Math.min(...glucose),
    peak_mg_dl: Math.max(...glucose),
    time_70_180_pct: part((value) => value >= 70 && value <= 180),
    time_below_70_pct: part((value) => value < 70),
    insulin_total_mU: trace.insulin_mU_min.reduce((a, b) => a + b, 0) * every,
  };
}
