// @ts-check
/** The integrator's matrices of a person's insulin. */

const TERMS = 12;
const FACTORIAL = Array.from({ length: TERMS + 1 }, (_, k) => Array.from({ length: k }, (_, i) => i + 1).reduce((a, b) => a * b, 1));

/**
 * The product of a square matrix and one of any width, row by row.
 * @param {Float64Array} a
 * @param {Float64Array} b
 * @param {number} size rows of both
 * @param {number} width columns of b
 * @param {Float64Array} into neither of the two
 */
function product(a, b, size, width, into) {
  for (let row = 0; row < size; row++) {
    const from = row * size;
    const to = row * width;
    let j = 0;
    // Four columns at a time, so that sums stay in registers.
    for (; j + 3 < width; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      for (let k = 0, at = j; k < size; k++, at += width) {
        const factor = a[from + k];
        s0 += factor * b[at];
        s1 += factor * b[at + 1];
        s2 += factor * b[at + 2];
        s3 += factor * b[at + 3];
      }
      into[to + j] = s0;
      into[to + j + 1] = s1;
      into[to + j + 2] = s2;
      into[to + j + 3] = s3;
    }
    for (; j < width; j++) {
      let sum = 0;
      for (let k = 0, at = j; k < size; k++, at += width) sum += a[from + k] * b[at];
      into[to + j] = sum;
    }
  }
}

/**
 * Matrices of a step of the driven block, as `glucoloop.simulation.people_plant` sums and doubles them.
 * @param {ArrayLike<number>} rates A with b beside it, (d, d + 1)
 * @param {import("./situation.mjs").People} of
 * @returns {Float64Array} the step's end (d, d + 1), and the path at the nodes (3, d, d + 1)
 */
export function driven(rates, { step_min, doublings, path }) {
  const size = Math.round((1 + Math.sqrt(1 + 4 * rates.length)) / 2);
  const all = size * size;
  const X = new Float64Array(all);
  for (let i = 0; i < rates.length; i++) X[i] = rates[i] * (step_min / 2 ** doublings);
  let [power, next] = [new Float64Array(all), new Float64Array(all)];
  for (let i = 0; i < size; i++) power[i * (size + 1)] = 1;
  /** e^X beside the three moments of the path, by Taylor's series; each row is the row of all four. */
  const wide = 4 * size;
  const sums = new Float64Array(4 * all);
  for (let k = 0; k <= TERMS; k++) {
    const of = 1 / FACTORIAL[k];
    for (let i = 0, at = 0; i < all; at += wide - size)
      for (let column = 0; column < size; column++, i++, at++) {
        const term = of * power[i];
        sums[at] += term;
        sums[at + size] += term / (k + 1);
        sums[at + 2 * size] += term / (k + 2);
        sums[at + 3 * size] += term / (k + 3);
      }
    product(power, X, size, size, next);
    [power, next] = [next, power];
  }
  /** What e^X is multiplied with to have all of twice the step: itself, and sums of the moments. */
  const E = new Float64Array(all);
  const factors = new Float64Array(4 * all);
  const later = new Float64Array(4 * all);
  for (let doubling = 0; doubling < doublings; doubling++) {
    for (let own = 0, at = 0; own < all; at += wide)
      for (let i = at; i < at + size; i++, own++) {
        const m0 = sums[i + size];
        const m1 = sums[i + 2 * size];
        const m2 = sums[i + 3 * size];
        E[own] = sums[i];
        factors[i] = sums[i];
        factors[i + size] = m0;
        factors[i + 2 * size] = m0 + m1;
        factors[i + 3 * size] = m0 + 2 * m1 + m2;
      }
    product(E, factors, size, wide, later);
    for (let at = 0; at < sums.length; at += wide)
      for (let i = at; i < at + size; i++) {
        const m0 = i + size;
        const m1 = m0 + size;
        const m2 = m1 + size;
        sums[i] = later[i];
        sums[m0] = (sums[m0] + later[m0]) / 2;
        sums[m1] = (sums[m1] + later[m1]) / 4;
        sums[m2] = (sums[m2] + later[m2]) / 8;
      }
  }
  const entries = size * (size - 1);
  const found = new Float64Array(4 * entries);
  for (let i = 0; i < entries; i++) {
    const at = Math.floor(i / size) * wide + (i % size);
    found[i] = sums[at];
    path.forEach(([of0, of1, of2], row) => {
      found[(row + 1) * entries + i] = of0 * sums[at + size] + of1 * sums[at + 2 * size] + of2 * sums[at + 3 * size];
    });
  }
  return found;
}
