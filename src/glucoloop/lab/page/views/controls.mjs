// @ts-check
/** The controls of the situation and of the units. */

import { button, byId, choices, element, input, say, select, setSlider, slider, tell } from "../dom.mjs";
import { familyOf, givesBoluses, patientId, tuningOf, usual, withPatient } from "../situation.mjs";
import { texts } from "../texts.mjs";
import { unitOf, UNITS, usualUnits } from "../units.mjs";
import { faultRows, faultsOffered } from "./faults.mjs";
import { sensorView } from "./sensor.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../situation.mjs").Situation} Situation */
/** @typedef {import("../situation.mjs").Meal} Meal */

const DURATIONS_MIN = [300, 600, 720, 1440];
/** Bounds of the time before eating at which meals are announced, and by which announcements are late, as people announce meals. */
const BEFORE_MIN = { least: 0, most: 60, step: 5 };
const LATE_MIN = { ...BEFORE_MIN, least: -60 };

/** @param {Session} session */
export function controlsView(session) {
  const { data } = session;
  const names = (/** @type {Record<string, unknown>} */ of) =>
    Object.keys(of).map((name) => /** @type {[string, string]} */ ([name, name]));
  choices(select("family"), names(data.families));
  choices(select("seed"), Array.from({ length: data.seeds }, (_, seed) => [`${seed}`, `${seed}`]));

  /** @param {Partial<Situation>} change @param {string} [by] */
  const change = (change, by) => {
    try {
      session.change(change, by);
      say(byId("lesson").hidden ? texts.ready : ""); // a lesson says itself what to do
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      say(texts.refused(error.message), true);
    }
  };
  /** @param {string} id @param {(value: string) => Partial<Situation>} changed */
  const chosen = (id, changed) => select(id).addEventListener("change", () => change(changed(select(id).value)));
  chosen("point", (point) => ({ patient: patientId(data.patients[session.situation.patient].family, point) }));
  select("family").addEventListener("change", () => {
    const family = select("family").value;
    const had = session.people !== null || session.person !== null;
    const { situation, reset } = withPatient(session.situation, family, undefined, data);
    change(situation);
    const { insulin } = usualUnits(data.families[family].route);
    const told = [texts.familyChosen(family, insulin.name, reset.map((part) => texts.resets[part]))];
    if (had) {
      session.crowd = null;
      session.follow(null);
      told.push(texts.peopleGone);
    }
    session.show({ insulin });
    say(told.join(" "));
  });
  // Who gives boluses needs to know of meals; to others the page tells nothing.
  chosen("controller", (controller) => {
    const next = { ...session.situation, controller, tuning: {} };
    return givesBoluses(next, data) ? { ...next, announce: true } : { ...next, announce: false, announce_before_min: 0, announced_late_min: 0 };
  });
  input("announce").addEventListener("change", () => change({ announce: input("announce").checked }));
  const before = slider("announce-before", texts.announceBefore, BEFORE_MIN, 0, (value) => change({ announce_before_min: value }, "announce-before"));
  const late = slider("announced-late", texts.announcedLate, LATE_MIN, 0, (value) => change({ announced_late_min: value }, "announced-late"));
  byId("announced-when").replaceChildren(before, late);
  chosen("seed", (seed) => ({ seed: Number(seed) }));
  chosen("duration", (value) => {
    const duration_min = Number(value);
    return { duration_min, meals: session.situation.meals.filter((meal) => meal.t_min < duration_min) };
  });
  input("guard").addEventListener("change", () => change({ guard: input("guard").checked }));
  byId("controls").addEventListener("submit", (event) => event.preventDefault());
  button("usual").addEventListener("click", () => change({ tuning: {} }));
  button("reset").addEventListener("click", () => {
    change(usual(data));
    session.show({ insulin: usualUnits(familyOf(session.situation, data).route).insulin });
  });
  button("add-meal").addEventListener("click", () => {
    const { meals, duration_min } = session.situation;
    change({ meals: [...meals, { t_min: Math.min((meals.at(-1)?.t_min ?? 0) + 120, duration_min - 5), carbs_g: 40 }] });
  });
  faultsOffered(session, change);
  for (const quantity of /** @type {("glucose" | "insulin")[]} */ (["glucose", "insulin"])) {
    const list = select(`${quantity}-unit`);
    choices(list, UNITS[quantity].map(({ name }) => [name, name]));
    list.addEventListener("change", () => session.show({ [quantity]: unitOf(quantity, list.value) }));
  }

  const showSensor = sensorView(session, change);
  /** The family and the controller whose choices and sliders are there. */
  let [shown, tuned] = ["", ""];
  /** The choices of the duration that are there. */
  let durations = "";
  return () => {
    const now = session.situation;
    const tuning = tuningOf(now, data);
    const { family, operating_point } = data.patients[now.patient];
    const of_family = familyOf(now, data);
    const { settings, summary } = of_family.controllers[now.controller];
    if (shown !== family) {
      [shown, tuned] = [family, ""];
      choices(select("point"), names(of_family.points));
      choices(select("controller"), names(of_family.controllers));
      limits(session, "guard_limits", change);
      limits(session, "pump_limits", change);
    }
    select("family").value = family;
    tell(byId("family-hint"), of_family.summary);
    select("point").value = operating_point;
    tell(byId("point-hint"), of_family.points[operating_point]);
    select("controller").value = now.controller;
    tell(byId("controller-hint"), summary);
    select("seed").value = `${now.seed}`;
    input("guard").checked = now.guard;
    input("announce").checked = now.announce;
    byId("announce-box").hidden = !givesBoluses(now, data) && !now.announce;
    byId("announced-when").hidden = !now.announce;
    setSlider(before, now.announce_before_min);
    setSlider(late, now.announced_late_min);
    const offered = [...new Set([...DURATIONS_MIN, now.duration_min])].sort((a, b) => a - b);
    if (durations !== `${offered}`) {
      durations = `${offered}`;
      choices(select("duration"), offered.map((of) => [`${of}`, texts.hours(of)]));
    }
    select("duration").value = `${now.duration_min}`;
    select("glucose-unit").value = session.units.glucose.name;
    select("insulin-unit").value = session.units.insulin.name;
    if (tuned !== now.controller) {
      tuned = now.controller;
      byId("tuning").replaceChildren(
        ...Object.entries(settings).map(([name, setting]) =>
          slider(`tuning-${name}`, setting.summary, setting, tuning[name], (value) =>
            change({ tuning: { ...session.situation.tuning, [name]: value } }, name),
          ),
        ),
      );
    }
    Object.keys(settings).forEach((name, i) => setSlider(byId("tuning").children[i], tuning[name]));
    showSensor();
    for (const of of /** @type {const} */ (["guard_limits", "pump_limits"])) {
      const boxes = byId(of.replace("_", "-")).children;
      Object.entries(of_family[of]).forEach(([name, { usual }], i) => setSlider(boxes[i], now[of][name] ?? usual));
    }
    byId("guard-box").hidden = !now.guard || Object.keys(of_family.guard_limits).length === 0;
    mealRows(session, change);
    faultRows(session, change);
  };
}

