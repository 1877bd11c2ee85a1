// @ts-check
/** The closed loop, sample by sample, with the functions of the module: as `glucoloop.simulation.loop` defines it. */

import { draws } from "./draws.mjs";
import { ofFault, ofPump, ofSensor } from "./fields.mjs";
import { announced, familyOf, givesBoluses } from "./situation.mjs";
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
 * @property {ArrayLike<number>} bolus_mU that is delivered beside the rate
 * @property {ArrayLike<number>} status
 * @property {ArrayLike<number>} inside_mg_dl (moments, people) glucose until the next sample, its moment included
 */

/**
 * Names of the functions of a controller, without what they do: of the one with the guard in it, or of the one inside and
 * of the guard around it.
 * @param {Situation} situation
 * @param {Data} data
 * @returns {{controller: string, guard: string | null}}
 */
export function programsOf(situation, data) {
  const { program, guard_program } = familyOf(situation, data).controllers[situation.controller];
  if (!situation.guard) return { controller: program, guard: null };
  return guard_program === undefined ? { controller: `${program}_guarded`, guard: null } : { controller: program, guard: guard_program };
}

/** A controller of one vector of people, from what it is shown to what it decides. */
class Deciding {
  /** @param {Lab} lab @param {Situation} situation */
  constructor(lab, situation) {
    const { controller, guard } = programsOf(situation, lab.data);
    this.start = lab.stage(`${controller}_start`);
    this.stage = lab.stage(`${controller}_step`);
    /** The guard, if it is a function of its own. */
    this.around = guard === null ? null : new Around(lab, guard);
    const numbers = lab.controllerNumbers(situation);
    for (const stage of [this.start, this.stage]) stage.give(numbers);
    if (this.around !== null) for (const stage of [this.around.start, this.around.stage]) stage.give(lab.guardNumbers(situation));
    this.at = this.places(this.deciding);
  }

  /** The function that decides last. */
  get deciding() {
    return this.around === null ? this.stage : this.around.stage;
  }

  /** First places of the numbers of a decision. @param {Stage} stage */
  places(stage) {
    const place = (/** @type {string} */ name) => stage.place(name, "outputs") * stage.lanes;
    return { rate: place("insulin_mU_min"), status: place("status"), bolus: "bolus_mU" in stage.fields.outputs ? place("bolus_mU") : -1 };
  }

  /** What is shown at a sample, or at the start. @param {boolean} starts @returns {{into: Float64Array | Float32Array, at: number}} */
  shown(starts) {
    if (this.around !== null) return this.around.shown(starts);
    return { into: (starts ? this.start : this.stage).own, at: 0 };
  }

  /** Wake at what is shown. */
  wake() {
    const { start, stage, around } = this;
    around?.wake(start.own);
    start.step();
    stage.carry.set(start.outputs);
  }

  /** Decide on what is shown. */
  step() {
    const { stage, around } = this;
    around?.ask(stage.own);
    stage.step();
    around?.answer(stage);
  }
}

/** A guard around a controller that is computed elsewhere: it is stepped to show what it shows, and again with the answer. */
class Around {
  /** @param {Lab} lab @param {string} name */
  constructor(lab, name) {
    this.start = lab.stage(`${name}_start`);
    this.stage = lab.stage(`${name}_step`);
    const { stage } = this;
    this.before = new Float64Array(stage.carry.length);
    this.observation = stage.place("observation.glucose_mg_dl", "own") * stage.lanes;
    this.inner = stage.place("inner.glucose_mg_dl", "carry") * stage.lanes;
    const decided = ["insulin_mU_min", "status", "bolus_mU"];
    this.decision = Object.fromEntries(decided.map((of) => [of, stage.place(`decision.${of}`, "own") * stage.lanes]));
  }

  /** @param {boolean} starts */
  shown(starts) {
    return starts ? { into: this.start.own, at: 0 } : { into: this.stage.own, at: this.observation };
  }

  /** Wake, and show the one inside what it wakes at. @param {Float64Array | Float32Array} own */
  wake(own) {
    const { start, stage, inner } = this;
    start.step();
    stage.carry.set(start.outputs);
    own.set(stage.carry.subarray(inner, inner + own.length));
  }

  /** Show the one inside what the guard lets it see. @param {Float64Array | Float32Array} own */
  ask(own) {
    const { stage, before, inner, decision } = this;
    before.set(stage.carry);
    for (const at of Object.values(decision)) stage.own.fill(0, at, at + stage.lanes);
    stage.step();
    own.set(stage.carry.subarray(inner, inner + own.length));
    stage.carry.set(before);
  }

  /** Bound what the one inside decided. @param {Stage} decided */
  answer({ outputs, lanes, fields }) {
    const { stage, decision } = this;
    let from = 0;
    for (const name in fields.outputs) {
      for (let lane = 0; lane < lanes; lane++) stage.own[decision[name] + lane] = outputs[from + lane];
      from += lanes;
    }
    stage.step();
  }
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
    this.at = { reading: stage.place("memory.glucose_mg_dl", "carry"), valid: stage.place("memory.valid", "carry") };
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
    this.controller = new Deciding(lab, situation);
    this.pumpStart = lab.stage(`${pump.name}_start`);
    this.pump = lab.stage(pump.name);
    this.plant = lab.plant(situation.patient);

