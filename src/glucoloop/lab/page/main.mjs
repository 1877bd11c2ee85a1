// @ts-check
/** The page: controls on one side, the picture of the loop on the other. */

import { load } from "../../native/targets/wasm/kernels.mjs";
import { fillTexts, say } from "./dom.mjs";
import { fromLink, link } from "./links.mjs";
import { Lab } from "./lab.mjs";
import { language } from "./language.mjs";
import { Many } from "./many.mjs";
import { Session } from "./session.mjs";
import { familyOf, usual } from "./situation.mjs";
import { dataInWords, texts, unknown } from "./texts.mjs";
import { controlsView } from "./views/controls.mjs";
import { crowdView } from "./views/challenge.mjs";
import { folderView } from "./views/folder.mjs";
import { lessonOf, lessonsView, putBeside, tellLesson } from "./views/lessons.mjs";
import { numbersView } from "./views/numbers.mjs";
import { pictureView } from "./views/picture.mjs";
import { shareView } from "./views/share.mjs";
import { whyView } from "./views/why.mjs";

/**
 * What start.js gives: the content of a part of the file, and a worker.
 * @type {{unpacked: (id: string) => Promise<Uint8Array>, worker: () => Worker}}
 */
const { unpacked, worker } = /** @type {any} */ (globalThis);
/** When the controls follow the picture. */
const LATER_MS = 60;
/** When the link does: browsers refuse more than a hundred changes of it in half a minute. */
const LINK_MS = 320;
/** When the workers are made, so that they are there when people are asked for. */
const WORKERS_MS = 1500;

export async function start() {
  document.documentElement.lang = language;
  fillTexts();
  const { content: version } = /** @type {HTMLMetaElement} */ (document.querySelector("meta[name=glucoloop-version]"));
  const [module, packed] = await Promise.all([unpacked("module").then((bytes) => WebAssembly.compile(/** @type {BufferSource} */ (bytes))), unpacked("data")]);
  /** @type {import("./situation.mjs").Data} */
  const data = dataInWords(new TextDecoder().decode(packed));
  if (unknown.length > 0) return say(texts.unknownTexts(unknown), true);
  const session = new Session(new Lab(await load(module, "float64"), data), data, version);
  const many = new Many({ module, data }, worker);
  const tryOnPeople = crowdView(session, many);
  lessonsView();
  folderView(session);
  /** What follows a control at the next frame, and what may come a moment later. */
  const picture = pictureView(session);
  const views = [picture.draw, whyView(session), numbersView(session)];
  const later = [controlsView(session), shareView(session, address), picture.tell];
  let waiting = 0;
  let resting = 0;
  let linking = 0;

  /** Show the run. */
  function show() {
    waiting = 0;
    for (const view of views) view();
    clearTimeout(resting);
    resting = setTimeout(showRest, LATER_MS);
  }

  function showRest() {
    for (const view of later) view();
    clearTimeout(linking);
    linking = setTimeout(address, LINK_MS - LATER_MS);
  }

  /** Put the situation into the link, which takes a browser longer than everything else. */
  function address() {
    history.replaceState(null, "", link(session, data, version));
    return location.href;
  }

  /** Take the situation of the link, or the usual one where the link tells none. */
  function open() {
    const own = location.hash.length < 2;
    const hash = own ? (data.open ?? "") : location.hash;
    if (hash.length < 2) return say(texts.ready);
    try {
      const found = fromLink(hash, data);
      const lesson = lessonOf(hash);
      const { route } = familyOf(session.situation, data);
      tellLesson(lesson);
      session.person = found.person;
      session.crowd = null;
      session.change(found.situation);
      if (lesson !== undefined) {
        putBeside(session, lesson);
        if (familyOf(found.situation, data).route !== route) session.show({ insulin: found.units.insulin });
        say("");
        if (lesson.people !== undefined) tryOnPeople(lesson.people);
        return;
      }
      session.show(found.units);
      const nobody = found.person !== null && session.following === null ? ` ${texts.nobody(found.person)}` : "";
      const left_out = (found.unlike.length ? ` ${texts.unlike(found.unlike)}` : "") + nobody;
      if (nobody) session.person = null;
      if (own) say(texts.ready + nobody);
      // a link that was written by hand has no version
      else say((found.version === null || found.version === version ? texts.fromLink : texts.otherVersion(found.version, version)) + left_out);
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      session.change(usual(data));
      say(texts.refusedLink(error.message), true);
    }
  }

  /** Show at the next frame, once for all changes until then. */
  function showSoon() {
    if (waiting === 0) waiting = requestAnimationFrame(show);
  }

  open();
  session.before.length = 0;
  show();
  session.onChange(showSoon);
  window.addEventListener("hashchange", open);
  window.addEventListener("resize", showSoon);
  // The picture comes first, the controls at the next opportunity.
  requestAnimationFrame(() => {
    performance.mark("first picture"); // as benchmarks/lab.mjs measures it
    setTimeout(() => {
      showRest();
      address();
      document.documentElement.dataset.ready = "true";
      setTimeout(() => many.begun(), WORKERS_MS);
    });
  });
}
