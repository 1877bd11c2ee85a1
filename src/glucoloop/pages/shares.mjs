// @ts-check
/** How people are spread: outlines of a metric under several controllers, and the control-variability grid. */

import { levels } from "./axes.mjs";
import { colourOf } from "./chart.mjs";

const [WIDTH, HEIGHT] = [1000, 100];
const TICKS = 5;
/** Share of the height that the most frequent value has. */
const HIGHEST = 0.95;
/** Shades of the grid, on a logarithmic scale, and the palest. */
const [SHADES, PALEST] = [6, 0.3];

/** What Python wrote into a place. @param {Element} place */
const written = (place) => JSON.parse(place.querySelector("script")?.textContent ?? "");

/** Outlines on one axis, whose heights are square roots of shares; a line from 5 to 95 %, and a dot for the median. @param {HTMLElement} place */
export function spread(place) {
  /** @type {{edges: number[], outlines: ({counts: number[], values: number[]} | null)[]}} */
  const { edges, outlines } = written(place);
  const [low, high] = [edges[0], edges[edges.length - 1]];
  const share = (/** @type {number} */ value) => Math.min(1, Math.max(0, (value - low) / (high - low)));
  const x = (/** @type {number} */ value) => Math.round(WIDTH * share(value));
  for (const field of /** @type {NodeListOf<HTMLElement>} */ (place.querySelectorAll(".outline"))) {
    const run = Number(field.dataset.place);
    const { counts, values } = /** @type {NonNullable<typeof outlines[number]>} */ (outlines[run]);
    const most = Math.max(...counts);
    const steps = counts.map((count, i) => `V${Math.round(HEIGHT * (1 - HIGHEST * Math.sqrt(count / most)))}H${x(edges[i + 1])}`);
    const [least, median, greatest] = values.map(x);
    const line = (/** @type {string} */ d, /** @type {string} */ colour, /** @type {number} */ width) =>
      `<path d="${d}" stroke="${colour}" stroke-width="${width}" stroke-linecap="round" vector-effect="non-scaling-stroke"/>`;
    field.innerHTML =
      `<svg viewBox="0 0 ${WIDTH} ${HEIGHT + 12}" preserveAspectRatio="none" aria-hidden="true">` +
      `<path d="M0 ${HEIGHT}${steps.join("")}V${HEIGHT}z" fill="${colourOf(run)}" fill-opacity="0.25"/>` +
      `${line(`M${least} ${HEIGHT + 5}H${greatest}`, colourOf(run), 4)}${line(`M${median} ${HEIGHT + 5}h0`, "var(--ink)", 8)}</svg>`;
  }
  if (edges.length === 0) return;
  const marks = levels([low, high], TICKS).map((value) => `<span style="left: ${(100 * share(value)).toFixed(2)}%">${value}</span>`);
  place.insertAdjacentHTML("beforeend", `<div class="below" aria-hidden="true">${marks.join("")}</div>`);
}

/** The grid: the least glucose rises to the left, the greatest upwards. @param {HTMLElement} place */
export function grid(place) {
  /** @type {{cells: number, most: number, people: [number, number, number][], zones: [string, string][]}} */
  const { cells, most, people, zones } = written(place);
  const side = 3 * cells;
  const corners = zones.map((_, i) => [side - cells * (Math.floor(i / 3) + 1), side - cells * ((i % 3) + 1)]);
  const tiles = zones.map(([, colour], i) =>
    `<rect x="${corners[i][0]}" y="${corners[i][1]}" width="${cells}" height="${cells}" fill="${colour}" fill-opacity="0.2" stroke="var(--rule)" stroke-width="0.15"/>`);
  const dots = people.map(([right, up, count]) => {
    const shade = Math.min(SHADES - 1, Math.floor((Math.log(count) / Math.log(Math.max(most, 2))) * SHADES));
    const opacity = PALEST + ((1 - PALEST) * shade) / (SHADES - 1);
    return `<path d="M${side - 1 - right} ${side - 1 - up}h1v1h-1z" fill-opacity="${opacity.toFixed(2)}"/>`;
  });
  const names = zones.map(([name], i) => `<text x="${corners[i][0] + 0.8}" y="${corners[i][1] + 3.2}" fill="var(--ink)">${name}</text>`);
  place.innerHTML =
    `<svg viewBox="0 0 ${side} ${side}" font-size="3" aria-hidden="true">${tiles.join("")}` +
    `<g fill="${colourOf(Number(place.dataset.place))}">${dots.join("")}</g>${names.join("")}</svg>`;
}
