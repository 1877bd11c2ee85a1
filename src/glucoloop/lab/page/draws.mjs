// @ts-check
/** Random numbers that the sensors of a run draw, in the order in which their functions take them: those of `glucoloop`. */

import { drawForWear, monitorNoise, monitorStart, whiteNoise } from "./threefry.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */

/**
 * @typedef {object} Draws
 * @property {ArrayLike<number>} start what is drawn at the start
 * @property {ArrayLike<number>} samples what is drawn at each sample, one after another
 * @property {number} each numbers of a sample
 */

/** @typedef {{name: "white-noise"} | {name: "monitor", processes: number}} Drawing what draws them */

/** Normal distribution, as the function of a draw takes it. @type {Record<string, number>} */
const NORMAL = { kind: -1, centre: 0, scale: 1, lower: -Infinity, upper: Infinity, below: 0, between: 1 };
/** The most processes of a monitor, for which its function has places. */
const PROCESSES = 2;

/**
 * @param {Lab} lab
 * @param {Drawing} drawing
 * @param {number} seed
 * @param {number} samples
 * @returns {Draws}
 */
export function draws(lab, drawing, seed, samples) {
  return lab.remembered(["draws", drawing, seed, samples], () => {
    const all = Array.from({ length: samples }, (_, k) => k);
    if (drawing.name === "white-noise") {
      return { start: [], samples: normals(lab, all.flatMap((k) => whiteNoise(seed, k))), each: 1 };
    }
    const { processes } = drawing;
    /** The first point of each process, and then the second. @param {number[]} points */
    const spread = (points) => Array.from({ length: 2 * PROCESSES }, (_, i) => (i % PROCESSES < processes ? points[Math.floor(i / PROCESSES) * processes + (i % PROCESSES)] : 0.5));
    const later = all.flatMap((k) => {
      const points = spread(monitorNoise(seed, k, 2 * processes));
      return [...points.slice(0, PROCESSES), ...points]; // the noise goes on, or begins anew with another sensor
    });
    const begun = normals(lab, spread(monitorStart(seed, 2 * processes)));
    return { start: [drawForWear(seed), ...begun], samples: normals(lab, later), each: 3 * PROCESSES };
  });
}

/** Normal numbers of their probabilities. @param {Lab} lab @param {number[]} probabilities */
function normals(lab, probabilities) {
  const stage = lab.stage("draw");
  const { lanes } = stage;
  stage.shared.set(Object.keys(stage.fields.shared).map((name) => NORMAL[name]));
  const found = new Float64Array(probabilities.length);
  for (let first = 0; first < found.length; first += lanes) {
    for (let lane = 0; lane < lanes; lane++) stage.own[lane] = probabilities[first + lane] ?? 0.5;
    stage.step();
    for (let lane = 0; lane < lanes && first + lane < found.length; lane++) found[first + lane] = stage.outputs[lane];
  }
  return found;
}
