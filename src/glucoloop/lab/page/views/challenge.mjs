// @ts-check
/** Many people under one tuning: percentiles behind the picture, who is harmed, and the points of the challenge. */

import { RULE } from "../crowd.mjs";
import { button, byId, choices, element, say, select, tell } from "../dom.mjs";
import { peopleAround, peopleIn } from "../situation.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../crowd.mjs").Score} Score */
/** @typedef {import("../situation.mjs").Situation} Situation */

const COUNTS = [100, 1000, 10_000];
const MOST_HARMED = 10;
const MOST_TRIED = 8;

/**
 * @param {Session} session
 * @param {import("../many.mjs").Many} many
 */
export function crowdView(session, many) {
  const bar = /** @type {HTMLProgressElement} */ (byId("people-progress"));
  /** @type {{score: Score, name: string, situation: Situation}[]} */
  let tried = [];
  choices(select("people-count"), COUNTS.map((count) => [`${count}`, `${count}`]));
  byId("people-columns").replaceChildren(...texts.triedColumns.map((name) => element("th", { scope: "col" }, name)));

  /** Whom the page tries a tuning on, or that it has nobody of the present patient. */
  function hint() {
    const { people, patients } = session.data;
    const { patient, controller } = session.situation;
    if (peopleAround(patient, session.data) !== null && peopleIn(session.situation, session.data) === null) return texts.peopleNotUnder(controller);
    const around = peopleAround(patient, session.data);
    if (around !== null) return texts.peopleHere(patient, around.population);
    const { family } = patients[patient];
    return family in people ? texts.peopleElsewhere(people[family].patient) : texts.peopleNone(family, session.data.families[family].population.split(",")[0]);
  }

  /** @param {number} wanted */
  async function tryOn(wanted) {
    const { situation } = session;
    const people = peopleIn(situation, session.data);
    if (people === null) return say(texts.refused(hint()), true);
    const count = Math.min(wanted, people.count);
    bar.hidden = false;
    bar.max = count;
    bar.value = 0;
    const progress = (/** @type {number} */ done) => {
      bar.value = done;
    };
    const crowd = await many.simulate(situation, count, progress, session.lab);
    if (crowd === null) return;
    bar.hidden = true;
    const score = crowd.score();
    const { family } = session.data.patients[situation.patient];
    const name = texts.tried(situation, family, score.people);
    tried = [...tried, { score, name, situation }].sort((a, b) => b.score.points - a.score.points).slice(0, MOST_TRIED);
    session.crowd = { percentiles: crowd.percentiles(texts.peopleOf(score.people)), situation };
    byId("people-points").textContent = texts.points(score, RULE);
    byId("people-tried").replaceChildren(...tried.map(row));
    byId("people-harmed").replaceChildren(...crowd.worst(MOST_HARMED).map(harmed));
    byId("people-box").hidden = false;
    session.changed();
    const told = texts.peopleTold(score, count);
    say(many.working ? told : `${told} ${texts.noWorkers}`);
  }

  /** @param {typeof tried[number]} of */
  function row({ score, name, situation }) {
    const take = element("button", { type: "button", "aria-label": texts.takeTuning(name) }, texts.take);
    take.addEventListener("click", () => session.change(situation));
    const values = [score.points, score.in_range_pct, score.below_70_pct, score.change_mU_min];
    const cells = values.map((value) => element("td", {}, value.toFixed(2)));
    return element("tr", {}, element("th", { scope: "row" }, name), ...cells, element("td", {}, take));
  }

  /** @param {import("../crowd.mjs").Fate} fate */
  function harmed(fate) {
    const { glucose } = session.units;
    const follow = element("button", { type: "button" }, texts.harmed(fate, shown(fate.lowest_mg_dl, glucose), glucose.name));
    follow.addEventListener("click", () => session.follow(fate.person));
    return element("li", {}, follow);
  }

  button("people-try").addEventListener("click", () => tryOn(Number(select("people-count").value)));
  button("people-clear").addEventListener("click", () => {
    many.stop();
    bar.hidden = true;
    byId("people-box").hidden = true;
    session.crowd = null;
    session.changed();
  });
  let { patient } = session.situation;
  session.onChange(() => {
    if (patient === session.situation.patient) return;
    ({ patient } = session.situation);
    tell(byId("people-hint"), hint());
  });
  tell(byId("people-hint"), hint());
  return tryOn;
}
