// @ts-check
/** Random numbers that depend on keys alone: Threefry-2x32, as `glucoloop.threefry` and JAX have it. */

const PARITY = 0x1bd11bda;
const ROTATIONS = [[13, 15, 26, 6], [17, 29, 16, 24]];
/** Numbers by which JAX's keys of the faults, of the pump, and of a choice of a reading are set apart, as in `glucoloop`. */
const [FAULTS, PUMP, WHICH] = [0x4641554c, 0x50554d50, 1];

/** @typedef {[number, number]} Key two whole numbers of 32 bits */

/**
 * One block with 20 rounds: J. K. Salmon and others, "Parallel random numbers: as easy as 1, 2, 3", SC11, 2011.
 * @param {Key} key
 * @param {number} first of the counter
 * @param {number} second
 * @returns {Key}
 */
function block([a, b], first, second) {
  const keys = [a, b, a ^ b ^ PARITY];
  let [x, y] = [(first + a) | 0, (second + b) | 0];
  for (let group = 0; group < 5; group++) {
    for (const rotation of ROTATIONS[group % 2]) {
      x = (x + y) | 0;
      y = ((y << rotation) | (y >>> (32 - rotation))) ^ x;
    }
    x = (x + keys[(group + 1) % 3]) | 0;
    y = (y + keys[(group + 2) % 3] + group + 1) | 0;
  }
  return [x >>> 0, y >>> 0];
}

/** The first 52 bits as a fraction, and a part of the last one's worth. @param {Key} bits @param {number} part */
const fraction = ([x, y], part) => (x * 2 ** 20 + (y >>> 12) + part) * 2 ** -52;

/**
 * Uniform number between 0 and 1 of a person, as in `glucoloop.threefry`.
 * @param {number} seed
 * @param {number} word of the drawn quantity
 * @param {number} person
 */
export function uniform(seed, word, person) {
  return fraction(block([seed, word], person, 0), 0.5);
}

/** JAX's `fold_in`. @param {Key} key @param {number[]} numbers one after the other */
const folded = (key, ...numbers) => numbers.reduce((of, number) => block(of, 0, number), key);

/** Key of the start of a sensor; folding in the numbers from 0 on is how a key is split. @param {number} seed */
const ofStart = (seed) => folded([0, seed], 0);

/** Key of the readings of a run. @param {number} seed */
const ofReadings = (seed) => folded([0, seed], 1);

/** Uniform number of JAX. @param {Key} key */
const drawn = (key) => fraction(block(key, 0, 0), 0);

/** Probabilities whose quantiles are the first of JAX's normal numbers. @param {Key} key @param {number} count */
const central = (key, count) => Array.from({ length: count }, (_, i) => fraction(block(key, 0, i), 0.25));

/** The normal number of white noise on a reading, as a probability. @param {number} seed @param {number} sample */
export const whiteNoise = (seed, sample) => central(folded(ofReadings(seed), sample, 0), 1);

/** Uniform number by which the time is drawn for which a monitor has been worn. @param {number} seed */
export const drawForWear = (seed) => drawn(folded(ofStart(seed), 0));

/** The normal numbers with which the noise of a monitor begins, as probabilities. @param {number} seed @param {number} count */
export const monitorStart = (seed, count) => central(folded(ofStart(seed), 2), count);

/** Those of a sample. @param {number} seed @param {number} sample @param {number} count */
export const monitorNoise = (seed, sample, count) => central(folded(ofReadings(seed), sample, 1), count);

/** The draw by which a fault of the sensor chooses a reading. @param {number} seed @param {number} sample */
export const drawForSensor = (seed, sample) => drawn(folded(ofReadings(seed), sample, FAULTS, WHICH));

/** The draw by which a random fault of the pump begins. @param {number} seed @param {number} sample */
export const drawForPump = (seed, sample) => drawn(folded(ofReadings(seed), PUMP, sample, FAULTS));
