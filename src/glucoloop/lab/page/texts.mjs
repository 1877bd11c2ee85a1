// @ts-check
/**
 * The page's texts in English, in one place, and those of another language in theirs; sentences on settings, patients and
 * statuses come with the data.
 */

import { own, sentences } from "./language.mjs";

const MOST_TIMES = 8;

const english = {
  /** Texts of the elements that name them in lab.html. */
  page: {
    picture: "Picture",
    loading: "Loading the simulator.",
    about: "Automatic insulin for a virtual patient with type 1 diabetes. Research software, not a medical device.",
    laneHelp: "Drag a meal to another time, or up and down to another size; or use the arrow keys, and Delete.",
    momentTitle: "Moment that is explained",
    results: "Numbers",
    numbersTitle: "Numbers of the runs",
    acts: "What the guard did",
    pin: "Pin this run",
    undo: "Undo",
    reset: "Begin again",
    copyLink: "Copy link",
    save: "Save",
    same: "The same as",
    copy: "Copy",
    formCommand: "command line",
    formPeople: "command line, for people",
    formToml: "configuration file (TOML)",
    formPython: "program in Python",
    people: "One tuning for many people",
    peopleCount: "People",
    peopleTry: "Try it on them",
    peopleProgress: "People who are done",
    peopleTried: "Tunings that were tried",
    peopleHarmed: "The lowest glucose of all: choose a person to follow",
    peopleClear: "Take the people away",
    situation: "Situation",
    lessons: "Lessons",
    presets: "Situations to begin with",
    lesson: "What to look at",
    closeLesson: "Close",
    noMeals: "No meals. Add one under Meals.",
    tools: "Tools",
    patient: "Patient",
    family: "Model of the patient",
    point: "Operating point",
    meals: "Meals",
    addMeal: "Add a meal",
    announce: "Meals are announced to the controller",
    duration: "Length of the run",
    controller: "Controller",
    usual: "Default tuning",
    guard: "Guard around the controller",
    guardLimits: "Limits of the guard",
    pumpLimits: "Limits of the pump",
    faults: "Faults",
    faultKind: "Kind of fault",
    addFault: "Add this fault",
    sensor: "Sensor",
    sensorKind: "Readings",
    seed: "Seed of the noise",
    load: "Load results",
    loadHelp: "Drop the folder of a run or of a trial anywhere on this page, or choose its files: trace.csv and run.toml of a run, report.html of a trial.",
    loadFiles: "Files of results",
    loadClear: "Take loaded results away",
    units: "Units",
    glucoseUnit: "Glucose",
    insulinUnit: "Insulin",
    remark: "The same definitions as the program, compiled to WebAssembly with portable arithmetic; this page asks the network nothing.",
  },
  ready: "Change anything; the picture follows at once.",
  unknownTexts: (/** @type {string[]} */ names) =>
    `The file of the language has what this page does not have: ${names.join("; ")}. Correct or delete it, and write the page again.`,
  fromLink: "This is the situation of the link.",
  otherVersion: (/** @type {string} */ there, /** @type {string} */ here) =>
    `The link was made by glucoloop ${there}, and this page is ${here}; numbers may differ.`,
  familyChosen: (/** @type {string} */ family, /** @type {string} */ unit, /** @type {string[]} */ reset) =>
    `The patient is ${family} now, for whom the controller was designed again; insulin is shown in ${unit}.` +
    (reset.length > 0 ? ` What was set for another patient has its default again: ${reset.join(", ")}.` : ""),
  resets: {
    controller: "the controller, which the page does not have for this patient",
    tuning: "the settings of the controller",
    guard_limits: "the limits of the guard",
    pump_limits: "the limits of the pump",
  },
  peopleGone: "The people are taken away, since they were drawn around the patient before.",
  refusedLink: (/** @type {string} */ why) => `The link was not used: ${why}. This is the default situation.`,
  refused: (/** @type {string} */ why) => `${why}. The picture is still that of the last possible situation.`,
  link: "link",
  forms: { command: "command", people: "command for people", toml: "configuration", python: "program" },
  copied: (/** @type {string} */ what) => `The ${what} was copied.`,
  notCopied: "The browser does not allow copying; mark the text and copy it by hand.",
  saved: (/** @type {string} */ name) => `${name} was saved.`,
  nextLesson: (/** @type {string} */ title) => `Next: ${title}`,
  /** Links to situations with what to look at; `beside` is a run that is pinned with it. */
  lessons: [
    {
      title: "What feedback can do",
      hash: "#controller=pid,+closed_loop_min=100",
      text: "A slow loop gives insulin late, and too long: glucose rises to 119 mg/dl and then falls to 64. Pin this run and make the time constant of the loop shorter: at 10 min neither happens.",
    },
    {
      title: "Horizon and weights",
      hash: "#controller=mpc,+prediction_horizon=20",
      text: "Pin this run, then predict 3 samples instead of 20: the controller acts earlier. A weight of 5 on the moves makes it slow, and lets glucose fall below 50 mg/dl. Move the slider below the picture to see what the controller expects at each sample.",
    },
    {
      title: "Dead time",
      hash: "#controller=mpc&sensor=dead-time,+minutes=10",
      text: "Readings come ten minutes late, and the controller does not know it: insulin and glucose swing. More weight on the moves calms insulin, at the price of a lower low.",
    },
    {
      title: "Occlusion and guard",
      hash: "#controller=mpc&guard=usual&faults=occlusion,+start_min=30,+duration_min=120",
      text: "For two hours no insulin passes the line, and nobody knows: glucose rises to 237 mg/dl either way. When the line is free again, MPC without a guard (dashed) brings it down to 63 mg/dl; under the guard, which bounds what is on board, it stays above 79.",
      beside: { name: "Without the guard", hash: "#controller=mpc&faults=occlusion,+start_min=30,+duration_min=120" },
    },
    {
      title: "One tuning, many people",
      hash: "#controller=mpc,+move_weight=0",
      text: "The tuning that keeps the nominal patient above 70 mg/dl is tried on 100 people: 35 of them come below. Follow one of those, named below the picture, then look for a tuning with more points.",
      people: 100,
    },
    {
      title: "The unannounced meal",
      hash: "#controller=pid,+closed_loop_min=60&meals=90g@60min",
      text: "The meal is not announced to the controller. It sees glucose rise, when much of the meal is on its way, and its insulin still works when the meal has ended: glucose falls to 53 mg/dl. MPC/SE, which knows how insulin acts, keeps it above 77; a guard around the PID keeps it above 70, and lets it rise to 121.",
    },
    {
      title: "What a monitor shows",
      hash: "#patient=hovorka-2004&controller=pid&sensor=dexcom-g6,+worn_min=1440&duration_min=720&meals=60g@60min",
      text: "The dots are what a continuous glucose monitor shows on its second day. With exact readings (dashed) the same controller keeps glucose above 87 mg/dl; with these it falls to 72. Switch parts of the monitor off, under Sensor. With the lag alone, which shows glucose ten minutes late, it falls to 80. With the noise alone it falls to 78: more than half of an error is still there a quarter of an hour later, so that the controller takes it for glucose, and moves insulin nine times as much. With the error of calibration alone, on this day, it falls to 86. MPC moves insulin less than half as much as PID, and keeps glucose above 79.",
      beside: { name: "Exact readings", hash: "#patient=hovorka-2004&controller=pid&duration_min=720&meals=60g@60min" },
    },
    {
      title: "Feedback alone is late",
      hash: "#patient=hovorka-2004&controller=profile-mpc&meals=60g@60min&sensor=dexcom-g6,+worn_min=1440&duration_min=720",
      text: "Subcutaneous insulin has its maximum effect after an hour, and acts for hours. This predictive controller knows that, and yet glucose rises above 240 mg/dl after an unannounced meal: when the readings rise, which lag behind, most of the meal is on its way. With the meal announced as eating begins (dashed), it gives a bolus at once, and glucose stays below 220. No tuning makes up for that: PID and MPC, which know less of the person, let glucose rise above 280.",
      beside: { name: "Announced meal", hash: "#patient=hovorka-2004&controller=profile-mpc&meals=60g@60min&announce_meals=true&sensor=dexcom-g6,+worn_min=1440&duration_min=720" },
    },
    {
      title: "A bolus before the meal",
      hash: "#patient=hovorka-2004&controller=basal-bolus&meals=60g@60min&announce_meals=true&announce_before_min=15&sensor=dexcom-g6,+worn_min=1440&duration_min=720",
      text: "Pump therapy: a constant basal rate, and a bolus by the carbohydrate ratio of the person, here 15 min before eating. Glucose rises to 194 mg/dl; with the bolus as eating begins (dashed) to 214. Move the bolus by the minutes under Meals: announced 0 min before eating and 20 min late, glucose rises to 240 mg/dl. If the controller is not told at all, it corrects high readings alone, and glucose rises to 290. Now choose profile-mpc: it is told that the meal is eaten in 15 min, and glucose rises to 172 mg/dl. Announced 0 min before eating and 15 min early, the meal is to its model one that is eaten at once, which the readings then do not show: 181.",
      beside: { name: "Bolus as eating begins", hash: "#patient=hovorka-2004&controller=basal-bolus&meals=60g@60min&announce_meals=true&sensor=dexcom-g6,+worn_min=1440&duration_min=720" },
    },
    {
      title: "What a guard costs",
      hash: "#patient=hovorka-2004&controller=basal-bolus&guard=usual&meals=120g@60min&announce_meals=true&announce_before_min=15&sensor=dexcom-g6,+worn_min=1440&duration_min=720",
      text: "A guard cannot know whether a meal that was announced is eaten, nor whether it was counted rightly. So it bounds the bolus for 120 g: 4 of 4.6 U pass, and glucose rises to 257 mg/dl, where it rises to 243 without a guard (dashed). A meal of 60 g passes whole, and costs nothing. Its limits are below Controller: try the largest dose in an hour.",
      beside: { name: "Without the guard", hash: "#patient=hovorka-2004&controller=basal-bolus&meals=120g@60min&announce_meals=true&announce_before_min=15&sensor=dexcom-g6,+worn_min=1440&duration_min=720" },
    },
  ],
  presets: [
    {
      title: "50 g of glucose, as in the paper",
      hash: "#controller=mpc",
      text: "The meal of Parker, Doyle and Peppas (1999): 50 g at 50 min, which nobody announces, and readings without noise.",
    },
    {
      title: "The same with a noisy sensor",
      hash: "#controller=mpc&sensor=white-noise,+variance=1.45",
      text: "The dots are the readings. With noise the default tuning is another, which moves insulin less.",
    },
    {
      title: "A tuning for readings without noise, with noise",
      hash: "#controller=mpc,+prediction_horizon=8,+output_weight=1,+move_weight=0&sensor=white-noise,+variance=1.45",
      text: "Moves cost nothing in this tuning, and so insulin follows the noise from sample to sample. Pin this run, and put weight on the moves.",
    },
    {
      title: "A day with three meals",
      hash: "#controller=mpc-se&sensor=white-noise,+variance=1.45&duration_min=1440&meals=45g@420min&meals=70g@720min&meals=60g@1080min",
      text: "Breakfast at 7, lunch at 12 and dinner at 18 hours, none of them announced. Drag a meal along the day, or up and down to change its size.",
    },
    {
      title: "A day with subcutaneous insulin",
      hash: "#patient=hovorka-2004&controller=mpc&guard=usual&sensor=white-noise,+variance=1.45&duration_min=1440&meals=45g@420min&meals=70g@720min&meals=60g@1080min",
      text: "Insulin that is given subcutaneously acts later and longer than intravenous insulin: what was given for a meal is still there when the meal has gone. The guard bounds it.",
    },
    {
      title: "A night without a meal",
      hash: "#controller=imc&sensor=white-noise,+variance=1.45&duration_min=720&meals=",
      text: "Nothing happens in these 12 hours, and yet insulin moves: the controller answers the noise of the readings. Make its filter slower, and it calms down.",
    },
    {
      title: "A large dinner under a guard",
      hash: "#controller=mpc-se&sensor=white-noise,+variance=1.45&guard=usual&meals=120g@60min",
      text: "120 g at 60 min. Orange marks above the insulin show where the guard gave less than the controller asked for; the list below the numbers says why.",
    },
    {
      title: "A sensor that sticks for two hours",
      hash: "#controller=mpc&guard=usual&faults=stuck,+start_min=90,+duration_min=120",
      text: "From 90 to 210 min the sensor repeats one reading, while a meal raises glucose. The guard takes readings that do not change for no readings, and gives at most the basal rate: glucose rises to 148 mg/dl, and does not fall below 78.",
    },
    {
      title: "Pressure on the sensor at night",
      hash: "#controller=mpc-se&guard=usual&sensor=white-noise,+variance=1.45&meals=&faults=compression,+start_min=200,+duration_min=60",
      text: "For an hour the patient lies on the sensor, and it reads too low. Insulin stops although glucose is not low: it rises to 119 mg/dl, and comes back without a low.",
    },
  ],
  now: "Now",
  run: (/** @type {number} */ number) => `Run ${number}`,
  runOf: (/** @type {string} */ name, /** @type {string} */ controller, /** @type {boolean} */ guarded) =>
    `${name}: ${controller}${guarded ? ", guarded" : ""}`,
  columns: (/** @type {string} */ glucose) => [
    "Run",
    `Mean\n${glucose}`,
    `Lowest\n${glucose}`,
    `Highest\n${glucose}`,
    "In range\n%",
    "Low\n%",
    "Insulin\nU",
    "Pinned",
  ],
  grams: (/** @type {number} */ carbs_g) => `${carbs_g} g`,
  meal: (/** @type {number} */ number, /** @type {number} */ carbs_g, /** @type {number} */ t_min) =>
    `Meal ${number}: ${carbs_g} g at ${t_min} min`,
  announceBefore: "Minutes before eating at which meals are announced; the controller is told so",
  announcedLate: "Minutes by which the announcements are late, which the controller is not told; below 0: early",
  mealTime: (/** @type {number} */ number) => `Meal ${number}, min`,
  mealSize: (/** @type {number} */ number) => `Meal ${number}, g`,
  removeMeal: (/** @type {number} */ number) => `Remove meal ${number}`,
  remove: "Remove",
  fault: (/** @type {number} */ number, /** @type {string} */ name) => `Fault ${number}: ${name}`,
  faultStart: "From, min",
  faultDuration: "For, min; nothing: to the end",
  removeFault: (/** @type {number} */ number) => `Remove fault ${number}`,
  faultSpan: (/** @type {string} */ name) => name,
  unpin: (/** @type {string} */ name) => `Unpin ${name}`,
  unpinShort: "Unpin",
  hours: (/** @type {number} */ minutes) => `${minutes / 60} h`,
  numberOf: (/** @type {string} */ name) => `${name}, as a number`,
  noMonitor: "exact, or with white noise",
  lag: (/** @type {number} */ minutes) => `Lag of the tissue behind blood, ${minutes} min`,
  /** @type {Record<string, string>} */
  parts: {
    noise: "Noise, which lasts from reading to reading",
    drift: "Error of calibration, which changes over the days of wear",
    display: "Display: whole mg/dl, from 40 to 400",
  },
  worn: "Worn before the start, min; nothing: drawn",
  noise: "Variance of the noise, (mg/dl)²",
  deadTime: "Dead time of the readings, min; the controller does not know it",
  pictureTitle: "Glucose and insulin of a simulated person",
  glucoseTitle: (/** @type {string} */ unit) => `Glucose, ${unit}`,
  insulinTitle: (/** @type {string} */ unit) => `Insulin, ${unit}`,
  inBand: (/** @type {string} */ low, /** @type {string} */ high) => `green band: ${low} to ${high}`,
  dots: "dots: readings",
  mostOf: (/** @type {string} */ most) => `dotted: maximum rate of the pump, ${most}`,
  mostAbove: (/** @type {string} */ value) => `maximum rate of the pump, ${value}, is above the range shown`,
  dashes: "fine dashes: commanded, not delivered",
  boluses: (/** @type {string} */ least) => `triangles: boluses of ${least} U or more; smaller ones are in the curve`,
  marks: "orange marks: the guard acted",
  shaded: "shaded: a fault",
  minutes: (/** @type {number} */ t) => `${t} min`,
  commanded: "Commanded",
  median: (/** @type {string} */ name) => `Median of people, ${name}`,
  peopleOf: (/** @type {number} */ count) => `${count} people`,
  person: (/** @type {number} */ number) => `Person ${number}`,
  nobody: (/** @type {number} */ number) => `Person ${number} is not followed: no rate holds the setpoint of that person.`,
  peopleHere: (/** @type {string} */ patient, /** @type {string} */ population) =>
    `The controller as it is now, on people around ${patient.replace("/", " at ")} as the population ${population} draws them. The challenge: find the tuning with the most points.`,
  peopleElsewhere: (/** @type {string} */ patient) =>
    `Of this family, the page draws people around ${patient.replace("/", " at ")} only; choose that operating point to try a tuning on them, or copy the command below that tries it on people around the present one`,
  peopleNone: (/** @type {string} */ family, /** @type {string} */ population) =>
    `The page draws nobody around ${family}; copy the command for people below, which tries the controller on people of the population ${population}`,
  peopleNotUnder: (/** @type {string} */ controller) =>
    `The page tries no people under ${controller}, whose model would be another one for each of them; copy the command for people below`,
  peopleTold: (/** @type {import("./crowd.mjs").Score} */ score, /** @type {number} */ drawn) =>
    (score.people < drawn ? `Left out of ${drawn}, since no rate holds their setpoint: ${drawn - score.people}. ` : "") +
    `Of ${score.people} people ${score.people_below_70} come below 70 mg/dl, and ${score.people_below_54} below 54. Half of the people lie within the darker band, 90 % within the lighter one; the green curve is their median.`,
  noWorkers: "This browser allows the page no workers, so that the people were simulated one after another.",
  points: (/** @type {import("./crowd.mjs").Score} */ score, /** @type {typeof import("./crowd.mjs").RULE} */ rule) =>
    `${score.points.toFixed(2)} points. The rule: the mean part of the time from 70 to 180 mg/dl, in % (${score.in_range_pct.toFixed(2)}), ` +
    `less ${rule.below_70_pct} times that below 70 (${score.below_70_pct.toFixed(2)}), ` +
    `less ${rule.change_mU_min} times the mean change of insulin from sample to sample, in mU/min (${score.change_mU_min.toFixed(2)}).`,
  triedColumns: ["Tuning", "Points", "In range %", "Low %", "Change mU/min", "Situation"],
  tried: (/** @type {import("./situation.mjs").Situation} */ { controller, guard, tuning }, /** @type {string} */ family, /** @type {number} */ count) =>
    [
      controller + (guard ? ", guarded" : ""),
      ...Object.entries(tuning).map(([name, value]) => `${name.replaceAll("_", " ")} ${value}`),
      `${texts.peopleOf(count)} of ${family}`,
    ].join(", "),
  take: "Take",
  takeTuning: (/** @type {string} */ name) => `Take the situation of ${name}`,
  harmed: (/** @type {import("./crowd.mjs").Fate} */ fate, /** @type {string} */ lowest, /** @type {string} */ unit) =>
    `Person ${fate.person}: lowest ${lowest} ${unit}, ${fate.below_70_pct.toFixed(1)} % low`,
  loadedRun: (/** @type {string} */ name, /** @type {string} */ difference, /** @type {string} */ unit) =>
    `${name} is drawn beside its situation, simulated here; at the samples, glucose differs by ${difference} ${unit} at most.`,
  loadedAlone: (/** @type {string} */ name, /** @type {string} */ why) => `${name} is drawn; it is not simulated here: ${why}.`,
  loadedPeople: (/** @type {string} */ name) =>
    `Behind the picture are the people of the trial under ${name}: half of them within the darker band, 90 % within the lighter one; ` +
    `the blue curve is the nominal person in the same situation.`,
  unlike: (/** @type {string[]} */ what) => `This page leaves out: ${what.join(", ")}.`,
  noSituation: "no configuration was given with it",
  nothingToLoad: "There is neither a trace.csv nor a page with percentiles among the files; give the folder of a run or of a trial",
  parquet:
    "This page does not read Parquet; give the whole folder of the trial, or its report.html, which has the percentiles of the people",
  notLoaded: (/** @type {string} */ why) => `Nothing was loaded: ${why}.`,
  loaded: "Loaded run",
  ifKept: "Expected without this dose",
  ifDosed: "Expected with this dose",
  expects: (/** @type {Record<string, string>} */ of) =>
    `Its model expects ${of.kept} ${of.glucose_unit} at ${of.t} min if insulin stayed at ${of.rate} ${of.insulin_unit} (dotted), ` +
    `and ${of.dosed} with the delivered rate (dashed); the setpoint is ${of.setpoint}.`,
  pidTerms: (/** @type {Record<string, string>} */ of) =>
    `The PID wants ${of.sum} ${of.unit}: ${of.i} that it has learned from all errors so far (I), ${of.p} for the error now (P) ` +
    `and ${of.d} for its change (D).`,
  imcTerms: (/** @type {Record<string, string>} */ of) =>
    `Its model explains ${of.model} ${of.glucose_unit} of the distance from the setpoint by the insulin that was given; it corrects the rest, ${of.rest}. ` +
    `After the filter that is ${of.filtered}, for which it wants ${of.wanted} ${of.unit}.`,
  moment: (
    /** @type {number} */ t,
    /** @type {string} */ glucose,
    /** @type {string} */ glucose_unit,
    /** @type {string} */ rate,
    /** @type {string} */ insulin_unit,
  ) => `${t} min: glucose ${glucose} ${glucose_unit}, insulin ${rate} ${insulin_unit}`,
  noMoment: "Point at the picture, or move the slider below it, to learn why a dose was given.",
  reading: (/** @type {string} */ value, /** @type {string} */ unit) => `reading ${value} ${unit}`,
  noReading: "no reading",
  bolus: (/** @type {string} */ units) => `, and a bolus of ${units} U`,
  at: (/** @type {Record<string, string>} */ of) =>
    `At ${of.t} min: glucose ${of.glucose} ${of.glucose_unit}, ${of.reading}; ` +
    `insulin commanded ${of.commanded}, delivered ${of.delivered} ${of.insulin_unit}${of.bolus}.`,
  acts: (/** @type {string} */ status, /** @type {number} */ total, /** @type {{from: number, to: number}[]} */ when) =>
    `${status} ${total} min: ${when.slice(0, MOST_TIMES).map(({ from, to }) => `${from} to ${to}`).join(", ")}` +
    (when.length > MOST_TIMES ? `, and ${when.length - MOST_TIMES} times more.` : "."),
  noActs: "The guard let every dose pass.",
  told: (/** @type {Record<string, string>} */ of) =>
    `Glucose goes from ${of.minimum} to ${of.peak} ${of.unit}, with a mean of ${of.mean}; ${of.inside} % of the time it is ` +
    `in the band. ${of.insulin} U of insulin are delivered.`,
};

