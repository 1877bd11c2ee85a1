// @ts-check
/** The closed loop, sample by sample, with the functions of the module: as `glucoloop.simulation.loop` defines it. */

import { design } from "./design.mjs";
import { ofController, ofFault, ofPump } from "./fields.mjs";
import { tuningOf } from "./situation.mjs";

/** @typedef {import("../../native/targets/wasm/kernels.mjs").Kernels} Kernels */
/** @typedef {import("../../native/targets/wasm/kernels.mjs").Prepared} Prepared */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./design.mjs").Numbers} Numbers */

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
 * A person at rest.
 * @typedef {object} Body
 * @property {ArrayLike<number>} numbers of the patient that differ between people
 * @property {ArrayLike<number>} matrices of the integrator, without their zeros
 * @property {ArrayLike<number>} x state
 * @property {number} basal_insulin_mU_min
 * @property {number} glucose_mg_dl
 */

/**
 * What happens at each sample: arrays of one number for each person of the vector, overwritten at the next sample.
 * @typedef {object} Happened
 * @property {ArrayLike<number>} glucose_mg_dl at the sample
 * @property {ArrayLike<number>} reading_mg_dl
 * @property {ArrayLike<number>} command_mU_min
 * @property {ArrayLike<number>} insulin_mU_min
 * @property {ArrayLike<number>} status
 * @property {ArrayLike<number>} inside_mg_dl (moments, people) glucose until the next sample, its moment included
 */

const MOMENTS = 3;
const MOST_KEPT = 32;

/**
 * Numbers in the order in which a function takes them. What is not given, no step uses.
 * @param {Record<string, number>} fields name -> how many
 * @param {Numbers} given
 * @returns {Float64Array}
 */
export function inOrder(fields, given) {
  let count = 0;
  for (const name in fields) count += fields[name];
  const numbers = new Float64Array(count);
  let at = 0;
  for (const name in fields) {
    const own = given[name];
    if (typeof own === "number") numbers[at] = own;
    else if (own !== undefined) for (let i = 0; i < fields[name] && i < own.length; i++) numbers[at + i] = own[i];
    at += fields[name];
  }
  return numbers;
}

/** @param {Record<string, number>} names */
function total(names) {
  return Object.values(names).reduce((a, b) => a + b, 0);
}

/** Functions of one vector of people, whose arrays are read and written in place. */
export class Stage {
  /**
   * @param {Lab} lab
   * @param {string} name
   */
  constructor(lab, name) {
    this.fields = lab.data.functions[name];
    this.lanes = lab.kernels.lanes;
    this.prepared = lab.prepared(name);
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.outputs = this.prepared.view("outputs");
  }

  /** Find the arrays again after the memory of the module has grown. */
  refresh() {
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.outputs = this.prepared.view("outputs");
  }

  /**
   * Set the numbers of all people of the vector, or of one of them, without computing what follows from them.
   * @param {ArrayLike<number>} numbers
   * @param {number} [lane]
   * @param {number} [at] place of the first
   */
  set(numbers, lane, at = 0) {
    const { lanes, person } = this;
    for (let i = 0; i < numbers.length; i++) {
      if (lane === undefined) for (let l = 0; l < lanes; l++) person[(at + i) * lanes + l] = numbers[i];
      else person[(at + i) * lanes + lane] = numbers[i];
    }
  }

  /** Place of the numbers of a name among those of a person. @param {string} name */
  place(name) {
    let at = 0;
    for (const other in this.fields.person) {
      if (other === name) return at;
      at += this.fields.person[other];
    }
    throw new RangeError(`the function takes no ${name}`);
  }

  /** @param {Numbers} given numbers by name, of all people of the vector */
  give(given) {
    this.set(inOrder(this.fields.person, given));
    this.prepared.hold();
  }

