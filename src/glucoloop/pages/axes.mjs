// @ts-check
/** Marks of axes: round values, and round times. */

/** @typedef {"min" | "h" | "days" | "weeks"} TimeUnit */

/** @type {Record<TimeUnit, number>} */
const MINUTES = { min: 1, h: 60, days: 1440, weeks: 10080 };
const LONGEST_IN_MIN = 12 * MINUTES.h;
const LONGEST_IN_H = MINUTES.days;
const LONGEST_IN_DAYS = 4 * MINUTES.weeks;
/** @type {Record<TimeUnit, number[]>} */
const STEPS = {
  min: [1, 2, 5, 10, 15, 20, 30, 60, 120, 180, 240],
  h: [0.25, 0.5, 1, 2, 3, 6, 12],
  days: [0.25 / 24, 0.5 / 24, 1 / 24, 1 / 12, 1 / 8, 0.25, 0.5, 1, 2, 7, 14, 42],
  weeks: [1, 2, 4, 8, 13, 26, 52],
};

/** Unit in which times up to an end are told: minutes, hours, days, and weeks where these are many. @param {number} end in min @returns {TimeUnit} */
export const unitOfTime = (end) => (end <= LONGEST_IN_MIN ? "min" : end <= LONGEST_IN_H ? "h" : end <= LONGEST_IN_DAYS ? "days" : "weeks");

/** A time in a unit, as text. @param {number} t in min @param {TimeUnit} unit */
const inUnit = (t, unit) => `${Number((t / MINUTES[unit]).toFixed(2))} ${unit}`;

/** Time of day. @param {number} t in min */
function clock(t) {
  const of = ((Math.round(t) % MINUTES.days) + MINUTES.days) % MINUTES.days;
  return [Math.floor(of / 60), of % 60].map((part) => `${part}`.padStart(2, "0")).join(":");
}

/** Day of a run, the first of which is 1. @param {number} t in min */
const day = (t) => `day ${Math.floor(Math.round(t) / MINUTES.days) + 1}`;

/** A moment as text: in a run of more than a day, day and clock. @param {number} t in min @param {TimeUnit} unit of the run's times @param {number} start of the run, in min after midnight */
export const timeText = (t, unit, start = 0) => (unit === "days" || unit === "weeks" ? `${day(start + t)}, ${clock(start + t)}` : inUnit(t, unit));

/** A mark of the axis of time as text; the unit stands at the first one. @param {number} t in min @param {TimeUnit} unit @param {boolean} first @param {number} start of the run, in min after midnight */
export function markText(t, unit, first, start = 0) {
  if (unit === "days") return Math.round(start + t) % MINUTES.days ? (first ? timeText(t, unit, start) : clock(start + t)) : day(start + t);
  return first ? inUnit(t, unit) : inUnit(t, unit).split(" ")[0];
}

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
 * @param {{from: number, to: number, unit: TimeUnit, start?: number}} view with the start of the run in min after midnight
 * @param {number} most
 */
export function times({ from, to, unit, start = 0 }, most) {
  const steps = STEPS[unit].map((step) => step * MINUTES[unit]);
  const last = steps[steps.length - 1];
  const every = steps.find((step) => (to - from) / step <= most) ?? last * Math.ceil((to - from) / most / last);
  const found = [];
  const shift = unit === "days" ? start : 0; // marks at round times of day
  for (let i = Math.ceil((from + shift) / every - 1e-9); i * every - shift <= to + 1e-9; i++) found.push(i * every - shift);
  return found;
}
