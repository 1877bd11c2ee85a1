// @ts-check
/** The closed loop, sample by sample, with the functions of the module: as `glucoloop.simulation.loop` defines it. */

import { design } from "./design.mjs";
import { ofController, ofFault, ofPump } from "./fields.mjs";
import { familyOf, tuningOf } from "./situation.mjs";
import { drawForPump, drawForSensor } from "./threefry.mjs";

/** @typedef {import("../../native/targets/wasm/kernels.mjs").Kernels} Kernels */
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
 * @property {Float64Array} [memory] (samples + 1, numbers) what the controller keeps before each sample and after the last,
 *   if asked for
 */

/**
 * A person at rest.
 * @typedef {object} Body
 * @property {ArrayLike<number>} numbers of the patient that differ between people
 * @property {ArrayLike<number>} matrices of the integrator, without their zeros
 * @property {ArrayLike<number>} [driven] the first of them where they are the person's own
 * @property {number[]} gut numbers in which the guts of people differ
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

/** Name of the functions of a controller, without what they do. @param {Situation} situation @param {Data} data */
export function controllerName(situation, data) {
  const { route } = familyOf(situation, data);
  return `${route}_${situation.controller.replace("-", "_")}${situation.guard ? "_guarded" : ""}`;
}

/** Name of a function of a family's patients. @param {string} family @param {"plant" | "meal" | "person"} what */
export function functionOf(family, what) {
  return `${family.replaceAll("-", "_")}_${what}`;
}

/** @param {Record<string, number>} names */
function total(names) {
  return Object.values(names).reduce((a, b) => a + b, 0);
}

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

/** A function of one vector of people, whose arrays are read and written in place. */
export class Stage {
  /**
   * @param {Lab} lab
   * @param {string} name
   */
  constructor(lab, name) {
    this.fields = lab.data.functions[name];
    const { person, held, carry, own, shared, outputs } = this.fields;
    const sizes = {
      person: total(person),
      held,
      carry: total(carry),
      own: total(own),
      shared: total(shared),
      outputs: total(outputs),
    };
    this.lanes = lab.kernels.lanes;
    /** Lists that the function holds, of all people of the vector. @type {Record<string, number[]>} */
    this.given = {};
    this.prepared = lab.kernels.prepare(name, sizes, this.lanes);
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.shared = this.prepared.view("shared");
    this.outputs = this.prepared.view("outputs");
  }