  step() {
    this.prepared.advance();
  }
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
    /** @type {Map<string, Stage>} */
    this.stages = new Map();
    /** Designs and meals that were computed last, by what they were computed from. @type {Map<string, any>} */
    this.kept = new Map();
  }

  /**
   * @param {string} name
   * @param {number} samples
   */
  prepared(name, samples = 1) {
    const key = `${name} ${samples}`;
    let found = this.ready.get(key);
    if (found === undefined) {
      const { person, held, carry, own, shared, outputs } = this.data.functions[name];
      const sizes = {
        person: total(person),
        held,
        carry: total(carry),
        own: total(own),
        shared: total(shared),
        outputs: total(outputs),
      };
      found = this.kernels.prepare(name, sizes, this.kernels.lanes, samples);
      this.ready.set(key, found);
      for (const stage of this.stages.values()) stage.refresh();
    }
    return found;
  }

  /** @param {string} name */
  stage(name) {
    let found = this.stages.get(name);
    if (found === undefined) {
      found = new Stage(this, name);
      this.stages.set(name, found);
    }
    return found;
  }

  /** The plant of a patient. @param {string} patient */
  plant(patient) {
    return this.stage(`${this.data.patients[patient].family.replaceAll("-", "_")}_plant`);
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
    const kalman = (/** @type {unknown} */ of, /** @type {() => number[]} */ gain) =>
      this.remembered([situation.patient, "kalman", of], gain);
    const designed = this.remembered([situation.patient, situation.controller, tuning], () =>
      design(situation.controller, tuning, data.patients[situation.patient], data.sample_time_min, kalman),
    );
    return ofController(designed, situation, data);
  }

  /**
   * Moments of all meals of a situation, as the plant takes them, step by step.
   * @param {Situation} situation
   * @param {number} steps
   * @returns {Float64Array} (steps, moments)
   */
  moments(situation, steps) {
    const sum = new Float64Array(steps * MOMENTS);
    const { family } = this.data.patients[situation.patient];
    for (const { t_min, carbs_g } of situation.meals) {
      const of = this.remembered([family, t_min, carbs_g, steps], () => this.momentsOfMeal(family, t_min, carbs_g, steps));
      for (let i = 0; i < sum.length; i++) sum[i] += of[i];
    }
    return sum;
  }

  /**
   * @param {string} family
   * @param {number} t_min
   * @param {number} carbs_g
   * @param {number} steps
   */
  momentsOfMeal(family, t_min, carbs_g, steps) {
    const { step_min, functions } = this.data;
    const { lanes } = this.kernels;
    const name = `${family.replaceAll("-", "_")}_meal`;
    const meal = this.prepared(name);
    const stage = this.stage(name);
    stage.give({ t_min, carbs_g, eating_min: 0 });
    const shared = meal.view("shared");
    const found = new Float64Array(steps * total(functions[name].outputs));
    // Nothing appears before the meal.
    for (let i = Math.floor(t_min / step_min); i < steps; i++) {
      shared[0] = i * step_min;
      stage.step();
      for (let j = 0; j < MOMENTS; j++) found[i * MOMENTS + j] = stage.outputs[j * lanes];
    }
    return found;
  }

  /**
   * @param {Situation} situation that `checked` returned
   * @param {number} [watch] sample about which the memory of the controller is told
   * @param {Body} [body] another person than the nominal patient
   * @returns {Trace}
   */
  simulate(situation, watch, body = this.data.patients[situation.patient]) {
    const { data } = this;
    const every = data.sample_time_min;
    const samples = Math.round(situation.duration_min / every);
    const inside = data.inside_min.length;
    const { lanes } = this.kernels;
    const array = (/** @type {number} */ length) => new Array(length).fill(0);
    /** @type {Trace} */
    const trace = {
      t_min: array(samples),
      glucose_mg_dl: array(samples),
      reading_mg_dl: array(samples),
      command_mU_min: array(samples),
      insulin_mU_min: array(samples),
      status: array(samples),
      fine_t_min: array(samples * inside + 1),
      fine_glucose_mg_dl: array(samples * inside + 1),
    };
    trace.fine_glucose_mg_dl[0] = body.glucose_mg_dl;
    const loop = new LoopOfVector(this, situation);
    loop.watch = watch;
    loop.run(new Array(lanes).fill(body), (k, happened) => {
      trace.t_min[k] = k * every;
      trace.glucose_mg_dl[k] = happened.glucose_mg_dl[0];
      trace.reading_mg_dl[k] = happened.reading_mg_dl[0];
      trace.command_mU_min[k] = happened.command_mU_min[0];
      trace.insulin_mU_min[k] = happened.insulin_mU_min[0];
      trace.status[k] = happened.status[0];
      for (let i = 0; i < inside; i++) {
        trace.fine_t_min[k * inside + i + 1] = k * every + data.inside_min[i];
        trace.fine_glucose_mg_dl[k * inside + i + 1] = happened.inside_mg_dl[i * lanes];
      }
    });
    if (loop.watched !== undefined) trace.watched = loop.watched;
    return trace;
  }
}

