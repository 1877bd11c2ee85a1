// @ts-check
/** Pictures over time in SVG: on all pages, and in files. Colours are names of the style sheet, which knows light and dark. */

import { levels, markText, times } from "./axes.mjs";

/**
 * A curve; the values of one with `until` are held until the next, the last until then. What is not finite is a gap.
 * @typedef {{name: string, x: number[], y: number[], until?: number, colour: string, width: number, dash: number[], opacity?: number}} Line
 */
/** @typedef {{name: string, x: number[], low: number[], high: number[], until?: number, colour: string, opacity: number}} Area */
/** @typedef {{x: number[], y: number[], colour: string, opacity: number}} Dots */
/** @typedef {{from: number, to: number, kind: "guard" | "fault", text: string}} Span */

/**
 * @typedef {object} Panel
 * @property {[number, number]} range
 * @property {[number, number] | null} band range that is aimed at
 * @property {{value: number, dash: number[]}[]} rules levels of thin lines
 * @property {Line[]} lines of which the first lies above the others
 * @property {Dots[]} dots
 * @property {Area[]} areas
 * @property {Span[]} spans
 * @property {[number, string][]} [marks] times and texts above the panel
 * @property {number} [second] what one is in a second unit, whose axis stands on the right; 0 leaves room for one
 * @property {boolean} [timeless] without an axis of time
 * @property {boolean} [bare] without any axis
 */

/** @typedef {{from: number, to: number, unit: import("./axes.mjs").TimeUnit, start?: number}} View times of the ends, and of the start of the run after midnight */
/** @typedef {{left: number, top: number, width: number, height: number}} Inside of the axes, in pixels */

/** Room around the inside of the axes, for their marks. */
const [LEFT, RIGHT, TOP, BELOW] = [44, 18, 6, 30];
const MARKED_PX = 26;
/** Least room for a mark of each axis, length of its line, and about the width of a letter. */
const [LEVEL_PX, TIME_PX, MARK_PX, LETTER_PX] = [28, 54, 5, 7];
const GUARD_PX = 5;
const NARROW_PX = 600;

/** Colour of a run, by its place. @param {number} place */
export const colourOf = (place) => `var(--run-${place % 6})`;

