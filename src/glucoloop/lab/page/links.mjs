// @ts-check
/** The part of the page's address after the #: the situation with its version, and the units in which it is shown. */

import { fromToml } from "./configuration.mjs";
import { fromHash, hash, situationOf, VERSION } from "./keys.mjs";
import { familyOf, peopleIn } from "./situation.mjs";
import { unitOf, usualUnits } from "./units.mjs";

/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./units.mjs").Units} Units */

/** Key under which pages of results hand over their whole configuration, as the text of its file. */
const CONFIGURATION = "configuration";
/** Keys of the units in a link. */
const KEYS = { glucose: "shown_glucose", insulin: "shown_insulin" };

/** Key of the person who is followed. */
const PERSON = "follow";

/**
 * @param {{situation: Situation, units: Units, person: number | null}} shown
 * @param {Data} data
 * @param {string} version
 */
export function link({ situation, units, person }, data, version) {
  const told = new URLSearchParams(hash(situation, data, version).slice(1));
  const usual = usualUnits(familyOf(situation, data).route);
  for (const quantity of /** @type {("glucose" | "insulin")[]} */ (["glucose", "insulin"])) {
    if (units[quantity] !== usual[quantity]) told.set(KEYS[quantity], units[quantity].name);
  }
  if (person !== null && peopleIn(situation, data) !== null) told.set(PERSON, `${person}`);
  return `#${told}`;
}

/**
 * What a link tells.
 * @param {string} text from the # on
 * @param {Data} data
 * @returns {{situation: Situation, version: string | null, units: Units, person: number | null, unlike: string[]}} with what a configuration has and the
 *   page has not
 * @throws {RangeError} with a sentence, for a link that tells nothing possible
 */
export function fromLink(text, data) {
  const told = new URLSearchParams(text.replace(/^#/, ""));
  /** @type {Partial<Units>} */
  const shown = {};
  for (const quantity of /** @type {("glucose" | "insulin")[]} */ (["glucose", "insulin"])) {
    const name = told.get(KEYS[quantity]);
    if (name !== null) shown[quantity] = unitOf(quantity, name);
    told.delete(KEYS[quantity]);
  }
  const person = told.get(PERSON);
  told.delete(PERSON);
  const unitsOf = (/** @type {Situation} */ situation) => ({ ...usualUnits(familyOf(situation, data).route), ...shown });
  const configuration = told.get(CONFIGURATION);
  if (configuration === null) {
    const found = fromHash(`#${told}`, data);
    return { ...found, units: unitsOf(found.situation), person: followed(person, found.situation, data), unlike: [] };
  }
  const keys = fromToml(configuration);
  const found = situationOf(keys, data);
  return { ...found, version: keys[VERSION] ?? null, units: unitsOf(found.situation), person: followed(person, found.situation, data) };
}

/** Number of the person whom a link follows. @param {string | null} text @param {Situation} situation @param {Data} data */
function followed(text, situation, data) {
  if (text === null) return null;
  const people = peopleIn(situation, data);
  const { patient, controller } = situation;
  if (people === null) throw new RangeError(`person '${text}' is to be followed, but nobody is drawn around ${patient.replace("/", " at ")} under ${controller}; leave ${PERSON} out`);
  const { count } = people;
  if (!/^\d+$/.test(text) || Number(text) >= count) throw new RangeError(`the person is '${text}'; give a number from 0 to ${count - 1}`);
  return Number(text);
}