  /** Find the arrays again after the memory of the module has grown. */
  refresh() {
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.shared = this.prepared.view("shared");
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

  /** Place of the numbers of a name among those of a person, or of another group. @param {string} name @param {"person" | "carry" | "outputs"} [group] */
  place(name, group = "person") {
    let at = 0;
    for (const other in this.fields[group]) {
      if (other === name) return at;
      at += this.fields[group][other];
    }
    throw new RangeError(`the function has no ${name}`);
  }

  /**
   * Give numbers by name to all people of the vector; a list that the function holds already is not copied again.
   * What is not given, no step uses.
   * @param {Numbers} given
   */
  give(given) {
    const { lanes, person, fields, given: before } = this;
    let at = 0;
    for (const name in fields.person) {
      const count = fields.person[name];
      const own = given[name];
      if (typeof own === "object") {
        for (let i = 0; own !== before[name] && i < count; i++) {
          const value = i < own.length ? own[i] : 0;
          for (let lane = 0; lane < lanes; lane++) person[(at + i) * lanes + lane] = value;
        }
        before[name] = own;
      } else {
        delete before[name];
        person.fill(0, at * lanes, (at + count) * lanes);
        if (own !== undefined) person.fill(own, at * lanes, (at + 1) * lanes);
      }
      at += count;
    }
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
    /** @type {import("./design.mjs").Kept} */
    const kept = (of, compute) => this.remembered([situation.patient, ...of], compute);
    const designed = this.remembered([situation.patient, situation.controller, tuning], () =>
      design(situation.controller, tuning, data.patients[situation.patient], data.sample_time_min, kept),
    );
    return ofController(designed, situation, data);
  }

  /**
   * Moments of all meals of a situation, as the plant takes them, step by step.
   * @param {Situation} situation
   * @param {number} steps
   * @param {Body[]} people one for each lane
   * @returns {Float64Array} (steps, moments, lanes), or without lanes where all have the same gut
   */
  moments({ patient, meals }, steps, people) {
    const name = functionOf(this.data.patients[patient].family, "meal");
    const guts = people.map(({ gut }) => gut);
    const alike = guts.every((gut) => gut === guts[0] || gut.length === 0);
    const wide = alike ? 1 : guts.length;
    const sum = new Float64Array(steps * MOMENTS * wide);
    for (const { t_min, carbs_g } of meals) {
      const compute = () => this.momentsOfMeal(name, { t_min, carbs_g }, steps, guts, wide);
      const of = alike ? this.remembered([name, guts[0], t_min, carbs_g, steps], compute) : compute();
      for (let i = 0; i < sum.length; i++) sum[i] += of[i];
    }
    return sum;
  }

  /**
   * @param {string} name of the function
   * @param {{t_min: number, carbs_g: number}} meal
   * @param {number} steps
   * @param {number[][]} guts of the people, one for each lane
   * @param {number} wide lanes that are wanted
   */
  momentsOfMeal(name, { t_min, carbs_g }, steps, guts, wide) {
    const { step_min } = this.data;
    const { lanes } = this.kernels;
    const stage = this.stage(name);
    stage.give({ "meal.t_min": t_min, "meal.carbs_g": carbs_g });
    if (guts[0].length > 0) {
      guts.forEach((gut, lane) => stage.set(gut, lane, stage.place("gut.0")));
      stage.prepared.hold();
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

/** Who is in all lanes of a plant, if it is one person. @type {WeakMap<Stage, Body>} */
const held = new WeakMap();

/**
 * Put people into the plant: constants, matrices and states. Only the states change while it is stepped, so that a
 * person who is in it already is not put there again.
 * @param {Stage} plant
 * @param {Body[]} people one for each lane
 */
export function put(plant, people) {
  const { person } = plant.fields;
  const first = Object.keys(person).find((name) => name !== "matrices");
  // Where all patients of a family are alike, their numbers are part of the function.
  const of_patient = first === undefined ? 0 : plant.place(first);
  const of_matrices = plant.place("matrices");
  people.forEach(({ x }, lane) => {
    for (let i = 0; i < x.length; i++) plant.carry[i * plant.lanes + lane] = x[i];
  });
  const [alike] = people;
  if (held.get(plant) === alike && people.every((body) => body === alike)) return;
  people.forEach(({ numbers, matrices, driven }, lane) => {
    plant.set(matrices, lane, of_matrices);
    if (driven !== undefined) plant.set(driven, lane, of_matrices);
    plant.set(numbers, lane, of_patient);
  });
  plant.prepared.hold();
  if (people.every((body) => body === alike)) held.set(plant, alike);
  else held.delete(plant);
}

/** The earlier readings of a fault that gives one of them; its function is shown the one that is chosen. */
class Past {
  /**
   * @param {Stage} stage
   * @param {number} earlier readings that are kept
   * @param {boolean} random whether one of them or the newest is drawn at each sample; otherwise it is the oldest
   */
  constructor(stage, earlier, random) {
    this.stage = stage;
    this.earlier = earlier;
    this.random = random;
    this.readings = new Float64Array(earlier * stage.lanes);
    this.valid = new Float64Array(earlier * stage.lanes);
    this.at = { reading: stage.place("past.glucose_mg_dl", "carry"), valid: stage.place("past.valid", "carry") };
  }

  /** @param {Float64Array} glucose that was read for a long time */
  fill(glucose) {
    for (let i = 0; i < this.readings.length; i++) this.readings[i] = glucose[i % glucose.length];
    this.valid.fill(1);
  }

  /**
   * Show the chosen reading, and keep the newest.
   * @param {number} k sample
   * @param {Float64Array} newest
   * @param {Float64Array} valid
   * @param {number[]} seeds
   * @param {boolean} moves whether the newest is kept
   */
  show(k, newest, valid, seeds, moves) {
    const { stage, earlier, at } = this;
    const { carry, lanes } = stage;
    for (let lane = 0; lane < lanes; lane++) {
      const ago = this.random ? earlier - Math.floor((earlier + 1) * drawForSensor(seeds[lane], k)) : earlier;
      const from = ((k - ago + earlier) % earlier) * lanes + lane;
      carry[at.reading * lanes + lane] = ago === 0 ? newest[lane] : this.readings[from];
      carry[at.valid * lanes + lane] = ago === 0 ? valid[lane] : this.valid[from];
      if (!moves) continue;
      this.readings[(k % earlier) * lanes + lane] = newest[lane];
      this.valid[(k % earlier) * lanes + lane] = valid[lane];
    }
  }
}

/** What stands for the draw of an onset that is given. */
const DRAWN = 0.5;

/** The loop of a situation for one vector of people after another. */
export class LoopOfVector {
  /**
   * @param {Lab} lab
   * @param {Situation} situation that `checked` returned
   */
  constructor(lab, situation) {
    const { data, kernels } = lab;
    const { lanes } = kernels;
    this.lab = lab;
    this.situation = situation;
    this.patient = data.patients[situation.patient];
    this.samples = Math.round(situation.duration_min / data.sample_time_min);
    this.steps = Math.round(data.sample_time_min / data.step_min);
    /** Moments of the meals; see `Lab.moments`. @type {Float64Array} */
    this.moments = new Float64Array(0);
    const name = controllerName(situation, data);
    const pump = ofPump(situation, data);
    this.noise = situation.noise_variance > 0 ? lab.stage("noise") : null;
    this.faults = situation.faults
      .filter((fault) => data.faults[fault.name].part === "sensor")
      .map((fault, place) => {
        const { name, numbers, earlier, random } = ofFault(fault, data);
        const [start, stage] = [lab.stage(`${name}_start`, place), lab.stage(name, place)];
        return { numbers, start, stage, past: earlier > 0 ? new Past(stage, earlier, random) : null };
      });
    this.start = lab.stage(`${name}_start`);
    this.controller = lab.stage(`${name}_step`);
    this.pumpStart = lab.stage(`${pump.name}_start`);
    this.pump = lab.stage(pump.name);
    this.plant = lab.plant(situation.patient);

    this.noise?.give({ variance: situation.noise_variance, bound_mg_dl: 5 });
    for (const { numbers, start, stage } of this.faults) for (const of of [start, stage]) of.give(numbers);
    for (const stage of [this.pumpStart, this.pump]) stage.give(pump.numbers);
    const numbers = lab.controllerNumbers(situation);
    for (const stage of [this.start, this.controller]) stage.give(numbers);

    /** Samples by which a reading is late, and the readings on their way. */
    this.late = Math.round(situation.dead_time_min / data.sample_time_min);
    this.line = new Float64Array(this.late * lanes);
    this.glucose = new Float64Array(lanes);
    this.reading = new Float64Array(lanes);
    this.valid = new Float64Array(lanes);
    this.reported = new Float64Array(lanes);
    /** Seeds of the people's random numbers. @type {number[]} */
    this.seeds = [];
    this.drawsPump = "drawn" in this.pump.fields.own;
  }

  /** How many numbers the controller keeps of a person. */
  get kept() {
    return this.controller.carry.length / this.controller.lanes;
  }

  /** Copy what the controller keeps of the first person. @param {Float64Array} into @param {number} at */
  remember(into, at) {
    const { carry, lanes } = this.controller;
    for (let i = 0; i < carry.length; i += lanes) into[at++] = carry[i];
  }

  /**
   * Read glucose at a sample, through noise, dead time and faults.
   * @param {number} k
   * @param {boolean} moves whether the readings on their way move
   */
  read(k, moves) {
    const { noise, faults, glucose, reading, valid, late, line, seeds } = this;
    const { normals } = this.lab.data;
    const lanes = reading.length;
    if (noise !== null) {
      for (let lane = 0; lane < lanes; lane++) {
        noise.own[lane] = glucose[lane];
        noise.own[lanes + lane] = normals[seeds[lane]][k];
      }
      noise.step();
    }
    const newest = noise === null ? glucose : noise.outputs;
    const place = late > 0 ? (k % late) * lanes : 0;
    for (let lane = 0; lane < lanes; lane++) {
      valid[lane] = 1;
      reading[lane] = late > 0 ? line[place + lane] : newest[lane];
      if (late > 0 && moves) line[place + lane] = newest[lane];
    }
    for (const { stage, past } of faults) {
      const { own, outputs } = stage;
      past?.show(k, reading, valid, seeds, moves);
      for (let lane = 0; lane < lanes; lane++) {
        own[lane] = reading[lane];
        own[lanes + lane] = valid[lane];
      }
      stage.step();
      for (let lane = 0; lane < lanes; lane++) {
        reading[lane] = outputs[lane];
        valid[lane] = outputs[lanes + lane];
      }
    }
  }

  /** Show a controller what was read, in the order of `Observation`. @param {Stage} stage */
  observe({ own, lanes }) {
    const { reading, valid, reported, patient } = this;
    for (let lane = 0; lane < lanes; lane++) {
      own[lane] = reading[lane];
      own[lanes + lane] = valid[lane];
      own[2 * lanes + lane] = patient.setpoint_mg_dl;
      own[3 * lanes + lane] = reported[lane];
      own[4 * lanes + lane] = 0;
    }
  }

  /** Bring the faults of the sensor to their start. */
  wake() {
    const { faults, glucose } = this;
    const lanes = glucose.length;
    for (const { start, stage, past } of faults) {
      past?.fill(glucose);
      for (let lane = 0; lane < lanes; lane++) {
        start.own[lane] = glucose[lane];
        start.own[lanes + lane] = DRAWN;
      }
      start.step();
      stage.carry.set(start.outputs);
    }
  }

  /**
   * Begin with one vector of people.
   * @param {Body[]} people one for each lane
   * @param {number[]} seeds of each person's random numbers
   */
  begin(people, seeds) {
    const { lab, situation, patient, start, controller, pumpStart, pump, plant, glucose, reported, late, line } = this;
    const { lanes } = lab.kernels;
    this.seeds = seeds;
    this.moments = lab.moments(situation, this.samples * this.steps, people);
    put(plant, people);
    if (situation.controller === "mpc-se" && people.some((person) => person !== patient)) {
      const name = `controller.${situation.guard ? "inner." : ""}basal_mU_min`;
      for (const stage of [start, controller]) {
        people.forEach((person, lane) => stage.set([person.basal_insulin_mU_min], lane, stage.place(name)));
        stage.prepared.hold();
      }
    }
    for (let lane = 0; lane < lanes; lane++) {
      glucose[lane] = people[lane].glucose_mg_dl;
      reported[lane] = people[lane].basal_insulin_mU_min;
      for (let i = 0; i < late; i++) line[i * lanes + lane] = glucose[lane];
    }
    this.wake();
    this.read(0, false);
    this.observe(start);
    start.step();
    controller.carry.set(start.outputs);
    this.wake();
    pumpStart.own.fill(DRAWN);
    pumpStart.own.set(reported);
    pumpStart.step();
    pump.carry.set(pumpStart.outputs);
  }

  /**
   * Simulate the vector of people that was begun with.
   * @param {(sample: number, happened: Happened) => void} tell
   */
  run(tell) {
    const { samples, steps, moments, controller, pump, plant, glucose, reported, seeds, drawsPump } = this;
    const lanes = glucose.length;
    const { inside } = familyOf(this.situation, this.lab.data);
    const within = new Float64Array(inside.length * lanes);
    const wide = moments.length / (samples * steps * MOMENTS);
    const happened = {
      glucose_mg_dl: glucose,
      reading_mg_dl: this.reading,
      command_mU_min: controller.outputs,
      insulin_mU_min: pump.outputs,
      status: pump.outputs.subarray(2 * lanes),
      inside_mg_dl: within,
    };
    for (let k = 0; k < samples; k++) {
      this.read(k, true);
      this.observe(controller);
      controller.step();
      for (let i = 0; i < 2 * lanes; i++) pump.own[i] = controller.outputs[i]; // rate and status
      if (drawsPump) for (let lane = 0; lane < lanes; lane++) pump.own[2 * lanes + lane] = drawForPump(seeds[lane], k);
      pump.step();
      for (let lane = 0; lane < lanes; lane++) {
        reported[lane] = pump.outputs[lanes + lane];
        plant.own[lane] = pump.outputs[lane];
      }
      for (let step = 0; step < steps; step++) {
        const at = (k * steps + step) * MOMENTS;
        for (let i = 0; i < MOMENTS; i++) {
          for (let lane = 0; lane < lanes; lane++) plant.own[(1 + i) * lanes + lane] = moments[(at + i) * wide + (lane % wide)];
        }
        plant.step();
        for (let i = 0; i < inside.length; i++) {
          if (inside[i][0] !== step) continue;
          const from = (1 + inside[i][1]) * lanes;
          for (let lane = 0; lane < lanes; lane++) within[i * lanes + lane] = plant.outputs[from + lane];
        }
      }
      tell(k, happened);
      for (let lane = 0; lane < lanes; lane++) glucose[lane] = plant.outputs[lane];
    }
  }
}

/** @typedef {ReturnType<typeof summed>} Summary */
/** @type {WeakMap<Trace, Summary>} */
const summaries = new WeakMap();

/**
 * The numbers below the picture, as `glucoloop run` gives them; of each trace they are computed once.
 * @param {Trace} trace
 * @returns {Summary}
 */
export function summary(trace) {
  const found = summaries.get(trace) ?? summed(trace);
  summaries.set(trace, found);
  return found;
}

/** @param {Trace} trace */
function summed({ fine_glucose_mg_dl: glucose, insulin_mU_min, t_min }) {
  let [sum, minimum_mg_dl, peak_mg_dl, inside, below, insulin] = [0, Infinity, -Infinity, 0, 0, 0];
  for (let i = 0; i < glucose.length; i++) {
    const value = glucose[i];
    sum += value;
    if (value < minimum_mg_dl) minimum_mg_dl = value;
    if (value > peak_mg_dl) peak_mg_dl = value;
    if (value < 70) below += 1;
    else if (value <= 180) inside += 1;
  }
  for (const rate of insulin_mU_min) insulin += rate;
  return {
    mean_mg_dl: sum / glucose.length,
    minimum_mg_dl,
    peak_mg_dl,
    time_70_180_pct: (100 * inside) / glucose.length,
    time_below_70_pct: (100 * below) / glucose.length,
    insulin_total_mU: insulin * (t_min.length > 1 ? t_min[1] - t_min[0] : 0),
  };
}
