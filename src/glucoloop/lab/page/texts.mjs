// @ts-check
/** The page's texts in English, in one place. */

export const texts = {
  ready: "Change anything; the picture follows at once.",
  fromLink: "This is the situation of the link.",
  otherVersion: (/** @type {string} */ there, /** @type {string} */ here) =>
    `The link was made by glucoloop ${there}, and this page is ${here}; numbers may differ.`,
  noVersion: "The link does not say which version made it; numbers may differ.",
  refusedLink: (/** @type {string} */ why) => `The link was not used: ${why}. This is the usual situation.`,
  refused: (/** @type {string} */ why) => `${why}. The picture is still that of the last possible situation.`,
  copied: (/** @type {string} */ what) => `The ${what} was copied.`,
  notCopied: "The browser does not allow copying; mark the text and copy it by hand.",
  lessons: [
    {
      title: "Feedback alone",
      hash: "#controller=pid&closed_loop_min=100",
      text: "A slow loop gives insulin late, and too long. Make the time constant of the loop shorter, and watch both the peak and the low after the meal.",
    },
    {
      title: "Horizon and weight",
      hash: "#controller=mpc&prediction_horizon=20",
      text: "Pin this run, then predict fewer samples: the controller acts earlier. A weight on the moves makes it slow, and lets glucose fall far below 70 mg/dl.",
    },
    {
      title: "Dead time",
      hash: "#controller=mpc&dead_time_min=10",
      text: "Readings come ten minutes late, and the controller does not know it: insulin and glucose swing. More weight on the moves calms insulin, at the price of a lower low.",
    },
    {
      title: "Noise",
      hash: "#controller=mpc&noise_variance=1.45&prediction_horizon=8&output_weight=1&move_weight=0",
      text: "The tuning for readings without noise follows every error of the sensor. The usual tuning for noise moves insulin a fifth as much.",
    },
    {
      title: "A guard",
      hash: "#controller=mpc&guard=true",
      text: "The guard knows nothing of meals: it bounds insulin on board, so that glucose stays above 79 mg/dl and rises to 113. Pin it, and take the guard away.",
    },
  ],
  now: "Now",
  run: (/** @type {number} */ number) => `Run ${number}`,
  mealTime: (/** @type {number} */ number) => `Meal ${number} at, min`,
  mealSize: (/** @type {number} */ number) => `Meal ${number}, g`,
  removeMeal: (/** @type {number} */ number) => `Remove meal ${number}`,
  remove: "Remove",
  unpin: (/** @type {string} */ name) => `Unpin ${name}`,
  unpinShort: "Unpin",
  hours: (/** @type {number} */ minutes) => `${minutes / 60} h`,
  numberOf: (/** @type {string} */ name) => `${name}, as a number`,
  noise: "Variance of the noise, (mg/dl)²",
  deadTime: "Dead time of the readings, min; the controller does not know it",
  time: "Time, min",
  glucose: "Glucose",
  reading: "Readings",
  insulin: "Insulin",
  at: (/** @type {number} */ t, /** @type {string} */ glucose, /** @type {string} */ reading, /** @type {string} */ rate) =>
    `At ${t} min: glucose ${glucose}, reading ${reading} mg/dl, insulin ${rate} mU/min.`,
  told: (/** @type {Record<string, string>} */ of) =>
    `Glucose goes from ${of.minimum} to ${of.peak} mg/dl, with a mean of ${of.mean}; ${of.inside} % of the time it is ` +
    `between 70 and 180 mg/dl. ${of.insulin} U of insulin are delivered.`,
};
