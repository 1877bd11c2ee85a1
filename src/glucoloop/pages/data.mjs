// @ts-check
/** What Python wrote into a page to be drawn: `reporting.charts` says how. */

import { colourOf } from "./chart.mjs";

/** @typedef {import("./chart.mjs").Panel} Panel */
/** @typedef {{run?: number, person?: number}} Whose */
/** @typedef {{name: string, unit: string, other: string, factor: number, digits: number, step: number, height: number}} Quantity */
/**
 * @typedef {Omit<Panel, "lines" | "areas" | "dots"> & Quantity & {
 *   lines: (import("./chart.mjs").Line & Whose)[],
 *   areas: (import("./chart.mjs").Area & Whose)[],
 *   dots: (import("./chart.mjs").Dots & Whose)[],
 * }} PlottedPanel
 */
/** @typedef {{name: string, rows: {periods: [number, number][], colour: number}[]}} Lane */
/** @typedef {{name: string, end: number, start: number, panels: PlottedPanel[], lanes: Lane[]}} Plot */

/** Resolution of times in min. */
const T_STEP = 0.1;
const DASHES = [[], [8, 3], [2, 3], [8, 3, 2, 3], [14, 4]];
/** @type {Record<string, {width: number, opacity: number}>} */
const LOOKS = {
  line: { width: 2, opacity: 1 },
  thin: { width: 1.2, opacity: 1 },
  ahead: { width: 1, opacity: 0.6 },
  asked: { width: 1, opacity: 0.75 },
  stems: { width: 3, opacity: 1 },
};

/** Dashes of a line, by their number. @param {number} dash */
export const dashOf = (dash) => DASHES[dash % DASHES.length];

/** Values of which the differences in steps are written; null is no number. @param {(number | null)[]} differences @param {number} step */
function values(differences, step) {
  let at = 0;
  return differences.map((difference) => (difference === null ? NaN : (at += difference) * step));
}

/** Times; if there is one more than values, these are held until it. @param {(number | null)[]} t @param {number} count */
function timed(t, count) {
  const x = values(t, T_STEP);
  return x.length > count ? { x: x.slice(0, count), until: x[count] } : { x };
}

/** @typedef {{name: string, colour: number, t: (number | null)[]} & Whose} Written */
/**
 * @param {Omit<PlottedPanel, "spans" | "rules" | "lines" | "areas" | "dots"> & {
 *   spans: [number, number][],
 *   rules: {values: number[], dash: number}[],
 *   lines: (Written & {y: (number | null)[], dash: number, kind: string})[],
 *   areas: (Written & {low: (number | null)[], high: (number | null)[]})[],
 *   dots: (Written & {y: (number | null)[]})[],
 * }} panel
 * @returns {PlottedPanel}
 */
function panelOf(panel) {
  const { step, rules, lines, areas, dots, spans, other, factor } = panel;
  return {
    ...panel,
    spans: spans.map(([from, to]) => ({ from, to, kind: "fault", text: "" })),
    second: other ? factor : 0,
    rules: rules.flatMap(({ values, dash }) => values.map((value) => ({ value, dash: dashOf(dash) }))),
    // the last that Python wrote lies above the others
    lines: lines.map(({ t, y, colour, dash, kind, ...about }) => ({
      ...about, ...timed(t, y.length), y: values(y, step), colour: colourOf(colour), dash: dashOf(dash), ...LOOKS[kind],
    })),
    areas: areas.map(({ t, low, high, colour, ...about }) => ({
      ...about, ...timed(t, low.length), low: values(low, step), high: values(high, step), colour: colourOf(colour), opacity: 0.25,
    })),
    dots: dots.map(({ t, y, colour, ...about }) => ({ ...about, ...timed(t, y.length), y: values(y, step), colour: colourOf(colour), opacity: 0.5 })),
  };
}

/** The picture of a figure. @param {Element} figure @returns {Plot} */
export function plotOf(figure) {
  const { panels, ...about } = JSON.parse(figure.querySelector("script")?.textContent ?? "");
  return { ...about, panels: panels.map(panelOf) };
}

/** All pictures of a page. @param {Document} page */
export const plotsOf = (page) => [...page.querySelectorAll(".plot")].map(plotOf);
