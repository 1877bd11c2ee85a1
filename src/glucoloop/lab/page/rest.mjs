// @ts-check
/** The state in which a person rests at the setpoint, and the basal rate that holds it, where they have no closed form. */

import { put } from "./stage.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
/** @typedef {import("./stage.mjs").Body} Body */

const MOST_ROUNDS = 80;
/** Relative change in a step at which a state rests. */
const AT_REST = 1e-13;
/** Relative step of the differences. */
const STEP = 1e-6;
const SMALL = 1e-3;

/**
 * Brings people to rest at the setpoint: a step of the plant leaves the state as it is, and glucose is the setpoint. The
 * unknowns, the state and the basal rate, are found by Broyden's method, which begins with the derivatives of the nominal
 * patient: C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math. Comput. 19(92), 1965.
 */
export class Rest {
  /** @param {Lab} lab @param {string} patient around whom the people are drawn */
  constructor(lab, patient) {
    const nominal = lab.data.patients[patient];
    this.nominal = nominal;
    this.plant = lab.plant(patient);
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
