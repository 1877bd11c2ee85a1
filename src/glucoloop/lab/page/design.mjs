// @ts-check
/**
 * Design of the controllers from models of a patient, as `glucoloop.control` does it: the numbers of each controller by
 * the names of its fields.
 */

import { exponential, power } from "./exact.mjs";

/** @typedef {Record<string, number | number[]>} Numbers numbers of a controller, or of a part of it */
/** @typedef {Record<string, number>} Tuning */
/**
 * Gives a gain that is kept from an earlier time, by what it is computed from, or computes it.
 * @typedef {(of: number[], compute: () => number[]) => number[]} Kept
 */
/** @typedef {{gain: number, tau_min: number, delay_min: number}} FirstOrder */
/** @typedef {{max_change_mU_min: number, min_mU_min: number, max_mU_min: number}} Limits */

/**
 * @typedef {object} Linear a patient linearised at the operating point
 * @property {number[][]} Phi
 * @property {number[]} Gamma
 * @property {number[]} C
 * @property {number[]} rest
 * @property {number} insulin_mU_min
 * @property {number} glucose_mg_dl
 * @property {number[]} noise_kinds of each state: 0 glucose, 1 insulin and slow effects, 2 glucagon, 3 a disturbance of glucose
 * @property {number[]} noise_factors of each state, by which the variance of its kind is multiplied
 * @property {boolean} held whether the innovation is held over the horizon
 */

/**
 * PID in velocity form; what is not given comes from a first-order model.
 * @param {Tuning} tuning
 * @param {FirstOrder} model
 * @param {number} sample_time_min
 * @returns {Numbers}
 */
export function pid(tuning, model, sample_time_min) {
  const half = model.delay_min / 2;
  const gain = tuning.gain || (model.tau_min + half) / (-model.gain * (tuning.closed_loop_min + half));
  const integral_time_min = tuning.integral_time_min || model.tau_min + half;
  const derivative_time_min =
    tuning.derivative_time_min === -1 ? (model.tau_min * half) / (model.tau_min + half) : tuning.derivative_time_min;
  if (derivative_time_min < 0) {
    throw new RangeError(
      `a derivative time of ${derivative_time_min} min is not possible; give 0 or more, or -1 for that of the model`,
    );
  }
  return {
    proportional: gain,
    integral: (gain * sample_time_min) / integral_time_min,
    derivative: (gain * derivative_time_min) / sample_time_min,
  };
}

/**
 * Internal model control with a filter.
 * @param {Tuning} tuning
 * @param {FirstOrder} model
 * @param {number} sample_time_min
 * @returns {Numbers}
 */
export function imc(tuning, model, sample_time_min) {
  const pole = exponential(-sample_time_min / model.tau_min);
  return { pole, gain: model.gain * (1 - pole), filter_pole: exponential(-sample_time_min / tuning.filter_min) };
}

/**
 * The first row of `(Gamma_y^2 A'A + Gamma_u^2 I)^-1 Gamma_y^2 A'`, by Cholesky's method.
 * @param {number[]} response step response S_1 .. S_p or longer
 * @param {Tuning} tuning
 * @returns {number[]} (p,)
 */
