// @ts-check
/** The page: controls on one side, the picture of the loop on the other. */

import { load } from "../../native/targets/wasm/kernels.mjs";
import { draw } from "./chart.mjs";
import { Lab, summary } from "./loop.mjs";
import { checked, commandLine, fromHash, hash, toml, tuningOf, usual } from "./situation.mjs";
import { texts } from "./texts.mjs";

/** @typedef {import("./situation.mjs").Situation} Situation */
/** @typedef {import("./loop.mjs").Trace} Trace */
/** @typedef {{name: string, situation: Situation, trace: Trace}} Run */

const MOST_PINNED = 4;
const DURATIONS_MIN = [300, 600, 720, 1440];

const byId = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const select = (/** @type {string} */ id) => /** @type {HTMLSelectElement} */ (byId(id));
const guard = /** @type {HTMLInputElement} */ (byId("guard"));
const version = /** @type {HTMLMetaElement} */ (document.querySelector("meta[name=glucoloop-version]")).content;

/** @param {string} id of an element with compressed content in base64 */
async function unpacked(id) {
  const text = atob(byId(id).textContent ?? "");
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const [module, packed] = await Promise.all([unpacked("module"), unpacked("data")]);
/** @type {import("./situation.mjs").Data} */
const data = JSON.parse(new TextDecoder().decode(packed));
const lab = new Lab(await load(module, "float64"), data);

/** @type {Situation} */
let now = usual(data);
/** @type {Run} */
let run = { name: texts.now, situation: now, trace: lab.simulate(now) };
/** @type {Run[]} */
let pinned = [];
/** @type {Situation[]} */
const before = [];
let numbered = 0;
let drawn = 0;

/** @param {string} text @param {boolean} [refused] */
function say(text, refused = false) {
  const said = byId("said");
  said.textContent = text;
  said.classList.toggle("refused", refused);
}

/**
 * Take a situation, draw it at the next frame, and keep the earlier one for undo.
 * @param {Partial<Situation>} change
 * @param {{keep?: boolean}} [how]
 */
function change(change, { keep = true } = {}) {
  try {
    const next = checked({ ...now, ...change }, data);
    const trace = lab.simulate(next);
    if (keep) before.push(now);
    now = next;
    run = { name: texts.now, situation: now, trace };
    say(texts.ready);
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    say(texts.refused(error.message), true);
    return;
  }
  cancelAnimationFrame(drawn);
  drawn = requestAnimationFrame(show);
}

/** @param {number} value @param {number} digits */
const fixed = (value, digits) => value.toFixed(digits);

/** Show the run and its numbers, and put the situation into the link. */
function show() {
  draw({ glucose: byId("glucose"), insulin: byId("insulin") }, [run, ...pinned], data, tell);
  history.replaceState(null, "", hash(now, data, version));
  byId("command").textContent = commandLine(now, data);
  /** @type {HTMLButtonElement} */ (byId("undo")).disabled = before.length === 0;
  /** @type {HTMLButtonElement} */ (byId("pin")).disabled = pinned.length >= MOST_PINNED;
  byId("numbers").replaceChildren(...[run, ...pinned].map(row));
  const of = summary(run.trace);
  byId("told").textContent = texts.told({
    minimum: fixed(of.minimum_mg_dl, 0),
    peak: fixed(of.peak_mg_dl, 0),
    mean: fixed(of.mean_mg_dl, 0),
    inside: fixed(of.time_70_180_pct, 0),
    insulin: fixed(of.insulin_total_mU / 1000, 1),
  });
  csv();
}

/** @param {Run} of @param {number} place */
function row(of, place) {
  const told = summary(of.trace);
  const line = document.createElement("tr");
  const head = document.createElement("th");
  head.scope = "row";
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.borderColor = draw.colours()[place];
  swatch.style.borderTopStyle = place === 0 ? "solid" : "dashed";
  const guarded = of.situation.guard ? ", guarded" : "";
  head.append(swatch, `${of.name}: ${of.situation.controller}${guarded}`);
  line.append(head);
  for (const value of [
    fixed(told.mean_mg_dl, 1),
    fixed(told.minimum_mg_dl, 1),
    fixed(told.peak_mg_dl, 1),
    fixed(told.time_70_180_pct, 1),
    fixed(told.time_below_70_pct, 1),
    fixed(told.insulin_total_mU / 1000, 2),
  ]) {
    const cell = document.createElement("td");
    cell.textContent = value;
    line.append(cell);
  }
  const last = document.createElement("td");
  if (place > 0) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = texts.unpinShort;
    button.setAttribute("aria-label", texts.unpin(of.name));
    button.addEventListener("click", () => {
      pinned = pinned.filter((other) => other !== of);
      show();
      byId("pin").focus();
    });
    last.append(button);
  }
  line.append(last);
  return line;
}

