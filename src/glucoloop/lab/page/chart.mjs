// @ts-check
/** The picture on the screen: two panels, each on two canvases. */

import { corners, levels, times } from "./axes.mjs";
import { element } from "./dom.mjs";
import { texts } from "./texts.mjs";

/** @typedef {import("./scene.mjs").Scene} Scene */
/** @typedef {import("./scene.mjs").Panel} Panel */

const NARROW_PX = 600;
const GUARD_PX = 5;
/** Room around the inside of the axes, for their marks. */
const [LEFT, RIGHT, TOP, BELOW] = [44, 18, 6, 30];
const FONT = "12px system-ui, sans-serif";
/** Least room for a mark of each axis, and length of its line. */
const [LEVEL_PX, TIME_PX, MARK_PX] = [28, 54, 5];

const NAMES = /** @type {const} */ (["--ink", "--paper", "--soft", "--rule", "--accent", "--band", "--guard", "--fault"]);

/** @typedef {Record<typeof NAMES[number], string>} Colours */

/** @type {{light?: Colours, dark?: Colours}} */
const read = {};
const dark = globalThis.matchMedia?.("(prefers-color-scheme: dark)");
let darkNow = dark?.matches;
dark?.addEventListener("change", () => {
  darkNow = dark.matches;
});

/** Whether the page is dark, which the browser would have to find out each time. */
export const isDark = () => darkNow;

/** Colours of the style sheet, which are asked for once: asking makes the browser lay out the page. @returns {Colours} */
function styles() {
  const theme = isDark() ? "dark" : "light";
  const found = read[theme];
  if (found !== undefined) return found;
  const of = getComputedStyle(document.documentElement);
  return (read[theme] = /** @type {Colours} */ (Object.fromEntries(NAMES.map((name) => [name, of.getPropertyValue(name).trim()]))));
}

/** @param {typeof NAMES[number]} name of a colour of the style sheet */
const style = (name) => styles()[name];

/** @param {CanvasRenderingContext2D} ctx @param {number} x @param {number} y @param {number} radius */
function dot(ctx, x, y, radius) {
  ctx.moveTo(x + radius, y);
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
}

/** A canvas. */
class Layer {
  constructor() {
    this.canvas = element("canvas", {});
    this.ctx = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.size = { width: 0, height: 0, pixel: 0 };
  }

  /** Give the canvas its size, and clear it. @param {{width: number, height: number, pixel: number}} size */
  fit(size) {
    const { width, height, pixel } = size;
    const { canvas, size: before } = this;
    if (before.width === width && before.height === height && before.pixel === pixel) {
      this.ctx.clearRect(0, 0, width, height);
      return;
    }
    this.size = size;
    canvas.width = Math.round(width * pixel);
    canvas.height = Math.round(height * pixel);
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    this.ctx.scale(pixel, pixel);
  }

  /** Draw nothing outside a rectangle. @param {number} left @param {number} top @param {number} width @param {number} height @param {() => void} draw */
  within(left, top, width, height, draw) {
    const { ctx } = this;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    draw();
    ctx.restore();
  }
}

/** A panel with its axes. */
class Chart {
  /**
   * @param {HTMLElement} place
   * @param {{wide: number, narrow: number}} height in pixels
   */
  constructor(place, height) {
    this.height = height;
    /** The axes with what lies behind them, which are drawn only when they change, and the curves above. */
    this.back = new Layer();
    this.front = new Layer();
    place.append(this.back.canvas, this.front.canvas);
    /** What the axes were drawn of. */
    this.drawn = "";
    /** @type {{end: number, moment: number | null, panel: Panel} | null} */
    this.shown = null;
    /** Width of the place, which the browser would have to lay out the page for at each picture. */
    this.width = place.clientWidth;
    this.size = { width: 0, height: 0, pixel: 0 };
    new ResizeObserver(() => {
      if (this.width === place.clientWidth) return;
      this.width = place.clientWidth;
      if (this.shown !== null) this.draw(this.shown);
    }).observe(place);
  }

  /** Inside of the axes, in pixels of the style sheet. */
  get inside() {
    const { width, height } = this.size;
    return { left: LEFT, top: TOP, width: Math.max(1, width - LEFT - RIGHT), height: height - TOP - BELOW };
  }

  /** @param {{end: number, moment: number | null, panel: Panel}} shown */
  draw(shown) {
    this.shown = shown;
    const { back, front } = this;
    const size = { width: this.width, height: this.width < NARROW_PX ? this.height.narrow : this.height.wide, pixel: devicePixelRatio };
    this.size = size;
    const { left, top, width, height } = this.inside;
    const { end, panel } = shown;
    const { range, band, spans, areas } = panel;
    const [low, high] = range;
    /** Places on the canvas of times and values. */
    const x = (/** @type {number} */ t) => left + (t / shown.end) * width;
    const y = (/** @type {number} */ value) => top + height - ((value - low) / (high - low)) * height;
    const drawn = JSON.stringify([size, end, range, band, spans, isDark()]);
    if (drawn !== this.drawn || areas.length > 0) {
      // Areas are long lists, which would take as long to compare as to draw.
      this.drawn = areas.length > 0 ? "" : drawn;
      back.fit(size);
      back.within(left, top, width, height, () => this.behind(shown, x, y));
      this.axes(shown, x, y);
    }
    front.fit(size);
    front.within(left, top, width, height, () => this.curves(shown, x, y));
  }

