// @ts-check
/**
 * People of a population: each is drawn as `glucoloop.patients.population` draws him, has a plant of his own, and rests at the
 * setpoint under a basal rate of his own.
 */

import { functionOf, put } from "./loop.mjs";
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
 * The product of a square matrix and one of any width, row by row.
 * @param {Float64Array} a
 * @param {Float64Array} b
 * @param {number} size rows of both
 * @param {number} width columns of b
 * @param {Float64Array} into neither of the two
 */
function product(a, b, size, width, into) {
  for (let row = 0; row < size; row++) {
    const from = row * size;
    const to = row * width;
    let j = 0;
    // Four columns at a time, so that sums stay in registers.
    for (; j + 3 < width; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      for (let k = 0, at = j; k < size; k++, at += width) {
        const factor = a[from + k];
        s0 += factor * b[at];
        s1 += factor * b[at + 1];
        s2 += factor * b[at + 2];
        s3 += factor * b[at + 3];
      }
      into[to + j] = s0;
      into[to + j + 1] = s1;
      into[to + j + 2] = s2;
      into[to + j + 3] = s3;
    }
    for (; j < width; j++) {
      let sum = 0;
      for (let k = 0, at = j; k < size; k++, at += width) sum += a[from + k] * b[at];
      into[to + j] = sum;
    }
  }
}

/**
 * Matrices of a step of the driven block, as `glucoloop.simulation.driven_block` sums and doubles them.
 * @param {ArrayLike<number>} rates A with b beside it, (d, d + 1)
 * @param {People} of
 * @returns {Float64Array} the step's end (d, d + 1), and the path at the nodes (3, d, d + 1)
 */
export function driven(rates, { step_min, doublings, path }) {
  const size = Math.round((1 + Math.sqrt(1 + 4 * rates.length)) / 2);
  const all = size * size;
  const X = new Float64Array(all);
  for (let i = 0; i < rates.length; i++) X[i] = rates[i] * (step_min / 2 ** doublings);
  let [power, next] = [new Float64Array(all), new Float64Array(all)];
  for (let i = 0; i < size; i++) power[i * (size + 1)] = 1;
  /** e^X beside the three moments of the path, by Taylor's series; each row is the row of all four. */
  const wide = 4 * size;
  const sums = new Float64Array(4 * all);
  for (let k = 0; k <= TERMS; k++) {
    const of = 1 / FACTORIAL[k];
    for (let i = 0, at = 0; i < all; at += wide - size)
      for (let column = 0; column < size; column++, i++, at++) {
        const term = of * power[i];
        sums[at] += term;
        sums[at + size] += term / (k + 1);
        sums[at + 2 * size] += term / (k + 2);
        sums[at + 3 * size] += term / (k + 3);
      }
    product(power, X, size, size, next);
    [power, next] = [next, power];
  }
  /** What e^X is multiplied with to have all of twice the step: itself, and sums of the moments. */
  const E = new Float64Array(all);
  const factors = new Float64Array(4 * all);
  const later = new Float64Array(4 * all);
  for (let doubling = 0; doubling < doublings; doubling++) {
    for (let own = 0, at = 0; own < all; at += wide)
      for (let i = at; i < at + size; i++, own++) {
        const m0 = sums[i + size];
        const m1 = sums[i + 2 * size];
        const m2 = sums[i + 3 * size];
        E[own] = sums[i];
        factors[i] = sums[i];
        factors[i + size] = m0;
        factors[i + 2 * size] = m0 + m1;
        factors[i + 3 * size] = m0 + 2 * m1 + m2;
      }
    product(E, factors, size, wide, later);
    for (let at = 0; at < sums.length; at += wide)
      for (let i = at; i < at + size; i++) {
        const m0 = i + size;
        const m1 = m0 + size;
        const m2 = m1 + size;
        sums[i] = later[i];
        sums[m0] = (sums[m0] + later[m0]) / 2;
        sums[m1] = (sums[m1] + later[m1]) / 4;
        sums[m2] = (sums[m2] + later[m2]) / 8;
      }
  }
  const entries = size * (size - 1);
  const found = new Float64Array(4 * entries);
  for (let i = 0; i < entries; i++) {
    const at = Math.floor(i / size) * wide + (i % size);
    found[i] = sums[at];
    path.forEach(([of0, of1, of2], row) => {
      found[(row + 1) * entries + i] = of0 * sums[at + size] + of1 * sums[at + 2 * size] + of2 * sums[at + 3 * size];
    });
  }
  return found;
}

