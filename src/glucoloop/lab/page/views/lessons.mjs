// @ts-check
/** Lessons and situations to begin with: links, the first with what to look at. */

import { byId, element } from "../dom.mjs";
import { fromLink } from "../links.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {{title: string, hash: string, text: string, beside?: {name: string, hash: string}, people?: number}} Lesson */

const link = (/** @type {{title: string, hash: string}} */ { title, hash }) => element("a", { href: hash }, title);

export function lessonsView() {
  for (const of of /** @type {const} */ (["lessons", "presets"])) byId(of).replaceChildren(...texts[of].map((one) => element("li", {}, link(one))));
  byId("close-lesson").addEventListener("click", () => tellLesson(undefined));
}

/** The lesson or the situation to begin with of a link, if it is one. @param {string} hash @returns {Lesson | undefined} */
export function lessonOf(hash) {
  return [...texts.lessons, ...texts.presets].find((lesson) => lesson.hash === hash);
}

/** Show what to look at above the picture, until another lesson is begun. @param {Lesson | undefined} lesson */
export function tellLesson(lesson) {
  byId("lesson").hidden = lesson === undefined;
  for (const own of document.querySelectorAll("#lessons a, #presets a")) {
    if (own.getAttribute("href") === lesson?.hash) own.setAttribute("aria-current", "true");
    else own.removeAttribute("aria-current");
  }
  if (lesson === undefined) return;
  byId("lesson-title").textContent = lesson.title;
  byId("lesson-text").textContent = lesson.text;
  const place = texts.lessons.findIndex(({ hash }) => hash === lesson.hash);
  const next = place < 0 ? undefined : texts.lessons[place + 1];
  const after = byId("next-lesson");
  after.hidden = next === undefined;
  byId("lesson").scrollIntoView({ block: "nearest" });
  if (next === undefined) return;
  after.setAttribute("href", next.hash);
  after.textContent = texts.nextLesson(next.title);
}

/** Pin the run that a lesson sets beside its own, in place of all others. @param {Session} session @param {Lesson} lesson */
export function putBeside(session, { beside }) {
  session.pinned = [];
  if (beside === undefined) return session.changed();
  const { situation } = fromLink(beside.hash, session.data);
  session.pinned = [{ name: beside.name, situation, trace: session.lab.simulate(situation) }];
  session.changed();
}
