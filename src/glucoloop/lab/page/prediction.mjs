// @ts-check
/** What a predictive controller expects at a sample, from its own memory: with the earlier rate, and with its dose. */

import { controllerName } from "./loop.mjs";

/** @typedef {import("./loop.mjs").Lab} Lab */
/** @typedef {import("./situation.mjs").Situation} Situation */

/**
 * @typedef {object} Prediction
 * @property {number} rate_mU_min rate before the sample
 * @property {number} now_mg_dl glucose that the controller takes for the present one
 * @property {number[]} t_min times from the sample on
 * @property {number[]} free_mg_dl glucose if the rate stays as it was
 * @property {number[]} dosed_mg_dl glucose if the delivered rate stays
 */

/**
 * @param {Lab} lab
 * @param {Situation} situation
 * @param {import("./loop.mjs").Trace} trace of the situation, with the memory of the controller
 * @param {number} sample
 * @returns {Prediction | null} null for a controller that does not predict
 */
export function predicted(lab, situation, trace, sample) {
  const { controller, guard } = situation;
  if (trace.memory === undefined || (controller !== "mpc" && controller !== "mpc-se")) return null;
  const watched = { before: trace.memory[sample], after: trace.memory[sample + 1] };
  const prefix = guard ? "inner." : "";
  const numbers = lab.controllerNumbers(situation);
  const { carry } = lab.data.functions[`${controllerName(situation, lab.data)}_step`];
  const memory = (/** @type {string} */ name, /** @type {ArrayLike<number>} */ of) => named(carry, of, `${prefix}${name}`);
  const number = (/** @type {string} */ name) => listOf(numbers[`controller.${prefix}${name}`]);
  const [rate_before] = memory("insulin_mU_min", watched.after);
  const move = trace.insulin_mU_min[sample] - rate_before;
  const horizon = number("plan.gain").length;

  const { now, free, step } =
    controller === "mpc"
      ? byStep(number, (name) => memory(name, watched.after), horizon)
      : byState(number, memory, watched, trace.reading_mg_dl[sample], rate_before, horizon);
  const every = lab.data.sample_time_min;
  return {
    rate_mU_min: rate_before,
    now_mg_dl: now,
    t_min: [0, ...free.map((_, i) => i + 1)].map((i) => (sample + i) * every),
    free_mg_dl: [now, ...free],
    dosed_mg_dl: [now, ...free.map((value, i) => value + (step[i] ?? step[step.length - 1]) * move)],
  };
}

/**
 * Linear MPC: glucose now, its free response, and that to a unit step, from the next sample on.
 * @param {(name: string) => number[]} number
 * @param {(name: string) => number[]} memory
 * @param {number} horizon
 */
function byStep(number, memory, horizon) {
  const [disturbance] = memory("disturbance_mg_dl");
  const [now, ...free] = memory("free_response").map((value) => value + disturbance);
  return { now, free: free.slice(0, horizon), step: number("step_response") };
}

/**
 * MPC/SE likewise: its state-space model from the filtered estimate, the last innovation held.
 * @param {(name: string) => number[]} number
 * @param {(name: string, of: ArrayLike<number>) => number[]} memory
 * @param {{before: ArrayLike<number>, after: ArrayLike<number>}} watched
 * @param {number} reading_mg_dl
 * @param {number} rate_mU_min in force before the sample
 * @param {number} horizon
 */
function byState(number, memory, watched, reading_mg_dl, rate_mU_min, horizon) {
  const [Phi, Gamma, C] = [number("Phi"), number("Gamma"), number("C")];
  const n = Gamma.length;
  const times = (/** @type {number[]} */ matrix, /** @type {number[]} */ vector) =>
    Array.from({ length: matrix.length / n }, (_, i) => vector.reduce((sum, value, j) => sum + matrix[i * n + j] * value, 0));
  const output = (/** @type {number[]} */ state) => times(C, state)[0];
  const [basal] = number("basal_mU_min");
  const [basal_glucose] = number("basal_glucose_mg_dl");
  const rate = rate_mU_min - basal;
  const expected = times(Phi, memory("estimate", watched.before)).map((value, i) => value + Gamma[i] * rate);
  const innovation = Number.isFinite(reading_mg_dl) ? reading_mg_dl - basal_glucose - output(expected) : 0;
  const [input, held] = [number("free_input"), number("free_innovation")];
  const free = times(number("free_state"), memory("estimate", watched.after))
    .slice(0, horizon)
    .map((value, i) => basal_glucose + value + input[i] * rate + held[i] * innovation);
  return { free, step: input, now: basal_glucose + output(memory("estimate", watched.after)) };
}

/** @param {number | number[]} of @returns {number[]} */
function listOf(of) {
  return typeof of === "number" ? [of] : of;
}

/**
 * Numbers of a name among those that a function keeps.
 * @param {Record<string, number>} counts
 * @param {ArrayLike<number>} of
 * @param {string} name
 */
function named(counts, of, name) {
  let at = 0;
  for (const [other, count] of Object.entries(counts)) {
    if (other === name) return Array.from(of).slice(at, at + count);
    at += count;
  }
  throw new RangeError(`the controller keeps no ${name}`);
}
