// @ts-check
/**
 * People of a population: each is drawn as `glucoloop.patients.population` draws him, has a plant of his own, and rests at the
 * setpoint under a basal rate of his own.
 */

import { put } from "./loop.mjs";
import { uniform } from "./threefry.mjs";

/** @typedef {import("./loop.mjs").Body} Body */
/** @typedef {import("./loop.mjs").Lab} Lab */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").People} People */

const TERMS = 12;
const FACTORIAL = Array.from({ length: TERMS + 1 }, (_, k) => Array.from({ length: k }, (_, i) => i + 1).reduce((a, b) => a * b, 1));
const MOST_ROUNDS = 80;
/** Relative change in a step at which a state rests. */
const AT_REST = 1e-13;
/** Relative step of the differences. */
const STEP = 1e-6;
const SMALL = 1e-3;

/**
 * The product of square matrices, row by row. What is zero in the first, as most of a chain of compartments, costs nothing.
 * @param {Float64Array} a
 * @param {Float64Array} b
 * @param {number} size
 * @param {Float64Array} into neither of the two
 */
function product(a, b, size, into) {
  into.fill(0);
  for (let row = 0; row < a.length; row += size)
    for (let k = 0; k < size; k++) {
      const factor = a[row + k];
      if (factor === 0) continue;
      const from = k * size;
      for (let j = 0; j < size; j++) into[row + j] += factor * b[from + j];
    }
}

/**
 * Matrices of a step of the driven block, as `glucoloop.simulation.driven_block` sums and doubles them.
 * @param {number[][]} rates A with b beside it, (d, d + 1) or with a row of zeros below
 * @param {People} of
 * @returns {Float64Array} the step's end (d, d + 1), and the path at the nodes (3, d, d + 1)
 */
export function driven(rates, { step_min, doublings, path }) {
  const size = rates[0].length;
  const all = size * size;
  const matrix = () => new Float64Array(all);
  const X = matrix();
  rates.forEach((line, i) => X.set(line, i * size));
  for (let i = 0; i < all; i++) X[i] *= step_min / 2 ** doublings;
  let [power, next] = [matrix(), matrix()];
  for (let i = 0; i < size; i++) power[i * (size + 1)] = 1;
  /** e^X, and the moments of the path, by Taylor's series. */
  let [E, m0, m1, m2] = [matrix(), matrix(), matrix(), matrix()];
  for (let k = 0; k <= TERMS; k++) {
    const of = 1 / FACTORIAL[k];
    for (let i = 0; i < all; i++) {
      const term = of * power[i];
      E[i] += term;
      m0[i] += term / (k + 1);
      m1[i] += term / (k + 2);
      m2[i] += term / (k + 3);
    }
    product(power, X, size, next);
    [power, next] = [next, power];
  }
  const sum = matrix();
  for (let doubling = 0; doubling < doublings; doubling++) {
    for (let i = 0; i < all; i++) sum[i] = m0[i] + 2 * m1[i] + m2[i];
    product(E, sum, size, next);
    for (let i = 0; i < all; i++) m2[i] = (m2[i] + next[i]) / 8;
    for (let i = 0; i < all; i++) sum[i] = m0[i] + m1[i];
    product(E, sum, size, next);
    for (let i = 0; i < all; i++) m1[i] = (m1[i] + next[i]) / 4;
    product(E, m0, size, next);
    for (let i = 0; i < all; i++) m0[i] = (m0[i] + next[i]) / 2;
    product(E, E, size, next);
    [E, next] = [next, E];
  }
  const entries = size * (size - 1);
  const found = new Float64Array(4 * entries);
  found.set(E.subarray(0, entries));
  for (let row = 0; row < path.length; row++) {
    const [of0, of1, of2] = path[row];
    for (let i = 0; i < entries; i++) found[(row + 1) * entries + i] = of0 * m0[i] + of1 * m1[i] + of2 * m2[i];
  }
  return found;
}

/**
 * The people of the page at rest; each is made once.
 * @param {Lab} lab
 * @returns {(first: number) => Body[]} those of the vector that begins with a person
 */
export function peopleOf(lab) {
  const { data } = lab;
  const of = data.people;
  const nominal = data.patients[of.patient];
  const { lanes } = lab.kernels;
  /** @type {Rest | undefined} made when somebody is asked for */
  let rest;
  /** @param {number} person @returns {Body} */
  const begun = (person) => {
    const values = of.parameters.map(({ word, lower, width }) => lower + width * uniform(of.seed, word, person));
    const value = (/** @type {import("./situation.mjs").Varied} */ [, parameter, a, b, c]) => (a + b * values[parameter]) / (1 + c * values[parameter]);
    const numbers = [...nominal.numbers];
    for (const number of of.numbers) numbers[number[0]] = value(number);
    const rates = of.rates.map((line) => [...line]);
    const wide = rates[0].length;
    for (const rate of of.entries) rates[Math.floor(rate[0] / wide)][rate[0] % wide] = value(rate);
    return { ...nominal, numbers, driven: driven(rates, of) };
  };
  /** @type {Map<number, Body[]>} */
  const made = new Map();
  return (first) => {
    rest ??= new Rest(lab);
    const found = made.get(first) ?? rest.bring(Array.from({ length: lanes }, (_, lane) => begun(first + lane)));
    made.set(first, found);
    return found;
  };
}

/**
 * Brings people to rest at the setpoint: a step of the plant leaves the state as it is, and glucose is the setpoint. The
 * unknowns, the state and the basal rate, are found by Broyden's method, which begins with the derivatives of the nominal
 * patient: C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math. Comput. 19(92), 1965.
 */
