// @ts-check
/** The picture with the meals above it, which are dragged, and the moment that is explained. */

import { Chart } from "../../../pages/chart.mjs";
import { attribute, byId, element, input, say, tell } from "../dom.mjs";
import { summary } from "../summary.mjs";
import { scene } from "../scene.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../situation.mjs").Meal} Meal */

const MEAL_STEP_MIN = 5;
const MEAL_STEP_G = 5;
/** Pixels upward that add a gram to a dragged meal. */
const PX_PER_G = 2;
const NARROW_PX = 600;

/** @param {Session} session */
export function pictureView(session) {
  const charts = {
    glucose: new Chart(byId("glucose"), (width) => (width < NARROW_PX ? 180 : 320)),
    insulin: new Chart(byId("insulin"), (width) => (width < NARROW_PX ? 100 : 170)),
  };
  const moment = input("moment");
  const every = session.data.sample_time_min;
  /** The meals and the axis for which their marks are there. */
  let marked = "";
  moment.step = `${every}`;
  moment.addEventListener("input", () => session.explain(Number(moment.value) / every));

  for (const chart of Object.values(charts)) {
    const point = (/** @type {PointerEvent} */ event) => session.explain(Math.floor(chart.timeAt(event) / every));
    chart.svg.addEventListener("pointermove", point);
    chart.svg.addEventListener("pointerdown", point);
  }

  /** The picture with its axes and meals. */
  function draw() {
    const of = scene(session);
    for (const panel of /** @type {const} */ (["glucose", "insulin"])) {
      charts[panel].draw(of[panel], { from: 0, to: of.end, unit: "min" }, of.moment);
      tell(byId(`${panel}-title`), of[panel].title);
      tell(byId(`${panel}-legend`), of[panel].legend);
    }
    const last = (session.run.trace.t_min.length - 1) * every;
    attribute(moment, "max", `${last}`);
    if (Number(moment.value) !== (of.moment ?? 0)) moment.value = `${of.moment ?? 0}`;
    const { trace } = session.run;
    const k = session.moment ?? 0;
    const { glucose, insulin } = session.units;
    attribute(
      moment,
      "aria-valuetext",
      texts.moment(trace.t_min[k], shown(trace.glucose_mg_dl[k], glucose), glucose.name, shown(trace.insulin_mU_min[k], insulin), insulin.name),
    );
    const { left, width } = charts.glucose.inside;
    const { meals } = session.situation;
    const now = JSON.stringify([meals, session.end_min, left, width]);
    if (now === marked) return;
    marked = now;
    lane(session, charts.glucose.inside);
  }
  return { draw, tell: () => tell(byId("told"), told(session)) };
}

/** What the picture shows, in words. @param {Session} session */
function told(session) {
  const of = summary(session.run.trace);
  const { glucose } = session.units;
  const value = (/** @type {number} */ of) => shown(of, glucose, glucose.digits - 1);
  return texts.told({
    minimum: value(of.minimum_mg_dl),
    peak: value(of.peak_mg_dl),
    mean: value(of.mean_mg_dl),
    unit: glucose.name,
    inside: of.time_70_180_pct.toFixed(0),
    insulin: (of.insulin_total_mU / 1000).toFixed(1),
  });
}

/**
 * The meals above the picture, each a button that is dragged or moved by the arrow keys.
 * @param {Session} session
 * @param {{left: number, width: number}} inside
 */
function lane(session, { left, width }) {
  const place = byId("lane");
  const { meals } = session.situation;
  byId("no-meals").hidden = meals.length > 0;
  const end = session.end_min;
  while (place.childElementCount > meals.length) place.lastElementChild?.remove();
  while (place.childElementCount < meals.length) place.append(mark(session, place.childElementCount));
  meals.forEach((meal, i) => {
    const button = /** @type {HTMLButtonElement} */ (place.children[i]);
    button.style.left = `${left + (meal.t_min / end) * width}px`;
    tell(button, texts.grams(meal.carbs_g));
    attribute(button, "aria-label", texts.meal(i + 1, meal.carbs_g, meal.t_min));
  });
}

/** @param {Session} session @param {number} place of the meal among the meals */
function mark(session, place) {
  const button = element("button", { type: "button", class: "mark", "aria-describedby": "lane-help" });
  /** The meal that this button moves; its place changes when it passes another. */
  let own = place;
  /** @param {Meal} meal @param {string} by */
  const set = (meal, by) => {
    const meals = [...session.situation.meals];
    meals[own] = meal;
    try {
      session.change({ meals }, by);
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      say(texts.refused(error.message), true);
      return;
    }
    own = session.situation.meals.findIndex((other) => other.t_min === meal.t_min && other.carbs_g === meal.carbs_g);
  };
  const within = (/** @type {number} */ t, /** @type {number} */ g) => ({
    t_min: Math.min(Math.max(0, t), session.situation.duration_min - MEAL_STEP_MIN),
    carbs_g: Math.min(Math.max(MEAL_STEP_G, g), 300),
  });
  button.addEventListener("keydown", (event) => {
    own = place;
    const meal = session.situation.meals[own];
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (event.key === "Delete" || event.key === "Backspace") {
      session.change({ meals: session.situation.meals.filter((_, i) => i !== own) });
      byId("add-meal").focus();
    } else if (event.key in moves) {
      const [right, up] = moves[/** @type {keyof typeof moves} */ (event.key)];
      set(within(meal.t_min + right * MEAL_STEP_MIN, meal.carbs_g + up * MEAL_STEP_G), `meal ${place} by keys`);
      /** @type {HTMLElement} */ (byId("lane").children[own]).focus();
    } else return;
    event.preventDefault();
  });
  button.addEventListener("pointerdown", (event) => {
    own = place;
    const from = { ...session.situation.meals[own], x: event.clientX, y: event.clientY };
    const per_px = session.end_min / (byId("glucose").clientWidth || 1);
    const drag = `drag ${event.timeStamp}`;
    button.setPointerCapture(event.pointerId);
    const move = (/** @type {PointerEvent} */ to) => {
      const t = from.t_min + (to.clientX - from.x) * per_px;
      const g = from.carbs_g - (to.clientY - from.y) / PX_PER_G;
      set(within(MEAL_STEP_MIN * Math.round(t / MEAL_STEP_MIN), MEAL_STEP_G * Math.round(g / MEAL_STEP_G)), drag);
    };
    button.addEventListener("pointermove", move);
    button.addEventListener("lostpointercapture", () => button.removeEventListener("pointermove", move), { once: true });
  });
  return button;
}
