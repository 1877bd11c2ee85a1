// @ts-check
/** Numbers of the present run and of the pinned ones, and what the guard did. */

import { isDark } from "../chart.mjs";
import { button, byId, element } from "../dom.mjs";
import { summary } from "../loop.mjs";
import { colours, dashes, guardActs } from "../scene.mjs";
import { MOST_PINNED } from "../session.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../session.mjs").Run} Run */

/** @param {Session} session */
export function numbersView(session) {
  button("pin").addEventListener("click", () => session.pin());
  button("undo").addEventListener("click", () => session.undo());
  return () => {
    button("undo").disabled = session.before.length === 0;
    button("pin").disabled = session.pinned.length >= MOST_PINNED;
    const glucose = session.units.glucose.name;
    byId("number-names").replaceChildren(
      ...texts.columns(glucose).map((name) => {
        const [what, unit] = name.split("\n");
        return element("th", { scope: "col" }, what, ...(unit ? [element("br"), unit] : []));
      }),
    );
    byId("numbers").replaceChildren(...session.runs.map((run, place) => row(session, run, place)));
    acts(session);
  };
}

/** @param {Session} session @param {Run} run @param {number} place */
function row(session, run, place) {
  const told = summary(run.trace);
  const { glucose } = session.units;
  const swatch = element("span", { class: "swatch" });
  swatch.style.borderColor = colours(isDark())[place];
  swatch.style.borderTopStyle = dashes(place).length ? "dashed" : "solid";
  const of = run.situation;
  const name = of === null ? run.name : texts.runOf(run.name, of.controller, of.guard);
  const values = [
    shown(told.mean_mg_dl, glucose),
    shown(told.minimum_mg_dl, glucose),
    shown(told.peak_mg_dl, glucose),
    told.time_70_180_pct.toFixed(1),
    told.time_below_70_pct.toFixed(1),
    (told.insulin_total_mU / 1000).toFixed(2),
  ];
  const last = element("td");
  if (place > 0) {
    const unpin = element("button", { type: "button", "aria-label": texts.unpin(run.name) }, texts.unpinShort);
    unpin.addEventListener("click", () => {
      session.unpin(run);
      byId("pin").focus();
    });
    last.append(unpin);
  }
  const cells = values.map((value) => element("td", {}, value));
  return element("tr", {}, element("th", { scope: "row" }, swatch, name), ...cells, last);
}

/** @param {Session} session */
function acts(session) {
  const { data, run, situation } = session;
  const found = guardActs(run.trace, data.sample_time_min);
  byId("acts-box").hidden = !situation.guard;
  const statuses = [...new Set(found.map(({ status }) => status))];
  const lines = statuses.map((status) => {
    const of = found.filter((act) => act.status === status);
    const total = of.reduce((sum, { from, to }) => sum + to - from, 0);
    return element("li", {}, texts.acts(data.statuses[status], total, of));
  });
  byId("acts").replaceChildren(...(lines.length ? lines : [element("li", {}, texts.noActs)]));
}