/**
 * Put people into the plant: constants, matrices and states.
 * @param {Stage} plant
 * @param {Body[]} people one for each lane
 */
export function put(plant, people) {
  const { person } = plant.fields;
  const first = Object.keys(person).find((name) => name !== "matrices") ?? "";
  const [of_patient, of_matrices] = [plant.place(first), plant.place("matrices")];
  people.forEach(({ numbers, matrices, x }, lane) => {
    plant.set(matrices, lane, of_matrices);
    plant.set(numbers, lane, of_patient);
    for (let i = 0; i < x.length; i++) plant.carry[i * plant.lanes + lane] = x[i];
  });
  plant.prepared.hold();
}

/** The loop of a situation for one vector of people after another. */
export class LoopOfVector {
  /**
   * @param {Lab} lab
   * @param {Situation} situation that `checked` returned
   */
  constructor(lab, situation) {
    const { data } = lab;
    this.lab = lab;
    this.situation = situation;
    this.patient = data.patients[situation.patient];
    this.samples = Math.round(situation.duration_min / data.sample_time_min);
    this.steps = Math.round(data.sample_time_min / data.step_min);
    this.moments = lab.moments(situation, this.samples * this.steps);
    const name = situation.controller.replace("-", "_") + (situation.guard ? "_guarded" : "");
    const pump = ofPump(situation, data);
    const faults = situation.faults.filter((fault) => data.faults[fault.name].part === "sensor");
    this.noise = situation.noise_variance > 0 ? lab.stage("noise") : null;
    this.faults = faults.map((fault) => {
      const of = ofFault(fault, data);
      // Two faults of one kind have states of their own, and share the function's arrays.
      return { ...of, start: lab.stage(`${of.name}_start`), stage: lab.stage(of.name), state: new Float64Array(0) };
    });
    this.start = lab.stage(`${name}_start`);
    this.controller = lab.stage(`${name}_step`);
    this.pumpStart = lab.stage(`${pump.name}_start`);
    this.pump = lab.stage(pump.name);
    this.plant = lab.plant(situation.patient);
    this.numbers = lab.controllerNumbers(situation);
    /** Sample about which the memory of the controller is told. @type {number | undefined} */
    this.watch = undefined;
    /** @type {{before: number[], after: number[]} | undefined} */
    this.watched = undefined;

    this.noise?.give({ variance: situation.noise_variance, bound_mg_dl: 5 });
    for (const stage of [this.pumpStart, this.pump]) stage.give(pump.numbers);
    for (const stage of [this.start, this.controller]) stage.give(this.numbers);
  }

  /** What the controller keeps of the first person. */
  memory() {
    const { carry, lanes } = this.controller;
    return Array.from({ length: carry.length / lanes }, (_, i) => carry[i * lanes]);
  }