/** @typedef {(change: Partial<Situation>, by?: string) => void} Change */

/**
 * Sliders of the limits of the guard or of the pump; the usual value is not told in links.
 * @param {Session} session
 * @param {"guard_limits" | "pump_limits"} of
 * @param {Change} change
 */
function limits(session, of, change) {
  byId(of.replace("_", "-")).replaceChildren(
    ...Object.entries(familyOf(session.situation, session.data)[of]).map(([name, setting]) =>
      slider(`limit-${name}`, setting.summary, setting, setting.usual, (value) => {
        const { [name]: _, ...others } = session.situation[of];
        change({ [of]: value === setting.usual ? others : { ...others, [name]: value } }, name);
      }),
    ),
  );
}

/** @param {Session} session @param {Change} change */
function mealRows(session, change) {
  const place = byId("meals");
  const { meals, duration_min } = session.situation;
  while (place.childElementCount > meals.length) place.lastElementChild?.remove();
  while (place.childElementCount < meals.length) place.append(mealRow(session, change, place.childElementCount));
  meals.forEach((meal, i) => {
    const [t, g] = place.children[i].querySelectorAll("input");
    t.max = `${duration_min - 1}`;
    if (document.activeElement !== t) t.value = `${meal.t_min}`;
    if (document.activeElement !== g) g.value = `${meal.carbs_g}`;
  });
}

/** @param {Session} session @param {Change} change @param {number} place */
function mealRow(session, change, place) {
  const field = (/** @type {keyof Meal} */ name, /** @type {string} */ text, /** @type {string} */ max) => {
    const made = element("input", { type: "number", min: "0", max, step: "5" });
    // When the field is left: a time that is half typed would move the meal past another.
    made.addEventListener("change", () => {
      const meals = session.situation.meals.map((meal, i) => (i === place ? { ...meal, [name]: Number(made.value) } : meal));
      change({ meals });
    });
    return element("label", {}, text, made);
  };
  const remove = element("button", { type: "button", "aria-label": texts.removeMeal(place + 1) }, texts.remove);
  remove.addEventListener("click", () => {
    change({ meals: session.situation.meals.filter((_, i) => i !== place) });
    byId("add-meal").focus();
  });
  return element(
    "div",
    { class: "meal" },
    field("t_min", texts.mealTime(place + 1), "1439"),
    field("carbs_g", texts.mealSize(place + 1), "300"),
    remove,
  );
}
