// @ts-check
/** People of a population: the plant of each, and the state in which each rests, from the numbers that differ between them. */

import { put } from "./loop.mjs";

/** @typedef {import("./loop.mjs").Body} Body */
/** @typedef {import("./loop.mjs").Lab} Lab */
/** @typedef {import("./situation.mjs").Data} Data */

const TERMS = 12;
const FACTORIAL = Array.from({ length: TERMS + 1 }, (_, k) => Array.from({ length: k }, (_, i) => i + 1).reduce((a, b) => a * b, 1));
const MOST_ROUNDS = 60;
/** Rounds in which derivatives are made again, and after how many they are later. */
const FAR_ROUNDS = 3;
const ROUNDS_OF_ONE = 10;
/** Relative change in a step at which a state rests. */
const AT_REST = 1e-13;
/** Relative step of the differences. */
const STEP = 1e-6;
const SMALL = 1e-3;

/** Numbers that differ, a row for each person. @param {Data["people"]} of @returns {Float64Array} */
function table(of) {
  const bytes = Uint8Array.from(atob(of.table), (letter) => letter.charCodeAt(0));
  return new Float64Array(bytes.buffer);
}

/**
 * Matrices of a step of the driven block, as `glucoloop.simulation.driven_block` sums and doubles them.
 * @param {number[][]} rates A with b beside it, (d, d + 1) or with a row of zeros below
 * @param {Data["people"]} of
 * @returns {number[]} the step's end (d, d + 1), and the path at the nodes (3, d, d + 1)
 */
export function driven(rates, { step_min, doublings, path }) {
  const size = rates[0].length;
  const states = size - 1;
  const X = Array.from({ length: size * size }, (_, i) => (rates[Math.floor(i / size)]?.[i % size] ?? 0) * (step_min / 2 ** doublings));
  const times = (/** @type {number[]} */ a, /** @type {number[]} */ b) => {
    const found = new Array(size * size).fill(0);
    for (let i = 0; i < size; i++)
      for (let k = 0; k < size; k++) {
        const factor = a[i * size + k];
        if (factor !== 0) for (let j = 0; j < size; j++) found[i * size + j] += factor * b[k * size + j];
      }
    return found;
  };
  const identity = X.map((_, i) => (i % (size + 1) === 0 ? 1 : 0));
  let power = identity;
  /** e^X, and the moments of the path, by Taylor's series. */
  let sums = [0, 1, 2, 3].map(() => new Array(size * size).fill(0));
  for (let k = 0; k <= TERMS; k++) {
    const factors = [1, 1 / (k + 1), 1 / (k + 2), 1 / (k + 3)].map((factor) => factor / FACTORIAL[k]);
    sums = sums.map((sum, n) => sum.map((value, i) => value + factors[n] * power[i]));
    power = times(power, X);
  }
  for (let doubling = 0; doubling < doublings; doubling++) {
    const [E, m0, m1, m2] = sums;
    const next = (/** @type {number[]} */ own, /** @type {number[]} */ moved, /** @type {number} */ by) => {
      const product = times(E, moved);
      return own.map((value, i) => (value + product[i]) / by);
    };
    sums = [
      times(E, E),
      next(m0, m0, 2),
      next(m1, m0.map((value, i) => value + m1[i]), 4),
      next(m2, m0.map((value, i) => value + 2 * m1[i] + m2[i]), 8),
    ];
  }
  const [E, ...moments] = sums.map((sum) => sum.slice(0, states * size));
  return [...E, ...path.flatMap((row) => E.map((_, i) => row.reduce((sum, factor, n) => sum + factor * moments[n][i], 0)))];
}

/**
 * The people of the page at rest; each is made once.
 * @param {Lab} lab
 * @returns {(first: number) => Body[]} those of the vector that begins with a person; the last one fills it
 */
export function peopleOf(lab) {
  const { data } = lab;
  const of = data.people;
  const nominal = data.patients[of.operating_point];
  const rows = table(of);
  const wide = of.places.length + of.entries.length;
  const { lanes } = lab.kernels;
  /** @param {number} person @returns {Body} */
  const begun = (person) => {
    const row = rows.subarray(person * wide, (person + 1) * wide);
    const numbers = [...nominal.numbers];
    of.places.forEach((place, i) => (numbers[place] = row[i]));
    const rates = of.rates.map((line) => [...line]);
    of.entries.forEach(([i, j], n) => (rates[i][j] = row[of.places.length + n]));
    const own = driven(rates, of);
    // The basal rate is the last but one number of a patient, the setpoint the last.
    return {
      numbers,
      matrices: [...own, ...nominal.matrices.slice(own.length)],
      x: nominal.x,
      basal_insulin_mU_min: numbers[numbers.length - 2],
      glucose_mg_dl: nominal.glucose_mg_dl,
    };
  };
  const rest = new Rest(lab);
  /** @type {Map<number, Body[]>} */
  const made = new Map();
  return (first) => {
    let found = made.get(first);
    if (found === undefined) {
      found = Array.from({ length: lanes }, (_, lane) => begun(Math.min(first + lane, of.count - 1)));
      rest.bring(found);
      made.set(first, found);
    }
    return found;
  };
}