export function closedFormGain(response, tuning) {
  const { move_horizon: m, prediction_horizon: p, output_weight, move_weight } = tuning;
  if (p < m) {
    throw new RangeError(
      `a prediction horizon of ${p} is not possible with a move horizon of ${m}; give a whole number of ${m} or more`,
    );
  }
  const q = output_weight ** 2;
  /** @type {(i: number, j: number) => number} */
  const A = (i, j) => (i >= j ? response[i - j] : 0);
  const L = Array.from({ length: m }, () => new Array(m).fill(0));
  let largest = 0;
  for (let j = 0; j < m; j++) {
    for (let k = 0; k <= j; k++) {
      let sum = j === k ? move_weight ** 2 : 0;
      for (let i = 0; i < p; i++) sum += q * A(i, j) * A(i, k);
      largest = Math.max(largest, Math.abs(sum));
      for (let l = 0; l < k; l++) sum -= L[j][l] * L[k][l];
      L[j][k] = j === k ? Math.sqrt(sum) : sum / L[k][k];
      if (j === k && !(sum > 1e-13 * largest)) {
        throw new RangeError(
          `the model's response over ${p} samples does not determine ${m} moves; lengthen the prediction horizon, ` +
            "shorten the move horizon, or give a move weight above 0",
        );
      }
    }
  }
  // The row is that of the inverse, which is the solution for the first unit vector, times Gamma_y^2 A'.
  const row = new Array(m).fill(0);
  for (let j = 0; j < m; j++) {
    row[j] = j === 0 ? 1 : 0;
    for (let k = 0; k < j; k++) row[j] -= L[j][k] * row[k];
    row[j] /= L[j][j];
  }
  for (let j = m - 1; j >= 0; j--) {
    for (let k = j + 1; k < m; k++) row[j] -= L[k][j] * row[k];
    row[j] /= L[j][j];
  }
  return Array.from({ length: p }, (_, i) => row.reduce((sum, of, j) => sum + of * q * A(i, j), 0));
}

/**
 * Linear MPC.
 * @param {Tuning} tuning
 * @param {Numbers & {step_response: number[]}} response with a realisation of what comes after it, if it outlasts its memory
 * @returns {Numbers}
 */
export function mpc(tuning, response) {
  return { ...response, "plan.gain": closedFormGain(response.step_response, tuning) };
}

/** Variance of the disturbance that MPC/SE estimates, (mg/dl)² per sample. */
const DISTURBANCE_VARIANCE = 1;

/** Rows by which outputs follow from the state and the inputs, `C Phi^i` and their sums; no tuning changes them. */
const predictions = new WeakMap();

/**
 * @param {Linear} linear
 * @param {number} p
 * @returns {{rows: number[][], free_state: number[], free_input: number[]}} rows `C Phi^(i - 1)`
 */
function predicted(linear, p) {
  const { Phi, Gamma, C } = linear;
  const n = C.length;
  let found = predictions.get(linear);
  if (found === undefined) {
    found = { rows: [], free_state: [], free_input: [] };
    predictions.set(linear, found);
  }
  while (found.rows.length < p) {
    const { rows, free_state, free_input } = found;
    const row = rows.length ? free_state.slice(-n) : C;
    const next = new Array(n).fill(0);
    for (let k = 0; k < n; k++) for (let j = 0; j < n; j++) next[j] += row[k] * Phi[k][j];
    rows.push(row);
    free_state.push(...next);
    free_input.push((free_input.at(-1) ?? 0) + dot(row, Gamma));
  }
  return { rows: found.rows, free_state: found.free_state.slice(0, p * n), free_input: found.free_input.slice(0, p) };
}

/**
 * MPC with state estimation.
 * @param {Tuning} tuning
 * @param {Linear} linear
 * @param {Kept} kept
 * @returns {Numbers}
 */
export function mpcSe(tuning, linear, kept) {
  const { Phi, Gamma, C } = linear;
  const p = tuning.prediction_horizon;
  const { glucose_process_noise, other_process_noise, glucagon_process_noise } = tuning;
  const variances = [glucose_process_noise, other_process_noise, glucagon_process_noise, DISTURBANCE_VARIANCE];
  const R = tuning.measurement_variance;
  const kalman_gain = kept([...variances, R], () =>
    steadyKalmanGain(Phi, C, linear.noise_kinds.map((kind, i) => variances[kind] * linear.noise_factors[i]), R),
  );
  const { rows, free_state, free_input } = predicted(linear, p);
  let ofInnovation = 0;
  const free_innovation = rows.slice(0, p).map((row) => (linear.held ? (ofInnovation += dot(row, kalman_gain)) : 0));
  return {
    Phi: Phi.flat(),
    Gamma,
    C,
    kalman_gain,
    rest: linear.rest,
    free_state,
    free_input,
    free_innovation,
    reference: Array.from({ length: p }, (_, i) => power(tuning.reference_filter, i + 1 - tuning.reference_start)),
    "plan.gain": closedFormGain(free_input, tuning),
    basal_mU_min: linear.insulin_mU_min,
    basal_glucose_mg_dl: linear.glucose_mg_dl,
  };
}

