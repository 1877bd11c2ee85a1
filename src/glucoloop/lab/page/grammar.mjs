// @ts-check
/** A part in writing, a name and settings, as the command line and files of `glucoloop` have it: `mpc, move_weight=2`. */

/** @typedef {Record<string, any>} Tree a part: its name, and its settings, of which some may be parts */

/** Pieces between commas that stand in no quotes or brackets. */
const PIECES = /(?:"[^"]*"|'[^']*'|\((?:[^()]|\([^()]*\))*\)|[^,])+/g;
const NUMBER = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;
const BARE = /^[^,='"()[\]]+$/;

/**
 * A part from its text; a table is one already.
 * @param {any} told
 * @returns {Tree}
 * @throws {RangeError} for a text that is no part
 */
export function partOf(told) {
  if (typeof told === "object") return told;
  /** @type {[string, any][]} */
  const found = [];
  for (const [place, piece] of (`${told}`.match(PIECES) ?? []).entries()) {
    const [, key, value] = /^\s*(\w+)\s*=(.*)$/s.exec(piece) ?? [];
    if (key === undefined && place > 0) throw new RangeError(`'${told}' is no part; write it like 'mpc, move_weight=2'`);
    found.push(key === undefined ? ["name", unquoted(piece.trim())] : [key, valueOf(value.trim())]);
  }
  return Object.fromEntries(found);
}

/** A number, a truth, a part or a text from its text. @param {string} text */
export function valueOf(text) {
  if (NUMBER.test(text)) return Number(text);
  if (/^\(.*\)$/.test(text)) return partOf(text.slice(1, -1));
  return ["true", "false"].includes(text) ? text === "true" : unquoted(text);
}

/** @param {string} text */
function unquoted(text) {
  return /^(["']).*\1$/.test(text) ? text.slice(1, -1) : text;
}

/** Text from which the same part is read. @param {Tree} part @returns {string} */
export function partText({ name, ...settings }) {
  return [...(name === undefined ? [] : [name]), ...Object.entries(settings).map(([key, value]) => `${key}=${valueText(value)}`)].join(", ");
}

/** @param {any} value */
function valueText(value) {
  if (typeof value === "object") return `(${partText(value)})`;
  return BARE.test(`${value}`) ? `${value}` : `"${value}"`;
}
