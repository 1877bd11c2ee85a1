// @ts-check
/** What the picture shows, in the units of the screen: two panels over one axis of time, on the screen and in a file. */

import { colourOf } from "../../pages/chart.mjs";
import { summary } from "./summary.mjs";
import { limitsOf } from "./situation.mjs";
import { texts } from "./texts.mjs";
import { inUnits, shown } from "./units.mjs";

/** @typedef {import("./session.mjs").Session} Session */
/** @typedef {import("../../pages/chart.mjs").Span} Span */
/** @typedef {import("../../pages/chart.mjs").Panel & {title: string, legend: string}} Panel */

/**
 * @typedef {object} Scene
 * @property {number} end in min
 * @property {number | null} moment time that is explained
 * @property {Panel} glucose
 * @property {Panel} insulin
 */

const LOW = 70;
const HIGH = 180;
/** The least range of the axis, so that small changes are seen and not taken for large ones. */
const SHOWN = [60, 130];
const MARGIN = 5;
/** Statuses by which a guard says that it acted. */
const GUARD = [5, 6, 7, 8, 9, 10];
/** Boluses from this one on are told above the insulin; smaller ones, as some controllers give them at each sample, are in its curve. */
const TOLD_BOLUS_MU = 500;
/** Dashes of a run: the present one is solid. @param {number} place */
export function dashes(place) {
  return place === 0 ? [] : [3 + 3 * place, 4];
}

/** Values in another unit; those that are in it already stay the same list. @param {number[]} values @param {number} factor */
const scaled = (values, factor) => (factor === 1 ? values : values.map((value) => value * factor));

/**
 * Stretches of samples at which the guard acted, each with its reason.
 * @param {import("./lab.mjs").Trace} trace
 * @param {number} every
 * @returns {{from: number, to: number, status: number}[]}
 */
export function guardActs(trace, every) {
  /** @type {{from: number, to: number, status: number}[]} */
  const found = [];
  for (let k = 0; k < trace.status.length; k++) {
    const status = trace.status[k];
    if (!GUARD.includes(status)) continue;
    const last = found.at(-1);
    const t = trace.t_min[k];
    if (last !== undefined && last.status === status && last.to === t) last.to = t + every;
    else found.push({ from: t, to: t + every, status });
  }
  return found;
}

/**
 * Where the axis of insulin ends: at the pump's limit, or at a half, a quarter and so on of it that no rate exceeds.
 * @param {number} most largest rate
 * @param {number} limit
 */
function topOf(most, limit) {
  let top = limit;
  while (most > 0 && most <= top / 2) top /= 2;
  return top;
}

/**
 * Insulin as a rate, with the boluses that are too small to be told, which the pump gives until the next sample.
 * @param {import("./lab.mjs").Trace} trace
 * @param {number} every
 */
function withSmallBoluses({ insulin_mU_min, bolus_mU }, every) {
  if (!bolus_mU.some((bolus) => bolus > 0 && bolus < TOLD_BOLUS_MU)) return insulin_mU_min;
  return insulin_mU_min.map((rate, k) => (bolus_mU[k] < TOLD_BOLUS_MU ? rate + bolus_mU[k] / every : rate));
}