/**
 * The controller of a name for a patient.
 * @param {string} name
 * @param {Tuning} tuning
 * @param {import("./situation.mjs").Patient} patient
 * @param {number} sample_time_min
 * @param {Kept} kept
 * @returns {Numbers}
 */
export function design(name, tuning, patient, sample_time_min, kept) {
  switch (name) {
    case "pid":
      return pid(tuning, patient.first_order.pid, sample_time_min);
    case "imc":
      return imc(tuning, patient.first_order.imc, sample_time_min);
    case "mpc":
      return mpc(tuning, patient.response);
    default:
      return mpcSe(tuning, patient.linear, kept);
  }
}

/** @typedef {Float64Array} Square a square matrix, row by row */

const NAMES = /** @type {const} */ (["A", "G", "P", "W", "V", "U", "PV", "more", "transposed", "moved"]);
/** Matrices that are used at each solution again, by their size. @type {Map<number, Record<typeof NAMES[number] | "rows", Square>>} */
const workspaces = new Map();

/** @param {number} n */
function workspace(n) {
  let found = workspaces.get(n);
  if (found === undefined) {
    const made = Object.fromEntries(NAMES.map((name) => [name, new Float64Array(n * n)]));
    found = /** @type {Record<typeof NAMES[number] | "rows", Square>} */ ({ ...made, rows: new Float64Array(3 * n * n + n) });
    workspaces.set(n, found);
  }
  return found;
}

const MOST_DOUBLINGS = 60;
/** Relative addition after which another doubling would add less than rounding does. */
const CONVERGED = 1e-9;

/**
 * The steady Kalman gain in filter form, `P C' / (C P C' + R)`, of a system that is read by one row C.
 *
 * The Riccati equation is solved by doubling: after k steps P is that of 2^k samples, so that some ten are enough.
 * E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic discrete-time algebraic
 * Riccati equations", Int. J. Control 77(8), 2004.
 * @param {number[][]} Phi (n, n)
 * @param {number[]} C (n,)
 * @param {number[]} Q (n,) variances of the process noise
 * @param {number} R variance of a reading
 * @returns {number[]} (n,)
 */
export function steadyKalmanGain(Phi, C, Q, R) {
  const states = C.length;
  const n = Math.ceil(states / 4) * 4; // with zeros for states that there are not
  const { A, G, P, W, V, U, PV, more, transposed, moved, rows } = workspace(n);
  for (const matrix of [A, G, P]) matrix.fill(0);
  for (let i = 0; i < states; i++) {
    P[i * n + i] = Q[i];
    for (let j = 0; j < states; j++) {
      A[i * n + j] = Phi[j][i];
      G[i * n + j] = (C[i] * C[j]) / R;
    }
  }
  for (let step = 0; step < MOST_DOUBLINGS; step++) {
    product(G, P, n, W);
    for (let i = 0; i < n; i++) W[i * n + i] += 1;
    solve(W, A, G, n, rows, V, U); // W^-1 A and W^-1 G
    transpose(A, n, transposed);
    product(P, V, n, PV);
    product(transposed, PV, n, more);
    add(P, more);
    // It converges quadratically: what the next doubling would add is the square of this.
    if (size(more) <= CONVERGED * size(P)) break;
    product(A, U, n, moved);
    product(moved, transposed, n, more);
    add(G, more);
    product(A, V, n, moved);
    A.set(moved);
  }
  const seen = C.map((_, i) => C.reduce((total, c, j) => total + 0.5 * (P[i * n + j] + P[j * n + i]) * c, 0));
  const gain = seen.map((value) => value / (dot(C, seen) + R));
  if (!gain.every(Number.isFinite)) throw new RangeError("these variances give no Kalman filter; bring Q and R closer");
  return gain;
}

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b */
function dot(a, b) {
  let total = 0;
  for (let i = 0; i < a.length; i++) total += a[i] * b[i];
  return total;
}