/** The people of a page by the patient around whom they are drawn. @type {WeakMap<Lab, Map<string, (first: number) => Body[]>>} */
const known = new WeakMap();

/**
 * The people around a patient, at rest; each is made once. Who has no basal rate has NaN for it.
 * @param {Lab} lab
 * @param {string} patient that has people
 * @returns {(first: number) => Body[]} those of the vector that begins with a person
 */
export function peopleOf(lab, patient) {
  const of = known.get(lab) ?? new Map();
  known.set(lab, of);
  const found = of.get(patient) ?? drawn(lab, patient);
  of.set(patient, found);
  return found;
}

/** @param {Lab} lab @param {string} patient @returns {(first: number) => Body[]} */
function drawn(lab, patient) {
  const { data } = lab;
  const { lanes } = lab.kernels;
  const nominal = data.patients[patient];
  const of = data.people[nominal.family];
  const draw = lab.stage("draw");
  const stage = lab.stage(functionOf(nominal.family, "person"));
  const { outputs } = stage.fields;
  const size = { numbers: outputs.numbers, rates: outputs.rates, x: outputs.x, gut: nominal.gut.length };
  const distributions = of.parameters.map(({ distribution }) => Object.keys(draw.fields.shared).map((name) => distribution[name]));
  /** What the function of a person tells of him. @param {string} name @param {number} count @param {number} lane */
  const told = (name, count, lane) => {
    const at = stage.place(name, "outputs");
    return Array.from({ length: count }, (_, i) => stage.outputs[(at + i) * lanes + lane]);
  };
  /** @param {number} lane @returns {Body} */
  const begun = (lane) => {
    const matrices = driven(told("rates", size.rates, lane), of);
    const body = {
      ...nominal,
      numbers: told("numbers", size.numbers, lane),
      gut: size.gut > 0 ? told("gut.0", size.gut, lane) : nominal.gut,
      driven: of.driven.map((place) => matrices[place]),
    };
    if (size.x === undefined) return body;
    const [basal_insulin_mU_min] = told("basal_insulin_mU_min", 1, lane);
    const [glucose_mg_dl] = told("glucose_mg_dl", 1, lane);
    return { ...body, basal_insulin_mU_min, glucose_mg_dl, x: told("x", size.x, lane) };
  };
  /** What brings people to rest whose function does not. @type {Rest | undefined} made when somebody is asked for */
  let rest;
  /** @param {number} first */
  const made = (first) => {
    of.parameters.forEach(({ word }, parameter) => {
      draw.shared.set(distributions[parameter]);
      for (let lane = 0; lane < lanes; lane++) draw.own[lane] = uniform(of.seed, word, first + lane);
      draw.step();
      for (let lane = 0; lane < lanes; lane++) stage.own[parameter * lanes + lane] = draw.outputs[lane];
    });
    stage.step();
    const people = Array.from({ length: lanes }, (_, lane) => begun(lane));
    if (size.x !== undefined) return people;
    rest ??= new Rest(lab, patient);
    return rest.bring(people);
  };
  /** @type {Map<number, Body[]>} */
  const kept = new Map();
  return (first) => {
    const found = kept.get(first) ?? made(first);
    kept.set(first, found);
    return found;
  };
}

/**
 * Brings people to rest at the setpoint: a step of the plant leaves the state as it is, and glucose is the setpoint. The
 * unknowns, the state and the basal rate, are found by Broyden's method, which begins with the derivatives of the nominal
 * patient: C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math. Comput. 19(92), 1965.
 */
class Rest {
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

/**
 * One of the people around a patient; null if no rate holds the setpoint of that one.
 * @param {Lab} lab
 * @param {string} patient
 * @param {number} person
 */
export function personOf(lab, patient, person) {
  const lane = person % lab.kernels.lanes;
  const body = peopleOf(lab, patient)(person - lane)[lane];
  return rests(body) ? body : null;
}

/** Whether a rate holds a person at the setpoint. @param {Body} body */
export function rests({ basal_insulin_mU_min }) {
  return basal_insulin_mU_min >= 0;
}
