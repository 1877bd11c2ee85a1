// @ts-check
/** The picture on the screen: axes by uPlot, and everything else drawn on its canvas. */

import { texts } from "./texts.mjs";

/** @typedef {import("./scene.mjs").Scene} Scene */
/** @typedef {import("./scene.mjs").Panel} Panel */
/** @typedef {import("./scene.mjs").Line} Line */

const NARROW_PX = 600;
const GUARD_PX = 5;

const NAMES = /** @type {const} */ (["--ink", "--paper", "--soft", "--rule", "--accent", "--band", "--guard", "--fault"]);

/** @typedef {Record<typeof NAMES[number], string>} Colours */

/** @type {{light?: Colours, dark?: Colours}} */
const read = {};
const dark = globalThis.matchMedia?.("(prefers-color-scheme: dark)");

/** Whether the page is dark. */
export const isDark = () => dark.matches;

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

/** A panel with its axes, made again only when its size or colours change. */
class Chart {
  /**
   * @param {HTMLElement} place
   * @param {{wide: number, narrow: number}} height in pixels
   */
  constructor(place, height) {
    this.place = place;
    this.height = height;
    this.made = "";
    /** @type {any} */
    this.plot = null;
    /** @type {{end: number, moment: number | null, panel: Panel} | null} */
    this.shown = null;
    /** Width of the place, which the browser would have to lay out the page for at each picture. */
    this.width = place.clientWidth;
    new ResizeObserver(() => {
      this.width = place.clientWidth;
      if (this.shown !== null) this.draw(this.shown);
    }).observe(place);
  }

  /** @param {{end: number, moment: number | null, panel: Panel}} shown */
  draw(shown) {
    this.shown = shown;
    const { width } = this;
    const height = width < NARROW_PX ? this.height.narrow : this.height.wide;
    const make = [width, height, devicePixelRatio, style("--ink"), style("--paper")].join(" ");
    if (make !== this.made) {
      this.plot?.destroy();
      this.plot = this.axes(width, height);
      this.made = make;
    } else {
      this.plot.setData(this.ends());
    }
  }

  /** @returns {[number[], null[]]} */
  ends() {
    return [[0, this.shown?.end ?? 1], [null, null]];
  }

  /** @param {number} width @param {number} height */
  axes(width, height) {
    const uPlot = /** @type {any} */ (globalThis).uPlot;
    const axis = {
      stroke: style("--ink"),
      grid: { stroke: style("--rule"), width: 0.5 },
      ticks: { stroke: style("--rule") },
      font: "12px system-ui, sans-serif",
    };
    return new uPlot(
      {
        width,
        height,
        scales: {
          x: { time: false, range: () => [0, this.shown?.end] },
          y: { auto: true, range: () => this.shown?.panel.range },
        },
        padding: [6, 18, 0, 0],
        legend: { show: false },
        cursor: { show: false },
        axes: [
          { ...axis, size: 30, incrs: [5, 10, 15, 30, 60, 120, 180, 240], values: (/** @type {any} */ _, /** @type {number[]} */ times) => times.map((t) => (t === 0 ? texts.minutes(t) : `${t}`)) },
          { ...axis, size: 44 },
        ],
        series: [{}, { points: { show: false } }],
        hooks: {
          drawClear: [(/** @type {any} */ plot) => this.within(plot, () => this.behind(plot))],
          draw: [(/** @type {any} */ plot) => this.within(plot, () => this.curves(plot))],
        },
      },
      this.ends(),
      this.place,
    );
  }

  /** Draw within the axes only. @param {any} plot @param {() => void} drawing */
  within(plot, drawing) {
    const { left, top, width, height } = plot.bbox;
    plot.ctx.save();
    plot.ctx.beginPath();
    plot.ctx.rect(left, top, width, height);
    plot.ctx.clip();
    drawing();
    plot.ctx.restore();
  }

