// @ts-check
// Plots answer: a moment of time tells its numbers, time can be zoomed, and what is drawn can be saved as a table.
// A path's own points are the data: times in tenths of a minute, values in the steps of its panel.
"use strict";
document.documentElement.classList.add("live");
const PER_MIN = 10;
const LEAST_SPAN = 30 * PER_MIN;

/**
 * Points of a path of lines, each from the one before; a new M begins after a gap.
 * @param {Element} path
 * @returns {{x: number, y: number, gap: boolean}[]}
 */
function pointsOf(path) {
  const points = [];
  for (const part of (path.getAttribute("d") ?? "").split("M").slice(1)) {
    const steps = (part.match(/-?\d+/g) ?? []).map(Number);
    let x = 0, y = 0;
    for (let i = 0; i < steps.length; i += 2) {
      x += steps[i];
      y += steps[i + 1];
      points.push({ x, y, gap: i === 0 });
    }
  }
  return points;
}

/**
 * Value at a time, on the line between the points around it.
 * @param {{x: number, y: number, gap: boolean}[]} points
 * @param {number} time
 */
function valueAt(points, time) {
  let low = 0, high = points.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle].x <= time) low = middle + 1; else high = middle;
  }
  const before = points[low - 1], after = points[low];
  if (!before) return NaN;
  if (!after || before.x === time) return before.x === time ? before.y : NaN;
  return after.gap ? NaN : before.y + ((after.y - before.y) * (time - before.x)) / (after.x - before.x);
}

/**
 * A drawn curve or band with its words.
 * @param {SVGElement} path
 */
function curveOf(path) {
  const panel = /** @type {HTMLElement} */ (path.closest(".panel"));
  const points = pointsOf(path);
  const half = points.length / 2;
  const { step = "1", unit = "", other = "", factor = "0", digits = "1" } = panel.dataset;
  /** @param {number} y */
  const told = (y) => (y * Number(step)).toFixed(Number(digits));
  /** @param {number} y */
  const also = (y) => (y * Number(step) * Number(factor)).toFixed(2);
  return {
    path, name: path.dataset.name ?? "", unit, step: Number(step),
    // a band goes there along its upper edge and back along its lower one
    edges: path.dataset.kind === "band" ? [points.slice(half).reverse(), points.slice(0, half)] : [points],
    /** @param {number} time */
    at(time) {
      const values = this.edges.map((edge) => valueAt(edge, time));
      if (values.some(Number.isNaN)) return `${this.name}: no value`;
      const second = other ? ` (${values.map(also).join(" – ")} ${other})` : "";
      return `${this.name} ${values.map(told).join(" – ")} ${unit}${second}`;
    },
  };
}

/**
 * Curves and bands of a panel as they are told: lines first, then bands from the inner one, which is drawn last.
 * @param {Element} panel
 */
function curvesOf(panel) {
  const curves = [...panel.querySelectorAll("path[data-name]")].map((path) => curveOf(/** @type {SVGElement} */ (path)));
  const isBand = (/** @type {ReturnType<typeof curveOf>} */ { edges }) => edges.length > 1;
  return [...curves.filter((curve) => !isBand(curve)), ...curves.filter(isBand).reverse()];
}

/** @param {number} span in units of the axis @param {boolean} minutes */
function tickOf(span, minutes) {
  const steps = minutes ? [1, 2, 5, 10, 20, 30, 60, 120, 180] : [0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 168, 336, 1008];
  return steps.find((step) => span / step <= 12) ?? steps[steps.length - 1] * 4;
}

