// @ts-check
/**
 * Design of the controllers from models of a patient, as `glucoloop.control` does it: the numbers of each controller by
 * the names of its fields.
 */

import { exponential, power } from "./exact.mjs";

/** @typedef {Record<string, number | number[]>} Numbers numbers of a controller, or of a part of it */
/** @typedef {Record<string, number>} Tuning */
/**
 * Gives numbers that are kept from an earlier time, by what they are computed from, or computes them.
 * @typedef {(of: (string | number)[], compute: () => number[]) => number[]} Kept
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

/**
 * What a linear model says of the next p outputs: rows `C Phi^(i - 1)`, and the response to the state and to a step.
 * @typedef {{rows: number[][], free_state: number[], free_input: number[], Phi: number[]}} Ahead
 */

/** What the models say, for the horizon that was asked for last; no other tuning changes it. @type {WeakMap<Linear, Ahead>} */
const predictions = new WeakMap();

/** @param {Linear} linear @param {number} p @returns {Ahead} */
function predicted(linear, p) {
  const { Phi, Gamma, C } = linear;
  const n = C.length;
  const before = predictions.get(linear);
  if (before?.rows.length === p) return before;
  /** @type {Ahead} */
  const found = { rows: [], free_state: [], free_input: [], Phi: before?.Phi ?? Phi.flat() };
  const { rows, free_state, free_input } = found;
  while (rows.length < p) {
    const row = rows.length ? free_state.slice(-n) : C;
    const next = new Array(n).fill(0);
    for (let k = 0; k < n; k++) for (let j = 0; j < n; j++) next[j] += row[k] * Phi[k][j];
    rows.push(row);
    free_state.push(...next);
    free_input.push((free_input.at(-1) ?? 0) + dot(row, Gamma));
  }
  predictions.set(linear, found);
  return found;
}

/**
 * MPC with state estimation.
 * @param {Tuning} tuning
 * @param {Linear} linear
 * @param {Kept} kept
 * @returns {Numbers}
 */
export function mpcSe(tuning, linear, kept) {
  const { Gamma, C } = linear;
  const { prediction_horizon: p, move_horizon, output_weight, move_weight, reference_filter, reference_start } = tuning;
  const { glucose_process_noise, other_process_noise, glucagon_process_noise } = tuning;
  const variances = [glucose_process_noise, other_process_noise, glucagon_process_noise, DISTURBANCE_VARIANCE];
  const R = tuning.measurement_variance;
  const kalman_gain = kept(["kalman", ...variances, R], () =>
    steadyKalmanGain(linear.Phi, C, linear.noise_kinds.map((kind, i) => variances[kind] * linear.noise_factors[i]), R),
  );
  const { rows, free_state, free_input, Phi } = predicted(linear, p);
  let ofInnovation = 0;
  const free_innovation = rows.map((row) => (linear.held ? (ofInnovation += dot(row, kalman_gain)) : 0));
  return {
    Phi,
    Gamma,
    C,
    kalman_gain,
    rest: linear.rest,
    free_state,
    free_input,
    free_innovation,
    reference: kept(["reference", p, reference_filter, reference_start], () =>
      Array.from({ length: p }, (_, i) => power(reference_filter, i + 1 - reference_start)),
    ),
    "plan.gain": kept(["plan", p, move_horizon, output_weight, move_weight], () => closedFormGain(free_input, tuning)),
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

const NAMES = /** @type {const} */ (["A", "G", "P", "W", "V", "U", "PV", "more", "moved", "H", "HP", "HPA", "HA", "L"]);
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
 * With `W = I + G P`, a step is
 *
 *     P + A' P W^-1 A,    G + A W^-1 G A',    A W^-1 A.
 *
 * At first `G = C' C / R`, and a step doubles its rank. While it is small, G is kept as `H' H`, of few rows, and W^-1
 * follows from a matrix of that size, `W^-1 = I - H' (I + H P H')^-1 H P`.
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
  const { A, G, P, W, V, U, PV, more, moved, H, HP, HPA, HA, L, rows } = workspace(n);
  for (const matrix of [P, H]) matrix.fill(0);
  A.set(transition(Phi, n));
  const root = Math.sqrt(R);
  for (let i = 0; i < states; i++) {
    P[i * n + i] = Q[i];
    H[i] = C[i] / root;
  }
  let rank = 1;
  for (let step = 0; step < MOST_DOUBLINGS; step++) {
    const thin = 2 * rank <= n;
    if (thin) {
      // L L' = I + H P H', V = A - H' (L L')^-1 H P A, and the new rows of H are L^-1 H A'.
      const even = rank + (rank % 2); // the row behind the last is zero
      product(P, A, n, PV);
      product(H, P, n, HP, even);
      product(H, PV, n, HPA, even);
      cholesky(HP, H, rank, n, L);
      forward(L, HPA, rank, n);
      backward(L, HPA, rank, n);
      V.set(A);
      for (let k = 0; k < rank; k++) {
        for (let i = 0; i < n; i++) if (H[k * n + i] !== 0) subtract(V, i * n, HPA, k * n, n, H[k * n + i]);
      }
      symmetric(V, PV, n, more);
    } else {
      product(G, P, n, W);
      for (let i = 0; i < n; i++) W[i * n + i] += 1;
      solve(W, A, G, n, rows, V, U); // W^-1 A and W^-1 G
      product(P, V, n, PV);
      symmetric(A, PV, n, more);
    }
    add(P, more);
    // It converges quadratically: what the next doubling would add is the square of this.
    if (size(more) <= CONVERGED * size(P)) break;
    if (thin) {
      transpose(A, n, moved);
      product(H, moved, n, HA, rank + (rank % 2));
      forward(L, HA, rank, n);
      for (let i = 0; i < rank * n; i++) H[rank * n + i] = HA[i];
      rank *= 2;
      if (2 * rank > n) symmetric(H, H, n, G, rank);
    } else {
      product(A, U, n, moved);
      transpose(moved, n, W);
      transpose(A, n, PV);
      symmetric(W, PV, n, more);
      add(G, more);
    }
    product(A, V, n, moved);
    A.set(moved);
  }
  const seen = C.map((_, i) => dot(C, P, i * n));
  const gain = seen.map((value) => value / (dot(C, seen) + R));
  if (!gain.every(Number.isFinite)) throw new RangeError("these variances give no Kalman filter; bring Q and R closer");
  return gain;
}

/** Transposed matrices of the models, with zeros for states that there are not. @type {WeakMap<number[][], Square>} */
const transitions = new WeakMap();

/** @param {number[][]} Phi @param {number} n */
function transition(Phi, n) {
  let found = transitions.get(Phi);
  if (found === undefined) {
    found = new Float64Array(n * n);
    for (let i = 0; i < Phi.length; i++) for (let j = 0; j < Phi.length; j++) found[i * n + j] = Phi[j][i];
    transitions.set(Phi, found);
  }
  return found;
}

/** The factor L of `L L' = I + a b'`, of the first rows of both. @param {Square} a @param {Square} b @param {number} rank @param {number} n @param {Square} L */
function cholesky(a, b, rank, n, L) {
  for (let i = 0; i < rank; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = i === j ? 1 : 0;
      for (let k = 0; k < n; k++) sum += a[i * n + k] * b[j * n + k];
      for (let k = 0; k < j; k++) sum -= L[i * n + k] * L[j * n + k];
      L[i * n + j] = i === j ? Math.sqrt(sum) : sum / L[j * n + j];
    }
  }
}

