// @ts-check
/** Lessons and situations to begin with: links, the first with what to look at. */

import { byId, element } from "../dom.mjs";
import { fromLink } from "../links.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {{title: string, hash: string, text: string, beside?: {name: string, hash: string}, people?: number}} Lesson */

/** A link to another situation of this page, which is not one to a part of it: so it has the name of the page's file. */
const link = (/** @type {{title: string, hash: string}} */ { title, hash }) =>
  element("a", { href: `./${location.pathname.split("/").at(-1)}${hash}` }, title);

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
  for (const own of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll("#lessons a, #presets a"))) {
    if (own.hash === lesson?.hash) {
      own.setAttribute("aria-current", "true");
      bringIntoRow(own);
    } else own.removeAttribute("aria-current");
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

/** Bring a chosen lesson into the middle of its row, which a narrow screen does not show whole. @param {Element} own */
function bringIntoRow(own) {
  const row = byId("lessons");
  if (!row.contains(own)) return;
  const [of_row, of_own] = [row, own].map((element) => element.getBoundingClientRect());
  row.scrollLeft += of_own.left + of_own.width / 2 - (of_row.left + of_row.width / 2);
}

/** Pin the run that a lesson sets beside its own, in place of all others. @param {Session} session @param {Lesson} lesson */
export function putBeside(session, { beside }) {
  session.pinned = [];
  if (beside === undefined) return session.changed();
  const { situation } = fromLink(beside.hash, session.data);
  session.pinned = [{ name: beside.name, situation, trace: session.lab.simulate(situation) }];
  session.changed();
}
