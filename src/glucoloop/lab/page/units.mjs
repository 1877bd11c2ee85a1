// @ts-check
/** Units in which numbers are shown. Everything is computed, linked and saved in mg/dl and mU/min. */

/**
 * @typedef {object} Unit
 * @property {string} name
 * @property {number} factor from mg/dl or mU/min
 * @property {number} digits behind the point in tables
 */

/** @typedef {{glucose: Unit, insulin: Unit}} Units */

const MG_DL_PER_MMOL_L = 18.0156;
const U_H_PER_MU_MIN = 0.06;

/** The units of each quantity, the usual one first. @type {{glucose: Unit[], insulin: Unit[]}} */
export const UNITS = {
  glucose: [
    { name: "mg/dl", factor: 1, digits: 1 },
    { name: "mmol/l", factor: 1 / MG_DL_PER_MMOL_L, digits: 2 },
  ],
  insulin: [
    { name: "mU/min", factor: 1, digits: 2 },
    { name: "U/h", factor: U_H_PER_MU_MIN, digits: 3 },
  ],
};

/** Units for insulin by a route, as pumps show them. @param {string} [route] of a family @returns {Units} */
export function usualUnits(route) {
  return { glucose: UNITS.glucose[0], insulin: UNITS.insulin[route === "subcutaneous" ? 1 : 0] };
}

/**
 * @param {"glucose" | "insulin"} quantity
 * @param {string} name
 * @returns {Unit}
 * @throws {RangeError} for a unit that is not known
 */
export function unitOf(quantity, name) {
  const found = UNITS[quantity].find((unit) => unit.name === name);
  if (found === undefined) {
    const known = UNITS[quantity].map((unit) => unit.name).join(", ");
    throw new RangeError(`the unit of ${quantity} is '${name}'; the known ones are: ${known}`);
  }
  return found;
}

/** A bolus in units of insulin, as text without the unit. @param {number} bolus_mU */
export function inUnits(bolus_mU) {
  return `${Math.round(bolus_mU / 10) / 100}`;
}

/**
 * A number in a unit, as text without the unit.
 * @param {number} value in mg/dl or mU/min
 * @param {Unit} unit
 * @param {number} [digits] behind the point
 */
export function shown(value, unit, digits = unit.digits) {
  return (value * unit.factor).toFixed(digits);
}
