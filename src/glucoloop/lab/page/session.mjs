// @ts-check
/** What the page has at the moment: the situation with its run, runs that are pinned, units, and what undo goes back to. */

import { seedOf } from "./many.mjs";
import { personOf } from "./people.mjs";
import { predicted, termsOf } from "./prediction.mjs";
import { checked, peopleIn, usual } from "./situation.mjs";
import { texts } from "./texts.mjs";
import { usualUnits } from "./units.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
/** @typedef {import("./lab.mjs").Trace} Trace */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./configuration.mjs").Percentiles} Percentiles */
/** @typedef {{name: string, situation: Situation | null, trace: Trace}} Run a run from elsewhere may have no situation */

export const MOST_PINNED = 4;
/** Changes by the same control that follow one another this quickly are one step of undo. */
const ONE_STEP_MS = 1000;

/** Whether two situations are the same. @param {Situation} a @param {Situation} b */
const same = (a, b) => a === b || JSON.stringify(a) === JSON.stringify(b);

export class Session {
  /**
   * @param {Lab} lab
   * @param {Data} data
   * @param {string} version
   */
  constructor(lab, data, version) {
    this.lab = lab;
    this.data = data;
    this.version = version;
    this.situation = usual(data);
    /** @type {Run} */
    this.run = this.simulated(this.situation);
    /** @type {Run[]} */
    this.pinned = [];
    this.units = usualUnits();
    /** Number of the person who is followed. @type {number | null} */
    this.person = null;
    /** His run in the present situation. @type {Run | null} */
    this.following = null;
    /**
     * Percentiles of people, and the situation in which they were simulated; those of a file have none here.
     * @type {{percentiles: Percentiles, situation: Situation | null} | null}
     */
    this.crowd = null;
    /** Sample that is explained. @type {number | null} */
    this.moment = null;
    /** @type {Situation[]} */
    this.before = [];
    /** The control that changed last, and when. */
    this.last = { by: "", at: 0 };
    this.numbered = 0;
    /** @type {(() => void)[]} */
    this.listeners = [];
  }

  /** What the controller of the present run expected at the moment that is explained; null if it does not predict. */
  get prediction() {
    return this.moment === null ? null : predicted(this.lab, this.situation, this.run.trace, this.moment);
  }

  /** Terms of the dose at the moment that is explained, for a controller that does not predict. */
  get terms() {
    return this.moment === null ? null : termsOf(this.lab, this.situation, this.run.trace, this.moment);
  }

  /** Percentiles that lie behind the runs: those of a file, or of people in the very situation that is shown. */
  get people() {
    if (this.crowd === null) return null;
    const { percentiles, situation } = this.crowd;
    return situation === null || same(situation, this.situation) ? percentiles : null;
  }

  /** Where the picture ends: with the longest of what is drawn. */
  get end_min() {
    const ends = this.runs.map(({ trace }) => trace.fine_t_min[trace.fine_t_min.length - 1]);
    return Math.max(...ends, this.people?.t_min.at(-1) ?? 0);
  }

  get runs() {
    return [this.run, ...(this.following === null ? [] : [this.following]), ...this.pinned];
  }

  /** The present run of the nominal patient. @param {Situation} situation @returns {Run} */
  simulated(situation) {
    return { name: texts.now, situation, trace: this.lab.simulate(situation, undefined, { memory: true }) };
  }

  /**
   * The run of the person who is followed, if there is one who lives in the situation.
   * @param {Situation} situation
   * @returns {Run | null}
   */
  ofPerson(situation) {
    const { lab, data, person } = this;
    if (person === null || peopleIn(situation, data) === null) return null;
    const body = personOf(lab, situation.patient, person);
    if (body === null) return null;
    const trace = lab.simulate(situation, body, { seed: seedOf(data, situation, person) });
    return { name: texts.person(person), situation, trace };
  }

  /** Follow a person through all that is changed from now on. @param {number | null} person */
  follow(person) {
    this.person = person;
    this.following = this.ofPerson(this.situation);
    this.changed();
  }

  /** Call a function after each change. @param {() => void} listener */
  onChange(listener) {
    this.listeners.push(listener);
  }

  changed() {
    for (const listener of this.listeners) listener();
  }

  /**
   * Take another situation; the earlier one is kept for undo.
   * @param {Partial<Situation>} change
   * @param {string} [by] name of the control, whose quick changes are one step of undo
   * @throws {RangeError} with a sentence, for a situation that is not possible; everything stays as it was
   */
  change(change, by = "") {
    const before = this.situation;
    const last = this.last;
    this.take({ ...before, ...change });
    const now = performance.now();
    if (!by || by !== last.by || now - last.at > ONE_STEP_MS) this.before.push(before);
    this.last = { by, at: now };
    this.changed();
  }

  /** @param {Situation} situation */
  take(situation) {
    const next = checked(situation, this.data);
    const [run, following] = [this.simulated(next), this.ofPerson(next)];
    this.situation = next;
    this.run = run;
    this.following = following;
    if (this.moment !== null) this.moment = Math.min(this.moment, run.trace.t_min.length - 1);
  }

  undo() {
    const before = this.before.pop();
    if (before === undefined) return;
    this.take(before);
    this.last = { by: "", at: 0 };
    this.changed();
  }

  /** Keep a run beside the present one; the oldest makes room. @param {Run} [run] the present one, if not given */
  pin(run) {
    if (run === undefined) this.numbered += 1;
    const kept = run ?? { ...this.run, name: texts.run(this.numbered) };
    this.pinned = [...this.pinned, kept].slice(-MOST_PINNED);
    this.changed();
  }

  /** @param {Run} run */
  unpin(run) {
    if (run === this.following) return this.follow(null);
    this.pinned = this.pinned.filter((other) => other !== run);
    this.changed();
  }

  /** @param {Partial<import("./units.mjs").Units>} units */
  show(units) {
    this.units = { ...this.units, ...units };
    this.changed();
  }

  /** Explain a sample. @param {number | null} sample */
  explain(sample) {
    const most = this.run.trace.t_min.length - 1;
    this.moment = sample === null ? null : Math.max(0, Math.min(sample, most));
    this.changed();
  }
}