  /**
   * Simulate one vector of people.
   * @param {Body[]} people one for each lane
   * @param {(sample: number, happened: Happened) => void} tell
   * @param {ArrayLike<number>[]} [normals] of each person, for the noise of the readings; those of the seed for all
   */
  run(people, tell, normals) {
    const { lab, situation, patient, samples, steps, noise, faults, start, controller, pumpStart, pump, plant } = this;
    const { data, kernels } = lab;
    const { lanes } = kernels;
    const drawn = normals ?? new Array(lanes).fill(data.normals[situation.seed]);
    const inside = data.inside[patient.family];
    const each = (/** @type {(lane: number) => void} */ of) => {
      for (let lane = 0; lane < lanes; lane++) of(lane);
    };

    put(plant, people);
    if (situation.controller === "mpc-se" && people.some((person) => person !== patient)) {
      const name = `controller.${situation.guard ? "inner." : ""}basal_mU_min`;
      for (const stage of [start, controller]) {
        each((lane) => stage.set([people[lane].basal_insulin_mU_min], lane, stage.place(name)));
        stage.prepared.hold();
      }
    }

    const glucose = new Float64Array(lanes);
    const reading = new Float64Array(lanes);
    const valid = new Float64Array(lanes);
    const reported = new Float64Array(lanes);
    const command = new Float64Array(lanes);
    const late = Math.round(situation.dead_time_min / data.sample_time_min);
    const line = new Float64Array(Math.max(1, late) * lanes);
    each((lane) => {
      glucose[lane] = people[lane].glucose_mg_dl;
      reported[lane] = people[lane].basal_insulin_mU_min;
      for (let i = 0; i < late; i++) line[i * lanes + lane] = glucose[lane];
    });

    const wake = () => {
      for (const fault of faults) {
        fault.start.give(fault.numbers);
        each((lane) => {
          fault.start.own[lane] = glucose[lane];
          fault.start.own[lanes + lane] = 0.5; // the draw of an onset that is given
        });
        fault.start.step();
        fault.state = Float64Array.from(fault.start.outputs);
      }
    };
    const read = (/** @type {number} */ k, /** @type {boolean} */ first) => {
      if (noise === null) reading.set(glucose);
      else {
        each((lane) => {
          noise.own[lane] = glucose[lane];
          noise.own[lanes + lane] = drawn[lane][k];
        });
        noise.step();
        each((lane) => (reading[lane] = noise.outputs[lane]));
      }
      if (late > 0) {
        const place = (k % late) * lanes;
        each((lane) => {
          const newest = reading[lane];
          reading[lane] = line[place + lane];
          if (!first) line[place + lane] = newest;
        });
      }
      valid.fill(1);
      for (const fault of faults) {
        const { stage } = fault;
        stage.give(fault.numbers);
        stage.carry.set(fault.state);
        each((lane) => {
          stage.own[lane] = reading[lane];
          stage.own[lanes + lane] = valid[lane];
        });
        stage.step();
        fault.state.set(stage.carry);
        each((lane) => {
          reading[lane] = stage.outputs[lane];
          valid[lane] = stage.outputs[lanes + lane];
        });
      }
    };
    // As `Observation`: glucose, valid, setpoint, delivered rate, announced carbohydrate.
    const observe = (/** @type {Stage} */ stage) =>
      each((lane) => {
        stage.own[lane] = reading[lane];
        stage.own[lanes + lane] = valid[lane];
        stage.own[2 * lanes + lane] = patient.setpoint_mg_dl;
        stage.own[3 * lanes + lane] = reported[lane];
        stage.own[4 * lanes + lane] = 0;
      });

    wake();
    read(0, true);
    observe(start);
    start.step();
    controller.carry.set(start.outputs);
    wake();
    each((lane) => {
      pumpStart.own[lane] = reported[lane];
      if (pumpStart.own.length > lanes) pumpStart.own[lanes + lane] = 0.5;
    });
    pumpStart.step();
    pump.carry.set(pumpStart.outputs);

    const status = pump.outputs.subarray(2 * lanes);
    const insulin = pump.outputs.subarray(0, lanes);
    const within = new Float64Array(inside.length * lanes);
    const happened = {
      glucose_mg_dl: glucose,
      reading_mg_dl: reading,
      command_mU_min: command,
      insulin_mU_min: insulin,
      status,
      inside_mg_dl: within,
    };
    for (let k = 0; k < samples; k++) {
      read(k, false);
      observe(controller);
      const before = k === this.watch ? this.memory() : undefined;
      controller.step();
      if (before !== undefined) this.watched = { before, after: this.memory() };
      pump.own.set(controller.outputs); // rate and status
      for (let lane = 0; lane < lanes; lane++) command[lane] = controller.outputs[lane];
      pump.step();
      for (let lane = 0; lane < lanes; lane++) {
        reported[lane] = pump.outputs[lanes + lane];
        plant.own[lane] = insulin[lane];
      }
      for (let step = 0; step < steps; step++) {
        const at = (k * steps + step) * MOMENTS;
        for (let i = 0; i < MOMENTS; i++) {
          for (let lane = 0; lane < lanes; lane++) plant.own[(1 + i) * lanes + lane] = this.moments[at + i];
        }
        plant.step();
        for (let i = 0; i < inside.length; i++) {
          if (inside[i][0] !== step) continue;
          for (let lane = 0; lane < lanes; lane++) {
            within[i * lanes + lane] = plant.outputs[(1 + inside[i][1]) * lanes + lane];
          }
        }
      }
      tell(k, happened);
      for (let lane = 0; lane < lanes; lane++) glucose[lane] = plant.outputs[lane];
    }
  }
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
