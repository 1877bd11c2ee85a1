// @ts-check
/** Results that glucoloop wrote, dropped on the page or chosen: a run beside its situation, or the people of a trial. */

import { fromPage, fromToml, fromTrace } from "../configuration.mjs";
import { button, byId, element, input, say } from "../dom.mjs";
import { situationOf } from "../keys.mjs";
import { texts } from "../texts.mjs";
import { shown } from "../units.mjs";

/** @typedef {import("../session.mjs").Session} Session */
/** @typedef {import("../configuration.mjs").Keys} Keys */
/** @typedef {import("../configuration.mjs").Percentiles} Percentiles */

/** @param {Session} session */
export function folderView(session) {
  const load = async (/** @type {File[]} */ files) => {
    try {
      await loadFiles(session, files);
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      say(texts.notLoaded(error.message), true);
    }
  };
  input("load").addEventListener("change", () => load([...(input("load").files ?? [])]));
  button("load-clear").addEventListener("click", () => {
    session.crowd = null;
    byId("loaded-cases").replaceChildren();
    for (const run of session.pinned.filter(({ situation }) => situation === null)) session.unpin(run);
    session.changed();
  });
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", async (event) => {
    event.preventDefault();
    load(await dropped(event.dataTransfer));
  });
}

/** Files that were dropped, and those in a folder that was. @param {DataTransfer | null} transfer @returns {Promise<File[]>} */
async function dropped(transfer) {
  const entries = [...(transfer?.items ?? [])].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const files = [];
  for (const entry of entries) {
    const inside = entry.isDirectory ? await listed(/** @type {FileSystemDirectoryEntry} */ (entry)) : [entry];
    for (const one of inside) {
      if (one.isFile) files.push(await new Promise((resolve, reject) => /** @type {FileSystemFileEntry} */ (one).file(resolve, reject)));
    }
  }
  return /** @type {File[]} */ (files);
}

/** @param {FileSystemDirectoryEntry} folder @returns {Promise<FileSystemEntry[]>} */
async function listed(folder) {
  const reader = folder.createReader();
  const found = [];
  for (;;) {
    /** @type {FileSystemEntry[]} */
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) return found;
    found.push(...some);
  }
}

/** @param {Session} session @param {File[]} files */
async function loadFiles(session, files) {
  const named = (/** @type {string} */ ending) => files.find(({ name }) => name.endsWith(ending));
  const trace = named("trace.csv");
  const page = named("report.html") ?? named(".html");
  if (trace !== undefined) {
    const configuration = named(".toml");
    return loadRun(session, await trace.text(), configuration && (await configuration.text()));
  }
  if (page === undefined) throw new RangeError(named(".parquet") === undefined ? texts.nothingToLoad : texts.parquet);
  // Only its numbers are read; its styles would be reported as violations of the policy of this page.
  const text = (await page.text()).replace(/<(?:style)\b[\s\S]*?<\/(?:style)>|\s(?:style)="[^"]*"/g, "");
  const { glucose, keys } = fromPage(new DOMParser().parseFromString(text, "text/html"));
  if (glucose.length === 0) throw new RangeError(texts.nothingToLoad);
  const show = (/** @type {number} */ place) => loadPeople(session, glucose[place], keys, place);
  const others = glucose.map(({ name }, place) => {
    const choose = element("button", { type: "button" }, name);
    choose.addEventListener("click", () => show(place));
    return choose;
  });
  byId("loaded-cases").replaceChildren(...(others.length > 1 ? others : []));
  show(0);
}

/** @param {Session} session @param {string} table @param {string} [configuration] */
function loadRun(session, table, configuration) {
  const trace = fromTrace(table, session.data);
  const run = { name: texts.loaded, situation: null, trace };
  if (configuration === undefined) {
    session.pin(run);
    return say(texts.loadedAlone(texts.loaded, texts.noSituation));
  }
  try {
    const { situation, unlike } = situationOf(fromToml(configuration), session.data);
    session.change(situation);
    session.pin(run);
    const here = session.run.trace.glucose_mg_dl;
    const difference = Math.max(...trace.glucose_mg_dl.map((value, k) => Math.abs(value - (here[k] ?? NaN))));
    const { glucose } = session.units;
    const told = texts.loadedRun(texts.loaded, shown(difference, glucose, glucose.digits + 2), glucose.name);
    say(unlike.length ? `${told} ${texts.unlike(unlike)}` : told);
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    session.pin(run);
    say(texts.loadedAlone(texts.loaded, error.message), true);
  }
}

/** @param {Session} session @param {Percentiles} people @param {Keys} keys @param {number} place of the controller */
function loadPeople(session, people, keys, place) {
  session.crowd = { percentiles: people, situation: null };
  try {
    const { situation, unlike } = situationOf({ ...keys, controller: [keys.controller].flat()[place] }, session.data);
    session.change(situation);
    const told = texts.loadedPeople(people.name);
    say(unlike.length ? `${told} ${texts.unlike(unlike)}` : told);
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    session.changed();
    say(texts.loadedAlone(people.name, error.message), true);
  }
}