/** @param {Session} session @returns {Scene} */
export function scene(session) {
  const { data, runs, units } = session;
  const every = data.sample_time_min;
  const [{ trace }] = runs;
  const end = session.end_min;
  const glucose = (/** @type {number} */ value) => value * units.glucose.factor;
  const insulin = (/** @type {number} */ value) => value * units.insulin.factor;
  const level = (/** @type {number} */ value) => shown(value, units.glucose, units.glucose.digits - 1);
  const { max_mU_min } = limitsOf(session.situation, data);
  const line = (/** @type {number} */ place) => ({
    name: runs[place].name,
    colour: colourOf(place),
    width: place === 0 ? 2.2 : 1.6,
    dash: dashes(place),
  });

  // Readings without noise and dead time are the curve itself, which they would hide; some are missing.
  const own = [];
  for (let k = 0; k < trace.t_min.length; k++) {
    const reading = trace.reading_mg_dl[k];
    if (Number.isFinite(reading) && reading !== trace.glucose_mg_dl[k]) own.push(k);
  }
  let [least, most] = SHOWN;
  const reaches = (/** @type {number} */ value) => {
    least = Math.min(least, value);
    most = Math.max(most, value);
  };
  for (const { trace } of runs) {
    const { minimum_mg_dl, peak_mg_dl } = summary(trace);
    [minimum_mg_dl, peak_mg_dl].forEach(reaches);
  }
  for (const k of own) reaches(trace.reading_mg_dl[k]);

  const prediction = session.prediction;
  const expected = (/** @type {string} */ name, /** @type {number[]} */ values, /** @type {number[]} */ dash) => ({
    name,
    colour: colourOf(0),
    width: 1.4,
    dash,
    x: prediction?.t_min ?? [],
    y: values.map(glucose),
  });
  const rates = (/** @type {import("./lab.mjs").Trace} */ trace, /** @type {number[]} */ values) =>
    ({ x: trace.t_min, y: scaled(values, units.insulin.factor), until: trace.t_min.length * every });
  const delivered = runs.map(({ trace }) => withSmallBoluses(trace, every));
  const dosed = runs.flatMap(({ trace }, i) => [delivered[i], ...(trace === runs[0].trace ? [trace.command_mU_min] : [])]);
  const most_mU_min = Math.max(...dosed.map((rates) => Math.max(...rates)));
  const top = Math.max(topOf(most_mU_min, max_mU_min), most_mU_min);
  const boluses = trace.bolus_mU.flatMap((bolus, k) => (bolus >= TOLD_BOLUS_MU ? [/** @type {[number, string]} */ ([trace.t_min[k], `${inUnits(bolus)} U`])] : []));
  const differs = trace.command_mU_min.some((command, k) => command !== trace.insulin_mU_min[k]);
  const commanded = { name: texts.commanded, colour: colourOf(0), width: 1.1, dash: [2, 3], ...rates(trace, trace.command_mU_min) };
  const { people } = session;
  if (people !== null) {
    least = Math.min(least, ...people.levels[0]);
    most = Math.max(most, ...people.levels[4]);
  }
  const between = (/** @type {import("./configuration.mjs").Percentiles} */ of, /** @type {number} */ low, /** @type {number} */ high, /** @type {number} */ opacity) => ({
    name: of.name,
    x: of.t_min,
    low: of.levels[low].map(glucose),
    high: of.levels[high].map(glucose),
    colour: "var(--link)",
    opacity,
  });
  const median = (/** @type {import("./configuration.mjs").Percentiles} */ of) => ({
    name: texts.median(of.name),
    colour: colourOf(2),
    width: 1.6,
    dash: [],
    x: of.t_min,
    y: of.levels[2].map(glucose),
  });
  /** @param {"sensor" | "pump"} part @returns {Span[]} */
  const faulty = (part) =>
    session.situation.faults
      .filter(({ name }) => data.faults[name].part === part)
      .map(({ name, start_min, duration_min }) => ({
        from: start_min,
        to: duration_min === null ? session.situation.duration_min : start_min + duration_min,
        kind: "fault",
        text: texts.faultSpan(name),
      }));
  const acts = session.situation.guard ? guardActs(trace, every) : [];
  const legend = (/** @type {[boolean, string][]} */ parts) => parts.flatMap(([there, text]) => (there ? [text] : [])).join("; ");
  return {
    end,
    moment: session.moment === null ? null : session.moment * every,
    glucose: {
      title: texts.glucoseTitle(units.glucose.name),
      legend: legend([
        [true, texts.inBand(level(LOW), level(HIGH))],
        [own.length > 0, texts.dots],
        [faulty("sensor").length > 0, texts.shaded],
      ]),
      range: [glucose(Math.max(0, least < SHOWN[0] ? least - MARGIN : least)), glucose(most + MARGIN)],
      band: [glucose(LOW), glucose(HIGH)],
      rules: [],
      lines: [
        ...runs.map(({ trace }, i) => ({ ...line(i), x: trace.fine_t_min, y: scaled(trace.fine_glucose_mg_dl, units.glucose.factor) })),
        ...(people === null ? [] : [median(people)]),
        ...(prediction === null
          ? []
          : [expected(texts.ifKept, prediction.free_mg_dl, [2, 3]), expected(texts.ifDosed, prediction.dosed_mg_dl, [7, 3])]),
      ],
      dots: [{ x: own.map((k) => trace.t_min[k]), y: own.map((k) => glucose(trace.reading_mg_dl[k])), colour: "var(--faint)", opacity: 1 }],
      areas: [
        ...(people === null ? [] : [between(people, 0, 4, 0.14), between(people, 1, 3, 0.18)]),
        ...(prediction === null
          ? []
          : [{ name: texts.ifDosed, x: prediction.t_min, low: prediction.dosed_mg_dl.map(glucose), high: prediction.free_mg_dl.map(glucose), colour: "var(--link)", opacity: 0.14 }]),
      ],
      spans: faulty("sensor"),
    },
    insulin: {
      title: texts.insulinTitle(units.insulin.name),
      legend: legend([
        [true, (top >= max_mU_min ? texts.mostOf : texts.mostAbove)(shown(max_mU_min, units.insulin))],
        [boluses.length > 0, texts.boluses(`${TOLD_BOLUS_MU / 1000}`)],
        [differs, texts.dashes],
        [acts.length > 0, texts.marks],
        [faulty("pump").length > 0, texts.shaded],
      ]),
      range: [0, insulin(top * 1.05)],
      band: null,
      marks: boluses,
      rules: top >= max_mU_min ? [{ value: insulin(max_mU_min), dash: [2, 4] }] : [],
      lines: [
        ...runs.map(({ trace }, i) => ({ ...line(i), ...rates(trace, delivered[i]) })),
        ...(differs ? [commanded] : []),
      ],
      dots: [],
      areas: [],
      spans: [
        ...faulty("pump"),
        ...acts.map(({ from, to, status }) => ({ from, to, kind: /** @type {const} */ ("guard"), text: data.statuses[status] })),
      ],
    },
  };
}