  /** Places on the canvas of times and values. @param {any} plot */
  places(plot) {
    return {
      x: (/** @type {number} */ t) => plot.valToPos(t, "x", true),
      y: (/** @type {number} */ value) => plot.valToPos(value, "y", true),
      pixel: devicePixelRatio,
    };
  }

  /** @param {any} plot */
  behind(plot) {
    if (this.shown === null) return;
    const { panel } = this.shown;
    const { x, y, pixel } = this.places(plot);
    const { left, top, width, height } = plot.bbox;
    const { ctx } = plot;
    if (panel.band !== null) {
      const [low, high] = panel.band;
      ctx.fillStyle = style("--band");
      ctx.fillRect(left, y(high), width, y(low) - y(high));
    }
    ctx.font = `${12 * pixel}px system-ui, sans-serif`;
    ctx.textAlign = "left"; // uPlot leaves that of its axes
    ctx.textBaseline = "bottom";
    for (const { from, to, kind, text } of panel.spans) {
      ctx.fillStyle = style(kind === "guard" ? "--guard" : "--fault");
      ctx.fillRect(x(from), top, x(to) - x(from), kind === "guard" ? GUARD_PX * pixel : height);
      if (kind === "guard") continue;
      ctx.fillStyle = style("--ink");
      ctx.fillText(text, x(from) + 4 * pixel, top + height - 2 * pixel);
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
    ctx.strokeStyle = style("--soft");
    ctx.lineWidth = pixel;
    ctx.setLineDash([2 * pixel, 4 * pixel]);
    for (const level of panel.rules) {
      ctx.beginPath();
      ctx.moveTo(left, y(level));
      ctx.lineTo(left + width, y(level));
      ctx.stroke();
    }
  }

  /** @param {any} plot */
  curves(plot) {
    if (this.shown === null) return;
    const { panel, moment } = this.shown;
    const { x, y, pixel } = this.places(plot);
    const { ctx } = plot;
    const { top, height } = plot.bbox;
    if (moment !== null) {
      ctx.strokeStyle = style("--soft");
      ctx.lineWidth = pixel;
      ctx.beginPath();
      ctx.moveTo(x(moment), top);
      ctx.lineTo(x(moment), top + height);
      ctx.stroke();
    }
    // The present run comes last, so that it lies above the others.
    for (const line of [...panel.lines].reverse()) {
      ctx.strokeStyle = line.colour;
      ctx.lineWidth = line.width * pixel;
      ctx.setLineDash(line.dash.map((length) => length * pixel));
      ctx.lineJoin = "round";
      ctx.beginPath();
      corners(line).forEach(([t, value]) => ctx.lineTo(x(t), y(value)));
      ctx.stroke();
    }
    ctx.setLineDash([]);
    ctx.fillStyle = style("--soft");
    const radius = (plot.width < NARROW_PX ? 1.2 : 2) * pixel;
    for (let i = 0; i < panel.dots.x.length; i++) {
      ctx.beginPath();
      ctx.arc(x(panel.dots.x[i]), y(panel.dots.y[i]), radius, 0, 2 * Math.PI);
      ctx.fill();
    }
  }
}

/** Corners of a line, which goes in steps where each value is held. @param {Line} line @returns {[number, number][]} */
export function corners({ x, y, steps }) {
  if (!steps) return x.map((t, i) => [t, y[i]]);
  return x.flatMap((t, i) => /** @type {[number, number][]} */ (i === 0 ? [[t, y[0]]] : [[t, y[i - 1]], [t, y[i]]]));
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

  /** The element above the axes' inside, for pointers. @returns {HTMLElement[]} */
  insides() {
    return [this.glucose.plot.over, this.insulin.plot.over];
  }

  /** Where the inside of the axes lies in its place, in pixels. */
  inside() {
    const { left, width } = this.glucose.plot.bbox;
    return { left: left / devicePixelRatio, width: width / devicePixelRatio };
  }
}
