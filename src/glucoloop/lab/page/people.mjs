// @ts-check
/**
 * People of a population: each is drawn as `glucoloop.patients.population` draws him, has a plant and a gut of his own, and
 * rests at the setpoint under a basal rate of his own.
 */

import { driven } from "./driven.mjs";
import { Rest } from "./rest.mjs";
import { functionOf } from "./stage.mjs";
import { uniform } from "./threefry.mjs";

/** @typedef {import("./lab.mjs").Lab} Lab */
/** @typedef {import("./stage.mjs").Body} Body */

/** The people of a page by the patient around whom they are drawn. @type {WeakMap<Lab, Map<string, (first: number) => Body[]>>} */
const known = new WeakMap();

/**
 * The people around a patient, at rest; each is made once. Who has no basal rate has NaN for it.
 * @param {Lab} lab
 * @param {string} patient that has people
 * @returns {(first: number) => Body[]} those of the vector that begins with a person
 */
export function peopleOf(lab, patient) {
  const of = known.get(lab) ?? new Map();
  known.set(lab, of);
  const found = of.get(patient) ?? drawn(lab, patient);
  of.set(patient, found);
  return found;
}

/** @param {Lab} lab @param {string} patient @returns {(first: number) => Body[]} */
function drawn(lab, patient) {
  const { data } = lab;
  const { lanes } = lab.kernels;
  const nominal = data.patients[patient];
  const of = data.people[nominal.family];
  const draw = lab.stage("draw");
  const stage = lab.stage(functionOf(nominal.family, "person"));
  const { outputs } = stage.fields;
  const size = { numbers: outputs.numbers, rates: outputs.rates, x: outputs.x, gut: nominal.gut.length };
  const distributions = of.parameters.map(({ distribution }) => Object.keys(draw.fields.shared).map((name) => distribution[name]));
  /** What the function of a person tells of him. @param {string} name @param {number} count @param {number} lane */
  const told = (name, count, lane) => {
    const at = stage.place(name, "outputs");
    return Array.from({ length: count }, (_, i) => stage.outputs[(at + i) * lanes + lane]);
  };
  /** @param {number} lane @returns {Body} */
  const begun = (lane) => {
    const matrices = driven(told("rates", size.rates, lane), of);
    const body = {
      ...nominal,
      numbers: told("numbers", size.numbers, lane),
      gut: size.gut > 0 ? told("gut.0", size.gut, lane) : nominal.gut,
      driven: of.driven.map((place) => matrices[place]),
    };
    if (size.x === undefined) return body;
    const [basal_insulin_mU_min] = told("basal_insulin_mU_min", 1, lane);
    const [glucose_mg_dl] = told("glucose_mg_dl", 1, lane);
    return { ...body, basal_insulin_mU_min, glucose_mg_dl, x: told("x", size.x, lane) };
  };
  /** What brings people to rest whose function does not. @type {Rest | undefined} made when somebody is asked for */
  let rest;
  /** @param {number} first */
  const made = (first) => {
    of.parameters.forEach(({ word }, parameter) => {
      draw.shared.set(distributions[parameter]);
      for (let lane = 0; lane < lanes; lane++) draw.own[lane] = uniform(of.seed, word, first + lane);
      draw.step();
      for (let lane = 0; lane < lanes; lane++) stage.own[parameter * lanes + lane] = draw.outputs[lane];
    });
    stage.step();
    const people = Array.from({ length: lanes }, (_, lane) => begun(lane));
    if (size.x !== undefined) return people;
    rest ??= new Rest(lab, patient);
    return rest.bring(people);
  };
  /** @type {Map<number, Body[]>} */
  const kept = new Map();
  return (first) => {
    const found = kept.get(first) ?? made(first);
    kept.set(first, found);
    return found;
  };
}

/**
 * One of the people around a patient; null if no rate holds the setpoint of that one.
 * @param {Lab} lab
 * @param {string} patient
 * @param {number} person
 */
export function personOf(lab, patient, person) {
  const lane = person % lab.kernels.lanes;
  const body = peopleOf(lab, patient)(person - lane)[lane];
  return rests(body) ? body : null;
}

/** Whether a rate holds a person at the setpoint. @param {Body} body */
export function rests({ basal_insulin_mU_min }) {
  return basal_insulin_mU_min >= 0;
}