  /**
   * What lies behind the axes: the band, faults, what the guard did, and areas.
   * @param {{panel: Panel}} shown
   * @param {(t: number) => number} x
   * @param {(value: number) => number} y
   */
  behind({ panel }, x, y) {
    const { ctx } = this.back;
    const { left, top, width, height } = this.inside;
    ctx.font = FONT;
    if (panel.band !== null) {
      const [low, high] = panel.band;
      ctx.fillStyle = style("--band");
      ctx.fillRect(left, y(high), width, y(low) - y(high));
    }
    ctx.textAlign = "left";
    ctx.textBaseline = "bottom";
    for (const { from, to, kind, text } of panel.spans) {
      ctx.fillStyle = style(kind === "guard" ? "--guard" : "--fault");
      ctx.fillRect(x(from), top, x(to) - x(from), kind === "guard" ? GUARD_PX : height);
      if (kind === "guard") continue;
      ctx.fillStyle = style("--ink");
      ctx.fillText(text, x(from) + 4, top + height - 2);
    }
    for (const area of panel.areas) {
      ctx.beginPath();
      area.x.forEach((t, i) => ctx.lineTo(x(t), y(area.high[i])));
      for (let i = area.x.length - 1; i >= 0; i--) ctx.lineTo(x(area.x[i]), y(area.low[i]));
      ctx.globalAlpha = area.opacity;
      ctx.fillStyle = style("--accent");
      ctx.fill();
      ctx.globalAlpha = 1;
    }
  }

  /**
   * Grid and marks.
   * @param {{end: number, panel: Panel}} shown
   * @param {(t: number) => number} x
   * @param {(value: number) => number} y
   */
  axes({ end, panel }, x, y) {
    const { ctx } = this.back;
    const { left, top, width, height } = this.inside;
    ctx.font = FONT;
    const rows = levels(panel.range, Math.max(2, Math.floor(height / LEVEL_PX)));
    const columns = times(end, Math.max(2, Math.floor(width / TIME_PX)));
    ctx.beginPath();
    for (const value of rows) {
      ctx.moveTo(left - MARK_PX, y(value));
      ctx.lineTo(left + width, y(value));
    }
    for (const t of columns) {
      ctx.moveTo(x(t), top);
      ctx.lineTo(x(t), top + height + MARK_PX);
    }
    ctx.strokeStyle = style("--rule");
    ctx.lineWidth = 0.5;
    ctx.stroke();
    ctx.fillStyle = style("--ink");
    ctx.textBaseline = "middle";
    ctx.textAlign = "right";
    for (const value of rows) ctx.fillText(`${value}`, left - 2 * MARK_PX, y(value));
    ctx.textBaseline = "top";
    ctx.textAlign = "center";
    for (const t of columns) ctx.fillText(t === 0 ? texts.minutes(t) : `${t}`, x(t), top + height + 2 * MARK_PX);
  }

  /**
   * Limits, curves, readings, and the moment that is explained.
   * @param {{moment: number | null, panel: Panel}} shown
   * @param {(t: number) => number} x
   * @param {(value: number) => number} y
   */
  curves({ panel, moment }, x, y) {
    const { ctx } = this.front;
    const { left, top, width, height } = this.inside;
    ctx.strokeStyle = style("--soft");
    ctx.lineWidth = 1;
    if (moment !== null) {
      ctx.beginPath();
      ctx.moveTo(x(moment), top);
      ctx.lineTo(x(moment), top + height);
      ctx.stroke();
    }
    ctx.setLineDash([2, 4]);
    for (const level of panel.rules) {
      ctx.beginPath();
      ctx.moveTo(left, y(level));
      ctx.lineTo(left + width, y(level));
      ctx.stroke();
    }
    ctx.lineJoin = "round";
    // The present run comes last, so that it lies above the others.
    for (const line of [...panel.lines].reverse()) {
      ctx.strokeStyle = line.colour;
      ctx.lineWidth = line.width;
      ctx.setLineDash(line.dash);
      ctx.beginPath();
      corners(line, (t, value) => ctx.lineTo(x(t), y(value)));
      ctx.stroke();
    }
    ctx.fillStyle = style("--soft");
    const radius = width < NARROW_PX ? 1.2 : 2;
    if (panel.dots.x.length === 0) return;
    ctx.beginPath();
    for (let i = 0; i < panel.dots.x.length; i++) dot(ctx, x(panel.dots.x[i]), y(panel.dots.y[i]), radius);
    ctx.fill();
  }
}

/** The two panels. */
export class Picture {
  /** @param {{glucose: HTMLElement, insulin: HTMLElement}} places */
  constructor(places) {
    this.glucose = new Chart(places.glucose, { wide: 320, narrow: 180 });
    this.insulin = new Chart(places.insulin, { wide: 170, narrow: 100 });
  }

  /** @param {Scene} scene */
  draw({ end, moment, glucose, insulin }) {
    this.glucose.draw({ end, moment, panel: glucose });
    this.insulin.draw({ end, moment, panel: insulin });
  }

  /** What pointers move over. */
  get canvases() {
    return [this.glucose.front.canvas, this.insulin.front.canvas];
  }

  /** Where the inside of the axes lies in its place, in pixels. */
  get inside() {
    return this.glucose.inside;
  }
}
