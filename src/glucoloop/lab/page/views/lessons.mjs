// @ts-check
/** Lessons: links to situations, each with what to look at. */

import { byId, element } from "../dom.mjs";
import { texts } from "../texts.mjs";

export function lessonsView() {
  byId("lessons").replaceChildren(
    ...texts.lessons.map(({ title, hash, text }) => element("li", {}, element("a", { href: hash }, title), `. ${text}`)),
  );
}

/** The lesson of a link, if it is one. @param {string} hash */
export function lessonOf(hash) {
  return texts.lessons.find((lesson) => lesson.hash === hash);
}
