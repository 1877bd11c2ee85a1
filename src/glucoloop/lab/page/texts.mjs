// @ts-check
/** The page's texts in English, in one place; names of settings, patients and statuses come with the data. */

const MOST_TIMES = 8;

export const texts = {
  /** Texts of the elements that name them in lab.html. */
  page: {
    picture: "Picture",
    loading: "Loading the simulator.",
    about: "Close the loop of a virtual person with type 1 diabetes. Research software, not a medical device.",
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
    formToml: "configuration file (TOML)",
    formPython: "program in Python",
    situation: "Situation",
    lessons: "Lessons",
    presets: "Situations to begin with",
    patient: "Patient",
    point: "Operating point of parker-1999",
    meals: "Meals",
    addMeal: "Add a meal",
    duration: "Length of the run",
    controller: "Controller",
    usual: "Usual tuning",
    guard: "Guard around the controller",
    guardLimits: "Limits of the guard",
    pumpLimits: "Limits of the pump",
    faults: "Faults",
    faultKind: "Kind of fault",
    addFault: "Add this fault",
    sensor: "Sensor",
    seed: "Seed of the noise",
    load: "Load results",
    loadHelp: "Drop the folder of a run or of a trial anywhere on this page, or choose its files: trace.csv and run.toml of a run, report.html of a trial.",
    loadFiles: "Files of results",
    loadClear: "Take loaded results away",
    units: "Units",
    glucoseUnit: "Glucose",
    insulinUnit: "Insulin",
    remark: "The same definitions as the program, compiled to WebAssembly with portable arithmetic; this page asks the network nothing. Drawn with uPlot, MIT licence.",
  },
  ready: "Change anything; the picture follows at once.",
  fromLink: "This is the situation of the link.",
  otherVersion: (/** @type {string} */ there, /** @type {string} */ here) =>
    `The link was made by glucoloop ${there}, and this page is ${here}; numbers may differ.`,
  noVersion: "The link does not say which version made it; numbers may differ.",
  refusedLink: (/** @type {string} */ why) => `The link was not used: ${why}. This is the usual situation.`,
  refused: (/** @type {string} */ why) => `${why}. The picture is still that of the last possible situation.`,
  link: "link",
  forms: { command: "command", toml: "configuration", python: "program" },
  copied: (/** @type {string} */ what) => `The ${what} was copied.`,
  notCopied: "The browser does not allow copying; mark the text and copy it by hand.",
  saved: (/** @type {string} */ name) => `${name} was saved.`,
  /** Links to situations with what to look at; `beside` is a run that is pinned with it. */
  lessons: [
    {
      title: "What feedback can do",
      hash: "#controller=pid&closed_loop_min=100",
      text: "A slow loop gives insulin late, and too long: glucose rises to 119 mg/dl and then falls to 64. Pin this run and make the time constant of the loop shorter: at 10 min neither happens.",
    },
    {
      title: "Horizon and weights",
      hash: "#controller=mpc&prediction_horizon=20",
      text: "Pin this run, then predict 3 samples instead of 20: the controller acts earlier. A weight of 5 on the moves makes it slow, and lets glucose fall below 50 mg/dl. Move the slider below the picture to see what the controller expects at each sample.",
    },
    {
      title: "Dead time destabilises",
      hash: "#controller=mpc&dead_time_min=10",
      text: "Readings come ten minutes late, and the controller does not know it: insulin and glucose swing. More weight on the moves calms insulin, at the price of a lower low.",
    },
    {
      title: "The meal that nobody announced",
      hash: "#controller=pid&closed_loop_min=60&meals=90g%4060min",
      text: "No controller of this page is told of a meal. It sees glucose rise, when much of the meal is on its way, and its insulin still works when the meal has ended: glucose falls to 53 mg/dl. MPC/SE, which knows how insulin acts, keeps it above 77; a guard around the PID keeps it above 80, and lets it rise to 124.",
    },
  ],
  presets: [
    { title: "50 g of glucose, as in the paper", hash: "#controller=mpc" },
    { title: "The same with a noisy sensor", hash: "#controller=mpc&noise_variance=1.45" },
    { title: "A day with three meals", hash: "#controller=mpc-se&noise_variance=1.45&duration_min=1440&meals=45g%40420min+70g%40720min+60g%401080min" },
    { title: "A night without a meal", hash: "#controller=imc&noise_variance=1.45&duration_min=720&meals=" },
    { title: "A large dinner under a guard", hash: "#controller=mpc-se&noise_variance=1.45&guard=true&meals=120g%4060min" },
    { title: "A tuning for readings without noise, with noise", hash: "#controller=mpc&noise_variance=1.45&prediction_horizon=8&output_weight=1&move_weight=0" },
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
  mealTime: (/** @type {number} */ number) => `Meal ${number}, min`,
  mealSize: (/** @type {number} */ number) => `Meal ${number}, g`,
  removeMeal: (/** @type {number} */ number) => `Remove meal ${number}`,
  remove: "Remove",
  fault: (/** @type {number} */ number, /** @type {string} */ name) => `Fault ${number}: ${name}`,
  faultStart: "From, min",
  faultDuration: "For, min; nothing: to the end",
  removeFault: (/** @type {number} */ number) => `Remove fault ${number}`,
  faultSpan: (/** @type {string} */ name) => `Fault: ${name}`,
  unpin: (/** @type {string} */ name) => `Unpin ${name}`,
  unpinShort: "Unpin",
  hours: (/** @type {number} */ minutes) => `${minutes / 60} h`,
  numberOf: (/** @type {string} */ name) => `${name}, as a number`,
  noise: "Variance of the noise, (mg/dl)²",
  deadTime: "Dead time of the readings, min; the controller does not know it",
  pictureTitle: "Glucose and insulin of a simulated person",
  glucoseIn: (/** @type {string} */ unit, /** @type {string} */ low, /** @type {string} */ high) =>
    `Glucose in ${unit}; the shaded band is ${low} to ${high}, dots are readings; time in min`,
  insulinIn: (/** @type {string} */ unit, /** @type {string} */ most) =>
    `Insulin delivered in ${unit}, fine dashes where another rate was commanded; the pump gives at most ${most}`,
  commanded: "Commanded",
  median: (/** @type {string} */ name) => `Median of people, ${name}`,
  loadedRun: (/** @type {string} */ name, /** @type {string} */ difference, /** @type {string} */ unit) =>
    `${name} is drawn beside its situation, simulated here; at the samples, glucose differs by ${difference} ${unit} at most.`,
  loadedAlone: (/** @type {string} */ name, /** @type {string} */ why) => `${name} is drawn; it is not simulated here: ${why}.`,
  loadedPeople: (/** @type {string} */ name) =>
    `Behind the picture are the people of the trial under ${name}: half of them within the darker band, 90 % within the lighter one; ` +
    `the blue curve is the nominal person in the same situation.`,
  unlike: (/** @type {string[]} */ what) => `This page leaves out: ${what.join(", ")}.`,
  noSituation: "no configuration was given with it",
  nothingToLoad: "There is neither a trace.csv nor a page with percentiles among the files; give the folder of a run or of a trial",
  notLoaded: (/** @type {string} */ why) => `Nothing was loaded: ${why}.`,
  loaded: "Loaded run",
  ifKept: "Expected without this dose",
  ifDosed: "Expected with this dose",
  expects: (/** @type {Record<string, string>} */ of) =>
    `Its model expects ${of.kept} ${of.glucose_unit} at ${of.t} min if insulin stayed at ${of.rate} ${of.insulin_unit} (dotted), ` +
    `and ${of.dosed} with the delivered rate (dashed); the setpoint is ${of.setpoint}.`,
  moment: (
    /** @type {number} */ t,
    /** @type {string} */ glucose,
    /** @type {string} */ glucose_unit,
    /** @type {string} */ rate,
    /** @type {string} */ insulin_unit,
  ) => `${t} min: glucose ${glucose} ${glucose_unit}, insulin ${rate} ${insulin_unit}`,
  noMoment: "Point at the picture, or move the slider below it, to learn why a dose was given.",
  at: (/** @type {Record<string, string>} */ of) =>
    `At ${of.t} min: glucose ${of.glucose}, reading ${of.reading} ${of.glucose_unit}; ` +
    `insulin commanded ${of.commanded}, delivered ${of.delivered} ${of.insulin_unit}.`,
  acts: (/** @type {string} */ status, /** @type {number} */ total, /** @type {{from: number, to: number}[]} */ when) =>
    `${status} ${total} min: ${when.slice(0, MOST_TIMES).map(({ from, to }) => `${from} to ${to}`).join(", ")}` +
    (when.length > MOST_TIMES ? `, and ${when.length - MOST_TIMES} times more.` : "."),
  noActs: "The guard let every dose pass.",
  told: (/** @type {Record<string, string>} */ of) =>
    `Glucose goes from ${of.minimum} to ${of.peak} ${of.unit}, with a mean of ${of.mean}; ${of.inside} % of the time it is ` +
    `in the band. ${of.insulin} U of insulin are delivered.`,
};