/** Plots that share their time. @param {HTMLElement} group */
function connect(group) {
  const slider = /** @type {HTMLInputElement} */ (group.querySelector(".controls input"));
  const figures = [...group.querySelectorAll(".plot")].map((figure) => ({
    figure,
    curves: [...figure.querySelectorAll(".panel")].flatMap(curvesOf),
    readout: /** @type {HTMLElement} */ (figure.querySelector(".readout")),
  }));
  const divisor = Number(group.dataset.divisor), unit = group.dataset.unit ?? "min";
  const end = Number(group.dataset.end);
  let view = [0, end];

  /** @param {number} time */
  const told = (time) => `${Number((time / PER_MIN / divisor).toFixed(unit === "min" ? 0 : 2))} ${unit}`;
  /** @param {HTMLElement} mark */
  const place = (mark) => {
    const share = (Number(mark.dataset.t) - view[0]) / (view[1] - view[0]);
    mark.style.left = `${100 * share}%`;
    mark.hidden = share < -1e-6 || share > 1 + 1e-6;
  };
  const cursors = [...group.querySelectorAll(".field")].map((field) => {
    const cursor = document.createElement("i");
    cursor.className = "cursor";
    field.append(cursor);
    return cursor;
  });

  /** @param {number} time */
  function point(time) {
    slider.value = String(Math.round(time));
    for (const cursor of cursors) { cursor.dataset.t = slider.value; place(cursor); }
    const words = [];
    for (const { figure, curves, readout } of figures) {
      const shown = curves
        .filter(({ path }) => getComputedStyle(path).display !== "none" && !path.classList.contains("faded"));
      const people = new Set(shown.map(({ path }) => path.dataset.person));
      const lines = people.size > 2 ? ["choose a person below for the numbers"] : shown.map((curve) => curve.at(time));
      readout.replaceChildren(...[told(time) + ":", ...lines].map((line) => {
        const row = document.createElement("div");
        row.textContent = line;
        return row;
      }));
      words.push(figure.getAttribute("aria-label") ?? "", ...lines);
    }
    slider.setAttribute("aria-valuetext", [told(time), ...words].filter(Boolean).join(", "));
  }

  /** @param {number} from @param {number} to */
  function show(from, to) {
    const span = Math.min(end, Math.max(Math.min(LEAST_SPAN, end), to - from));
    const start = Math.min(Math.max(0, from), end - span);
    view = [start, start + span];
    for (const svg of group.querySelectorAll(".field > svg")) {
      const box = (svg.getAttribute("viewBox") ?? "").split(" ");
      svg.setAttribute("viewBox", `${start} ${box[1]} ${span} ${box[3]}`);
    }
    const scale = PER_MIN * divisor, tick = tickOf(span / scale, unit === "min");
    for (const times of group.querySelectorAll(".times > div")) {
      times.replaceChildren();
      for (let at = Math.ceil(start / scale / tick - 1e-9) * tick; at * scale <= view[1] + 1e-6; at += tick) {
        const label = document.createElement("span");
        label.textContent = String(Number(at.toFixed(2)));
        label.dataset.t = String(at * scale);
        times.append(label);
      }
    }
    group.querySelectorAll("[data-t]").forEach((mark) => place(/** @type {HTMLElement} */ (mark)));
  }

  /** @param {number} factor */
  const zoom = (factor) => {
    const span = (view[1] - view[0]) * factor, at = Number(slider.value);
    const middle = at >= view[0] && at <= view[1] ? at : (view[0] + view[1]) / 2;
    show(middle - span / 2, middle + span / 2);
  };
  /** @type {Record<string, () => void>} */
  const actions = {
    in: () => zoom(0.5), out: () => zoom(2), all: () => show(0, end),
    save: () => {
      const lines = [["plot", "curve", "t_min", "value", "unit"]];
      for (const { figure, curves } of figures)
        for (const curve of curves)
          curve.edges.forEach((edge, side) => edge.forEach(({ x, y }) => lines.push([
            figure.getAttribute("aria-label") ?? "", curve.name + (curve.edges.length > 1 ? ["", " (upper)"][side] : ""),
            String(x / PER_MIN), String(Number((y * curve.step).toFixed(4))), curve.unit])));
      const quoted = lines.map((line) => line.map((cell) => `"${cell.replaceAll('"', '""')}"`).join(",")).join("\n");
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([quoted + "\n"], { type: "text/csv" }));
      link.download = `${document.title.replace(/[^\w.-]+/g, "-")}.csv`;
      link.click();
      URL.revokeObjectURL(link.href);
    },
  };
  point(0);
  group.querySelectorAll(".controls button").forEach((button) =>
    button.addEventListener("click", () => actions[/** @type {HTMLElement} */ (button).dataset.does ?? ""]()));
  slider.addEventListener("input", () => point(Number(slider.value)));

  for (const field of /** @type {NodeListOf<HTMLElement>} */ (group.querySelectorAll(".field"))) {
    let pressed = NaN;
    /** @param {PointerEvent} event */
    const timeOf = (event) => {
      const box = field.getBoundingClientRect();
      const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
      return view[0] + share * (view[1] - view[0]);
    };
    field.addEventListener("pointermove", (event) => point(timeOf(event)));
    field.addEventListener("pointerdown", (event) => {
      pressed = event.pointerType === "mouse" ? timeOf(event) : NaN;
      point(timeOf(event));
    });
    field.addEventListener("pointerup", (event) => {
      const [from, to] = [pressed, timeOf(event)].sort((a, b) => a - b);
      if (to - from > (view[1] - view[0]) / 50) show(from, to);
      pressed = NaN;
    });
    field.addEventListener("dblclick", actions.all);
  }
}

document.querySelectorAll(".linked").forEach((group) => connect(/** @type {HTMLElement} */ (group)));

/** Tell the numbers of the moment again, since other curves are shown. @param {Element} part */
const tellAgain = (part) =>
  part.querySelectorAll(".controls input").forEach((slider) => slider.dispatchEvent(new Event("input")));

// A box in the legend shows or hides the curves of a run, and a button in a table singles out a person.
for (const box of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("input[data-run]")))
  box.addEventListener("change", () => {
    for (const drawn of /** @type {NodeListOf<SVGElement>} */ (document.querySelectorAll(`.${box.dataset.run}`)))
      drawn.style.display = box.checked ? "" : "none";
    tellAgain(document.body);
  });
for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("button[data-person]")))
  button.addEventListener("click", () => {
    const card = /** @type {Element} */ (button.closest(".card"));
    const chosen = button.getAttribute("aria-pressed") !== "true" ? button.dataset.person : undefined;
    for (const other of card.querySelectorAll("button[data-person]"))
      other.setAttribute("aria-pressed", String(other === button && chosen !== undefined));
    for (const drawn of card.querySelectorAll("path[data-person]"))
      drawn.classList.toggle("faded", chosen !== undefined && drawn.getAttribute("data-person") !== chosen);
    tellAgain(/** @type {Element} */ (card.closest(".linked")));
  });