/** @param {Square} a */
function size(a) {
  let most = 0;
  for (let i = 0; i < a.length; i++) most = Math.max(most, Math.abs(a[i]));
  return most;
}

/** @param {Square} a @param {Square} b what is added to it */
function add(a, b) {
  for (let i = 0; i < a.length; i++) a[i] += b[i];
}

/** @param {Square} a @param {number} n @param {Square} into */
function transpose(a, n, into) {
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) into[j * n + i] = a[i * n + j];
}

/** Two rows and four columns at a time, so that sums stay in registers. @param {Square} a @param {Square} b @param {number} n a multiple of four @param {Square} into neither of the two */
function product(a, b, n, into) {
  for (let i = 0; i < n; i += 2) {
    const first = i * n;
    const second = first + n;
    for (let j = 0; j < n; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      let t0 = 0;
      let t1 = 0;
      let t2 = 0;
      let t3 = 0;
      for (let k = 0, at = j; k < n; k++, at += n) {
        const s = a[first + k];
        const t = a[second + k];
        const b0 = b[at];
        const b1 = b[at + 1];
        const b2 = b[at + 2];
        const b3 = b[at + 3];
        s0 += s * b0;
        s1 += s * b1;
        s2 += s * b2;
        s3 += s * b3;
        t0 += t * b0;
        t1 += t * b1;
        t2 += t * b2;
        t3 += t * b3;
      }
      into[first + j] = s0;
      into[first + j + 1] = s1;
      into[first + j + 2] = s2;
      into[first + j + 3] = s3;
      into[second + j] = t0;
      into[second + j + 1] = t1;
      into[second + j + 2] = t2;
      into[second + j + 3] = t3;
    }
  }
}

/**
 * The solutions V and U of `W V = A` and `W U = B`, by elimination with row exchanges.
 * @param {Square} W @param {Square} A @param {Square} B @param {number} n
 * @param {Float64Array} rows room for the three, side by side, and for the pivots @param {Square} V @param {Square} U
 */
function solve(W, A, B, n, rows, V, U) {
  const width = 3 * n;
  const pivots = rows.subarray(3 * n * n);
  for (let i = 0; i < n; i++) {
    const to = i * width;
    const from = i * n;
    for (let j = 0; j < n; j++) {
      rows[to + j] = W[from + j];
      rows[to + n + j] = A[from + j];
      rows[to + 2 * n + j] = B[from + j];
    }
  }
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) {
      if (Math.abs(rows[i * width + k]) > Math.abs(rows[pivot * width + k])) pivot = i;
    }
    const from = k * width;
    for (let j = k, to = pivot * width + k; pivot !== k && j < width; j++, to++) {
      const kept = rows[to];
      rows[to] = rows[from + j];
      rows[from + j] = kept;
    }
    pivots[k] = rows[from + k];
    for (let i = 0; i < n; i++) {
      const to = i * width;
      const factor = i === k ? 0 : rows[to + k] / pivots[k];
      if (factor === 0) continue;
      // Four columns at a time; what is in the columns before k is not read again.
      for (let j = k - (k % 4); j < width; j += 4) {
        const at = to + j;
        const of = from + j;
        rows[at] -= factor * rows[of];
        rows[at + 1] -= factor * rows[of + 1];
        rows[at + 2] -= factor * rows[of + 2];
        rows[at + 3] -= factor * rows[of + 3];
      }
    }
  }
  for (let i = 0; i < n; i++) {
    const from = i * width;
    for (let j = 0; j < n; j++) {
      V[i * n + j] = rows[from + n + j] / pivots[i];
      U[i * n + j] = rows[from + 2 * n + j] / pivots[i];
    }
  }
}
