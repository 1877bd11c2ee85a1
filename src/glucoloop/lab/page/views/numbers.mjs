// @ts-check
/** Numbers of the present run and of the pinned ones, and what the guard did. */

import { colourOf } from "../../../pages/chart.mjs";
import { button, byId, element, tell } from "../dom.mjs";
import { summary } from "../summary.mjs";
import { dashes, guardActs } from "../scene.mjs";
import { MOST_PINNED } from "../session.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../session.mjs").Run} Run */

/** @param {Session} session */
export function numbersView(session) {
  button("pin").addEventListener("click", () => session.pin());
  button("undo").addEventListener("click", () => session.undo());
  /** Unit and other runs for which the rows were made. @type {unknown[]} */
  let shownOf = [];
  return () => {
    button("undo").disabled = session.before.length === 0;
    button("pin").disabled = session.pinned.length >= MOST_PINNED;
    const glucose = session.units.glucose.name;
    const { runs } = session;
    const now = [glucose, ...runs.slice(1)];
    // The rows stay as they are, but for the numbers of the present run, until a run comes or goes.
    if (now.length !== shownOf.length || now.some((of, i) => of !== shownOf[i])) {
      shownOf = now;
      byId("number-names").replaceChildren(
        ...texts.columns(glucose).map((name) => {
          const [what, unit] = name.split("\n");
          return element("th", { scope: "col" }, what, ...(unit ? [element("br"), unit] : []));
        }),
      );
      byId("numbers").replaceChildren(...runs.map((run, place) => row(session, run, place)));
    }
    const [name, ...cells] = byId("numbers").children[0].children;
    tell(/** @type {Element} */ (name.lastElementChild), nameOf(runs[0]));
    valuesOf(session, runs[0]).forEach((value, i) => tell(cells[i], value));
    acts(session);
  };
}

/** @param {Run} run */
function nameOf({ situation, name }) {
  return situation === null ? name : texts.runOf(name, situation.controller, situation.guard);
}

/** @param {Session} session @param {Run} run */
function valuesOf(session, run) {
  const told = summary(run.trace);
  const { glucose } = session.units;
  return [
    shown(told.mean_mg_dl, glucose),
    shown(told.minimum_mg_dl, glucose),
    shown(told.peak_mg_dl, glucose),
    told.time_70_180_pct.toFixed(1),
    told.time_below_70_pct.toFixed(1),
    (told.insulin_total_mU / 1000).toFixed(2),
  ];
}

/** @param {Session} session @param {Run} run @param {number} place */
function row(session, run, place) {
  const swatch = element("span", { class: "swatch" });
  swatch.style.borderColor = colourOf(place);
  swatch.style.borderTopStyle = dashes(place).length ? "dashed" : "solid";
  const last = element("td");
  if (place > 0) {
    const unpin = element("button", { type: "button", "aria-label": texts.unpin(run.name) }, texts.unpinShort);
    unpin.addEventListener("click", () => {
      session.unpin(run);
      byId("pin").focus();
    });
    last.append(unpin);
  }
  const cells = valuesOf(session, run).map((value) => element("td", {}, value));
  return element("tr", {}, element("th", { scope: "row" }, swatch, element("span", {}, nameOf(run))), ...cells, last);
}

/** @param {Session} session */
function acts(session) {
  const { data, run, situation } = session;
  byId("acts-box").hidden = !situation.guard;
  if (!situation.guard) return;
  const found = guardActs(run.trace, data.sample_time_min);
  const statuses = [...new Set(found.map(({ status }) => status))];
  const lines = statuses.map((status) => {
    const of = found.filter((act) => act.status === status);
    const total = of.reduce((sum, { from, to }) => sum + to - from, 0);
    return texts.acts(data.statuses[status], total, of);
  });
  const told = lines.length ? lines : [texts.noActs];
  const place = byId("acts");
  if (place.childElementCount === told.length) told.forEach((line, i) => tell(place.children[i], line));
  else place.replaceChildren(...told.map((line) => element("li", {}, line)));
}