const escaped = (/** @type {string} */ text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
const short = (/** @type {number} */ value) => Math.round(10 * value) / 10;
const titled = (/** @type {string} */ name) => (name ? `<title>${escaped(name)}</title>` : "");
const dashed = (/** @type {number[]} */ dash) => (dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : "");

/** Inside of the axes of a panel that is so large. @param {Panel} panel @param {number} width @param {number} height @returns {Inside} */
export function insideOf(panel, width, height) {
  if (panel.bare) return { left: LEFT, top: 0, width: Math.max(1, width - 2 * LEFT), height };
  const top = panel.marks?.length ? MARKED_PX : TOP;
  const right = panel.second === undefined ? RIGHT : LEFT;
  return { left: LEFT, top, width: Math.max(1, width - LEFT - right), height: height - top - (panel.timeless ? TOP : BELOW) };
}

/** Path through values, from a point or on to it. @param {number[]} x @param {number[]} y @param {number | undefined} until @param {(t: number) => number} across @param {(value: number) => number} up */
function pathOf(x, y, until, across, up) {
  const parts = [];
  let on = false;
  for (let i = 0; i < x.length; i++) {
    const there = Number.isFinite(y[i]);
    const [right, high] = [short(across(x[i])), there && short(up(y[i]))];
    if (on && until !== undefined) parts.push(there ? `H${right}V${high}` : `H${right}`);
    else if (there) parts.push(`${on ? "L" : "M"}${right} ${high}`);
    on = there;
  }
  if (on && until !== undefined) parts.push(`H${short(across(until))}`);
  return parts.join("");
}

/** Corners of a curve; each value that is held has two. @param {number[]} x @param {number[]} y @param {number} [until] @returns {[number, number][]} */
function corners(x, y, until) {
  if (until === undefined) return x.map((t, i) => [t, y[i]]);
  return y.flatMap((value, i) => /** @type {[number, number][]} */ ([[x[i], value], [x[i + 1] ?? until, value]]));
}

/**
 * Outlines of the stretches of a band in which both of its edges are known.
 * @param {[number, number][]} upper
 * @param {[number, number][]} lower corners at the same times
 */
function outlines(upper, lower) {
  /** @type {[number, number][][][]} */
  const stretches = [];
  let within = false;
  upper.forEach((corner, i) => {
    const known = Number.isFinite(corner[1]) && Number.isFinite(lower[i][1]);
    if (known && !within) stretches.push([[], []]);
    if (known) {
      const [there, back] = stretches[stretches.length - 1];
      there.push(corner);
      back.push(lower[i]);
    }
    within = known;
  });
  return stretches.map(([there, back]) => [...there, ...back.reverse()]);
}

/**
 * What lies behind, and the curves with the inside of the axes for their place, as SVG.
 * @param {Panel} panel
 * @param {View} view
 * @param {number} width
 * @param {number} height
 */
export function drawn(panel, view, width, height) {
  const inside = insideOf(panel, width, height);
  const { left, top } = inside;
  const [low, high] = panel.range;
  /** Places of times and values, inside the axes. */
  const x = (/** @type {number} */ t) => ((t - view.from) / (view.to - view.from)) * inside.width;
  const y = (/** @type {number} */ value) => inside.height - ((value - low) / (high - low)) * inside.height;
  const text = (/** @type {number} */ right, /** @type {number} */ down, /** @type {string} */ anchor, /** @type {string | number} */ words, colour = "ink") =>
    `<text x="${short(right)}" y="${short(down)}" text-anchor="${anchor}" fill="var(--${colour})">${escaped(`${words}`)}</text>`;

  const axes = [];
  if (!panel.bare) {
    const count = Math.max(2, Math.floor(inside.height / LEVEL_PX));
    const rows = levels(panel.range, count);
    const columns = times(view, Math.max(2, Math.floor(inside.width / TIME_PX)));
    const grid = [
      ...rows.map((value) => `M${left - MARK_PX} ${short(top + y(value))}h${short(inside.width + MARK_PX)}`),
      ...columns.map((t) => `M${short(left + x(t))} ${top}v${inside.height + (panel.timeless ? 0 : MARK_PX)}`),
    ];
    axes.push(`<path d="${grid.join("")}" stroke="var(--rule)" stroke-width="0.7"/>`);
    for (const value of rows) axes.push(text(left - 2 * MARK_PX, top + y(value) + 4, "end", value));
    const { second } = panel;
    if (second) {
      for (const value of levels([low * second, high * second], count))
        axes.push(text(left + inside.width + MARK_PX, top + y(value / second) + 4, "start", value));
    }
    if (!panel.timeless) {
      columns.forEach((t, i) => {
        axes.push(text(left + x(t), top + inside.height + 22, "middle", markText(t, view.unit, i === 0, view.start)));
      });
    }
  }
  let free = -Infinity;
  for (const [t, words] of panel.marks ?? []) {
    const at = x(t);
    if (at < 0 || at > inside.width) continue;
    axes.push(`<path d="M${short(left + at - 4)} ${top - 8}h8l-4 7z" fill="var(--faint)"/>`);
    const half = (LETTER_PX * words.length) / 2;
    if (at - half < free) continue;
    axes.push(text(left + at, top - 12, "middle", words, "faint"));
    free = at + half;
  }

  const behind = [];
  if (panel.band !== null) {
    const [from, to] = panel.band.map((value) => Math.min(Math.max(value, low), high));
    behind.push(`<rect y="${short(y(to))}" width="${inside.width}" height="${short(y(from) - y(to))}" fill="var(--target)"/>`);
  }
  for (const { from, to, kind, text: words } of panel.spans) {
    const tall = kind === "guard" ? GUARD_PX : inside.height;
    const wide = Math.max(1, short(x(to) - x(from)));
    behind.push(`<rect x="${short(x(from))}" width="${wide}" height="${tall}" fill="var(--${kind})">${titled(words)}</rect>`);
    if (kind === "fault") behind.push(text(x(from) + 4, inside.height - 5, "start", words));
  }

  const curves = [];
  for (const { name, x: t, low: least, high: most, until, colour, opacity } of panel.areas) {
    const stretches = outlines(corners(t, most, until), corners(t, least, until));
    const d = stretches.map((corner) => `M${corner.map(([right, up]) => `${short(x(right))} ${short(y(up))}`).join("L")}z`);
    if (d.length) curves.push(`<path class="area" d="${d.join("")}" fill="${colour}" fill-opacity="${opacity}">${titled(name)}</path>`);
  }
  for (const { value, dash } of panel.rules) {
    curves.push(`<path d="M0 ${short(y(value))}h${inside.width}" stroke="var(--faint)" stroke-width="1.2"${dashed(dash)}/>`);
  }
  for (const line of [...panel.lines].reverse()) {
    const look = `stroke="${line.colour}" stroke-width="${line.width}" stroke-opacity="${line.opacity ?? 1}"${dashed(line.dash)}`;
    curves.push(`<path class="line" d="${pathOf(line.x, line.y, line.until, x, y)}" ${look}>${titled(line.name)}</path>`);
  }
  for (const { x: t, y: values, colour, opacity } of panel.dots) {
    const d = t.map((right, i) => (Number.isFinite(values[i]) ? `M${short(x(right))} ${short(y(values[i]))}h0` : ""));
    const size = inside.width < NARROW_PX ? 2.4 : 4;
    curves.push(`<path class="dots" d="${d.join("")}" stroke="${colour}" stroke-width="${size}" stroke-linecap="round" stroke-opacity="${opacity}"/>`);
  }
  return { axes: axes.join(""), behind: behind.join(""), curves: curves.join(""), inside };
}

/** Attributes of what holds a picture. */
export const FONT = 'font-family="system-ui, sans-serif" font-size="12" fill="none" stroke-linejoin="round"';
/** Attributes of a box. @param {Inside} box */
export const boxed = ({ left, top, width, height }) => `x="${left}" y="${top}" width="${width}" height="${height}"`;

/** A piece of a line for a legend. @param {string} colour @param {number[]} dash */
export const swatch = (colour, dash) =>
  `<svg width="30" height="10" aria-hidden="true"><path d="M0 5h30" stroke="${colour}" stroke-width="2"${dashed(dash)}/></svg>`;

/** A panel on the screen, as wide as its place. */
export class Chart {
  /**
   * @param {HTMLElement} place
   * @param {(width: number) => number} height in pixels
   */
  constructor(place, height) {
    this.height = height;
    place.innerHTML = `<svg ${FONT} aria-hidden="true"><g></g><svg><g></g><g></g><path stroke="var(--ink)"/></svg></svg>`;
    this.svg = /** @type {SVGSVGElement} */ (place.firstElementChild);
    const [axes, box] = this.svg.children;
    const [behind, curves, cursor] = box.children;
    this.box = box;
    this.cursor = cursor;
    this.parts = { axes, behind, curves };
    /** What stands in each part, which is asked of the browser only where it changes. */
    this.text = { axes: "", behind: "", curves: "" };
    /** @type {Inside} */
    this.inside = { left: 0, top: 0, width: 1, height: 1 };
    /** @type {{panel: Panel, view: View, moment: number | null} | null} */
    this.shown = null;
    /** Width of the place, for which the browser would have to lay out the page at each picture. */
    this.width = place.clientWidth;
    new ResizeObserver(() => {
      if (this.width === place.clientWidth || place.clientWidth === 0) return;
      this.width = place.clientWidth;
      if (this.shown !== null) this.draw(this.shown.panel, this.shown.view, this.shown.moment);
    }).observe(place);
  }

  /** @param {Panel} panel @param {View} view @param {number | null} moment */
  draw(panel, view, moment) {
    const [width, height] = [this.width, this.height(this.width)];
    const { inside, ...parts } = drawn(panel, view, width, height);
    if (this.svg.getAttribute("viewBox") !== `0 0 ${width} ${height}`) {
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svg.setAttribute("width", `${width}`);
      this.svg.setAttribute("height", `${height}`);
    }
    for (const [name, value] of Object.entries(inside)) {
      this.box.setAttribute({ left: "x", top: "y" }[name] ?? name, `${value}`);
    }
    this.inside = inside;
    for (const name of /** @type {const} */ (["axes", "behind", "curves"])) {
      if (this.text[name] === parts[name]) continue;
      this.text[name] = parts[name];
      this.parts[name].innerHTML = parts[name];
    }
    this.shown = { panel, view, moment };
    this.point(moment);
  }

  /** Show a moment, or none. @param {number | null} moment in min */
  point(moment) {
    if (this.shown === null) return;
    this.shown.moment = moment;
    const { from, to } = this.shown.view;
    const { width, height } = this.inside;
    const at = moment === null ? -1 : short(((moment - from) / (to - from)) * width);
    this.cursor.setAttribute("d", at < 0 || at > width ? "" : `M${at} 0v${height}`);
  }

  /** Time at which a pointer is. @param {PointerEvent} event */
  timeAt(event) {
    const { left, width } = this.svg.getBoundingClientRect();
    const { from, to } = /** @type {{view: View}} */ (this.shown).view;
    const px = ((event.clientX - left) * this.width) / width - this.inside.left;
    return from + Math.min(1, Math.max(0, px / this.inside.width)) * (to - from);
  }
}
