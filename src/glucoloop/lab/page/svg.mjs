// @ts-check
/** The picture as a file: SVG text, which a browser can also make a PNG of. */

import { corners, levels, times } from "./axes.mjs";
import { texts } from "./texts.mjs";

/** @typedef {import("./scene.mjs").Scene} Scene */
/** @typedef {import("./scene.mjs").Panel} Panel */

const WIDTH = 960;
const LEFT = 64;
const RIGHT = 16;
const TITLE = 26;
const BELOW = 26;
const HEIGHTS = { glucose: 320, insulin: 170 };
const MOST_TIMES = 11;
const LEVELS = 5;
const INK = "#1d2126";
const SOFT = "#575e66";
const RULE = "#c9ced4";
const FILLS = { guard: "#b34700", fault: "#f3d9c4" };

const escaped = (/** @type {string} */ text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
const short = (/** @type {number} */ value) => `${Math.round(100 * value) / 100}`;

/**
 * @param {Panel} panel
 * @param {number} end
 * @param {number} top
 * @param {number} height
 */
function drawn(panel, end, top, height) {
  const [low, high] = panel.range;
  const right = WIDTH - RIGHT;
  const x = (/** @type {number} */ t) => LEFT + (t / end) * (right - LEFT);
  const y = (/** @type {number} */ value) => top + height - ((value - low) / (high - low)) * height;
  const point = (/** @type {number} */ t, /** @type {number} */ value) => `${short(x(t))},${short(y(value))}`;
  const parts = [`<text x="${LEFT}" y="${top - 8}" fill="${SOFT}">${escaped(`${panel.title}; ${panel.legend}`)}</text>`];
  if (panel.band !== null) {
    const [from, to] = panel.band.map((value) => Math.min(Math.max(value, low), high));
    parts.push(`<rect x="${LEFT}" y="${short(y(to))}" width="${right - LEFT}" height="${short(y(from) - y(to))}" fill="#dff0ea"/>`);
  }
  for (const { from, to, kind, text } of panel.spans) {
    const tall = kind === "guard" ? 5 : height;
    parts.push(
      `<rect x="${short(x(from))}" y="${top}" width="${short(x(to) - x(from))}" height="${tall}" fill="${FILLS[kind]}"><title>${escaped(text)}</title></rect>`,
    );
  }
  for (const area of panel.areas) {
    const there = area.x.map((t, i) => point(t, area.high[i]));
    const back = area.x.map((t, i) => point(t, area.low[i])).reverse();
    parts.push(`<polygon points="${[...there, ...back].join(" ")}" fill="#0b5cad" fill-opacity="${area.opacity}"/>`);
  }
  for (const value of levels(panel.range, LEVELS)) {
    parts.push(`<path d="M${LEFT} ${short(y(value))}H${right}" stroke="${RULE}" stroke-width="0.5"/>`);
    parts.push(`<text x="${LEFT - 6}" y="${short(y(value) + 4)}" text-anchor="end" fill="${INK}">${value}</text>`);
  }
  for (const t of times(end, MOST_TIMES)) {
    parts.push(`<path d="M${short(x(t))} ${top}v${height}" stroke="${RULE}" stroke-width="0.5"/>`);
    parts.push(`<text x="${short(x(t))}" y="${top + height + 17}" text-anchor="middle" fill="${INK}">${t}</text>`);
  }
  for (const value of panel.rules) {
    parts.push(`<path d="M${LEFT} ${short(y(value))}H${right}" stroke="${SOFT}" stroke-dasharray="2 4"/>`);
  }
  for (const line of [...panel.lines].reverse()) {
    const dash = line.dash.length ? ` stroke-dasharray="${line.dash.join(" ")}"` : "";
    /** @type {string[]} */
    const points = [];
    corners(line, (t, value) => points.push(point(t, value)));
    parts.push(
      `<polyline points="${points.join(" ")}" fill="none" stroke="${line.colour}" stroke-width="${line.width}" stroke-linejoin="round"${dash}><title>${escaped(line.name)}</title></polyline>`,
    );
  }
  for (let i = 0; i < panel.dots.x.length; i++) {
    parts.push(`<circle cx="${short(x(panel.dots.x[i]))}" cy="${short(y(panel.dots.y[i]))}" r="2" fill="${SOFT}"/>`);
  }
  return parts.join("\n");
}

/**
 * The picture in light colours, with the names of its curves and the command that repeats the present run.
 * @param {Scene} scene
 * @param {string} command
 */
export function svg({ end, glucose, insulin }, command) {
  const first = TITLE + 8;
  const second = first + HEIGHTS.glucose + BELOW + TITLE;
  const below = second + HEIGHTS.insulin + BELOW;
  const height = below + 30;
  let at = LEFT;
  const names = glucose.lines.map(({ name, colour, dash }) => {
    const part =
      `<path d="M${at} ${below + 11}h24" stroke="${colour}" stroke-width="2" stroke-dasharray="${dash.join(" ") || "none"}"/>` +
      `<text x="${at + 30}" y="${below + 15}" fill="${INK}">${escaped(name)}</text>`;
    at += 60 + 7 * name.length;
    return part;
  });
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${height}" viewBox="0 0 ${WIDTH} ${height}" font-family="system-ui, sans-serif" font-size="12" role="img">
<title>${escaped(texts.pictureTitle)}</title>
<desc>${escaped(command)}</desc>
<rect width="${WIDTH}" height="${height}" fill="#fff"/>
${drawn(glucose, end, first, HEIGHTS.glucose)}
${drawn(insulin, end, second, HEIGHTS.insulin)}
${names.join("\n")}
</svg>
`;
}
