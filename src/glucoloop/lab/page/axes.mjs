// @ts-check
/** Marks of the axes: round values, and round times. */

/** @typedef {import("./scene.mjs").Line} Line */

const STEPS_MIN = [5, 10, 15, 30, 60, 120, 180, 240];

/** Round values over a range, about as many as asked for. @param {[number, number]} range @param {number} count */
export function levels([low, high], count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((of) => of * power).find((of) => of >= rough) ?? rough;
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high + 1e-9 * step; i++) found.push(Number((i * step).toPrecision(12)));
  return found;
}

/** Round times from 0 to the end, at most as many as asked for. @param {number} end in min @param {number} most */
export function times(end, most) {
  const every = STEPS_MIN.find((step) => end / step <= most) ?? STEPS_MIN[STEPS_MIN.length - 1];
  return Array.from({ length: Math.floor(end / every) + 1 }, (_, i) => i * every);
}

/** Call a function with each corner of a line, which goes in steps where each value is held. @param {Line} line @param {(t: number, value: number) => void} to */
export function corners({ x, y, end }, to) {
  for (let i = 0; i < x.length; i++) {
    if (end !== undefined && i > 0) to(x[i], y[i - 1]);
    to(x[i], y[i]);
  }
  if (end !== undefined) to(end, y[x.length - 1]);
}
