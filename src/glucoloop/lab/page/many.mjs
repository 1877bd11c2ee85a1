// @ts-check
/** Many people in one situation, simulated a few at a time by workers, or by the page itself where it may have none. */

import { Crowd } from "./crowd.mjs";
import { LoopOfVector } from "./loop.mjs";
import { peopleOf, rests } from "./people.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./situation.mjs").Data} Data */

/** The most people whom a worker simulates before it tells of them, and those whom the page does between two answers. */
const AT_A_TIME = 64;
const FEW = 8;
const MOST_WORKERS = 8;
/** Turns that each worker has at least, so that all end at the same time; people in a turn are a multiple of a vector's. */
const TURNS = 6;
const MULTIPLE = 4;

/** How many people the workers draw before they are asked for them. */
const EXPECTED = 1000;

/**
 * Turns of each worker, by their first people: always the same, so that a worker need not draw others the next time.
 * @param {number} count of all people
 * @param {number} workers
 * @returns {{size: number, turns: number[][]}} how many people a turn has
 */
function turnsOf(count, workers) {
  const size = workers ? MULTIPLE * Math.ceil(Math.min(AT_A_TIME, count / (TURNS * workers)) / MULTIPLE) : FEW;
  const turns = Array.from({ length: Math.max(1, workers) }, () => /** @type {number[]} */ ([]));
  for (let first = 0; first < count; first += size) turns[(first / size) % turns.length].push(first);
  return { size, turns };
}

/**
 * Seed of a person's random numbers: the page has the noise of ten, which people share.
 * @param {Data} data
 * @param {Situation} situation
 * @param {number} person
 */
export function seedOf(data, { seed }, person) {
  return (seed + person) % data.seeds;
}

/**
 * Some of the people around the patient of a situation. Whom no rate holds at the setpoint is left out.
 * @param {Lab} lab
 * @param {Situation} situation
 * @param {number} first a multiple of the vectors' length
 * @param {number} count
 * @returns {Crowd}
 */
export function some(lab, situation, first, count) {
  const { data } = lab;
  const { lanes } = lab.kernels;
  const inside = data.inside_min.length;
  const later = new Float64Array(inside);
  const crowd = new Crowd(count, Math.round(situation.duration_min / data.sample_time_min), data.sample_time_min);
  const people = peopleOf(lab, situation.patient);
  const loop = new LoopOfVector(lab, situation);
  for (let begin = 0; begin < count; begin += lanes) {
    const vector = people.from(first + begin);
    const present = vector.map(rests);
    if (!present.includes(true)) continue;
    loop.begin(
      vector,
      vector.map((_, lane) => seedOf(data, situation, first + begin + lane)),
    );
    loop.run((k, happened) => {
      for (let lane = 0; lane < lanes && begin + lane < count; lane++) {
        if (!present[lane]) continue;
        for (let i = 0; i < inside; i++) later[i] = happened.inside_mg_dl[i * lanes + lane];
        crowd.add(begin + lane, k, happened.glucose_mg_dl[lane], later, happened.insulin_mU_min[lane]);
      }
    });
  }
  return crowd;
}

/** Simulates people; what is asked last is done, and what was asked before is left. */
export class Many {
  /**
   * @param {{module: WebAssembly.Module, data: Data}} given to each worker
   * @param {() => Worker} worker makes one, or throws
   */
  constructor(given, worker) {
    this.given = given;
    this.make = worker;
    /** @type {Promise<Worker[]> | null} */
    this.making = null;
    /** Whether workers simulate. */
    this.working = false;
    this.asked = 0;
  }

  /** Workers, made once; none if the browser refuses them. @returns {Promise<Worker[]>} */
  begun() {
    return (this.making ??= this.makeWorkers());
  }

  async makeWorkers() {
    const { given, make } = this;
    const count = Math.min(MOST_WORKERS, globalThis.navigator?.hardwareConcurrency ?? 2);
    const { size, turns } = turnsOf(EXPECTED, count);
    /** @param {unknown} _ @param {number} i @returns {Promise<Worker>} */
    const made = (_, i) =>
      new Promise((resolve, reject) => {
        const worker = make();
        worker.onmessage = () => resolve(worker);
        worker.onerror = reject;
        worker.postMessage({ ...given, expected: { size, turns: turns[i] } });
      });
    try {
      return await Promise.all(Array.from({ length: count }, made));
    } catch {
      return [];
    }
  }

  /**
   * @param {Situation} situation
   * @param {number} count
   * @param {(done: number) => void} progress
   * @param {Lab} here with which the page itself simulates
   * @returns {Promise<Crowd | null>} null if others were asked for meanwhile
   */
  async simulate(situation, count, progress, here) {
    const own = ++this.asked;
    const { sample_time_min } = this.given.data;
    const crowd = new Crowd(count, Math.round(situation.duration_min / sample_time_min), sample_time_min);
    const workers = await this.begun();
    this.working = workers.length > 0;
    const { size, turns: left } = turnsOf(count, workers.length);
    let done = 0;
    /** @param {number[]} turns @param {(first: number, count: number) => Promise<Crowd>} simulated */
    const work = async (turns, simulated) => {
      while (own === this.asked) {
        const first = turns.shift() ?? left.reduce((most, other) => (other.length > most.length ? other : most)).pop();
        if (first === undefined) return;
        const part = await simulated(first, Math.min(size, count - first));
        if (own !== this.asked) return;
        crowd.join(part, first);
        done += part.people;
        progress(done);
      }
    };
    await Promise.all(workers.map((worker, i) => work(left[i], (first, count) => answered(worker, { situation, first, count }))));
    if (!this.working) {
      await work(left[0], async (first, count) => {
        await new Promise((resolve) => setTimeout(resolve));
        return some(here, situation, first, count);
      });
    }
    return own === this.asked ? crowd : null;
  }

  /** Leave what was asked for. */
  stop() {
    this.asked += 1;
  }
}

/** What a worker answers to a request. @param {Worker} worker @param {unknown} request @returns {Promise<any>} */
function answered(worker, request) {
  return new Promise((resolve, reject) => {
    worker.addEventListener("message", ({ data }) => resolve(data), { once: true });
    worker.onerror = reject;
    worker.postMessage(request);
  });
}
