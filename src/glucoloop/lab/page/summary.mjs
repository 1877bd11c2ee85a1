// @ts-check
/** The numbers below the picture. */

/** @typedef {import("./lab.mjs").Trace} Trace */

/** @typedef {ReturnType<typeof summed>} Summary */
/** @type {WeakMap<Trace, Summary>} */
const summaries = new WeakMap();

/**
 * The numbers below the picture, as `glucoloop run` gives them; of each trace they are computed once.
 * @param {Trace} trace
 * @returns {Summary}
 */
export function summary(trace) {
  const found = summaries.get(trace) ?? summed(trace);
  summaries.set(trace, found);
  return found;
}

/** @param {Trace} trace */
function summed({ fine_glucose_mg_dl: glucose, insulin_mU_min, bolus_mU, t_min }) {
  let [sum, minimum_mg_dl, peak_mg_dl, inside, below, insulin] = [0, Infinity, -Infinity, 0, 0, 0];
  for (let i = 0; i < glucose.length; i++) {
    const value = glucose[i];
    sum += value;
    if (value < minimum_mg_dl) minimum_mg_dl = value;
    if (value > peak_mg_dl) peak_mg_dl = value;
    if (value < 70) below += 1;
    else if (value <= 180) inside += 1;
  }
  for (const rate of insulin_mU_min) insulin += rate;
  let boluses = 0;
  for (const bolus of bolus_mU) boluses += bolus;
  return {
    mean_mg_dl: sum / glucose.length,
    minimum_mg_dl,
    peak_mg_dl,
    time_70_180_pct: (100 * inside) / glucose.length,
    time_below_70_pct: (100 * below) / glucose.length,
    insulin_total_mU: insulin * (t_min.length > 1 ? t_min[1] - t_min[0] : 0) + boluses,
  };
}