    for (const { numbers, start, stage } of [...this.sensors, ...this.faults]) for (const of of [start, stage]) of.give(numbers);
    for (const stage of [this.pumpStart, this.pump]) stage.give(pump.numbers);

    /** Samples by which a reading is late, and the readings on their way. */
    this.late = Math.round(situation.dead_time_min / data.sample_time_min);
    this.line = new Float64Array(this.late * lanes);
    this.lineValid = new Float64Array(this.late * lanes);
    this.glucose = new Float64Array(lanes);
    this.reading = new Float64Array(lanes);
    this.valid = new Float64Array(lanes);
    this.reported = new Float64Array(lanes);
    this.reportedBolus = new Float64Array(lanes);
    /** What the controller is told of meals, sample by sample. */
    this.announced = announced(situation, data);
    this.boluses = givesBoluses(situation, data);
    /** Seeds of the people's random numbers. @type {number[]} */
    this.seeds = [];
    this.drawsPump = "drawn" in this.pump.fields.own;
    const own = (/** @type {string} */ name) => this.pump.place(name, "own") * lanes;
    const given = (/** @type {string} */ name) => this.pump.place(name, "outputs") * lanes;
    /** First places of the numbers that the pump takes and gives. */
    this.takes = { rate: own("insulin_mU_min"), status: own("status"), bolus: own("bolus_mU"), drawn: this.drawsPump ? own("drawn") : -1 };
    this.gives = {
      rate: given("insulin_mU_min"),
      bolus: given("bolus_mU"),
      infused: given("infused_mU_min"),
      reported: given("reported_mU_min"),
      reported_bolus: given("reported_bolus_mU"),
      status: given("status"),
    };
  }

  /** How many numbers the controller keeps of a person. */
  get kept() {
    const { carry, lanes } = this.controller.stage;
    return carry.length / lanes;
  }

  /** Copy what the controller keeps of the first person. @param {Float64Array} into @param {number} at */
  remember(into, at) {
    const { carry, lanes } = this.controller.stage;
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

  /** Show the controller what was read, in the order of `Observation`. @param {number} k sample @param {boolean} starts */
  observe(k, starts) {
    const { reading, valid, reported, reportedBolus, patient, announced, boluses, situation } = this;
    const { into, at } = this.controller.shown(starts);
    const lanes = reading.length;
    for (let lane = 0; lane < lanes; lane++) {
      const own = at + lane;
      into[own] = reading[lane];
      into[own + lanes] = valid[lane];
      into[own + 2 * lanes] = patient.setpoint_mg_dl;
      into[own + 3 * lanes] = reported[lane];
      into[own + 4 * lanes] = announced[k];
      if (!boluses) continue;
      into[own + 5 * lanes] = reportedBolus[lane];
      into[own + 6 * lanes] = situation.announce_before_min;
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
    const { lab, situation, patient, controller, pumpStart, pump, plant, glucose, reported, late, line } = this;
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
    if (people.some((person) => person !== patient)) {
      for (const stage of [controller.start, controller.stage]) {
        people.forEach((person, lane) => {
          for (const [name, value] of Object.entries(lab.ofPerson(situation, person))) stage.set([value], lane, stage.place(name));
        });
        stage.prepared.computePerPerson();
      }
    }
    for (let lane = 0; lane < lanes; lane++) {
      glucose[lane] = people[lane].glucose_mg_dl;
      reported[lane] = people[lane].basal_insulin_mU_min;
      for (let i = 0; i < late; i++) line[i * lanes + lane] = glucose[lane];
    }
    this.lineValid.fill(1);
    this.reportedBolus.fill(0);
    this.wake();
    this.read(0, false);
    this.observe(0, true);
    controller.wake();
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
    const { samples, steps, step_min, moments, controller, pump, plant, glucose, reported, reportedBolus, seeds, drawsPump } = this;
    const { takes, gives, boluses } = this;
    const { at: of } = controller;
    const decided = controller.deciding.outputs;
    const lanes = glucose.length;
    const { inside } = familyOf(this.situation, this.lab.data);
    const timed = plant.shared.length > 0;
    const within = new Float64Array(inside.length * lanes);
    const wide = moments.length / (samples * steps * MOMENTS);
    const happened = {
      glucose_mg_dl: glucose,
      reading_mg_dl: this.reading,
      command_mU_min: decided.subarray(of.rate),
      insulin_mU_min: pump.outputs.subarray(gives.rate),
      bolus_mU: pump.outputs.subarray(gives.bolus),
      status: pump.outputs.subarray(gives.status),
      inside_mg_dl: within,
    };
    for (let k = 0; k < samples; k++) {
      this.read(k, true);
      this.observe(k, false);
      controller.step();
      for (let lane = 0; lane < lanes; lane++) {
        pump.own[takes.rate + lane] = decided[of.rate + lane];
        pump.own[takes.status + lane] = decided[of.status + lane];
        pump.own[takes.bolus + lane] = boluses ? decided[of.bolus + lane] : 0;
        if (drawsPump) pump.own[takes.drawn + lane] = drawForPump(seeds[lane], k);
      }
      pump.step();
      for (let lane = 0; lane < lanes; lane++) {
        reported[lane] = pump.outputs[gives.reported + lane];
        reportedBolus[lane] = pump.outputs[gives.reported_bolus + lane];
        plant.own[lane] = pump.outputs[gives.infused + lane];
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
