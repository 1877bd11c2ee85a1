// @ts-check
/** Pages of results: a moment is told in numbers, time can be zoomed, curves are chosen, and what is drawn can be saved. */

import { timeText, unitOfTime } from "./axes.mjs";
import { Chart, colourOf, swatch } from "./chart.mjs";
import { csvText } from "./csv.mjs";
import { dashOf, plotOf } from "./data.mjs";
import { grid, spread } from "./shares.mjs";

/** @typedef {import("./data.mjs").PlottedPanel} Panel */
/** @typedef {Panel["lines"][number]} Line */
/** @typedef {Panel["areas"][number]} Area */

const LEAST_SPAN_MIN = 30;
const FADED = 0.08;
const ROW_PX = 10;

/** Runs that are hidden by the boxes of the legend. @type {Set<number>} */
const hidden = new Set();

/** @param {string} tag @param {string} kind @param {(Node | string)[]} content */
function element(tag, kind, ...content) {
  const made = document.createElement(tag);
  made.className = kind;
  made.append(...content);
  return made;
}

/** Value at a time: the one that is held, or on the line between two. @param {number[]} x @param {number[]} y @param {number | undefined} until @param {number} time */
function valueAt(x, y, until, time) {
  let low = 0, high = x.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (x[middle] <= time + 1e-6) low = middle + 1; else high = middle;
  }
  const before = low - 1;
  if (until !== undefined) return time > until + 1e-6 ? NaN : y[before];
  if (x[before] >= time - 1e-6) return y[before];
  return y[before] + ((y[low] - y[before]) * (time - x[before])) / (x[low] - x[before]);
}

/** Edges of what is drawn. @param {Line | Area} of */
const edges = (of) => ("y" in of ? [of.y] : [of.low, of.high]);

/** Curves and bands of a panel as they are told: lines first, then bands from the inner one. @param {Panel} panel @returns {(Line | Area)[]} */
const told = (panel) => [...panel.lines, ...[...panel.areas].reverse()].filter(({ name }) => name);

/** A value in the units of a panel. @param {Panel} panel @param {number[]} values */
function inUnits({ unit, other, factor, digits }, values) {
  const second = other ? ` (${values.map((value) => (value * factor).toFixed(2)).join(" – ")} ${other})` : "";
  return `${values.map((value) => value.toFixed(digits)).join(" – ")} ${unit}${second}`;
}

/** A panel in words, for those who do not see it. @param {Panel} panel @param {import("./axes.mjs").TimeUnit} unit @param {number} start */
function inWords(panel, unit, start) {
  const courses = told(panel).map((of) => {
    const [low, high] = [edges(of)[0], edges(of)[edges(of).length - 1]];
    const at = (/** @type {number[]} */ values, /** @type {number} */ i) =>
      i < 0 ? "no value" : `${values[i].toFixed(panel.digits)} ${panel.unit} at ${timeText(of.x[i], unit, start)}`;
    const least = at(low, low.indexOf(Math.min(...low.filter(Number.isFinite))));
    const most = at(high, high.indexOf(Math.max(...high.filter(Number.isFinite))));
    const gaps = low.some(Number.isNaN) ? ", with times without a value" : "";
    return `${of.name}: minimum ${least}${of.person === undefined ? `, maximum ${most}` : ""}${gaps}`;
  });
  return `${panel.name}. ${courses.join("; ")}`;
}

/** A figure: its panels above each other, a line of time for each lane, and the numbers of a moment. */
class Plot {
  /** @param {HTMLElement} figure */
  constructor(figure) {
    const { name, end, start, panels, lanes } = plotOf(figure);
    this.name = name;
    this.end = end;
    this.start = start;
    this.unit = unitOfTime(end);
    this.panels = panels;
    this.lanes = lanes.map(({ name, rows }) => ({ name, rows, height: ROW_PX * rows.length }));
    /** The person who is singled out. @type {number | null} */
    this.person = null;
    this.readout = element("div", "readout");
    this.charts = panels.map((panel, place) => {
      const { name, unit, other, height } = panel;
      panel.timeless = place + 1 < panels.length;
      const [head, field] = [element("div", "axes", element("span", "", `${name} (${unit})`)), element("div", "field")];
      if (other) head.append(element("span", "", `(${other})`));
      field.setAttribute("role", "img");
      field.setAttribute("aria-label", inWords(panel, this.unit, start));
      figure.append(head, field);
      return new Chart(field, () => height);
    });
    figure.append(this.readout);
    this.strips = this.lanes.map(({ name, height }) => {
      const field = element("div", "field");
      figure.append(element("p", "lane", name), field);
      return new Chart(field, () => height);
    });
  }

