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

/** The people around a patient, at rest, a vector of them at a time; each is made once. Who has no basal rate has NaN for it. */
class People {
  /** @param {Lab} lab @param {string} patient that has people */
  constructor(lab, patient) {
    this.lab = lab;
    this.patient = patient;
    this.nominal = lab.data.patients[patient];
    this.of = lab.data.people[this.nominal.family];
    this.draw = lab.stage("draw");
    /** What follows from the parameters of a person. */
    this.stage = lab.stage(functionOf(this.nominal.family, "person"));
    this.outputs = this.stage.fields.outputs;
    /** Numbers of each distribution, in the order in which a draw takes them. */
    this.distributions = this.of.parameters.map(({ distribution }) => Object.keys(this.draw.fields.shared).map((name) => distribution[name]));
    /** What brings people to rest whose function does not. @type {Rest | undefined} made when somebody is asked for */
    this.rest = undefined;
    /** @type {Map<number, Body[]>} */
    this.made = new Map();
  }

  /** The vector that begins with a person. @param {number} first @returns {Body[]} */
  from(first) {
    const found = this.made.get(first) ?? this.make(first);
    this.made.set(first, found);
    return found;
  }

  /** @param {number} first @returns {Body[]} */
  make(first) {
    const { lab, of, draw, stage, outputs } = this;
    const { lanes } = lab.kernels;
    const { given } = of;
    if (given !== undefined) {
      for (let i = 0; i < stage.own.length; i++) stage.own[i] = given[Math.min(first + (i % lanes), of.count - 1)][Math.floor(i / lanes)];
    } else of.parameters.forEach(({ word }, parameter) => {
      draw.shared.set(this.distributions[parameter]);
      for (let lane = 0; lane < lanes; lane++) draw.own[lane] = uniform(of.seed, word, first + lane);
      draw.step();
      for (let lane = 0; lane < lanes; lane++) stage.own[parameter * lanes + lane] = draw.outputs[lane];
    });
    stage.step();
    const people = Array.from({ length: lanes }, (_, lane) => this.person(lane));
    if ("x" in outputs) return people;
    this.rest ??= new Rest(lab, this.patient);
    return this.rest.bring(people);
  }

  /** The person whose numbers the function gave last; of whom it finds no rest, that is the nominal patient's. @param {number} lane @returns {Body} */
  person(lane) {
    const { nominal, of, outputs } = this;
    const matrices = driven(this.told("rates", outputs.rates, lane), of);
    const body = {
      ...nominal,
      numbers: this.told("numbers", outputs.numbers, lane),
      gut: nominal.gut.length > 0 ? this.told("gut.0", nominal.gut.length, lane) : nominal.gut,
      driven: of.driven.map((place) => matrices[place]),
    };
    if (!("x" in outputs)) return body;
    const [[basal_insulin_mU_min], [glucose_mg_dl]] = ["basal_insulin_mU_min", "glucose_mg_dl"].map((name) => this.told(name, 1, lane));
    return { ...body, basal_insulin_mU_min, glucose_mg_dl, x: this.told("x", outputs.x, lane) };
  }

  /** Numbers that the function gave of a person. @param {string} name of the first @param {number} count @param {number} lane */
  told(name, count, lane) {
    const { stage } = this;
    const at = stage.place(name, "outputs");
    return Array.from({ length: count }, (_, i) => stage.outputs[(at + i) * stage.lanes + lane]);
  }
}

/** People of a page by the patient around whom they are drawn. @type {WeakMap<Lab, Map<string, People>>} */
const known = new WeakMap();

/** The people around a patient. @param {Lab} lab @param {string} patient that has people @returns {People} */
export function peopleOf(lab, patient) {
  const ofLab = known.get(lab) ?? new Map();
  known.set(lab, ofLab);
  const found = ofLab.get(patient) ?? new People(lab, patient);
  ofLab.set(patient, found);
  return found;
}

/**
 * One of the people around a patient; null if no rate holds the setpoint of that one.
 * @param {Lab} lab
 * @param {string} patient
 * @param {number} person
 */
export function personOf(lab, patient, person) {
  const lane = person % lab.kernels.lanes;
  const body = peopleOf(lab, patient).from(person - lane)[lane];
  return rests(body) ? body : null;
}

/** Whether a rate holds a person at the setpoint. @param {Body} body */
export function rests({ basal_insulin_mU_min }) {
  return basal_insulin_mU_min >= 0;
}
