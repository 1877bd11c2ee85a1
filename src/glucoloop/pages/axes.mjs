// @ts-check
/** Marks of axes: round values, and round times. */

/** @typedef {"min" | "h" | "weeks"} TimeUnit */

/** @type {Record<TimeUnit, number>} */
const MINUTES = { min: 1, h: 60, weeks: 10080 };
const LONGEST_IN_MIN = 12 * MINUTES.h;
const LONGEST_IN_H = 4 * MINUTES.weeks;
/** @type {Record<TimeUnit, number[]>} */
const STEPS = {
  min: [1, 2, 5, 10, 15, 20, 30, 60, 120, 180, 240],
  h: [0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 168, 336, 1008],
  weeks: [1, 2, 4, 8, 13, 26, 52],
};

/** Unit in which times up to an end are told: minutes, hours where there are many, and weeks where these are many. @param {number} end in min @returns {TimeUnit} */
export const unitOfTime = (end) => (end <= LONGEST_IN_MIN ? "min" : end <= LONGEST_IN_H ? "h" : "weeks");

/** A time in a unit, as text. @param {number} t in min @param {TimeUnit} unit */
export const timeText = (t, unit) => `${Number((t / MINUTES[unit]).toFixed(2))} ${unit}`;

/** Round values over a range, about as many as asked for. @param {[number, number]} range @param {number} count */
export function levels([low, high], count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((of) => of * power).find((of) => of >= rough * (1 - 1e-9)) ?? rough;
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(Number((i * step).toPrecision(12)));
  return found;
}

/**
 * Round times from one to another in min, about as many as asked for at most.
 * @param {{from: number, to: number, unit: TimeUnit}} view
 * @param {number} most
 */
export function times({ from, to, unit }, most) {
  const steps = STEPS[unit].map((step) => step * MINUTES[unit]);
  const last = steps[steps.length - 1];
  const every = steps.find((step) => (to - from) / step <= most) ?? last * Math.ceil((to - from) / most / last);
  const found = [];
  for (let i = Math.ceil(from / every - 1e-9); i * every <= to + 1e-9; i++) found.push(i * every);
  return found;
}
