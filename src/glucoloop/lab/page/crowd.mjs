// @ts-check
/** Many people in one situation: their percentiles, what happened to each, and the points of a tuning. */

/** @typedef {import("./configuration.mjs").Percentiles} Percentiles */

/**
 * What happened to a person.
 * @typedef {object} Fate
 * @property {number} person
 * @property {number} lowest_mg_dl
 * @property {number} highest_mg_dl
 * @property {number} in_range_pct part of the time from 70 to 180 mg/dl
 * @property {number} below_70_pct
 * @property {number} change_mU_min mean change of insulin from a sample to the next
 */

/**
 * Points of a tuning: the means of what happened to the people, and what the rule makes of them.
 * @typedef {object} Score
 * @property {number} points
 * @property {number} in_range_pct
 * @property {number} below_70_pct
 * @property {number} change_mU_min
 * @property {number} people whose time is counted
 * @property {number} people_below_70
 * @property {number} people_below_54
 */

export const LEVELS_PCT = [5, 25, 50, 75, 95];
/** The rule: a percent of the time in range is a point; low glucose and restless insulin cost points. */
export const RULE = { below_70_pct: 5, change_mU_min: 2 };
const [LOW, HIGH, VERY_LOW] = [70, 180, 54];

/**
 * Order numbers, in part: at each of some places stands the number that would if all were sorted.
 * C. A. R. Hoare, "Algorithm 65: find", Comm. ACM 4(7), 1961.
 * @param {Float32Array} numbers
 * @param {number[]} places
 * @param {number} first of those that are ordered
 * @param {number} last
 */
function order(numbers, places, first, last) {
  if (first >= last || places.length === 0) return;
  const pivot = numbers[(first + last) >> 1];
  let [i, j] = [first, last];
  while (i <= j) {
    while (numbers[i] < pivot) i++;
    while (numbers[j] > pivot) j--;
    if (i > j) break;
    const kept = numbers[i];
    numbers[i++] = numbers[j];
    numbers[j--] = kept;
  }
  order(numbers, places.filter((place) => place <= j), first, j);
  order(numbers, places.filter((place) => place >= i), i, last);
}

/** Collects what happens to people, sample by sample. */
export class Crowd {
  /**
   * @param {number} people
   * @param {number} samples
   * @param {number} every minutes
   */
  constructor(people, samples, every) {
    this.people = people;
    this.samples = samples;
    this.every = every;
    /** Glucose at each sample and at the end, people trailing. */
    this.glucose = new Float32Array((samples + 1) * people);
    this.lowest = new Float64Array(people).fill(Infinity);
    this.highest = new Float64Array(people).fill(-Infinity);
    this.inside = new Float64Array(people);
    this.below = new Float64Array(people);
    this.change = new Float64Array(people);
    this.last = new Float64Array(people);
    this.moments = 0;
  }

  /**
   * Take the glucose of a person up to the next sample.
   * @param {number} person
   * @param {number} sample
   * @param {number} glucose_mg_dl at the sample
   * @param {ArrayLike<number>} later_mg_dl at the moments until the next sample, its moment included
   * @param {number} insulin_mU_min
   */
  add(person, sample, glucose_mg_dl, later_mg_dl, insulin_mU_min) {
    this.glucose[sample * this.people + person] = glucose_mg_dl;
    if (sample === 0) this.count(person, glucose_mg_dl);
    else this.change[person] += Math.abs(insulin_mU_min - this.last[person]);
    this.last[person] = insulin_mU_min;
    for (let i = 0; i < later_mg_dl.length; i++) this.count(person, later_mg_dl[i]);
    if (sample === this.samples - 1) this.glucose[this.samples * this.people + person] = later_mg_dl[later_mg_dl.length - 1];
    this.moments = this.samples * later_mg_dl.length + 1;
  }

