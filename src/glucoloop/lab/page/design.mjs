// @ts-check
/**
 * Design of the controllers from models of a patient, as `glucoloop.control` does it: the numbers of each controller by
 * the names of its fields.
 */

/** @typedef {Record<string, number | number[]>} Numbers numbers of a controller, or of a part of it */
/** @typedef {Record<string, number>} Tuning */
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
 * @property {number[]} noise_kinds of each state: 0 glucose, 1 insulin and slow effects, 2 glucagon
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
  const pole = Math.exp(-sample_time_min / model.tau_min);
  return { pole, gain: model.gain * (1 - pole), filter_pole: Math.exp(-sample_time_min / tuning.filter_min) };
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
 * @param {number[]} step_response
 * @returns {Numbers}
 */
export function mpc(tuning, step_response) {
  return { step_response, "plan.gain": closedFormGain(step_response, tuning) };
}

/**
 * MPC with state estimation.
 * @param {Tuning} tuning
 * @param {Linear} linear
 * @returns {Numbers}
 */
export function mpcSe(tuning, linear) {
  const { Phi, Gamma, C } = linear;
  const p = tuning.prediction_horizon;
  const variances = [tuning.glucose_process_noise, tuning.other_process_noise, tuning.glucagon_process_noise];
  const Q = linear.noise_kinds.map((kind) => variances[kind]);
  const kalman_gain = steadyKalmanGain(Phi, C, Q, tuning.measurement_variance);
  const free_state = [];
  const free_input = [];
  const free_innovation = [];
  let row = C;
  let ofInput = 0;
  let ofInnovation = 0;
  for (let i = 0; i < p; i++) {
    ofInput += dot(row, Gamma);
    ofInnovation += dot(row, kalman_gain);
    row = Gamma.map((_, j) => row.reduce((sum, c, k) => sum + c * Phi[k][j], 0));
    free_state.push(...row);
    free_input.push(ofInput);
    free_innovation.push(ofInnovation);
  }
  return {
    Phi: Phi.flat(),
    Gamma,
    C,
    kalman_gain,
    rest: linear.rest,
    free_state,
    free_input,
    free_innovation,
    reference: Array.from({ length: p }, (_, i) => tuning.reference_filter ** (i + 1 - tuning.reference_start)),
    "plan.gain": closedFormGain(free_input, tuning),
    basal_mU_min: linear.insulin_mU_min,
    basal_glucose_mg_dl: linear.glucose_mg_dl,
  };
}

/** @typedef {Float64Array} Square a square matrix, row by row */

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
  const n = C.length;
  let A = Float64Array.from({ length: n * n }, (_, at) => Phi[at % n][Math.floor(at / n)]);
  let G = Float64Array.from({ length: n * n }, (_, at) => (C[Math.floor(at / n)] * C[at % n]) / R);
  let P = Float64Array.from({ length: n * n }, (_, at) => (at % (n + 1) === 0 ? Q[at % n] : 0));
  for (let step = 0; step < 60; step++) {
    const W = product(G, P, n);
    for (let i = 0; i < n; i++) W[i * n + i] += 1;
    // W^-1 A and W^-1 G
    const V = solved(W, A, n);
    const U = solved(W, G, n);
    const transposed = transpose(A, n);
    const more = product(transposed, product(P, V, n), n);
    G = sum(G, product(product(A, U, n), transposed, n));
    A = product(A, V, n);
    P = sum(P, more);
    if (size(more) <= 1e-17 * size(P)) break;
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
  return a.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
}

/** @param {Square} a @param {Square} b */
function sum(a, b) {
  return a.map((value, at) => value + b[at]);
}

/** @param {Square} a @param {number} n */
function transpose(a, n) {
  return a.map((_, at) => a[(at % n) * n + Math.floor(at / n)]);
}

/** @param {Square} a @param {Square} b @param {number} n */
function product(a, b, n) {
  const found = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < n; k++) {
      const factor = a[i * n + k];
      if (factor !== 0) for (let j = 0; j < n; j++) found[i * n + j] += factor * b[k * n + j];
    }
  }
  return found;
}

/**
 * The solution X of `W X = B`, by elimination with row exchanges.
 * @param {Square} W @param {Square} B @param {number} n
 */
function solved(W, B, n) {
  const left = W.slice();
  const X = B.slice();
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(left[i * n + k]) > Math.abs(left[pivot * n + k])) pivot = i;
    for (const matrix of [left, X]) {
      for (let j = 0; j < n; j++) {
        [matrix[k * n + j], matrix[pivot * n + j]] = [matrix[pivot * n + j], matrix[k * n + j]];
      }
    }
    for (let i = 0; i < n; i++) {
      const factor = i === k ? 0 : left[i * n + k] / left[k * n + k];
      if (factor === 0) continue;
      for (let j = k; j < n; j++) left[i * n + j] -= factor * left[k * n + j];
      for (let j = 0; j < n; j++) X[i * n + j] -= factor * X[k * n + j];
    }
  }
  return X.map((value, at) => value / left[Math.floor(at / n) * (n + 1)]);
}
