// @ts-check
/**
 * Design of the controllers from models of a patient, as `glucoloop.control` does it: the numbers of each controller by
 * the names of its fields.
 */

import { exponential, power } from "./exact.mjs";
import { steadyKalmanGain } from "./kalman.mjs";
import { dot } from "./matrices.mjs";

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
 * PID; what is not given comes from a first-order model.
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

/** The rules of 500 and 1800, by the total daily dose, which is twice the basal dose; see `glucoloop.therapy.profile`. */
const CARB_RULE = 500;
const CORRECTION_RULE = 1800;
const LEAST_DAILY_BASAL_U = 0.5;
const U_A_DAY = 1440 / 1000; // of 1 mU/min

/**
 * Basal-bolus therapy; what is not given is the person's own, by the rules unless the profile has it.
 * @param {Tuning} tuning
 * @param {number} basal_mU_min
 * @param {{carb_ratio_g_U: number, correction_mg_dl_U: number}} [profile]
 */
export function basalBolus(tuning, basal_mU_min, profile) {
  const daily_U = 2 * Math.max(basal_mU_min * U_A_DAY, LEAST_DAILY_BASAL_U);
  const own = profile ?? { carb_ratio_g_U: CARB_RULE / daily_U, correction_mg_dl_U: CORRECTION_RULE / daily_U };
  return {
    basal_mU_min,
    carbs_per_U: tuning.carb_ratio_g_U || own.carb_ratio_g_U,
    fall_per_U: tuning.correction_mg_dl_U || own.correction_mg_dl_U,
    insulin_on_board_min: tuning.insulin_on_board_min,
    correction_above_mg_dl: tuning.correction_above_mg_dl,
    correction_every_min: tuning.correction_every_min,
  };
}

/** Least variance that predictive control by a profile expects of readings, (mg/dl)². */
const LEAST_VARIANCE = 0.25;

/**
 * Predictive control by a profile, of which the page sets costs, doubts and the error of the sensor.
 * @param {Tuning} tuning
 * @param {number} noise_variance of the readings
 * @param {Numbers} of_profile numbers of its model that follow from the profile, where it knows no equations
 * @returns {Numbers}
 */
export function profileMpc(tuning, noise_variance, of_profile) {
  const measurement_variance = tuning.measurement_variance || Math.max(noise_variance, LEAST_VARIANCE);
  return { ...tuning, ...of_profile, measurement_variance };
}

/**
 * The controller of a name for a patient.
 * @param {string} name
 * @param {Tuning} tuning
 * @param {import("./situation.mjs").Patient} patient
 * @param {number} noise_variance of the readings
 * @param {number} sample_time_min
 * @param {Kept} kept
 * @returns {Numbers}
 */
export function design(name, tuning, patient, noise_variance, sample_time_min, kept) {
  switch (name) {
    case "basal-bolus":
      return basalBolus(tuning, patient.basal_insulin_mU_min, patient.profile);
    case "profile-mpc":
    case "therapy-mpc":
      return profileMpc(tuning, noise_variance, patient.of_profile[name]);
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