  /** Whether something is shown. @param {{run?: number}} of */
  shows({ run }) {
    return run === undefined || !hidden.has(run);
  }

  /** @param {import("./chart.mjs").View} view @param {number} moment */
  draw(view, moment) {
    const shown = (/** @type {{run?: number}[]} */ of) => of.filter((one) => this.shows(one));
    this.panels.forEach((panel, place) => {
      const faded = (/** @type {Line} */ line) => (this.person === null || line.person === this.person ? line : { ...line, opacity: FADED });
      // the last that is told lies above the others
      const lines = /** @type {Line[]} */ (shown(panel.lines)).map(faded).reverse();
      const [areas, dots] = [panel.areas, panel.dots].map(shown);
      this.charts[place].draw(/** @type {any} */ ({ ...panel, lines, areas, dots }), view, moment);
    });
    this.lanes.forEach(({ rows, height }, place) => {
      const lines = rows.flatMap(({ periods, colour }, row) => ({
        name: "", x: periods.flat(), y: periods.flatMap(() => [row + 0.5, NaN]), until: 0, colour: colourOf(colour), width: 0.8 * ROW_PX, dash: [],
      }));
      const panel = { range: /** @type {[number, number]} */ ([rows.length, 0]), band: null, rules: [], lines, dots: [], areas: [], spans: [], bare: true };
      this.strips[place].draw(panel, view, moment);
    });
    this.tell(moment);
  }

  /** Tell the numbers of a moment. @param {number} moment */
  tell(moment) {
    for (const chart of [...this.charts, ...this.strips]) chart.point(moment);
    const lines = this.panels.flatMap((panel) =>
      told(panel)
        .filter((of) => this.shows(of) && (this.person === null || of.person === this.person))
        .map((of) => {
          const values = edges(of).map((edge) => valueAt(of.x, edge, of.until, moment));
          return { person: of.person, text: values.some((value) => !Number.isFinite(value)) ? `${of.name}: no value` : `${of.name} ${inUnits(panel, values)}` };
        }),
    );
    const many = new Set(lines.map(({ person }) => person)).size > 2;
    const texts = many ? ["choose a person below for the numbers"] : lines.map(({ text }) => text);
    this.readout.replaceChildren(...[`${timeText(moment, this.unit, this.start)}:`, ...texts].map((text) => element("div", "", text)));
    return [this.name, ...texts];
  }

  /** Rows of a table of all that is drawn. */
  rows() {
    return this.panels.flatMap((panel) =>
      told(panel).flatMap((of) =>
        edges(of).flatMap((edge, side) =>
          edge.map((value, i) => [this.name, of.name + (side ? " (upper)" : ""), of.x[i], value, panel.unit]).filter(([, , , value]) => Number.isFinite(value)),
        ),
      ),
    );
  }
}

