// @ts-check
/** Why this dose: what happened at the moment that is explained. */

import { byId, tell } from "../dom.mjs";
import { texts } from "../texts.mjs";
import { inUnits, shown } from "../units.mjs";

/** @param {import("../session.mjs").Session} session */
export function whyView(session) {
  return () => {
    const k = session.moment;
    if (k === null) {
      tell(byId("why"), texts.noMoment);
      return;
    }
    const { trace } = session.run;
    const { glucose, insulin } = session.units;
    const reading = trace.reading_mg_dl[k];
    const bolus_mU = trace.bolus_mU[k];
    const told = texts.at({
      t: `${trace.t_min[k]}`,
      glucose: shown(trace.glucose_mg_dl[k], glucose),
      reading: Number.isFinite(reading) ? texts.reading(shown(reading, glucose), glucose.name) : texts.noReading,
      glucose_unit: glucose.name,
      commanded: shown(trace.command_mU_min[k], insulin),
      delivered: shown(trace.insulin_mU_min[k], insulin),
      insulin_unit: insulin.name,
      bolus: bolus_mU > 0 ? texts.bolus(inUnits(bolus_mU)) : "",
    });
    const reason = expectation(session) || terms(session);
    tell(byId("why"), [told, session.data.statuses[trace.status[k]], reason].filter(Boolean).join(" "));
  };
}

/** What the controller expects, in words. @param {import("../session.mjs").Session} session */
function expectation(session) {
  const { prediction, data, situation } = session;
  if (prediction === null) return "";
  const { glucose, insulin } = session.units;
  const last = prediction.t_min.length - 1;
  return texts.expects({
    t: `${prediction.t_min[last]}`,
    kept: shown(prediction.free_mg_dl[last], glucose),
    dosed: shown(prediction.dosed_mg_dl[last], glucose),
    rate: shown(prediction.rate_mU_min, insulin),
    setpoint: shown(data.patients[situation.patient].setpoint_mg_dl, glucose),
    glucose_unit: glucose.name,
    insulin_unit: insulin.name,
  });
}

/** Of what the dose of a controller that does not predict is made, in words. @param {import("../session.mjs").Session} session */
function terms(session) {
  const found = session.terms;
  if (found === null) return "";
  const { glucose, insulin } = session.units;
  const rate = (/** @type {number} */ of) => shown(of, insulin);
  const signed = (/** @type {string} */ text) => (text.startsWith("-") ? text.replace("-", "\u2212") : `+${text}`);
  if ("pid" in found) {
    const { proportional_mU_min, integral_mU_min, derivative_mU_min } = found.pid;
    const [p, i, d] = [proportional_mU_min, integral_mU_min, derivative_mU_min];
    return texts.pidTerms({ sum: rate(p + i + d), p: signed(rate(p)), i: rate(i), d: signed(rate(d)), unit: insulin.name });
  }
  const level = (/** @type {number} */ of) => signed(shown(of, glucose));
  const { model_mg_dl, rest_mg_dl, filtered_mg_dl, wanted_mU_min } = found.imc;
  return texts.imcTerms({
    model: level(model_mg_dl),
    rest: level(rest_mg_dl),
    filtered: level(filtered_mg_dl),
    wanted: rate(wanted_mU_min),
    glucose_unit: glucose.name,
    unit: insulin.name,
  });
}
