// Answers calls of the npm package oref0, one JSON line each: [a name of `answers`, arguments].
process.env.TZ = "UTC";
const readline = require("readline");
const path = require("path");

const modules = process.argv[2];
const oref0 = (file) => require(path.join(modules, "oref0", "lib", file));
const tempBasal = oref0("basal-set-temp");
const determineBasal = oref0("determine-basal/determine-basal");
const total = oref0("iob/total");
const calculate = oref0("iob/calculate");
const history = oref0("iob");
const meal = oref0("meal/total");
const detectCarbAbsorption = oref0("determine-basal/cob");
const glucoseGetLast = oref0("glucose-get-last");
const profileOf = oref0("profile");

const now = Date.UTC(2020, 0, 15, 12, 0, 0);
const at = (minutesAgo) => new Date(now - minutesAgo * 60000);
const tell = (text) => process.stdout.write(text);
// The package talks on both streams; only answers belong here.
process.stderr.write = () => true;
console.log = console.error = () => {};

/** What a function answers at a minute of the day, which the package asks the clock for. */
const atMinute = (minute, answer) => {
  const Clock = Date;
  global.Date = class extends Clock {
    constructor(...given) {
      super(...(given.length ? given : [Clock.UTC(2020, 0, 15) + minute * 60000]));
    }
  };
  try {
    return answer();
  } finally {
    global.Date = Clock;
  }
};

const seen = (readings, profile) => {
  const basalprofile = [{ i: 0, minutes: 0, rate: profile.current_basal }];
  const isfProfile = { sensitivities: [{ offset: 0, sensitivity: profile.sens, endOffset: 1440 }] };
  const glucose = readings.map(([ago, value]) => ({
    date: at(ago).getTime(),
    dateString: at(ago).toISOString(),
    glucose: value,
  }));
  return { glucose, basalprofile, whose: { ...profile, isfProfile, basalprofile } };
};

const answers = {
  dose({ glucose, temp, iob, profile, meal: food, allowed }) {
    const status = { ...glucose };
    if ("minutes_ago" in glucose) status.date = at(glucose.minutes_ago).getTime();
    const insulin = JSON.parse(JSON.stringify(iob));
    const first = Array.isArray(insulin) ? insulin[0] : insulin;
    if ("last_bolus_age" in first) first.lastBolusTime = at(first.last_bolus_age).getTime();
    const eaten = { ...food };
    if ("last_carb_age" in food) eaten.lastCarbTime = at(food.last_carb_age).getTime();
    const told = determineBasal(status, temp, insulin, profile, { ratio: 1 }, eaten, tempBasal, allowed, 100, at(0));
    const { rate, duration, units, reason, error, predBGs } = told;
    return { rate, duration, units, reason, error, predBGs };
  },
  // The profile at a minute of the day, by segments [[minute, value], ...] and temporary targets
  // [[minute, minutes, mg/dl], ...], of which one of 0 minutes ends those before it; and the dose by it.
  scheduled({ minute, basal, ratio, sensitivity, target, temporary, dose }) {
    const inputs = {
      settings: { insulin_action_curve: 6, maxBasal: dose.profile.max_basal },
      basals: basal.map(([minutes, rate], i) => ({ i, minutes, rate })),
      carbratio: { units: "grams", schedule: ratio.map(([offset, value]) => ({ offset, ratio: value })) },
      isf: { sensitivities: sensitivity.map(([offset, value]) => ({ offset, sensitivity: value })) },
      targets: { targets: target.map(([offset, value]) => ({ offset, low: value, high: value })) },
      temptargets: temporary.map(([from, duration, value]) => ({
        created_at: new Date(Date.UTC(2020, 0, 15) + from * 60000).toISOString(),
        duration,
        ...(duration ? { targetTop: value, targetBottom: value } : {}),
      })),
    };
    const told = atMinute(minute, () => profileOf({ stdout: "", err: "", return_val: 0 }, inputs));
    const { current_basal, max_daily_basal, sens, carb_ratio, min_bg, max_bg, temptargetSet } = told;
    const whose = { current_basal, max_daily_basal, sens, carb_ratio, min_bg, max_bg, temptargetSet };
    return { ...answers.dose({ ...dose, profile: { ...dose.profile, ...whose } }), profile: whose };
  },
  // Insulin on board at `ahead` minutes from now, of treatments [[minutes ago, U], ...].
  iob({ treatments, profile, ahead }) {
    const given = treatments.map(([ago, insulin]) => ({ date: at(ago).getTime(), insulin }));
    return ahead.map((minutes) => {
      const found = total({ treatments: given, profile, calculate }, at(-minutes));
      return [found.iob, found.activity];
    });
  },
  // The same from the history of a pump: temporary basal rates [[minutes ago, U/h, minutes], ...] and boluses.
  history({ temps, boluses, profile }) {
    const events = temps.flatMap(([ago, rate, duration]) => [
      { _type: "TempBasal", temp: "absolute", rate, timestamp: at(ago).toISOString() },
      { _type: "TempBasalDuration", "duration (min)": duration, timestamp: at(ago).toISOString() },
    ]);
    for (const [ago, amount] of boluses) events.push({ _type: "Bolus", amount, timestamp: at(ago).toISOString() });
    events.sort((one, other) => (one.timestamp < other.timestamp ? 1 : -1));
    const found = history({ history: events, profile, clock: at(0).toISOString() });
    return found.map((tick) => [tick.iob, tick.activity, tick.iobWithZeroTemp.activity]);
  },
  // Readings [[minutes ago, mg/dl], ...], the newest first.
  glucose: ({ readings }) => glucoseGetLast(readings.map(([ago, glucose]) => ({ date: at(ago).getTime(), glucose }))),
  // Meals [[minutes ago, g], ...].
  meal({ readings, carbs, profile }) {
    const food = carbs.map(([ago, g]) => ({ carbs: g, nsCarbs: g, timestamp: at(ago).toISOString() }));
    const { glucose, basalprofile, whose } = seen(readings, profile);
    return meal({ treatments: food, profile: whose, pumphistory: [], glucose, basalprofile }, at(0));
  },
  // Carbohydrate that was absorbed since a meal, and how deviations change if that is asked for.
  absorption({ readings, treatments, profile, since, now: changes }) {
    const { glucose, basalprofile, whose } = seen(readings, profile);
    const boluses = treatments.map(([ago, amount]) => ({ _type: "Bolus", amount, timestamp: at(ago).toISOString() }));
    const iobInputs = { profile: whose, history: boluses };
    const inputs = { glucose_data: glucose, iob_inputs: iobInputs, basalprofile, mealTime: at(since).getTime() };
    return detectCarbAbsorption(changes ? { ...inputs, ciTime: now } : inputs);
  },
};

readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const [asked, given] = JSON.parse(line);
  tell(`${JSON.stringify(answers[asked](given))}\n`);
});