/**
 * Brings people to rest under their basal rates: Newton's method on a step of the plant, which leaves a state at rest as it
 * is. Close to rest the derivatives are kept.
 */
class Rest {
  /** @param {Lab} lab */
  constructor(lab) {
    this.plant = lab.plant(lab.data.people.operating_point);
    this.lanes = lab.kernels.lanes;
    /** Inverse derivatives, row by row. @type {Float64Array[][]} */
    this.inverse = [];
  }

  /**
   * A step from states of all people.
   * @param {Float64Array[]} states
   * @param {Body[]} people
   */
  moved(states, people) {
    const { plant, lanes } = this;
    const inputs = plant.own.length / lanes;
    states.forEach((x, lane) => {
      for (let i = 0; i < x.length; i++) plant.carry[i * lanes + lane] = x[i];
      plant.own[lane] = people[lane].basal_insulin_mU_min;
      for (let i = 1; i < inputs; i++) plant.own[i * lanes + lane] = 0;
    });
    plant.step();
    return states.map((x, lane) => x.map((_, i) => plant.carry[i * lanes + lane]));
  }

  /** @param {Float64Array[]} states @param {Float64Array[]} after @param {Body[]} people */
  differentiate(states, after, people) {
    const columns = people.map(() => /** @type {Float64Array[]} */ ([]));
    const n = states[0].length;
    for (let j = 0; j < n; j++) {
      const by = states.map((x) => STEP * (SMALL + Math.abs(x[j])));
      const shifted = this.moved(states.map((x, lane) => x.map((value, i) => (i === j ? value + by[lane] : value))), people);
      shifted.forEach((x, lane) => columns[lane].push(x.map((value, i) => (value - after[lane][i]) / by[lane] - (i === j ? 1 : 0))));
    }
    this.inverse = columns.map(inverted);
  }

  /** @param {Body[]} people of one vector; their state and glucose are set */
  bring(people) {
    put(this.plant, people);
    const states = people.map(({ x }) => Float64Array.from(x));
    for (let round = 0; round < MOST_ROUNDS; round++) {
      const after = this.moved(states, people);
      const gap = states.map((x, lane) => x.map((value, i) => after[lane][i] - value));
      const largest = Math.max(...gap.map((of, lane) => of.reduce((most, value, i) => Math.max(most, Math.abs(value) / (SMALL + Math.abs(states[lane][i]))), 0)));
      if (largest < AT_REST) break;
      if (round < FAR_ROUNDS || round % ROUNDS_OF_ONE === 0) this.differentiate(states, after, people);
      states.forEach((x, lane) => {
        const rows = this.inverse[lane];
        for (let i = 0; i < x.length; i++) {
          let change = 0;
          for (let j = 0; j < x.length; j++) change += rows[i][j] * gap[lane][j];
          x[i] -= change;
        }
      });
    }
    this.moved(states, people);
    people.forEach((person, lane) => {
      person.x = states[lane];
      person.glucose_mg_dl = this.plant.outputs[lane];
    });
  }
}

/** Inverse of a matrix that is given by its columns. @param {Float64Array[]} columns @returns {Float64Array[]} rows */
function inverted(columns) {
  const n = columns.length;
  const rows = columns.map((_, i) => Float64Array.from({ length: 2 * n }, (_, j) => (j < n ? columns[j][i] : j === n + i ? 1 : 0)));
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[pivot][k])) pivot = i;
    [rows[k], rows[pivot]] = [rows[pivot], rows[k]];
    const scale = 1 / rows[k][k];
    for (let j = k; j < 2 * n; j++) rows[k][j] *= scale;
    for (let i = 0; i < n; i++) {
      const factor = rows[i][k];
      if (i !== k && factor !== 0) for (let j = k; j < 2 * n; j++) rows[i][j] -= factor * rows[k][j];
    }
  }
  return rows.map((row) => row.slice(n));
}
