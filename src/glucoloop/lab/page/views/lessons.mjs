// @ts-check
/** Lessons and situations to begin with: links, the first with what to look at. */

import { byId, element } from "../dom.mjs";
import { fromLink } from "../links.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {{title: string, hash: string, text: string, beside?: {name: string, hash: string}, people?: number}} Lesson */

const link = (/** @type {{title: string, hash: string}} */ { title, hash }) => element("a", { href: hash }, title);

export function lessonsView() {
  byId("lessons").replaceChildren(...texts.lessons.map((lesson) => element("li", {}, link(lesson), `. ${lesson.text}`)));
  byId("presets").replaceChildren(...texts.presets.map((preset) => element("li", {}, link(preset))));
}

/** The lesson of a link, if it is one. @param {string} hash @returns {Lesson | undefined} */
export function lessonOf(hash) {
  return texts.lessons.find((lesson) => lesson.hash === hash);
}

/** Whether a link is one of those that the page offers, which need no version. @param {string} hash */
export function isOwn(hash) {
  return [...texts.lessons, ...texts.presets].some((own) => own.hash === hash);
}

/** Pin the run that a lesson sets beside its own, in place of all others. @param {Session} session @param {Lesson} lesson */
export function putBeside(session, { beside }) {
  if (beside === undefined) return;
  const { situation } = fromLink(beside.hash, session.data);
  session.pinned = [{ name: beside.name, situation, trace: session.lab.simulate(situation) }];
  session.changed();
}
