// @ts-check
/** The picture: glucose with its band and readings above, insulin below, pinned runs dashed. */

import { texts } from "./texts.mjs";

/** @typedef {import("./loop.mjs").Trace} Trace */
/** @typedef {import("./situation.mjs").Data} Data */
/** @typedef {{name: string, trace: Trace}} Drawn */

const LOW = 70;
const HIGH = 180;
/** The least range of the axis, so that small changes are seen and not taken for large ones. */
const SHOWN = [60, 130];
const NARROW_PX = 600;
/** Colours that colour-blind people tell apart (Okabe and Ito), and darker or lighter by the page. */
const LIGHT = ["#0b5cad", "#b34700", "#00704f", "#8a3d75", "#5c5200"];
const DARK = ["#7ab8ff", "#ffa05c", "#4fd1a5", "#e59bd0", "#e6d96a"];

const isDark = () => matchMedia("(prefers-color-scheme: dark)").matches;
const style = (/** @type {string} */ name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** @type {{destroy: () => void}[]} */
let charts = [];

/** @param {number[]} values each held until the next time */
function held(values) {
  return values.flatMap((value) => [value, value]);
}

/**
 * Draw runs, the first of which is the present one.
 * @param {{glucose: HTMLElement, insulin: HTMLElement}} places
 * @param {Drawn[]} runs
 * @param {Data} data
 * @param {(sample: number | null) => void} tell called with the sample under the cursor
 */
export function draw(places, runs, data, tell) {
  const uPlot = /** @type {any} */ (globalThis).uPlot;
  for (const chart of charts) chart.destroy();
  const width = places.glucose.clientWidth;
  const narrow = width < NARROW_PX;
  const colours = draw.colours();
  const every = data.sample_time_min;
  const end = Math.max(...runs.map(({ trace }) => trace.fine_t_min[trace.fine_t_min.length - 1]));
  const axis = {
    stroke: style("--ink"),
    grid: { stroke: style("--rule"), width: 0.5 },
    ticks: { stroke: style("--rule") },
    font: "12px system-ui, sans-serif",
  };
  const sample = (/** @type {any} */ chart) => {
    const left = chart.cursor.left;
    return left === undefined || left < 0 ? null : Math.max(0, Math.floor(chart.posToVal(left, "x") / every));
  };
  const common = {
    width,
    scales: { x: { time: false, range: [0, end] } },
    legend: { show: false },
    cursor: { y: false, sync: { key: "lab" }, drag: { x: false, y: false }, points: { show: false } },
    hooks: { setCursor: [(/** @type {any} */ chart) => tell(sample(chart))] },
  };
  const line = (/** @type {Drawn} */ run, /** @type {number} */ i) => ({
    label: run.name,
    stroke: colours[i],
    width: i === 0 ? 2.2 : 1.6,
    dash: i === 0 ? undefined : [3 + 3 * i, 4],
    points: { show: false },
  });
  const [{ trace }] = runs;
  // One axis of time for curves on the fine grid and readings at samples.
  // Readings without noise and dead time are the curve itself, which they would hide.
  const told = trace.reading_mg_dl.map((reading, i) => (reading === trace.glucose_mg_dl[i] ? null : reading));
  const glucose = uPlot.join([
    ...runs.map((run) => [run.trace.fine_t_min, run.trace.fine_glucose_mg_dl]),
    [trace.t_min, told],
  ]);
  const values = [...SHOWN, ...glucose.slice(1).flat().filter((/** @type {any} */ v) => v != null)];
  const least = Math.max(0, Math.min(...values));
  const most = Math.max(...values);
  const band = (/** @type {any} */ chart) => {
    const { left, top, width: wide } = chart.bbox;
    const from = Math.max(top, chart.valToPos(HIGH, "y", true));
    chart.ctx.save();
    chart.ctx.fillStyle = style("--band");
    chart.ctx.fillRect(left, from, wide, chart.valToPos(LOW, "y", true) - from);
    chart.ctx.restore();
  };
  charts = [
    new uPlot(
      {
        ...common,
        height: narrow ? 180 : 320,
        scales: { ...common.scales, y: { range: [least, most + 5] } },
        axes: [{ ...axis, size: 30 }, { ...axis, size: 44 }],
        hooks: { ...common.hooks, drawClear: [band] },
        series: [
          { label: texts.time },
          ...runs.map(line),
          {
            label: texts.reading,
            stroke: style("--soft"),
            paths: () => null,
            points: { show: true, size: 4, fill: style("--soft"), stroke: style("--soft") },
          },
        ],
      },
      glucose,
      places.glucose,
    ),
    new uPlot(
      {
        ...common,
        height: narrow ? 100 : 170,
        scales: { ...common.scales, y: { range: [0, data.limits.max_mU_min * 1.05] } },
        axes: [{ ...axis, size: 30 }, { ...axis, size: 44 }],
        series: [{ label: texts.time }, ...runs.map(line)],
      },
      uPlot.join(
        runs.map((run) => [
          run.trace.t_min.flatMap((t) => [t, t + every - 1e-6]),
          held(run.trace.insulin_mU_min),
        ]),
      ),
      places.insulin,
    ),
  ];
}

/** Colours of the present run and of the pinned ones. */
draw.colours = () => (isDark() ? DARK : LIGHT);