/** Texts and sentences of the language that the page does not have. @type {string[]} */
export const unknown = [];

export const texts = /** @type {typeof english} */ (inPlace(english, own, ""));

/** Some texts with others in the place of those of the same name and form. @param {any} there @param {any} others @param {string} within */
function inPlace(there, others, within) {
  const found = Array.isArray(there) ? [...there] : { ...there };
  for (const [name, text] of Object.entries(others)) {
    const now = there[name];
    if (typeof text !== typeof now || Array.isArray(text) !== Array.isArray(now)) unknown.push(within + name);
    else found[name] = typeof text === "object" ? inPlace(now, text, `${within}${name}.`) : text;
  }
  return found;
}

/** The page's data from their text, with their sentences in the page's language. @param {string} text @returns {any} */
export function dataInWords(text) {
  const left = new Set(Object.keys(sentences));
  if (left.size === 0) return JSON.parse(text); // a reviver is called for each of many numbers
  const data = JSON.parse(text, (_, value) => {
    if (typeof value !== "string") return value;
    // a label is shown without the full stop of its sentence
    const known = [value, value.replace(/\.$/, "")].find((text) => Object.hasOwn(sentences, text));
    if (known === undefined) return value;
    left.delete(known);
    return sentences[known];
  });
  unknown.push(...left);
  return data;
}
