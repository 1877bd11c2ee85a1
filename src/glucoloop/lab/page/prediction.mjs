// @ts-check
/** Why a dose was given, from the controller's own memory: what a predictive one expects, or the terms of which it is the sum. */

import { programsOf } from "./loop.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
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
 * @param {import("./lab.mjs").Trace} trace of the situation, with the memory of the controller
 * @param {number} sample
 * @returns {Prediction | null} null for a controller that does not predict
 */
export function predicted(lab, situation, trace, sample) {
  const { controller } = situation;
  if (trace.memory === undefined || (controller !== "mpc" && controller !== "mpc-se")) return null;
  const watched = { before: keptAt(trace, sample), after: keptAt(trace, sample + 1) };
  const { memory, number } = inside(lab, situation);
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
 * The terms of a PID or of an internal model controller at a sample, from its own memory.
 * @typedef {{proportional_mU_min: number, integral_mU_min: number, derivative_mU_min: number}} Pid
 * @typedef {{model_mg_dl: number, rest_mg_dl: number, filtered_mg_dl: number, wanted_mU_min: number}} Imc
 */

/** Statuses of a dose that no reading made. */
const UNREAD = [2, 4, 5, 6, 7, 10];

/**
 * @param {Lab} lab
 * @param {Situation} situation
 * @param {import("./lab.mjs").Trace} trace of the situation, with the memory of the controller
 * @param {number} sample
 * @returns {{pid: Pid} | {imc: Imc} | null} null for another controller, or where no reading was used
 */
export function termsOf(lab, situation, trace, sample) {
  const { controller } = situation;
  if (trace.memory === undefined || UNREAD.includes(trace.status[sample])) return null;
  const { memory, number } = inside(lab, situation);
  const before = (/** @type {string} */ name) => memory(name, keptAt(trace, sample))[0];
  const after = (/** @type {string} */ name) => memory(name, keptAt(trace, sample + 1))[0];
  if (controller === "pid") {
    const reading = after("last_mg_dl");
    const error = reading - lab.data.patients[situation.patient].setpoint_mg_dl;
    return {
      pid: {
        proportional_mU_min: number("proportional")[0] * error,
        integral_mU_min: after("integral_mU_min"),
        derivative_mU_min: number("derivative")[0] * (reading - before("last_mg_dl")),
      },
    };
  }
  if (controller !== "imc") return null;
  const filtered = after("filtered_mg_dl");
  return {
    imc: {
      model_mg_dl: after("model_mg_dl"),
      rest_mg_dl: -after("error_mg_dl"),
      filtered_mg_dl: -filtered,
      wanted_mU_min: after("basal_mU_min") + (filtered - number("pole")[0] * before("filtered_mg_dl")) / number("gain")[0],
    },
  };
}

/** What the controller of a trace kept before a sample. @param {import("./lab.mjs").Trace} trace @param {number} sample */
function keptAt({ memory = new Float64Array(), t_min }, sample) {
  const numbers = memory.length / (t_min.length + 1);
  return memory.subarray(sample * numbers, (sample + 1) * numbers);
}

/**
 * What the controller of a situation keeps, and its numbers, by their names, in a guard or not.
 * @param {Lab} lab
 * @param {Situation} situation
 */
function inside(lab, situation) {
  const prefix = situation.guard ? "inner." : "";
  const numbers = lab.controllerNumbers(situation);
  const { carry } = lab.data.functions[`${programsOf(situation, lab.data).controller}_step`];
  return {
    memory: (/** @type {string} */ name, /** @type {ArrayLike<number>} */ of) => named(carry, of, `${prefix}${name}`),
    number: (/** @type {string} */ name) => listOf(numbers[`controller.${prefix}${name}`]),
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
