// @ts-check
/** The faults of sensor and pump, each with its times and settings. */

import { button, byId, choices, element, select, slider } from "../dom.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../situation.mjs").Fault} Fault */
/** @typedef {import("./controls.mjs").Change} Change */

const BEGINS_MIN = 120;
const LASTS_MIN = 60;

/** Fill the list of faults that the page has. @param {Session} session @param {Change} change */
export function faultsOffered(session, change) {
  const known = Object.entries(session.data.faults);
  byId("faults-box").hidden = known.length === 0;
  choices(select("fault"), known.map(([name, { summary }]) => [name, `${name}: ${summary}`]));
  button("add-fault").addEventListener("click", () => {
    const { faults, duration_min } = session.situation;
    const begins = Math.min(BEGINS_MIN, duration_min - LASTS_MIN);
    const { timed } = session.data.faults[select("fault").value];
    const times = timed ? { start_min: Math.max(0, begins), duration_min: LASTS_MIN } : { start_min: 0, duration_min: null };
    change({ faults: [...faults, { name: select("fault").value, ...times, settings: {} }] });
  });
}

/** Show the faults; their controls are made again when there are others. @param {Session} session @param {Change} change */
export function faultRows(session, change) {
  const place = byId("faults");
  const { faults } = session.situation;
  const names = faults.map(({ name }) => name).join();
  if (place.dataset.names !== names) {
    place.dataset.names = names;
    place.replaceChildren(...faults.map((_, i) => faultRow(session, change, i)));
  }
  faults.forEach((fault, i) => {
    for (const field of place.children[i].querySelectorAll("input")) {
      if (field === document.activeElement) continue;
      const name = field.dataset.name ?? "";
      const value = name in fault ? fault[/** @type {keyof Fault} */ (name)] : fault.settings[name] ?? usualOf(session, fault, name);
      if (field.type === "checkbox") field.checked = Boolean(value);
      else field.value = value === null ? "" : `${Number(value)}`;
    }
  });
}

/** @param {Session} session @param {Fault} fault @param {string} name */
function usualOf(session, fault, name) {
  return session.data.faults[fault.name].settings[name]?.usual ?? null;
}

/** @param {Session} session @param {Change} change @param {number} place */
function faultRow(session, change, place) {
  const { name } = session.situation.faults[place];
  const { timed, settings, summary } = session.data.faults[name];
  /** @param {(fault: Fault) => Fault} how @param {string} [by] */
  const set = (how, by) =>
    change({ faults: session.situation.faults.map((fault, i) => (i === place ? how(fault) : fault)) }, by && `fault ${place} ${by}`);
  /** @param {"start_min" | "duration_min"} key @param {string} text */
  const time = (key, text) => {
    const made = element("input", { type: "number", min: "0", step: "5", "data-name": key });
    made.addEventListener("change", () =>
      set((fault) => ({ ...fault, [key]: key === "duration_min" && made.value === "" ? null : Number(made.value) })),
    );
    return element("label", {}, text, made);
  };
  const controls = Object.entries(settings).map(([key, setting]) => {
    const put = (/** @type {number | boolean} */ value) =>
      set((fault) => ({ ...fault, settings: { ...fault.settings, [key]: value } }), key);
    if (typeof setting.usual === "boolean") {
      const made = element("input", { type: "checkbox", "data-name": key });
      made.addEventListener("change", () => put(made.checked));
      return element("label", { class: "check" }, made, setting.summary);
    }
    const made = slider(`fault-${place}-${key}`, setting.summary, setting, setting.usual, put);
    for (const field of made.querySelectorAll("input")) field.dataset.name = key;
    return made;
  });
  const remove = element("button", { type: "button", "aria-label": texts.removeFault(place + 1) }, texts.remove);
  remove.addEventListener("click", () => {
    change({ faults: session.situation.faults.filter((_, i) => i !== place) });
    byId("add-fault").focus();
  });
  const times = timed ? [time("start_min", texts.faultStart), time("duration_min", texts.faultDuration)] : [];
  return element(
    "div",
    { class: "fault", role: "group", "aria-label": texts.fault(place + 1, name) },
    element("p", { class: "label" }, texts.fault(place + 1, name)),
    element("p", { class: "hint" }, summary),
    element("div", { class: "meal" }, ...times, remove),
    ...controls,
  );
}
