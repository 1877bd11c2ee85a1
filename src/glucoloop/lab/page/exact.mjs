// @ts-check
/**
 * Functions with the same bits in every browser: those of `Math` and the operator `**` differ between engines by a unit
 * in the last place, and the numbers of a controller with them.
 */

const LN2_HIGH = 6.93147180369123816490e-01;
const LN2_LOW = 1.90821492927058770002e-10;
const P = [1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05, -1.65339022054652515390e-06, 4.13813679705723846039e-08];

/**
 * Exponential of a number from -700 to 700, by the rational approximation of fdlibm (e_exp.c).
 * @param {number} x
 * @returns {number}
 */
export function exponential(x) {
  const doublings = Math.round(x / Math.LN2);
  const high = x - doublings * LN2_HIGH, low = doublings * LN2_LOW;
  const rest = high - low, square = rest * rest;
  const c = rest - square * P.reduceRight((sum, of) => of + square * sum, 0);
  return (1 - ((low - (rest * c) / (2 - c)) - high)) * power(doublings < 0 ? 0.5 : 2, Math.abs(doublings));
}

/**
 * A number multiplied by itself.
 * @param {number} base
 * @param {number} times a whole number, 0 or more
 * @returns {number}
 */
export function power(base, times) {
  let product = 1;
  for (let i = 0; i < times; i++) product *= base;
  return product;
}