/** Subtract a multiple of a row from another. @param {Square} from @param {number} at @param {Square} row @param {number} of @param {number} n @param {number} factor */
function subtract(from, at, row, of, n, factor) {
  for (let j = 0; j < n; j++) from[at + j] -= factor * row[of + j];
}

/** Solve `L X = B` in place, of B the first rows. @param {Square} L @param {Square} B @param {number} rank @param {number} n */
function forward(L, B, rank, n) {
  for (let i = 0; i < rank; i++) {
    for (let k = 0; k < i; k++) subtract(B, i * n, B, k * n, n, L[i * n + k]);
    for (let j = 0; j < n; j++) B[i * n + j] /= L[i * n + i];
  }
}

/** Solve `L' X = B` in place, of B the first rows. @param {Square} L @param {Square} B @param {number} rank @param {number} n */
function backward(L, B, rank, n) {
  for (let i = rank - 1; i >= 0; i--) {
    for (let k = i + 1; k < rank; k++) subtract(B, i * n, B, k * n, n, L[k * n + i]);
    for (let j = 0; j < n; j++) B[i * n + j] /= L[i * n + i];
  }
}

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b @param {number} [from] the first number of b */
function dot(a, b, from = 0) {
  let total = 0;
  for (let i = 0; i < a.length; i++) total += a[i] * b[from + i];
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

/**
 * `a' b`, which is known to be symmetric, so that half of it is computed.
 * @param {Square} a @param {Square} b @param {number} n a multiple of four @param {Square} into neither of the two
 * @param {number} [rows] of a and b
 */
function symmetric(a, b, n, into, rows = n) {
  for (let i = 0; i < n; i += 2) {
    for (let j = i - (i % 4); j < n; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      let t0 = 0;
      let t1 = 0;
      let t2 = 0;
      let t3 = 0;
      for (let k = 0, of = i, at = j; k < rows; k++, of += n, at += n) {
        const s = a[of];
        const t = a[of + 1];
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
      const first = i * n + j;
      const second = first + n;
      into[first] = s0;
      into[first + 1] = s1;
      into[first + 2] = s2;
      into[first + 3] = s3;
      into[second] = t0;
      into[second + 1] = t1;
      into[second + 2] = t2;
      into[second + 3] = t3;
    }
  }
  for (let i = 0; i < n; i++) for (let j = 0; j < i; j++) into[i * n + j] = into[j * n + i];
}

/**
 * Two rows and four columns at a time, so that sums stay in registers.
 * @param {Square} a @param {Square} b @param {number} n a multiple of four @param {Square} into neither of the two
 * @param {number} [rows] an even number of rows of a
 */
function product(a, b, n, into, rows = n) {
  for (let i = 0; i < rows; i += 2) {
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
