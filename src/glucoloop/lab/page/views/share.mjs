// @ts-check
/** What is taken from the page: a link, the same as a command, a file or a program, and the picture and its numbers. */

import { csvText } from "../../../pages/csv.mjs";
import { button, byId, say, select, tell } from "../dom.mjs";
import { commandForPeople, commandLine, python, toml } from "../repeat.mjs";
import { scene } from "../scene.mjs";
import { svg } from "../svg.mjs";
import { texts } from "../texts.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../lab.mjs").Trace} Trace */

const PNG_SCALE = 2;
const NAME = "glucoloop-lab";

/** @param {Session} session @param {() => string} address that of the page with the present situation */
export function shareView(session, address) {
  const texts_of = {
    command: () => commandLine(session.situation, session.data),
    people: () => commandForPeople(session.situation, session.data, Number(select("people-count").value)),
    toml: () => toml(session.situation, session.data, session.version),
    python: () => python(session.situation, session.data),
  };
  const form = () => /** @type {keyof typeof texts_of} */ (select("form").value);
  const picture = () => svg(scene(session), texts_of.command());
  const show = () => {
    tell(byId("same"), texts_of[form()]());
  };
  for (const id of ["form", "people-count"]) select(id).addEventListener("change", show);
  button("copy-same").addEventListener("click", () => copy(texts.forms[form()], texts_of[form()]()));
  button("copy-link").addEventListener("click", () => copy(texts.link, address()));
  button("save-csv").addEventListener("click", () => save("csv", new Blob([csv(session.run.trace)], { type: "text/csv" })));
  button("save-svg").addEventListener("click", () => save("svg", new Blob([picture()], { type: "image/svg+xml" })));
  button("save-png").addEventListener("click", async () => save("png", await png(picture())));
  return show;
}

/** @param {string} what @param {string} text */
async function copy(what, text) {
  try {
    await navigator.clipboard.writeText(text);
    say(texts.copied(what));
  } catch {
    say(texts.notCopied, true);
  }
}

/** @param {string} ending @param {Blob} content */
function save(ending, content) {
  const link = document.createElement("a");
  link.download = `${NAME}.${ending}`;
  link.href = URL.createObjectURL(content);
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  say(texts.saved(link.download));
}

/** Samples of a run as a table, in mg/dl and mU/min. @param {Trace} trace */
export function csv(trace) {
  const boluses = trace.bolus_mU.some((bolus) => bolus > 0) ? /** @type {const} */ (["bolus_mU"]) : [];
  const names = /** @type {const} */ (["t_min", "glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min", ...boluses, "status"]);
  return csvText([[...names], ...trace.t_min.map((_, i) => names.map((name) => trace[name][i]))]);
}

/** @param {string} picture in SVG @returns {Promise<Blob>} */
async function png(picture) {
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(picture)}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  canvas.width = image.width * PNG_SCALE;
  canvas.height = image.height * PNG_SCALE;
  /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")).drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob === null ? reject(new Error("no PNG was made")) : resolve(blob)), "image/png"),
  );
}
