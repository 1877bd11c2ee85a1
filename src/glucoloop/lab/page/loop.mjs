// @ts-check
/** The closed loop, sample by sample, with the functions of the module: as `glucoloop.simulation.loop` defines it. */

import { draws } from "./draws.mjs";
import { ofFault, ofPump, ofSensor } from "./fields.mjs";
import { familyOf } from "./situation.mjs";
import { MOMENTS, put } from "./stage.mjs";
import { drawForPump, drawForSensor } from "./threefry.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./stage.mjs").Body} Body */
/** @typedef {import("./stage.mjs").Stage} Stage */

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

/** Name of the functions of a controller, without what they do. @param {Situation} situation @param {Data} data */
export function controllerName(situation, data) {
  const { program } = familyOf(situation, data).controllers[situation.controller];
  return situation.guard ? `${program}_guarded` : program;
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

/** Numbers of people beside one another. @param {ArrayLike<number>[]} people */
function beside(people) {
  const [count, lanes] = [people[0].length, people.length];
  const found = new Float64Array(count * lanes);
  for (let lane = 0; lane < lanes; lane++) for (let i = 0; i < count; i++) found[i * lanes + lane] = people[lane][i];
  return found;
}

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
    this.step_min = familyOf(situation, data).step_min;
    this.steps = Math.round(data.sample_time_min / this.step_min);
    /** Moments of the meals; see `Lab.moments`. @type {Float64Array} */
    this.moments = new Float64Array(0);
    const name = controllerName(situation, data);
    const pump = ofPump(situation, data);
    this.sensors = ofSensor(situation, data).map(({ name, numbers, drawing }) => ({
      numbers,
      start: lab.stage(`${name}_start`),
      stage: lab.stage(name),
      drawing,
      /** What is drawn at the start, and at each sample, of the people beside one another. */
      begun: new Float64Array(0),
      drawn: new Float64Array(0),
      each: 0,
    }));
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

    for (const { numbers, start, stage } of [...this.sensors, ...this.faults]) for (const of of [start, stage]) of.give(numbers);
    for (const stage of [this.pumpStart, this.pump]) stage.give(pump.numbers);
    const numbers = lab.controllerNumbers(situation);
    for (const stage of [this.start, this.controller]) stage.give(numbers);

    /** Samples by which a reading is late, and the readings on their way. */
    this.late = Math.round(situation.dead_time_min / data.sample_time_min);
    this.line = new Float64Array(this.late * lanes);
    this.lineValid = new Float64Array(this.late * lanes);
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
   * Read glucose at a sample, through the sensor, dead time and faults.
   * @param {number} k
   * @param {boolean} moves whether the readings on their way move
   */
  read(k, moves) {
    const { sensors, faults, glucose, reading, valid, late, line, lineValid, seeds } = this;
    const lanes = reading.length;
    reading.set(glucose);
    valid.fill(1);
    for (const { stage, drawn, each } of sensors) {
      for (let i = 0, at = k * each; i < each; i++) stage.own[2 * lanes + i] = drawn[at + i];
      this.through(stage);
    }
    if (late > 0) {
      const place = (k % late) * lanes;
      for (let lane = 0; lane < lanes; lane++) {
        const [newest, there] = [reading[lane], valid[lane]];
        reading[lane] = line[place + lane];
        valid[lane] = lineValid[place + lane];
        if (!moves) continue;
        line[place + lane] = newest;
        lineValid[place + lane] = there;
      }
    }
    for (const { stage, past } of faults) {
      past?.show(k, reading, valid, seeds, moves);
      this.through(stage);
    }
  }

  /** Take the reading through what is around a sensor. @param {Stage} stage */
  through(stage) {
    const { reading, valid } = this;
    const { own, lanes } = stage;
    for (let lane = 0; lane < lanes; lane++) {
      own[lane] = reading[lane];
      own[lanes + lane] = valid[lane];
    }
    stage.step();
    const { outputs } = stage;
    for (let lane = 0; lane < lanes; lane++) {
      reading[lane] = outputs[lane];
      valid[lane] = outputs[lanes + lane];
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

  /** Bring the sensor and its faults to their start. */
  wake() {
    const { sensors, faults, glucose } = this;
    const lanes = glucose.length;
    for (const { start, stage, begun } of sensors) {
      start.own.set(glucose);
      start.own.set(begun, lanes);
      start.step();
      stage.carry.set(start.outputs);
    }
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
    for (const sensor of this.sensors) {
      const { drawing } = sensor;
      if (drawing === undefined) continue;
      const of = seeds.map((seed) => draws(lab, drawing, seed, this.samples));
      sensor.begun = beside(of.map(({ start }) => start));
      sensor.drawn = beside(of.map(({ samples }) => samples));
      sensor.each = of[0].each * lanes;
    }
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
    this.lineValid.fill(1);
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
    const { samples, steps, step_min, moments, controller, pump, plant, glucose, reported, seeds, drawsPump } = this;
    const lanes = glucose.length;
    const { inside } = familyOf(this.situation, this.lab.data);
    const timed = plant.shared.length > 0;
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
        if (timed) plant.shared.fill((k * steps + step) * step_min); // the time of day, which equations may follow
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