  /**
   * Take over what happened to people who were simulated apart.
   * @param {Crowd} part
   * @param {number} first of the people
   */
  join(part, first) {
    for (const name of /** @type {const} */ (["lowest", "highest", "inside", "below", "change"])) this[name].set(part[name], first);
    for (let k = 0; k <= this.samples; k++) {
      this.glucose.set(part.glucose.subarray(k * part.people, (k + 1) * part.people), k * this.people + first);
    }
    this.moments = Math.max(this.moments, part.moments);
  }

  /** Numbers of the people of whom something was told. */
  get everybody() {
    return Array.from({ length: this.people }, (_, person) => person).filter((person) => this.lowest[person] < Infinity);
  }

  /** @param {number} person @param {number} glucose_mg_dl */
  count(person, glucose_mg_dl) {
    if (glucose_mg_dl < this.lowest[person]) this.lowest[person] = glucose_mg_dl;
    if (glucose_mg_dl > this.highest[person]) this.highest[person] = glucose_mg_dl;
    if (glucose_mg_dl < LOW) this.below[person] += 1;
    else if (glucose_mg_dl <= HIGH) this.inside[person] += 1;
  }

  /**
   * Percentiles of glucose at each sample, linear between the people around each.
   * @param {string} name
   * @returns {Percentiles}
   */
  percentiles(name) {
    const { samples, every, everybody } = this;
    const glucose = this.glucoseOf(everybody);
    const people = everybody.length;
    /** @type {number[][]} */
    const levels = LEVELS_PCT.map(() => []);
    const places = LEVELS_PCT.map((level) => (level / 100) * (people - 1));
    const around = places.map((place) => [Math.floor(place), Math.min(Math.floor(place) + 1, people - 1)]);
    for (let k = 0; k <= samples; k++) {
      const sorted = glucose.slice(k * people, (k + 1) * people);
      order(sorted, around.flat(), 0, people - 1);
      around.forEach(([below, above], i) => {
        levels[i].push(sorted[below] + (places[i] - below) * (sorted[above] - sorted[below]));
      });
    }
    return { name, t_min: Array.from({ length: samples + 1 }, (_, k) => k * every), levels };
  }

  /** Glucose at each sample and at the end of some people, who trail. @param {number[]} people in their order */
  glucoseOf(people) {
    if (people.length === this.people) return this.glucose;
    const found = new Float32Array((this.samples + 1) * people.length);
    for (let k = 0, at = 0; k <= this.samples; k++) for (const person of people) found[at++] = this.glucose[k * this.people + person];
    return found;
  }

  /** @param {number} person @returns {Fate} */
  fate(person) {
    return {
      person,
      lowest_mg_dl: this.lowest[person],
      highest_mg_dl: this.highest[person],
      in_range_pct: (100 * this.inside[person]) / this.moments,
      below_70_pct: (100 * this.below[person]) / this.moments,
      change_mU_min: this.samples > 1 ? this.change[person] / (this.samples - 1) : 0,
    };
  }

  /** The people with the lowest glucose, lowest first. @param {number} most @returns {Fate[]} */
  worst(most) {
    return this.everybody
      .sort((a, b) => this.lowest[a] - this.lowest[b])
      .slice(0, most)
      .map((person) => this.fate(person));
  }

  /** @returns {Score} */
  score() {
    const mean = { in_range_pct: 0, below_70_pct: 0, change_mU_min: 0 };
    const { everybody } = this;
    let [low, very_low] = [0, 0];
    for (const person of everybody) {
      const fate = this.fate(person);
      for (const name of /** @type {(keyof typeof mean)[]} */ (Object.keys(mean))) mean[name] += fate[name] / everybody.length;
      if (fate.lowest_mg_dl < LOW) low += 1;
      if (fate.lowest_mg_dl < VERY_LOW) very_low += 1;
    }
    const points = mean.in_range_pct - RULE.below_70_pct * mean.below_70_pct - RULE.change_mU_min * mean.change_mU_min;
    return { ...mean, points, people: everybody.length, people_below_70: low, people_below_54: very_low };
  }
}