class Rest {
  /** @param {Lab} lab */
  constructor(lab) {
    const { data } = lab;
    const nominal = data.patients[data.people.patient];
    this.nominal = nominal;
    this.plant = lab.plant(data.people.patient);
    this.lanes = lab.kernels.lanes;
    this.size = nominal.x.length + 1;
    /** Unknowns of the nominal patient, which are their units. */
    this.scale = Float64Array.from([...nominal.x, nominal.basal_insulin_mU_min], (value) => SMALL + Math.abs(value));
    this.begun = Float64Array.from([...nominal.x, nominal.basal_insulin_mU_min], (value, i) => value / this.scale[i]);
    put(this.plant, new Array(this.lanes).fill(nominal));
    const at = (/** @type {Float64Array} */ unknowns) => {
      const gap = new Float64Array(this.size);
      this.gaps(new Array(this.lanes).fill(unknowns), new Array(this.lanes).fill(gap));
      return gap;
    };
    const here = at(this.begun);
    const columns = Array.from(here, (_, j) => {
      const there = at(this.begun.map((value, i) => (i === j ? value + STEP : value)));
      return there.map((value, i) => (value - here[i]) / STEP);
    });
    this.inverse = inverted(columns);
  }

  /**
   * What is missing to rest at the setpoint, of each person.
   * @param {Float64Array[]} unknowns
   * @param {Float64Array[]} into
   * @returns {number} the largest
   */
  gaps(unknowns, into) {
    const { plant, lanes, scale, size, nominal } = this;
    const { own, carry, outputs } = plant;
    const states = size - 1;
    let largest = 0;
    own.fill(0);
    for (let lane = 0; lane < lanes; lane++) {
      for (let i = 0; i < states; i++) carry[i * lanes + lane] = unknowns[lane][i] * scale[i];
      own[lane] = unknowns[lane][states] * scale[states];
    }
    plant.step();
    for (let lane = 0; lane < lanes; lane++) {
      const gap = into[lane];
      for (let i = 0; i < states; i++) gap[i] = carry[i * lanes + lane] / scale[i] - unknowns[lane][i];
      gap[states] = outputs[lane] / nominal.setpoint_mg_dl - 1;
      for (let i = 0; i < size; i++) if (!(Math.abs(gap[i]) <= largest)) largest = Math.abs(gap[i]);
    }
    return largest;
  }

  /** @param {Body[]} people of one vector, whose basal rates, states and glucose are set */
  bring(people) {
    const { size, scale, begun } = this;
    put(this.plant, people);
    const vectors = () => people.map(() => new Float64Array(size));
    const [unknowns, inverse, gaps, moves, left] = [people.map(() => begun.slice()), people.map(() => this.inverse.slice()), vectors(), vectors(), vectors()];
    this.gaps(unknowns, gaps);
    for (let round = 0; round < MOST_ROUNDS; round++) {
      for (let lane = 0; lane < people.length; lane++) {
        times(inverse[lane], gaps[lane], moves[lane]);
        for (let i = 0; i < size; i++) unknowns[lane][i] -= moves[lane][i];
      }
      if (this.gaps(unknowns, gaps) < AT_REST) break;
      for (let lane = 0; lane < people.length; lane++) {
        times(inverse[lane], gaps[lane], left[lane]);
        update(inverse[lane], moves[lane], left[lane]);
      }
    }
    people.forEach((person, lane) => {
      person.x = unknowns[lane].slice(0, size - 1).map((value, i) => value * scale[i]);
      person.basal_insulin_mU_min = unknowns[lane][size - 1] * scale[size - 1];
      // The basal rate is the last but one number of a patient, the setpoint the last.
      /** @type {number[]} */ (person.numbers)[person.numbers.length - 2] = person.basal_insulin_mU_min;
      person.glucose_mg_dl = this.plant.outputs[lane];
    });
    return people;
  }
}

/** A matrix, row by row, times a vector. @param {Float64Array} matrix @param {Float64Array} vector @param {Float64Array} into */
function times(matrix, vector, into) {
  const n = vector.length;
  for (let i = 0; i < n; i++) {
    let sum = 0;
    for (let j = 0; j < n; j++) sum += matrix[i * n + j] * vector[j];
    into[i] = sum;
  }
}

/**
 * Broyden's update of inverse derivatives H after a move by -m, where t is H times the gap that is left:
 * `H + t (m' H) / (m' (m - t))`.
 * @param {Float64Array} H @param {Float64Array} m @param {Float64Array} t
 */
function update(H, m, t) {
  const n = m.length;
  const row = new Float64Array(n);
  let length = 0;
  for (let i = 0; i < n; i++) {
    const [move, at] = [m[i], i * n];
    length += move * (move - t[i]);
    for (let j = 0; j < n; j++) row[j] += move * H[at + j];
  }
  for (let i = 0; i < n; i++) {
    const [left, at] = [t[i], i * n];
    for (let j = 0; j < n; j++) H[at + j] += (left * row[j]) / length;
  }
}

/** Inverse of a matrix that is given by its columns. @param {Float64Array[]} columns @returns {Float64Array} row by row */
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
  return Float64Array.from(rows.flatMap((row) => [...row.subarray(n)]));
}

/**
 * One of the people.
 * @param {Lab} lab
 * @param {ReturnType<typeof peopleOf>} people
 * @param {number} person
 */
export function personOf(lab, people, person) {
  const lane = person % lab.kernels.lanes;
  return people(person - lane)[lane];
}