/** @param {number | null} sample under the cursor */
function tell(sample) {
  const { trace } = run;
  byId("cursor").textContent =
    sample === null || sample >= trace.t_min.length
      ? ""
      : `${texts.at(
          trace.t_min[sample],
          fixed(trace.glucose_mg_dl[sample], 1),
          fixed(trace.reading_mg_dl[sample], 1),
          fixed(trace.insulin_mU_min[sample], 2),
        )} ${data.statuses[trace.status[sample]]}`;
}

function csv() {
  const { trace } = run;
  const names = /** @type {(keyof Trace)[]} */ (
    ["t_min", "glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min", "status"]
  );
  const lines = trace.t_min.map((_, i) => names.map((name) => trace[name][i]).join(","));
  const text = `${[names.join(","), ...lines].join("\n")}\n`;
  /** @type {HTMLAnchorElement} */ (byId("csv")).href = `data:text/csv;charset=utf-8,${encodeURIComponent(text)}`;
}

/**
 * A slider with a field for its number.
 * @param {string} id
 * @param {string} label
 * @param {{least: number, most: number, step: number}} range
 * @param {number} value
 * @param {(value: number) => void} changed
 */
function slider(id, label, { least, most, step }, value, changed) {
  const box = document.createElement("div");
  box.className = "slider";
  const title = document.createElement("label");
  title.htmlFor = id;
  title.textContent = label;
  const input = (/** @type {string} */ type) => {
    const made = document.createElement("input");
    Object.assign(made, { type, min: `${least}`, max: `${most}`, step: type === "range" ? `${step}` : "any" });
    made.value = `${value}`;
    return made;
  };
  const range = input("range");
  range.id = id;
  const number = input("number");
  number.setAttribute("aria-label", texts.numberOf(label));
  range.addEventListener("input", () => {
    number.value = range.value;
    changed(Number(range.value));
  });
  number.addEventListener("change", () => {
    range.value = number.value;
    changed(Number(number.value));
  });
  box.append(title, range, number);
  return box;
}

/** Make the controls that depend on the situation show it. */
function fill() {
  select("patient").value = now.patient;
  byId("patient-hint").textContent = data.summaries[now.patient];
  select("controller").value = now.controller;
  byId("controller-hint").textContent = data.controllers[now.controller].summary;
  select("seed").value = `${now.seed}`;
  guard.checked = now.guard;
  if (!DURATIONS_MIN.includes(now.duration_min)) option("duration", `${now.duration_min}`, texts.hours(now.duration_min));
  select("duration").value = `${now.duration_min}`;
  const tuning = tuningOf(now, data);
  byId("tuning").replaceChildren(
    ...Object.entries(data.controllers[now.controller].settings).map(([name, setting]) =>
      slider(`tuning-${name}`, setting.summary, setting, tuning[name], (value) =>
        change({ tuning: { ...now.tuning, [name]: value } }),
      ),
    ),
  );
  byId("sensor").replaceChildren(
    slider("noise", texts.noise, { least: 0, most: 20, step: 0.05 }, now.noise_variance, (noise_variance) =>
      change({ noise_variance }),
    ),
    slider("dead-time", texts.deadTime, { least: 0, most: 60, step: data.sample_time_min }, now.dead_time_min, (value) =>
      change({ dead_time_min: value }),
    ),
  );
  byId("meals").replaceChildren(...now.meals.map(mealRow));
}

