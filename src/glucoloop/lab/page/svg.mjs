// @ts-check
/** The picture as a file: SVG text, which a browser can also make a PNG of. */

import { boxed, drawn, FONT } from "../../pages/chart.mjs";
import { texts } from "./texts.mjs";

/** @typedef {import("./scene.mjs").Scene} Scene */
/** @typedef {import("./scene.mjs").Panel} Panel */

const WIDTH = 960;
const TITLE = 26;
const HEIGHTS = { glucose: 350, insulin: 200 };

const escaped = (/** @type {string} */ text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

/** Light colours of the style sheet, which a file does not have. @param {string} text */
function inLight(text) {
  const rules = [...document.styleSheets].flatMap((sheet) => [...sheet.cssRules]);
  const root = /** @type {CSSStyleRule} */ (rules.find((rule) => rule instanceof CSSStyleRule && rule.selectorText === ":root"));
  return text.replace(/var\((--[\w-]+)\)/g, (_, name) => root.style.getPropertyValue(name).trim());
}

/** A panel from its top on. @param {Panel} panel @param {number} end @param {number} top @param {number} height */
function placed(panel, end, top, height) {
  const { axes, behind, curves, inside } = drawn(panel, { from: 0, to: end, unit: "min" }, WIDTH, height);
  const title = `<text x="${inside.left}" y="${top + TITLE - 8}" fill="var(--faint)">${escaped(`${panel.title}; ${panel.legend}`)}</text>`;
  return `${title}<g transform="translate(0 ${top + TITLE})">${axes}<svg ${boxed(inside)}>${behind}${curves}</svg></g>`;
}

/**
 * The picture in light colours, with the names of its curves and the command that repeats the present run.
 * @param {Scene} scene
 * @param {string} command
 */
export function svg({ end, glucose, insulin }, command) {
  const second = TITLE + HEIGHTS.glucose;
  const below = second + TITLE + HEIGHTS.insulin;
  let at = 44;
  const names = glucose.lines.map(({ name, colour, dash }) => {
    const part =
      `<path d="M${at} ${below + 11}h24" stroke="${colour}" stroke-width="2" stroke-dasharray="${dash.join(" ") || "none"}"/>` +
      `<text x="${at + 30}" y="${below + 15}" fill="var(--ink)">${escaped(name)}</text>`;
    at += 60 + 7 * name.length;
    return part;
  });
  return inLight(`<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${below + 30}" viewBox="0 0 ${WIDTH} ${below + 30}" ${FONT} role="img">
<title>${escaped(texts.pictureTitle)}</title>
<desc>${escaped(command)}</desc>
<rect width="${WIDTH}" height="${below + 30}" fill="#fff"/>
${placed(glucose, end, 0, HEIGHTS.glucose)}
${placed(insulin, end, second, HEIGHTS.insulin)}
${names.join("\n")}
</svg>
`);
}
