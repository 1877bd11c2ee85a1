// @ts-check
/** CSV tables, in which no spreadsheet takes a text for a formula; the same as in glucoloop/text.py. */

const FORMULA = /(?:^|(?<=[;\t\r\n]))(?='*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20])/g;
const APOSTROPHE = /(?:^|(?<=[;\t\r\n]))'(?='*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20])/g;

/** @param {string | number} value */
function cell(value) {
  if (typeof value === "number") return `${value}`;
  const safe = value.replace(FORMULA, "'");
  return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

/** A table whose first row names the columns; texts are safe cells, and numbers stay numbers. @param {(string | number)[][]} rows */
export function csvText(rows) {
  return rows.map((row) => `${row.map(cell).join(",")}\n`).join("");
}

/** Rows of a table, with the texts that were in it. @param {string} text @returns {string[][]} */
export function csvRows(text) {
  /** @type {string[][]} */
  const rows = [[]];
  for (const [, quoted, plain, end] of `${text.trim()}\n`.matchAll(/(?:"((?:[^"]|"")*)"|([^,\r\n]*))(,|\r?\n)/g)) {
    rows[rows.length - 1].push((quoted?.replaceAll('""', '"') ?? plain).replace(APOSTROPHE, ""));
    if (end !== ",") rows.push([]);
  }
  return rows.slice(0, -1);
}
