// @ts-check
/** Many people under one tuning: percentiles behind the picture, who is harmed, and the points of the challenge. */

import { Crowd, RULE } from "../crowd.mjs";
import { button, byId, choices, element, say, select } from "../dom.mjs";
import { LoopOfVector } from "../loop.mjs";
import { peopleOf } from "../people.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../crowd.mjs").Score} Score */
/** @typedef {import("../loop.mjs").Lab} Lab */
/** @typedef {import("../loop.mjs").Body} Body */
/** @typedef {import("../situation.mjs").Situation} Situation */

const COUNTS = [100, 1000];
const MOST_HARMED = 10;
const MOST_TRIED = 8;
/** Longest time for which the page does not answer. */
const SLICE_MS = 24;

/**
 * Simulate people in a situation, and let the page answer in between.
 * @param {Lab} lab of its own, since it is interrupted
 * @param {(first: number) => Body[]} people
 * @param {Situation} situation
 * @param {number} count
 * @param {(done: number) => boolean} progress says how many are done; false ends it
 * @returns {Promise<Crowd | null>} null if it was ended
 */
export async function simulated(lab, people, situation, count, progress) {
  const { data } = lab;
  const { lanes } = lab.kernels;
  const crowd = new Crowd(count, Math.round(situation.duration_min / data.sample_time_min), data.sample_time_min);
  const inside = data.inside_min.length;
  const later = new Float64Array(inside);
  const loop = new LoopOfVector(lab, situation);
  let last = performance.now();
  for (let first = 0; first < count; first += lanes) {
    const vector = people(first);
    const normals = vector.map((_, lane) => data.normals[(situation.seed + first + lane) % data.normals.length]);
    loop.run(
      vector,
      (k, happened) => {
        for (let lane = 0; lane < lanes && first + lane < count; lane++) {
          for (let i = 0; i < inside; i++) later[i] = happened.inside_mg_dl[i * lanes + lane];
          crowd.add(first + lane, k, happened.glucose_mg_dl[lane], later, happened.insulin_mU_min[lane]);
        }
      },
      normals,
    );
    if (performance.now() - last > SLICE_MS) {
      if (!progress(Math.min(first + lanes, count))) return null;
      await new Promise((resolve) => setTimeout(resolve));
      last = performance.now();
    }
  }
  return crowd;
}

/**
 * @param {Session} session
 * @param {Lab} lab of the people alone
 */
export function crowdView(session, lab) {
  const bar = /** @type {HTMLProgressElement} */ (byId("people-progress"));
  const people = peopleOf(lab);
  /** @type {{score: Score, name: string, situation: Situation}[]} */
  let tried = [];
  let asked = 0;
  choices(select("people-count"), COUNTS.map((count) => [`${count}`, `${count}`]));
  byId("people-columns").replaceChildren(...texts.triedColumns.map((name) => element("th", { scope: "col" }, name)));

  /** @param {number} count */
  async function tryOn(count) {
    const { situation } = session;
    const { operating_point } = session.data.people;
    if (situation.patient !== operating_point) return say(texts.refused(texts.peopleElsewhere(operating_point)), true);
    const own = ++asked;
    bar.hidden = false;
    bar.max = count;
    const crowd = await simulated(lab, people, situation, count, (done) => {
      bar.value = done;
      return own === asked;
    });
    if (crowd === null) return;
    bar.hidden = true;
    const score = crowd.score();
    const name = `${texts.tried(situation.controller, situation.guard, situation.tuning)}, ${texts.peopleOf(count)}`;
    tried = [...tried, { score, name, situation }].sort((a, b) => b.score.points - a.score.points).slice(0, MOST_TRIED);
    session.people = crowd.percentiles(texts.peopleOf(count));
    byId("people-points").textContent = texts.points(score, RULE);
    byId("people-tried").replaceChildren(...tried.map(row));
    byId("people-harmed").replaceChildren(...crowd.worst(MOST_HARMED).map((fate) => harmed(fate, situation)));
    byId("people-box").hidden = false;
    session.changed();
    say(texts.peopleTold(count, score.people_below_70, score.people_below_54));
  }

  /** @param {typeof tried[number]} of */
  function row({ score, name, situation }) {
    const take = element("button", { type: "button", "aria-label": texts.takeTuning(name) }, texts.take);
    take.addEventListener("click", () => session.change(situation));
    const values = [score.points, score.in_range_pct, score.below_70_pct, score.change_mU_min];
    const cells = values.map((value) => element("td", {}, value.toFixed(2)));
    return element("tr", {}, element("th", { scope: "row" }, name), ...cells, element("td", {}, take));
  }

  /** @param {import("../crowd.mjs").Fate} fate @param {Situation} situation in which it happened */
  function harmed(fate, situation) {
    const { glucose } = session.units;
    const follow = element("button", { type: "button" }, texts.harmed(fate, shown(fate.lowest_mg_dl, glucose), glucose.name));
    follow.addEventListener("click", () => {
      const { lanes } = lab.kernels;
      const first = fate.person - (fate.person % lanes);
      const seed = (situation.seed + fate.person) % session.data.normals.length;
      const trace = lab.simulate({ ...situation, seed }, undefined, people(first)[fate.person % lanes]);
      session.pin({ name: texts.person(fate.person), situation: null, trace });
    });
    return element("li", {}, follow);
  }

  button("people-try").addEventListener("click", () => tryOn(Number(select("people-count").value)));
  button("people-clear").addEventListener("click", () => {
    asked += 1;
    bar.hidden = true;
    byId("people-box").hidden = true;
    session.people = null;
    session.changed();
  });
  return tryOn;
}