/** @param {import("./situation.mjs").Meal} meal @param {number} place */
function mealRow(meal, place) {
  const box = document.createElement("div");
  box.className = "meal";
  const field = (/** @type {"t_min" | "carbs_g"} */ name, /** @type {string} */ text) => {
    const label = document.createElement("label");
    const input = document.createElement("input");
    Object.assign(input, { type: "number", min: "0", max: name === "t_min" ? `${now.duration_min - 1}` : "300", step: "5" });
    input.value = `${meal[name]}`;
    input.addEventListener("input", () => {
      if (input.value === "") return;
      meal[name] = Number(input.value);
      change({ meals: edited() });
    });
    label.append(text, input);
    return label;
  };
  const remove = document.createElement("button");
  remove.type = "button";
  remove.textContent = texts.remove;
  remove.setAttribute("aria-label", texts.removeMeal(place + 1));
  remove.addEventListener("click", () => {
    change({ meals: now.meals.filter((_, i) => i !== place) });
    fill();
    byId("add-meal").focus();
  });
  box.append(field("t_min", texts.mealTime(place + 1)), field("carbs_g", texts.mealSize(place + 1)), remove);
  return box;
}

/** The meals as their fields tell them now. */
function edited() {
  return [...document.querySelectorAll("#meals .meal")].map((box) => {
    const [t, g] = [...box.querySelectorAll("input")].map((input) => Number(input.value));
    return { t_min: t, carbs_g: g };
  });
}

/** @param {string} id @param {string} value @param {string} text */
function option(id, value, text) {
  const made = document.createElement("option");
  made.value = value;
  made.textContent = text;
  select(id).append(made);
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

/** The situation of the link, or the usual one where the link tells none. */
function open() {
  if (location.hash.length < 2) return say(texts.ready);
  try {
    const found = fromHash(location.hash, data);
    const lesson = texts.lessons.find(({ hash: link }) => link === location.hash);
    change(found.situation);
    if (lesson !== undefined) say(lesson.text);
    else if (found.version === null) say(texts.noVersion);
    else say(found.version === version ? texts.fromLink : texts.otherVersion(found.version, version));
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    change(usual(data));
    say(texts.refusedLink(error.message), true);
  }
}

for (const { title, hash: link, text } of texts.lessons) {
  const item = document.createElement("li");
  const anchor = document.createElement("a");
  anchor.href = link;
  anchor.textContent = title;
  item.append(anchor, `. ${text}`);
  byId("lessons").append(item);
}
for (const [name] of Object.entries(data.patients)) option("patient", name, name);
for (const name of Object.keys(data.controllers)) option("controller", name, name);
for (const minutes of DURATIONS_MIN) option("duration", `${minutes}`, texts.hours(minutes));
for (let seed = 0; seed < data.normals.length; seed++) option("seed", `${seed}`, `${seed}`);

select("patient").addEventListener("change", (event) => {
  change({ patient: /** @type {HTMLSelectElement} */ (event.target).value });
  fill();
});
select("controller").addEventListener("change", (event) => {
  change({ controller: /** @type {HTMLSelectElement} */ (event.target).value, tuning: {} });
  fill();
});
select("duration").addEventListener("change", (event) => {
  const duration_min = Number(/** @type {HTMLSelectElement} */ (event.target).value);
  change({ duration_min, meals: now.meals.filter((meal) => meal.t_min < duration_min) });
  fill();
});
select("seed").addEventListener("change", (event) =>
  change({ seed: Number(/** @type {HTMLSelectElement} */ (event.target).value) }),
);
guard.addEventListener("change", () => change({ guard: guard.checked }));
byId("controls").addEventListener("submit", (event) => event.preventDefault());
byId("usual").addEventListener("click", () => {
  change({ tuning: {} });
  fill();
});
byId("add-meal").addEventListener("click", () => {
  const last = now.meals.at(-1)?.t_min ?? 0;
  change({ meals: [...now.meals, { t_min: Math.min(last + 120, now.duration_min - 5), carbs_g: 40 }] });
  fill();
});
byId("pin").addEventListener("click", () => {
  numbered += 1;
  pinned = [...pinned, { ...run, name: texts.run(numbered) }];
  show();
});
byId("undo").addEventListener("click", () => {
  change(/** @type {Situation} */ (before.pop()), { keep: false });
  fill();
});
byId("reset").addEventListener("click", () => {
  change(usual(data));
  fill();
});
byId("copy-link").addEventListener("click", () => copy("link", location.href));
byId("copy-command").addEventListener("click", () => copy("command", commandLine(now, data)));
byId("copy-toml").addEventListener("click", () => copy("configuration", toml(now, data, version)));
// Noise changes the usual tuning, which the sliders then show.
byId("sensor").addEventListener("change", fill);
window.addEventListener("hashchange", () => {
  open();
  fill();
});
window.addEventListener("resize", show);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);

open();
fill();
show();
document.documentElement.dataset.ready = "true";