/** Figures that share their time, with the controls for it. @param {HTMLElement} group */
function connect(group) {
  const slider = /** @type {HTMLInputElement} */ (group.querySelector(".controls input"));
  const figures = /** @type {HTMLElement[]} */ ([...group.querySelectorAll(".plot")]);
  const plots = figures.map((figure) => new Plot(figure));
  const end = Math.max(...plots.map((plot) => plot.end));
  const unit = unitOfTime(end);
  const { start } = plots[0];
  let [from, to] = [0, end];
  slider.max = `${end}`;

  const moment = () => Number(slider.value);
  /** @param {(plot: Plot) => string[] | void} act */
  function each(act) {
    const words = plots.flatMap((plot) => act(plot) ?? []);
    slider.setAttribute("aria-valuetext", [timeText(moment(), unit, start), ...words].filter(Boolean).join(", "));
  }
  const draw = () => each((plot) => (plot.draw({ from, to, unit, start }, moment()), plot.tell(moment())));
  /** @param {number} [time] */
  function point(time) {
    if (time !== undefined) slider.value = `${Math.round(time)}`;
    each((plot) => plot.tell(moment()));
  }
  /** @param {number} start @param {number} stop */
  function show(start, stop) {
    const span = Math.min(end, Math.max(LEAST_SPAN_MIN, stop - start));
    from = Math.min(Math.max(0, start), end - span);
    to = from + span;
    draw();
  }
  const zoom = (/** @type {number} */ factor) => {
    const span = (to - from) * factor;
    const middle = moment() >= from && moment() <= to ? moment() : (from + to) / 2;
    show(middle - span / 2, middle + span / 2);
  };
  function save() {
    const rounded = (/** @type {string | number} */ of) => (typeof of === "number" ? Number(of.toFixed(4)) : of);
    const rows = plots.flatMap((plot) => plot.rows()).map((row) => row.map(rounded));
    const text = csvText([["plot", "curve", "t_min", "value", "unit"], ...rows]);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.download = `${document.title.replace(/[^\w.-]+/g, "-")}.csv`;
    link.click();
    URL.revokeObjectURL(link.href);
  }
  /** @type {Record<string, () => void>} */
  const actions = { in: () => zoom(0.5), out: () => zoom(2), all: () => show(0, end), save };
  for (const button of /** @type {NodeListOf<HTMLElement>} */ (group.querySelectorAll(".controls button"))) {
    button.addEventListener("click", () => actions[button.dataset.does ?? ""]());
  }
  slider.addEventListener("input", () => point());
  for (const chart of plots.flatMap((plot) => [...plot.charts, ...plot.strips])) {
    let pressed = NaN;
    chart.svg.addEventListener("pointermove", (event) => point(chart.timeAt(event)));
    chart.svg.addEventListener("pointerdown", (event) => {
      pressed = event.pointerType === "mouse" ? chart.timeAt(event) : NaN;
      point(chart.timeAt(event));
    });
    chart.svg.addEventListener("pointerup", (event) => {
      const [start, stop] = [pressed, chart.timeAt(event)].sort((a, b) => a - b);
      if (stop - start > (to - from) / 50) show(start, stop);
      pressed = NaN;
    });
    chart.svg.addEventListener("dblclick", actions.all);
  }
  figures.forEach((figure, place) => {
    const buttons = /** @type {NodeListOf<HTMLElement>} */ ((figure.closest(".card") ?? figure).querySelectorAll("button[data-person]"));
    for (const button of buttons) {
      button.addEventListener("click", () => {
        const chosen = button.getAttribute("aria-pressed") !== "true";
        plots[place].person = chosen ? Number(button.dataset.person) : null;
        for (const other of buttons) other.setAttribute("aria-pressed", `${other === button && chosen}`);
        draw();
      });
    }
  });
  draw();
  return draw;
}

/** Draw everything, and answer. */
export function start() {
  document.documentElement.classList.add("live");
  for (const place of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".swatch[data-dash]"))) {
    const { colour, dash } = place.dataset;
    place.innerHTML = swatch(colour === undefined ? "var(--faint)" : colourOf(Number(colour)), dashOf(Number(dash)));
  }
  /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".spread")).forEach(spread);
  /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".cvga > .people")).forEach(grid);
  const draws = /** @type {HTMLElement[]} */ ([...document.querySelectorAll(".linked")]).map(connect);
  for (const box of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("input[data-run]"))) {
    box.addEventListener("change", () => {
      if (box.checked) hidden.delete(Number(box.dataset.run)); else hidden.add(Number(box.dataset.run));
      for (const draw of draws) draw();
    });
  }
}
